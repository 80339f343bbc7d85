#include "report/figures.hpp"

#include <algorithm>
#include <cmath>

#include "report/figure_parts.hpp"

namespace convoy::cli {

using nlohmann::json;

template <class G>
std::string gauge_note(const RunRecord<G>& run, const json& m) {
  if (!m.at("gauge_shift_m").is_number()) return "";
  for (const json& v : m.at("vehicles")) {
    if (v.at("id") != json(run.common_frame_vehicle) || !v.at("pose_anees_fit").is_number() ||
        !v.at("pose_anees_start").is_number())
      continue;
    const auto of = [&v](const std::string& gauge) {
      return fixed(v.at("pose_anees_" + gauge).get<double>(), 2) + " (" +
             fixed(100.0 * v.at("pose_coverage95_" + gauge).get<double>(), 1) + " % within the bound)";
    };
    return " Here the two lie " + fixed(m.at("gauge_shift_m").get<double>(), 3) + " m and " +
           fixed(m.at("gauge_turn_rad").get<double>() * 180.0 / M_PI, 1) + " degrees apart. The start of " +
           the_vehicle(run, run.common_frame_vehicle) +
           " is the origin of the common frame and known exactly, so whatever the fit is off counts in full against "
           "its first "
           "poses: its ANEES is " +
           of("fit") + " in gauge fit and " + of("start") + " in gauge start.";
  }
  return "";
}

template <class G>
std::string vehicle_name(const RunRecord<G>& run, VehicleId id) {
  if ((run.scenario == "street" || run.scenario == "camera") && run.vehicles.size() == 2) return id == 1 ? "front vehicle" : "back vehicle";
  return "robot " + std::to_string(id);
}

template <class G>
std::string vehicle_color(const RunRecord<G>& run, VehicleId id) {
  static const char* const colors[] = {"#1a8f3c", "#1f5fbf", "#e07b00", "#8e3fb5", "#7a5230",
                                       "#009aa6", "#b8860b", "#5b6770", "#c2185b", "#4b7a00"};
  const auto it = std::find_if(run.vehicles.begin(), run.vehicles.end(), [id](const auto& v) { return v.id == id; });
  return colors[static_cast<std::size_t>(it - run.vehicles.begin()) % std::size(colors)];
}

template <class G>
std::string the_vehicle(const RunRecord<G>& run, VehicleId id) {
  const std::string name = vehicle_name(run, id);
  return name.ends_with("vehicle") ? "the " + name : name;
}

template <class G>
std::vector<Figure> make_figures(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  if (run.vehicles.empty()) return {};
  std::vector<Figure> all{figures::slam_only(run, evaluation), figures::drift_of_first(run, evaluation)};
  if (run.vehicles.size() > 1) all.push_back(figures::drift_of_others(run, evaluation));
  all.push_back(figures::common_map(run, evaluation));
  if constexpr (G::Dim == 3) all.push_back(figures::height_profile(run, evaluation));
  all.push_back(figures::bytes_sent(run, evaluation));
  if (run.vehicles.size() > 1) all.push_back(figures::distances(run, evaluation));
  all.push_back(figures::consistency(run, evaluation));
  return all;
}

#define CONVOY_INSTANTIATE(G)                                         \
  template std::string gauge_note(const RunRecord<G>&, const json&);  \
  template std::string vehicle_name(const RunRecord<G>&, VehicleId);  \
  template std::string vehicle_color(const RunRecord<G>&, VehicleId); \
  template std::string the_vehicle(const RunRecord<G>&, VehicleId);   \
  template std::vector<Figure> make_figures(const RunRecord<G>&, const Evaluation<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
