// What a run left behind, read back for judgement. The vehicle processes wrote their own files without seeing the
// truth; only the evaluator holds the two side by side.
//
//   RUN/run.json, RUN/scenario.json, RUN/truth/...        (see scenario.hpp)
//   RUN/vehicle_<id>/live.csv trajectory.csv traffic.csv labels.csv map.json summary.json
//   RUN/vehicle_<id>/front_end.csv                        of a camera    (see front_end_record.hpp)
#pragma once

#include <array>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/facts.hpp>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "evaluate/front_end_record.hpp"
#include "scenario/pose_columns.hpp"
#include "scenario/scenario.hpp"

namespace convoy::cli {

/// First lines of live.csv and trajectory.csv. Poses and covariances: see pose_columns.hpp.
template <class G>
inline const std::string trajectory_header = "t_s,abscissa_m," + pose_header<G>("slam_") +
                                             "," + covariance_header<G>("S") + "," + pose_header<G>("") +
                                             "," + covariance_header<G>("P");
template <class G>
inline const std::string live_header = "t_s,vehicle," + trajectory_header<G>.substr(4) + ",integrity,reasons";
inline constexpr std::string_view traffic_header = "t_s,bytes_sent,messages_sent";
/// truth/tracks_<id>.csv, of a vehicle whose tracks nobody has named: where what they follow is in the world.
inline constexpr std::string_view tracks_header = "track,x_m,y_m,z_m,sightings";
inline constexpr std::string_view labels_header = "index,epoch,track";

/// A pose with the covariance of its right perturbation, order (rho, theta).
template <class G>
struct PoseEstimate {
  G T;
  typename G::Covariance P = G::Covariance::Zero();
};

/// A pose of one vehicle, as known at one moment. In live.csv `vehicle` may be a peer.
template <class G>
struct PoseRow {
  double t_s = 0.0;
  VehicleId vehicle = 0;
  double abscissa_m = 0.0;
  std::optional<PoseEstimate<G>> slam;    ///< T_slam_body, in the start frame of that vehicle's own SLAM
  std::optional<PoseEstimate<G>> common;  ///< T_common_body; empty while not aligned
};

struct TrafficRow {
  double t_s = 0.0;
  double bytes_sent = 0.0;  ///< since the process started
};

template <class G>
struct MapAnchor {
  Key key;
  double stamp_s = 0.0;
  std::optional<PoseEstimate<G>> common;  ///< T_common_body
  std::optional<G> T_slam_body;
  typename G::Covariance drift = G::Covariance::Zero();  ///< C, cumulative drift covariance, SLAM start frame
};

template <class G>
struct MapLandmark {
  Key key;
  std::optional<typename G::Point> p_common_m;  ///< empty while its chain is not aligned
  std::int64_t landmark_class = -1;             ///< -1: associated with nothing
  std::uint32_t anchor = 0;                     ///< index of the anchor of its batch, of its own chain
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

template <class G>
struct MapRecord {
  std::string map_digest;
  std::vector<MapChain> chains;
  std::vector<MapAnchor<G>> anchors;
  std::vector<MapLandmark<G>> landmarks;
  std::vector<MapAssociation> associations;
};

template <class G>
struct VehicleRecord {
  VehicleId id = 0;
  bool lost = false;  ///< its process did not live to the end
  std::vector<PoseRow<G>> live;
  std::vector<PoseRow<G>> trajectory;
  std::vector<TrafficRow> traffic;
  std::map<std::pair<Epoch, std::uint32_t>, std::uint32_t> track_of_landmark;  ///< (epoch, index) -> true id
  bool has_labels = false;
  std::map<std::uint32_t, Eigen::Vector3d> place_of_track;  ///< world [m]; empty: tracks are named by what they are
  std::optional<MapRecord<G>> map;
  nlohmann::json summary;                ///< null if missing
  std::vector<FrontEndFrame> front_end;  ///< empty unless it has a camera
  std::vector<TruthPose<G>> truth;
  std::optional<StaticPrior<G>> prior;
};

template <class G>
struct RunRecord {
  std::filesystem::path folder;
  nlohmann::json info;  ///< run.json
  std::string scenario;
  VehicleId common_frame_vehicle = 0;
  std::vector<VehicleRecord<G>> vehicles;  ///< by id
  std::vector<TruthLandmark<G>> landmarks;
  std::optional<PoseTolerance> pose_tolerance;  ///< see Scenario
  std::map<VehicleId, double> first_event_s;    ///< time of each vehicle's first sensor event

  const VehicleRecord<G>* find(VehicleId id) const;
  /// The first vehicle that lived to the end and left a map; nullptr if none did.
  const VehicleRecord<G>* first_survivor() const;
};

/// Reads a run folder, whose fleet is of the dimension of G. A file that is missing stays empty and so does what would
/// follow from it; one that is cut or malformed, or that has no row although its vehicle lived, is refused with
/// file:line (ConfigError). The files of a lost vehicle may end in half a line, which is left out. run.json must be
/// there.
template <class G>
RunRecord<G> read_run(const std::filesystem::path& folder);

/// Throws ConfigError, naming the file, if a vehicle that lived to its end has not left all that such a vehicle writes:
/// a verdict on what is left would be one on another run.
template <class G>
void expect_survivors(const RunRecord<G>& run);

/// RUN/truth/tracks_<id>.csv
std::filesystem::path tracks_file(const std::filesystem::path& run_folder, VehicleId id);

/// What run.json says of the fleet: 2 or 3. Throws ConfigError.
int run_dimension(const std::filesystem::path& folder);

}  // namespace convoy::cli
