#include "consistency/real_drift.hpp"

#include <convoy/config_error.hpp>

#include <cstdlib>
#include <map>

namespace convoy::cli::consistency {
namespace {
namespace fs = std::filesystem;

constexpr double scale_over_m = 100.0;

struct KnownOutput {
  const char* file;
  const char* sequence;
  bool scale_free;
  const char* about;
};
constexpr KnownOutput outputs[] = {{"example_0_09", "09", true, "monocular SLAM, scale-free"},
                                   {"example_0_10", "10", true, "monocular SLAM, scale-free"},
                                   {"example_1_09", "09", false, "visual SLAM, metric"},
                                   {"example_1_10", "10", false, "visual SLAM, metric"},
                                   {"KITTI_00_ORB", "00", false, "ORB-SLAM, stereo"},
                                   {"KITTI_00_SPTAM", "00", false, "S-PTAM, stereo"}};
constexpr const char* graph_sequences[] = {"00", "02", "05", "06", "07", "09"};
constexpr const char* cut_sequences[] = {"05", "06"};

class Study {
 public:
  explicit Study(fs::path data) : poses_(data / "kitti_trajectories"), graphs_(data / "pose_graphs" / "single") {}

  RealDrift measure() {
    for (const KnownOutput& output : outputs) study_output(output);
    read_graphs();
    for (const RealGraph& graph : read_) study_odometry(graph);
    for (const RealGraph& graph : read_)
      for (const char* sequence : cut_sequences)
        if (graph.name == std::string("KITTI ") + sequence && read_.size() > 1)
          drift_.halves.push_back(study_halves(graph, without(graph)));
    return std::move(drift_);
  }

 private:
  bool there(const fs::path& file) {
    if (fs::exists(file)) return true;
    drift_.absent.push_back(file.filename().string());
    return false;
  }
  fs::path truth_file(const std::string& sequence) const { return poses_ / "gt" / (sequence + ".txt"); }

  const std::vector<FramePose>& truth_of(const std::string& sequence) {
    const auto [it, fresh] = truth_.try_emplace(sequence);
    if (fresh) it->second = read_kitti_poses(truth_file(sequence));
    return it->second;
  }

  // Each half is judged by what was fitted to the other one.
  void study_output(const KnownOutput& output) {
    const fs::path file = poses_ / "slam_estimates" / (std::string(output.file) + ".txt");
    if (!there(file) || !fs::exists(truth_file(output.sequence))) return;
    const Recording<SE3> whole = recording_of(output.file, read_kitti_poses(file), truth_of(output.sequence),
                                              output.scale_free ? scale_over_m : 0.0);
    const std::size_t middle = middle_of(whole);
    const Recording<SE3> first = part_of(whole, 0, middle), second = part_of(whole, middle, whole.truth.size());
    const auto named = [&](Recording<SE3> part, const char* which) {
      part.name += which;
      return part;
    };
    const std::vector<Fold<SE3>> folds{{first, fit_models<SE3>({named(second, " (2nd half)")})},
                                       {second, fit_models<SE3>({named(first, " (1st half)")})}};
    SpanStudy study = study_spans(folds);
    study.about = std::string(output.about) + ", sequence " + output.sequence;
    study.fitted_on = "each half judged by the other half";
    drift_.spans.push_back(std::move(study));
  }

  void read_graphs() {
    for (const std::string sequence : graph_sequences) {
      const fs::path file = graphs_ / ("kitti_" + sequence + ".g2o");
      if (!there(file) || !fs::exists(truth_file(sequence))) continue;
      G2oFile graph = read_g2o(file);
      if (graph.dim != 2) throw ConfigError(file.string() + ": is not planar; fetch the file again");
      Recording<SE2> odometry = odometry_of("KITTI " + sequence, graph, file.string(), truth_of(sequence));
      drift_.lateral.emplace_back("KITTI " + sequence, lateral_sense(graph, truth_of(sequence)));
      read_.push_back({"KITTI " + sequence, std::move(graph), std::move(odometry)});
    }
  }

  std::vector<RealGraph> without(const RealGraph& graph) const {
    std::vector<RealGraph> others;
    for (const RealGraph& other : read_)
      if (other.name != graph.name) others.push_back(other);
    return others;
  }

  void study_odometry(const RealGraph& graph) {
    std::vector<Recording<SE2>> calibration;
    std::string names;
    for (const RealGraph& other : without(graph)) {
      calibration.push_back(other.odometry);
      names += (names.empty() ? "" : ", ") + other.name;
    }
    if (calibration.empty()) return;
    SpanStudy study = study_spans<SE2>({{graph.odometry, fit_models(calibration)}});
    study.about = "odometry of the pose graph, seen from above";
    study.fitted_on = names;
    drift_.spans.push_back(std::move(study));
  }

  fs::path poses_, graphs_;
  std::map<std::string, std::vector<FramePose>> truth_;
  std::vector<RealGraph> read_;
  RealDrift drift_;
};

}  // namespace

RealDrift measure_real_drift(fs::path data) {
  const bool given = !data.empty();
  if (!given)
    if (const char* variable = std::getenv("CONVOY_DATA_DIR")) data = variable;
  const bool holds = !data.empty() && fs::is_directory(data / "kitti_trajectories");
  const std::string fault =
      data.string() + (fs::is_directory(data) ? ": holds no folder kitti_trajectories" : ": no such folder");
  if (given && !holds)
    throw ConfigError(fault + "; --data names the folder that holds kitti_trajectories and pose_graphs");
  if (!holds) {
    RealDrift none;
    none.left_out = "Real drift is left out: no recordings" +
                    (data.empty() ? "" : " (CONVOY_DATA_DIR: " + fault + ")") +
                    ". Name the folder that holds kitti_trajectories and pose_graphs with --data DIR or "
                    "CONVOY_DATA_DIR.";
    return none;
  }
  return Study(data).measure();
}

nlohmann::ordered_json to_json(const RealDrift& drift) {
  using json = nlohmann::ordered_json;
  json out = json::array();
  const auto fit = [&](const std::string& judged, const char* kind, const FitFigures& f) {
    json constants = json::object();
    for (const auto& [name, mean] : f.constants) constants[name] = {{"scale", mean[0]}, {"heading_rad_per_m", mean[1]}};
    out.push_back(json{{"kind", "fit"},
                       {"of", kind},
                       {"sequence", judged},
                       {"fitted_on", f.fitted_on},
                       {"translation_m2_per_m", f.plain_translation},
                       {"rotation_rad2_per_m", f.plain_rotation},
                       {"with_constants",
                        {{"translation_m2_per_m", f.translation},
                         {"rotation_rad2_per_m", f.rotation},
                         {"scale_sigma", f.scale},
                         {"heading_sigma_rad_per_m", f.heading},
                         {"found", constants}}},
                       {"literal_translation_m2_per_m", f.literal_translation},
                       {"literal_rotation_rad2_per_m", f.literal_rotation}});
  };
  for (const SpanStudy& study : drift.spans)
    for (const FitFigures& f : study.fits) fit(study.name, "spans", f);
  for (const HalvesStudy& study : drift.halves) fit(study.name, "halves", study.fit);
  for (const SpanStudy& study : drift.spans)
    for (const SpanRow& row : study.rows)
      for (std::size_t m = 0; m < row.models.size(); ++m)
        out.push_back(json{{"kind", "spans"},
                           {"sequence", study.name},
                           {"dim", study.dim},
                           {"fitted_on", study.fitted_on},
                           {"model", study.models[m]},
                           {"span_m", row.span_m},
                           {"spans", row.spans},
                           {"anees", row.models[m].anees},
                           {"coverage95", row.models[m].coverage95},
                           {"position_rmse_m", row.position_rmse_m},
                           {"rotation_rmse_rad", row.rotation_rmse_rad},
                           {"predicted_position_m", row.models[m].predicted_position_m},
                           {"lag1", study.lag_plain.largest},
                           {"lag1_alarm", study.lag_plain.alarm}});
  for (const HalvesStudy& study : drift.halves)
    for (const HalvesRow& row : study.rows)
      out.push_back(json{{"kind", "halves"},
                         {"sequence", study.name},
                         {"dim", 2},
                         {"fitted_on", study.fit.fitted_on},
                         {"model", row.model},
                         {"start", row.start},
                         {"fused", row.fused},
                         {"linked", row.linked},
                         {"ate_m", row.ate_m},
                         {"anees", row.anees},
                         {"coverage95", row.coverage95},
                         {"distance_rmse_m", row.distance_rmse_m},
                         {"loop_median_error_m", study.loops.median_error_m},
                         {"loop_worst_error_m", study.loops.worst_error_m},
                         {"stated", row.stated},
                         {"accepted", row.accepted}});
  return out;
}

}  // namespace convoy::cli::consistency
