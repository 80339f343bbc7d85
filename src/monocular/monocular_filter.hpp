// The monocular filter: follows tracks of pixels, starts landmarks late, keeps the state small. It knows frames and
// steps; MonocularEkf knows time and anchors.
#pragma once

#include <convoy/monocular/camera_model.hpp>
#include <convoy/monocular/inlier_search.hpp>
#include <convoy/monocular/landmark_view.hpp>
#include <convoy/monocular/monocular_params.hpp>
#include <convoy/monocular/monocular_state.hpp>
#include <convoy/monocular/slip_monitor.hpp>
#include <convoy/monocular/triangulation.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

namespace convoy {

/// A pixel at which a track was found. A track is a name that lasts as long as the image side follows the same thing,
/// and is never given again.
struct FeatureObservation {
  std::uint64_t track = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< [px]
};

/// Where a track should be found in the next image: what active search and warp of its patch need.
struct FeaturePrediction {
  std::uint64_t track = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();       ///< [px]
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  ///< of the innovation, the pixel's own noise in it [px^2]
  Eigen::Vector3d p_camera = Eigen::Vector3d::Zero();    ///< where it is, frame of the camera now [m]
  SE3 T_camera_first;                                    ///< maps points of the camera that saw it first to it now
  bool landmark = false;                                 ///< or a candidate, of which the depth is a guess
  bool converged = false;                                ///< it will be exported unless something speaks against it
};

struct FrameReport {
  int matched = 0;            ///< landmarks that were observed
  int inliers = 0;            ///< and used
  int started = 0;            ///< new landmarks
  bool standstill = false;    ///< nothing was used, since nothing has moved
  bool slip = false;          ///< the step was made more uncertain
  bool contradicted = false;  ///< what was seen makes the step another one than the odometer said, far beyond its noise
};

struct MonocularCounters {
  std::uint64_t frames = 0;
  std::uint64_t observations_used = 0;      ///< of landmarks
  std::uint64_t observations_outlying = 0;  ///< of landmarks, outside of the consensus
  std::uint64_t observations_invalid = 0;   ///< not finite, outside of the image or the field, or a track twice
  std::uint64_t frames_invalid = 0;         ///< of a time that is not finite or goes back
  std::uint64_t odometry_invalid = 0;       ///< not finite or going back in time
  std::uint64_t landmarks_started = 0;
  std::uint64_t candidates_refused = 0;  ///< their pixels do not fit one point
  std::uint64_t landmarks_dropped = 0;   ///< before they converged
  std::uint64_t landmarks_frozen = 0;
  std::uint64_t landmarks_unfit = 0;  ///< converged, but did not meet the freeze rule when they had to leave
  std::uint64_t standstill_frames = 0;
  std::uint64_t slip_frames = 0;
  std::uint64_t failing_frames = 0;       ///< enough was seen, but too few landmarks agreed
  std::uint64_t contradicted_frames = 0;  ///< see FrameReport::contradicted
};

class MonocularFilter {
 public:
  MonocularFilter(const MonocularParams& params, const CameraModel& camera, const SE3& T_body_camera);

  /// The vehicle has moved since the last frame.
  void move(const OdometryStep& step);
  std::vector<FeaturePrediction> predictions() const;
  /// What was found in the image taken here.
  FrameReport update(double stamp_s, double abscissa_m, const std::vector<FeatureObservation>& observations);

  const MonocularState& state() const { return state_; }
  /// Landmarks that may leave; all, or only those that are out of view.
  std::vector<std::size_t> freezable(bool also_in_view) const;
  /// These leave, and those that could have but do not meet the freeze rule; the current pose becomes the anchor.
  void freeze(double abscissa_m, const std::vector<std::size_t>& landmarks);
  /// Images are there, but for long no landmarks in them that agree, or none that agree with the odometer: wheels that
  /// slip do not slip for so long.
  bool lost() const {
    const auto too_long = [this](const Doubt& d) {
      return d.frames >= params_.lost_frames && d.path_m >= params_.lost_length_m;
    };
    return too_long(failing_) || too_long(doubtful_);
  }
  std::size_t candidates() const { return candidates_.size(); }
  /// The track is a landmark or a candidate.
  bool follows(std::uint64_t track) const { return tracks_.count(track) > 0 || candidates_.count(track) > 0; }
  const MonocularCounters& counters() const { return counters_; }
  MonocularCounters& counters() { return counters_; }

 private:
  struct Track {         // of a landmark
    SE3 T_anchor_first;  // camera that saw it first
    int sightings = 0, confirmations = 0, unseen = 0;
    int rejections = 0, all_rejections = 0;    // in a row; ever
    std::vector<Eigen::Vector2d> innovations;  // the latest, whitened
  };
  struct ClonePixel {
    std::uint64_t clone = 0;
    Eigen::Vector2d pixel;
  };
  struct Candidate {
    SE3 T_anchor_first, T_anchor_last;  // cameras
    Eigen::Vector2d last_pixel;
    double inverse_depth = 0.0, sigma_inverse_depth = 0.0;  // at the last sighting; a guess
    int unseen = 0;
    std::vector<ClonePixel> pixels;
  };
  struct Doubt {
    int frames = 0;
    double path_m = 0.0;
  };
  struct Match {
    std::size_t landmark = 0;
    Eigen::Vector2d innovation;
  };
  struct Matches {
    std::vector<Match> matches;
    std::vector<LandmarkView> views;
    Eigen::VectorXd innovations() const;
  };
  struct Linearised;

  std::vector<FeatureObservation> valid(const std::vector<FeatureObservation>& observations);
  Matches match(const std::vector<FeatureObservation>& observations) const;
  std::vector<std::size_t> select(const Matches& matches, JointInnovation& joint, FrameReport& report);
  void correct(const Matches& matches, const std::vector<std::size_t>& inliers, const JointInnovation& joint,
               FrameReport& report);
  void score_slip(const Matches& inliers, const Eigen::LLT<Eigen::MatrixXd>& S, const Eigen::VectorXd& innovation);
  void note(const Matches& matches, const std::vector<std::size_t>& inliers, const Eigen::MatrixXd& S);
  bool stands(const Matches& matches, const Eigen::MatrixXd& S) const;
  bool contradicts(const SE3& correction, double path_m) const;
  void count_failure(const FrameReport& report, std::size_t observations, double path_m);
  SE3::Tangent slip_variance() const;

  void follow_candidates(const std::vector<FeatureObservation>& observations);
  void clone_if_due(double stamp_s, double abscissa_m, const std::vector<FeatureObservation>& observations);
  int start_landmarks();
  bool start(std::uint64_t id, Candidate& candidate, bool& refused);
  std::optional<Triangulation> fit(std::vector<ClonePixel>& pixels) const;
  std::vector<TrackView> views_of(const std::vector<ClonePixel>& pixels) const;
  std::optional<Linearised> linearise(const std::vector<ClonePixel>& pixels, const Triangulation& t) const;
  bool add(std::uint64_t id, const Candidate& candidate, const std::vector<ClonePixel>& pixels, const Triangulation& t);
  std::size_t anchor_of(const std::vector<ClonePixel>& pixels) const;
  void tidy();
  bool converges(std::size_t landmark) const;
  double linearity(std::size_t landmark) const;
  bool may_freeze(std::size_t landmark) const;
  void drop_landmarks(const std::vector<std::size_t>& landmarks);
  void drop_clones();
  SE3 camera_pose() const { return state_.pose() * state_.T_body_camera(); }
  FeaturePrediction prediction_of(std::uint64_t id, const Candidate& candidate) const;

  MonocularParams params_;
  CameraModel camera_;
  MonocularState state_;
  InlierSearchParams search_;
  SlipMonitor slip_monitor_;
  std::map<std::uint64_t, Track> tracks_;
  std::map<std::uint64_t, Candidate> candidates_;
  OdometryStep step_;  // since the last update
  double clone_abscissa_m_ = -1e9, trail_abscissa_m_ = 0.0;
  int slipping_ = 0;  // frames that the step is more uncertain for
  Doubt failing_;     // since the last frame that went well
  Doubt doubtful_;    // failing and contradicted frames, less those that went well
  MonocularCounters counters_;
};

}  // namespace convoy
