#include "report/front_end_section.hpp"

#include <algorithm>
#include <cmath>

#include "evaluate/truth.hpp"
#include "report/figure_parts.hpp"
#include "report/page_parts.hpp"
#include "report/svg_plot.hpp"

namespace convoy::cli {

namespace fs = std::filesystem;
using figures::Point;
using nlohmann::json;
using Frames = std::vector<FrontEndFrame>;

namespace {

constexpr std::size_t most_pictures = 6;

std::string shown(const json& value, int decimals, const std::string& unit) {
  if (!value.is_number()) return "\u2013";
  return fixed(value.get<double>(), decimals) + (unit.empty() ? "" : " " + unit);
}

std::string tile(const std::string& value, const std::string& what) {
  return "<div class=\"tile\"><b>" + xml_escaped(value) + "</b><span>" + xml_escaped(what) + "</span></div>\n";
}

std::string tiles(const json& m) {
  std::string out = "<div class=\"tiles\">\n";
  out += tile(shown(m.at("frames"), 0, ""), "frames");
  out += tile(shown(m.at("ms_p50"), 2, "ms"), "per frame, median");
  out += tile(shown(m.at("ms_p95"), 2, "ms"), "95 % take less");
  out += tile(shown(m.at("ms_max"), 2, "ms"), "longest");
  out += tile(shown(m.at("tracked_p50"), 0, ""), "features found again, median");
  out += tile(shown(m.at("track_length_mean"), 1, ""), "frames per track, mean");
  if (m.at("path_m").is_number()) {
    out += tile(shown(m.at("path_m"), 0, "m"), "driven");
    out += tile(shown(m.at("exports_per_100m"), 0, ""), "landmarks exported per 100 m");
    out += tile(shown(m.at("drift_percent"), 2, "%"), "drift at the end");
    out += tile(shown(m.at("drift_percent_100m"), 2, "%"), "drift over 100 m, mean");
    out += tile(shown(m.at("odometry_drift_percent"), 2, "%"), "drift of the odometer alone");
    out += tile(shown(m.at("lost_epochs"), 0, ""), "times lost");
  }
  return out + "</div>\n";
}

template <class Value>
std::vector<Point> over_time(const Frames& frames, const Value& value) {
  std::vector<Point> points;
  for (const FrontEndFrame& f : frames) points.emplace_back(f.t_s, static_cast<double>(value(f)));
  return points;
}

std::string figure(const std::string& title, const std::string& body, const std::string& caption) {
  return "<h3>" + xml_escaped(title) + "</h3>\n<figure>\n" + body + "<figcaption>" + xml_escaped(caption) +
         "</figcaption>\n</figure>\n";
}

std::string time_figure(const Frames& frames, const json& m) {
  SvgPlot time(figures::page_width, 240.0), features(figures::page_width, 280.0);
  time.x_label("time [s]");
  time.y_label("per frame [ms]");
  time.log_y(0.1);
  time.line(over_time(frames, [](const FrontEndFrame& f) { return f.took_ms; }), {figures::convoy_color, 1.0}, "took");
  const double first_s = frames.front().t_s, last_s = frames.back().t_s;
  for (const auto& [key, dash] : {std::pair{"ms_p50", ""}, std::pair{"ms_p95", "5 4"}})
    time.line({{first_s, m.at(key).get<double>()}, {last_s, m.at(key).get<double>()}}, {"#5b6770", 1.2, dash},
              key == std::string("ms_p50") ? "median" : "95 %");
  features.x_label("time [s]");
  features.y_label("features");
  features.include({0.0, 0.0});
  features.line(over_time(frames, [](const FrontEndFrame& f) { return f.sought; }), {"#b6bec7", 1.0}, "looked for");
  features.line(over_time(frames, [](const FrontEndFrame& f) { return f.tracked; }), {"#ff9d00", 1.2}, "found again");
  if (frames.back().epoch > 0) {
    features.line(over_time(frames, [](const FrontEndFrame& f) { return f.landmarks; }), {"#1f5fbf", 1.2},
                  "of them landmarks");
    if (std::any_of(frames.begin(), frames.end(), [](const FrontEndFrame& f) { return f.converged > 0; }))
      features.line(over_time(frames, [](const FrontEndFrame& f) { return f.converged; }), {"#2f9e63", 1.2},
                    "converged");
  }
  return figure("Time and features", time.svg() + features.svg(),
                "Wall time of each frame (logarithmic), all that the front end does with it, and what became of the "
                "tracks in it. A landmark has a place; a converged one will be exported unless something speaks "
                "against it.");
}

/// From the pose at the first image that has a truth, as both begin there.
std::string path_figure(const Frames& frames, const std::vector<TruthPose<SE3>>& truth, const json& m) {
  std::vector<Point> path, odometry, true_path, height, true_height;
  std::optional<SE3> T_start_world;
  for (const FrontEndFrame& f : frames) {
    const Eigen::Vector3d p = f.T_start_body.translation();
    path.emplace_back(p.head<2>());
    height.emplace_back(f.path_m, p.z());
    odometry.emplace_back(f.T_start_odometry.translation().head<2>());
    const auto pose = truth_at(truth, f.t_s);
    if (!pose) continue;
    if (!T_start_world) T_start_world = f.T_start_body * pose->inverse();
    const Eigen::Vector3d q = *T_start_world * pose->translation();
    true_path.emplace_back(q.head<2>());
    true_height.emplace_back(f.path_m, q.z());
  }
  SvgPlot above(figures::page_width, 500.0), side(figures::page_width, 220.0);
  figures::metres(above);
  above.equal_aspect(180.0, 620.0);
  above.line(odometry, {"#9aa5b1", 1.2, "5 4"}, "odometer alone");
  above.line(true_path, {figures::truth_color, 2.6}, "truth");
  above.line(path, {figures::convoy_color, 1.5}, "front end");
  side.x_label("path [m]");
  side.y_label("height [m]");
  side.include({0.0, -0.5});
  side.include({0.0, 0.5});
  side.line(true_height, {figures::truth_color, 2.6}, "truth");
  side.line(height, {figures::convoy_color, 1.5}, "front end");
  const std::string drift =
      m.at("drift_percent").is_number()
          ? "Both begin in the same pose, and nothing is fitted. At the end the front end is off by " +
                shown(m.at("drift_percent"), 2, "%") + " of the distance driven, the odometer alone by " +
                shown(m.at("odometry_drift_percent"), 2, "%") + "."
          : "There is no truth to judge it by.";
  const bool flat = std::all_of(height.begin(), height.end(), [](const Point& p) { return p.y() == 0.0; });
  return flat ? figure("Path", above.svg(), "Live poses, from above. " + drift)
              : figure("Path", above.svg() + side.svg(), "Live poses, from above, and heights. " + drift);
}

std::string picture_figure(const fs::path& folder, bool with_depths) {
  std::vector<std::string> names;
  std::error_code none;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder / "frames", none))
    if (entry.path().extension() == ".png") names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  std::string cells;
  for (const std::string& name : figures::spread(names, most_pictures))
    cells += figures::cell("<img src=\"frames/" + xml_escaped(name) + "\" alt=\"image " + xml_escaped(name) + "\"/>",
                           "half");
  if (cells.empty()) return "";
  return figure("Features in the images", figures::row_of(cells),
                std::string("Some images of the recording, with what was found in them: ") +
                    (with_depths ? "green, converged landmarks; blue, landmarks; orange, candidates, of unknown depth"
                                 : "orange, what was found again, all of unknown depth") +
                    "; grey, new ones. All that were kept are in frames/.");
}

}  // namespace

std::string front_end_section(const json& front_end, const Frames& frames, const std::vector<TruthPose<SE3>>& truth,
                              const fs::path& folder) {
  std::string out = "<section>\n<h2>Front end</h2>\n" + tiles(front_end) + time_figure(frames, front_end);
  if (frames.back().epoch > 0) out += path_figure(frames, truth, front_end);
  return out + picture_figure(folder, frames.back().epoch > 0) + "</section>\n";
}

std::string front_end_section(const json& front_end, const json& vehicles, const std::vector<FrontEndDrive>& drives) {
  std::string out = "<section>\n<h2>Front ends</h2>\n" + tiles(front_end);
  for (std::size_t i = 0; i < drives.size(); ++i) {
    const json& own = vehicles.at(i).at("front_end");
    if (own.is_null()) continue;
    out += "<h2>Vehicle " + vehicles.at(i).at("id").dump() + "</h2>\n" + time_figure(drives[i].frames, own) +
           path_figure(drives[i].frames, drives[i].truth, own);
  }
  return out + "</section>\n";
}

std::string make_front_end_page(const json& metrics, const Frames& frames, const fs::path& folder) {
  return page_begin("convoy: replay") + "<h1>convoy: images of a recording</h1>\n<p class=\"lead\">" +
         xml_escaped(metrics.at("notice").get<std::string>()) + ".</p>\n<p class=\"source\">" +
         xml_escaped(metrics.at("source").get<std::string>()) + "</p>\n" +
         front_end_section(metrics.at("front_end"), frames, {}, folder) + page_end();
}

}  // namespace convoy::cli
