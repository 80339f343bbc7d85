#include "replay/outcome.hpp"

#include <cstdio>

namespace convoy::cli {

namespace {

std::string show(const nlohmann::json& value, const char* format) {
  char text[48];
  if (!value.is_number()) return "-";
  std::snprintf(text, sizeof text, format, value.get<double>());
  return text;
}

}  // namespace

void print_front_end(const nlohmann::json& m, const std::string& frames) {
  std::printf("%s %s, %s ms (95 %%: %s, longest %s), %s features followed, over %s %s each\n",
              show(m.at("frames"), "%.0f").c_str(), frames.c_str(), show(m.at("ms_p50"), "%.2f").c_str(),
              show(m.at("ms_p95"), "%.2f").c_str(), show(m.at("ms_max"), "%.2f").c_str(),
              show(m.at("tracked_p50"), "%.0f").c_str(), show(m.at("track_length_mean"), "%.1f").c_str(),
              frames.c_str());
  if (m.at("path_m").is_null()) return;
  std::printf("%s m driven, %s landmarks exported per 100 m, lost %s times; drift %s %% (odometer alone: %s %%)\n",
              show(m.at("path_m"), "%.1f").c_str(), show(m.at("exports_per_100m"), "%.0f").c_str(),
              show(m.at("lost_epochs"), "%.0f").c_str(), show(m.at("drift_percent"), "%.2f").c_str(),
              show(m.at("odometry_drift_percent"), "%.2f").c_str());
}

void print_where(const std::filesystem::path& out) {
  std::printf("Report:  %s\nMetrics: %s\n", std::filesystem::absolute(out / "report.html").c_str(),
              std::filesystem::absolute(out / "metrics.json").c_str());
}

}  // namespace convoy::cli
