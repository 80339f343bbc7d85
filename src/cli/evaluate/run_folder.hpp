// What a run left behind, read back for judgement. The vehicle processes wrote their own files without seeing the
// truth; only the evaluator holds the two side by side.
//
//   RUN/run.json, RUN/scenario.json, RUN/truth/...        (see scenario.hpp)
//   RUN/vehicle_<id>/live.csv trajectory.csv traffic.csv labels.csv map.json summary.json
#pragma once

#include <array>
#include <convoy/geometry/se2.hpp>
#include <convoy/submap/facts.hpp>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "scenario/scenario.hpp"

namespace convoy::cli {

inline constexpr std::string_view live_header =
    "t_s,vehicle,abscissa_m,slam_x,slam_y,slam_th,S00,S01,S02,S11,S12,S22,"
    "x,y,th,P00,P01,P02,P11,P12,P22,integrity,reasons";
inline constexpr std::string_view trajectory_header =
    "t_s,abscissa_m,slam_x,slam_y,slam_th,S00,S01,S02,S11,S12,S22,x,y,th,P00,P01,P02,P11,P12,P22";
inline constexpr std::string_view traffic_header = "t_s,bytes_sent,messages_sent";
inline constexpr std::string_view labels_header = "index,epoch,track";

/// A pose with the covariance of its right perturbation, order (rho_x, rho_y, theta).
struct PoseEstimate {
  SE2 T;
  Eigen::Matrix3d P = Eigen::Matrix3d::Zero();
};

/// A pose of one vehicle, as known at one moment. In live.csv `vehicle` may be a peer.
struct PoseRow {
  double t_s = 0.0;
  VehicleId vehicle = 0;
  double abscissa_m = 0.0;
  std::optional<PoseEstimate> slam;    ///< T_slam_body, in the start frame of that vehicle's own SLAM
  std::optional<PoseEstimate> common;  ///< T_common_body; empty while not aligned
};

struct TrafficRow {
  double t_s = 0.0;
  double bytes_sent = 0.0;  ///< since the process started
};

struct MapAnchor {
  Key key;
  double stamp_s = 0.0;
  std::optional<PoseEstimate> common;  ///< T_common_body
  std::optional<SE2> T_slam_body;
  Eigen::Matrix3d drift = Eigen::Matrix3d::Zero();  ///< C, cumulative drift covariance, SLAM start frame
};

struct MapLandmark {
  Key key;
  std::optional<Eigen::Vector2d> p_common_m;  ///< empty while its chain is not aligned
  std::int64_t landmark_class = -1;           ///< -1: associated with nothing
};

struct MapAssociation {
  VehicleId author = 0;
  double t_s = 0.0;
  bool accepted = false;
  std::vector<Pairing> pairings;
};

struct MapChain {
  ChainId chain;
  bool aligned = false;
};

struct MapRecord {
  std::string map_digest;
  std::vector<MapChain> chains;
  std::vector<MapAnchor> anchors;
  std::vector<MapLandmark> landmarks;
  std::vector<MapAssociation> associations;
};

struct VehicleRecord {
  VehicleId id = 0;
  bool lost = false;  ///< its process did not live to the end
  std::vector<PoseRow> live;
  std::vector<PoseRow> trajectory;
  std::vector<TrafficRow> traffic;
  std::map<std::pair<Epoch, std::uint32_t>, std::uint32_t> track_of_landmark;  ///< (epoch, index) -> true id
  bool has_labels = false;
  std::optional<MapRecord> map;
  nlohmann::json summary;  ///< null if missing
  std::vector<TruthPose> truth;
  std::optional<StaticPrior> prior;
};

struct RunRecord {
  std::filesystem::path folder;
  nlohmann::json info;  ///< run.json
  std::string scenario;
  VehicleId common_frame_vehicle = 0;
  std::vector<VehicleRecord> vehicles;  ///< by id
  std::vector<TruthLandmark> landmarks;
  std::map<VehicleId, double> first_event_s;  ///< time of each vehicle's first sensor event

  const VehicleRecord* find(VehicleId id) const;
  /// The first vehicle that lived to the end and left a map; nullptr if none did.
  const VehicleRecord* first_survivor() const;
};

/// Reads a run folder. A file that is missing stays empty and so does what would follow from it; one that is cut or
/// malformed, or that has no row although its vehicle lived, is refused with file:line (ConfigError). The files of a lost vehicle may end in half a line, which is
/// left out. run.json must be there.
RunRecord read_run(const std::filesystem::path& folder);

/// Throws ConfigError, naming the file, if a vehicle that lived to its end has not left all that such a vehicle writes:
/// a verdict on what is left would be one on another run.
void expect_survivors(const RunRecord& run);

}  // namespace convoy::cli
