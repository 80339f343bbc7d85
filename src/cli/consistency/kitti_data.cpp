#include "consistency/kitti_data.hpp"

#include <convoy/config_error.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>

#include "report/svg_plot.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli::consistency {
namespace {

Eigen::Matrix3d R_body_camera() {
  return (Eigen::Matrix3d() << 0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0).finished();
}

/// 12, or 13 if the first line has that many fields.
std::size_t columns_of(const std::filesystem::path& file) {
  std::istringstream text(read_text_file(file));
  std::string line, field;
  std::size_t fields = 0;
  if (std::getline(text, line))
    for (std::istringstream words(line); words >> field;) ++fields;
  return fields == 13 ? 13 : 12;
}

template <class G>
void append_state(Recording<G>& recording, const G& pose, const G& truth) {
  ChainState<G> state;
  state.pose = pose;
  if (!recording.slam.states.empty()) {
    const ChainState<G>& before = recording.slam.states.back();
    state.abscissa_m = before.abscissa_m + (pose.translation() - before.pose.translation()).norm();
  }
  state.stamp_s = static_cast<double>(recording.slam.states.size());
  recording.slam.states.push_back(state);
  recording.truth.push_back(truth);
}

double scale_of(const std::string& name, const std::vector<FramePose>& estimate,
                const std::vector<const FramePose*>& truth, double over_m) {
  double said = 0.0, true_length = 0.0;
  for (std::size_t k = 1; k < estimate.size() && true_length < over_m; ++k) {
    said += (estimate[k].T_start_body.translation() - estimate[k - 1].T_start_body.translation()).norm();
    true_length += (truth[k]->T_start_body.translation() - truth[k - 1]->T_start_body.translation()).norm();
  }
  if (!(said > 0.0) || true_length < over_m)
    throw ConfigError(name + ": does not cover the first " + fixed(over_m, 0) +
                      " m of the truth, so that it has no scale; fetch the recording again");
  return true_length / said;
}

}  // namespace

std::vector<FramePose> read_kitti_poses(const std::filesystem::path& file) {
  const std::size_t columns = columns_of(file), first = columns - 12;
  TableFile table(file, {' ', {}, columns, false});
  const Eigen::Matrix3d R = R_body_camera();
  std::vector<FramePose> poses;
  while (table.next()) {
    Eigen::Matrix<double, 3, 4> M;
    for (std::size_t i = 0; i < 12; ++i)
      M(static_cast<Eigen::Index>(i / 4), static_cast<Eigen::Index>(i % 4)) = table.number(first + i);
    const Eigen::Matrix3d C = M.leftCols<3>();
    if (!(C.transpose() * C).isIdentity(1e-3) || C.determinant() < 0.0)
      table.refuse("the first three columns of the pose are no rotation; fetch the file again");
    FramePose pose;
    pose.frame = first == 1 ? table.small_number(0) : static_cast<std::uint32_t>(poses.size());
    if (!poses.empty() && pose.frame <= poses.back().frame)
      table.refuse("frame " + std::to_string(pose.frame) + " does not follow frame " +
                   std::to_string(poses.back().frame) + "; sort the file by frame");
    pose.T_start_body = SE3::from_rotation(R * C * R.transpose(), R * M.col(3));
    poses.push_back(pose);
  }
  if (poses.empty()) throw ConfigError(file.string() + ": holds no pose; fetch the file again");
  return poses;
}

SE2 on_plane(const SE3& T) {
  const Eigen::Vector3d forward = T.rotation().col(0);
  return {T.translation().head<2>(), std::atan2(forward.y(), forward.x())};
}

Recording<SE3> recording_of(const std::string& name, const std::vector<FramePose>& estimate,
                            const std::vector<FramePose>& truth, double scale_over_m) {
  std::map<std::uint32_t, const FramePose*> at_frame;
  for (const FramePose& pose : truth) at_frame[pose.frame] = &pose;
  std::vector<const FramePose*> matched;
  for (const FramePose& pose : estimate) {
    const auto it = at_frame.find(pose.frame);
    if (it == at_frame.end())
      throw ConfigError(name + ": the truth has no frame " + std::to_string(pose.frame) +
                        "; is it of another sequence?");
    matched.push_back(it->second);
  }
  Recording<SE3> recording;
  recording.name = name;
  if (scale_over_m > 0.0) recording.scale = scale_of(name, estimate, matched, scale_over_m);
  for (std::size_t k = 0; k < estimate.size(); ++k) {
    const SE3& T = estimate[k].T_start_body;
    append_state(recording, SE3(T.quaternion(), recording.scale * T.translation()), matched[k]->T_start_body);
  }
  return recording;
}

LateralSense lateral_sense(const G2oFile& graph, const std::vector<FramePose>& truth) {
  double said = 0.0, said_turn = 0.0, true_y = 0.0, true_turn = 0.0;
  for (const G2oFile::Edge& edge : graph.edges) {
    if (edge.to != edge.from + 1 || static_cast<std::size_t>(edge.to) >= truth.size()) continue;
    const auto pose = [&](int frame) { return on_plane(truth[static_cast<std::size_t>(frame)].T_start_body); };
    const SE2 T = pose(edge.from).inverse() * pose(edge.to);
    said += edge.measured[2] * edge.measured[1];
    said_turn += edge.measured[2] * edge.measured[2];
    true_y += T.theta() * T.translation().y();
    true_turn += T.theta() * T.theta();
  }
  if (!(said_turn > 0.0) || !(true_turn > 0.0)) return {};
  return {said / said_turn, true_y / true_turn};
}

Recording<SE2> odometry_of(const std::string& name, const G2oFile& graph, const std::string& file_name,
                           const std::vector<FramePose>& truth) {
  for (std::size_t k = 0; k < graph.vertices.size(); ++k)
    if (graph.vertices[k].id != k || k >= truth.size() || truth[k].frame != k)
      throw ConfigError(file_name + ": vertex " + std::to_string(graph.vertices[k].id) +
                        " is no frame of the truth; vertices must be the frames 0, 1, ... of its sequence");
  std::vector<const G2oFile::Edge*> next(graph.vertices.size(), nullptr);
  for (const G2oFile::Edge& edge : graph.edges)
    if (edge.to == edge.from + 1) next[static_cast<std::size_t>(edge.from)] = &edge;
  const double left = lateral_sense(graph, truth).mirrored() ? -1.0 : 1.0;
  Recording<SE2> recording;
  recording.name = name;
  SE2 pose;
  for (std::size_t k = 0; k < graph.vertices.size(); ++k) {
    append_state(recording, pose, on_plane(truth[k].T_start_body));
    if (k + 1 == graph.vertices.size()) break;
    if (!next[k])
      throw ConfigError(file_name + ": no edge from vertex " + std::to_string(k) +
                        " to the next one; the odometry is cut");
    const std::vector<double>& z = next[k]->measured;
    pose = pose * SE2(z[0], left * z[1], z[2]);
  }
  return recording;
}

template <class G>
Recording<G> part_of(const Recording<G>& whole, std::size_t begin, std::size_t end) {
  Recording<G> part;
  part.name = whole.name;
  part.scale = whole.scale;
  const auto cut = [&](const auto& all, auto& some) {
    some.assign(all.begin() + static_cast<std::ptrdiff_t>(begin), all.begin() + static_cast<std::ptrdiff_t>(end));
  };
  cut(whole.slam.states, part.slam.states);
  cut(whole.truth, part.truth);
  return part;
}

template <class G>
Recording<G> chain_of(const Recording<G>& whole, std::size_t begin, std::size_t end) {
  Recording<G> chain = part_of(whole, begin, end);
  const ChainState<G> start = whole.slam.states[begin];
  for (ChainState<G>& state : chain.slam.states) {
    state.pose = start.pose.inverse() * state.pose;
    state.abscissa_m -= start.abscissa_m;
    state.stamp_s -= start.stamp_s;
  }
  return chain;
}

template <class G>
std::size_t middle_of(const Recording<G>& recording) {
  const auto& states = recording.slam.states;
  const double half = states.empty() ? 0.0 : 0.5 * (states.front().abscissa_m + states.back().abscissa_m);
  return static_cast<std::size_t>(
      std::find_if(states.begin(), states.end(), [&](const auto& s) { return s.abscissa_m >= half; }) - states.begin());
}

#define CONVOY_INSTANTIATE(G)                                                    \
  template Recording<G> part_of(const Recording<G>&, std::size_t, std::size_t);  \
  template Recording<G> chain_of(const Recording<G>&, std::size_t, std::size_t); \
  template std::size_t middle_of(const Recording<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::consistency
