#include "evaluate/front_end_record.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <string>

#include "evaluate/truth.hpp"
#include "scenario/pose_columns.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {

using nlohmann::json;
using Frames = std::vector<FrontEndFrame>;

namespace {

constexpr double part_m = 100.0;
constexpr std::size_t part_step = 10;  // frames from one part's start to the next

const std::string header = "t_s,epoch,path_m," + pose_header<SE3>("") + "," + pose_header<SE3>("odometry_") +
                           ",took_ms,sought,tracked,started,landmarks,converged,exported";

/// The value below which a share of all lies.
template <class Value>
json quantile(std::vector<Value> values, double share) {
  if (values.empty()) return nullptr;
  const auto at = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[static_cast<std::size_t>(at)];
}

/// A frame with the truth of its moment.
struct Judged {
  const FrontEndFrame* frame;
  SE3 T_world_body;
  double path_m;  // true
};

std::vector<Judged> with_truth(const Frames& frames, const std::vector<TruthPose<SE3>>& truth) {
  std::vector<Judged> judged;
  for (const FrontEndFrame& frame : frames) {
    const auto pose = frame.epoch == 0 ? std::nullopt : truth_at(truth, frame.t_s);
    if (!pose) continue;
    const double step_m =
        judged.empty() ? 0.0 : (pose->translation() - judged.back().T_world_body.translation()).norm();
    judged.push_back({&frame, *pose, judged.empty() ? 0.0 : judged.back().path_m + step_m});
  }
  return judged;
}

/// Of the way from a to b.
double error_m(const Judged& a, const Judged& b, SE3 FrontEndFrame::*pose) {
  const SE3 truth = a.T_world_body.inverse() * b.T_world_body;
  const SE3 estimate = (a.frame->*pose).inverse() * (b.frame->*pose);
  return (estimate.translation() - truth.translation()).norm();
}

void add_drift_of_parts(const std::vector<Judged>& judged, std::vector<double>& percent) {
  for (std::size_t i = 0; i < judged.size(); i += part_step) {
    const auto end = std::find_if(judged.begin() + static_cast<std::ptrdiff_t>(i), judged.end(),
                                  [&](const Judged& b) { return b.path_m >= judged[i].path_m + part_m; });
    if (end == judged.end()) break;
    percent.push_back(100.0 * error_m(judged[i], *end, &FrontEndFrame::T_start_body) /
                      (end->path_m - judged[i].path_m));
  }
}

void judge_drift(const std::vector<FrontEndDrive>& drives, json& out) {
  std::vector<double> parts;
  double path_m = 0.0, off_m = 0.0, odometry_off_m = 0.0;
  for (const FrontEndDrive& drive : drives) {
    const std::vector<Judged> judged = with_truth(drive.frames, drive.truth);
    add_drift_of_parts(judged, parts);
    if (judged.empty() || judged.back().path_m < 1.0) continue;
    path_m += judged.back().path_m;
    off_m += error_m(judged.front(), judged.back(), &FrontEndFrame::T_start_body);
    odometry_off_m += error_m(judged.front(), judged.back(), &FrontEndFrame::T_start_odometry);
  }
  out["drift_parts_100m"] = parts.size();
  out["drift_percent"] = path_m > 0.0 ? json(100.0 * off_m / path_m) : json();
  out["odometry_drift_percent"] = path_m > 0.0 ? json(100.0 * odometry_off_m / path_m) : json();
  out["drift_percent_100m"] = nullptr;
  double sum = 0.0;
  for (const double drift : parts) sum += drift;
  if (!parts.empty()) out["drift_percent_100m"] = sum / static_cast<double>(parts.size());
}

}  // namespace

void write_front_end(const std::filesystem::path& file, const Frames& frames) {
  std::string text = header + "\n";
  for (const FrontEndFrame& f : frames) {
    append_number(text, f.t_s);
    text += ',';
    append_number(text, f.epoch);
    text += ',';
    append_number(text, f.path_m);
    append_pose(text, f.T_start_body);
    append_pose(text, f.T_start_odometry);
    text += ',';
    append_csv_row(text, f.took_ms, f.sought, f.tracked, f.started, f.landmarks, f.converged, f.exported);
  }
  write_text_file(file, text);
}

Frames read_front_end(const std::filesystem::path& file, bool may_be_cut) {
  constexpr std::size_t odometry = 3 + coordinate_count<SE3>, counts = odometry + coordinate_count<SE3>;
  Frames frames;
  for (TableFile table(file, {.header = header, .drop_cut_last_line = may_be_cut}); table.next();) {
    frames.push_back({table.number(0), table.whole_number(1), table.number(2), read_pose<SE3>(table, 3),
                      read_pose<SE3>(table, odometry), table.number(counts), table.small_number(counts + 1),
                      table.small_number(counts + 2), table.small_number(counts + 3), table.small_number(counts + 4),
                      table.small_number(counts + 5), table.small_number(counts + 6)});
    if (frames.size() > 1 && frames.back().t_s <= frames[frames.size() - 2].t_s)
      table.refuse("time does not grow; the run has to be repeated");
  }
  return frames;
}

json judge_front_ends(const std::vector<FrontEndDrive>& drives) {
  std::vector<double> ms;
  std::vector<std::uint32_t> tracked;
  double found = 0.0, started = 0.0, path_m = 0.0, exported = 0.0;
  Epoch lost = 0;
  bool with_paths = true;
  for (const auto& [frames, truth] : drives) {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      ms.push_back(frames[i].took_ms);
      found += frames[i].tracked;
      started += frames[i].started;
      if (i > 0) tracked.push_back(frames[i].tracked);  // in the first, all are new
    }
    if (frames.empty()) continue;
    with_paths = with_paths && frames.back().epoch > 0;
    path_m += frames.back().path_m;
    exported += frames.back().exported;
    lost += frames.back().epoch - frames.front().epoch;
  }
  if (ms.empty()) return nullptr;
  json out = {{"frames", ms.size()},
              {"ms_p50", quantile(ms, 0.5)},
              {"ms_p95", quantile(ms, 0.95)},
              {"ms_max", quantile(ms, 1.0)},
              {"tracked_p50", quantile(tracked, 0.5)},
              {"track_length_mean", started > 0.0 ? json((found + started) / started) : json()},
              {"frames_without_tracks", std::count(tracked.begin(), tracked.end(), 0U)},
              {"exports_per_100m", with_paths && path_m >= 1.0 ? json(100.0 * exported / path_m) : json()},
              {"path_m", with_paths ? json(path_m) : json()},
              {"lost_epochs", with_paths ? json(lost) : json()}};
  judge_drift(drives, out);
  return out;
}

json judge_front_end(const Frames& frames, const std::vector<TruthPose<SE3>>& truth) {
  return judge_front_ends({{frames, truth}});
}

SE3 in_space(const SE2& pose) {
  const Eigen::Vector2d& p = pose.translation();
  return {{std::cos(0.5 * pose.theta()), 0.0, 0.0, std::sin(0.5 * pose.theta())}, {p.x(), p.y(), 0.0}};
}

}  // namespace convoy::cli
