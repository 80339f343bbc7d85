// MonocularSlam: one camera and an odometer in, poses and converged landmarks out. MonocularEkf with eyes: it looks for
// each track where the filter expects it, by the patch it was first seen with, and finds new tracks where there are
// few. Front end for FrontEndComponent and Vehicle.
//
//   convoy::MonocularSlam slam({}, camera, T_body_camera);
//   slam.on_odometry(stamp_s, distance_m, yaw_rate_radps);   // of the time since the reading before
//   slam.on_image(stamp_s, grey);                             // in any order that their stamps allow
#pragma once

#include <convoy/frontend/front_end.hpp>
#include <convoy/monocular/monocular_ekf.hpp>
#include <convoy/vision/active_search.hpp>
#include <convoy/vision/corner_detector.hpp>
#include <convoy/vision/patch_descriptor.hpp>
#include <convoy/vision/reference_patch.hpp>

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace convoy {

struct MonocularSlamParams {
  MonocularParams filter = street_params();
  ActiveSearchParams search;
  CornerParams corners;
  int features = 50;                 ///< tracks that are followed at once, landmarks and candidates: 12..400
  int new_features = 12;             ///< of them started in one image at most: 1..100
  double candidate_length_m = 25.0;  ///< path after which a track that has no depth yet makes room for another, > 0
  /// Slower turning of wheels that stand is noise of the gyro, and nothing moves. [rad/s], >= 0
  double standstill_yaw_radps = 0.02;
  double max_image_delay_s = 0.2;  ///< by which an image may come later than the odometry of its time, [0, 10]
  int max_waiting_images = 8;      ///< for their odometry, beyond which the oldest is refused: 1..100
};

/// Throws ConfigError when a value is out of its range, for images of that size [px].
void validate(const MonocularSlamParams& params, int width, int height);

/// What was found in an image of a track, for pictures and statistics.
struct TrackedFeature {
  std::uint64_t track = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double score = 0.0;      ///< of the correlation; 0: it is new
  bool landmark = false;   ///< it had a depth before this image
  bool converged = false;  ///< it will be exported unless something speaks against it
};

struct ImageReport {
  double stamp_s = 0.0;
  FrameReport filter;
  int sought = 0;                        ///< tracks that were looked for
  std::vector<TrackedFeature> features;  ///< found, and new
  double took_ms = 0.0;                  ///< of wall time, everything
};

struct NewTrack {
  ReferencePatch patch;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
};

/// The `most` strongest corners of `image` that are worth following, in cells in which none of `features` lies.
std::vector<NewTrack> find_new_tracks(const ImagePyramid& image, const std::vector<TrackedFeature>& features,
                                      std::size_t most, CornerDetector& corners, const ActiveSearch& search);

struct MonocularSlamCounters {
  std::uint64_t images = 0;            ///< used
  std::uint64_t images_refused = 0;    ///< not grey, of another size, out of order, or too many waiting
  std::uint64_t images_frozen = 0;     ///< the same as the one before, to the bit, though the vehicle moved: not used
  std::uint64_t odometry_refused = 0;  ///< not finite, or not after the reading before
  std::uint64_t tracks_started = 0;
  std::uint64_t descriptors = 0;  ///< landmarks that were described
  std::uint64_t restarts = 0;     ///< restart() after it was lost
};

/// For one thread. The same input gives the same output, to the bit.
class MonocularSlam final : public FrontEnd<SE3> {
 public:
  using ImageListener = std::function<void(const ImageReport&, const cv::Mat& grey)>;

  /// T_body_camera: where the camera is fixed to the body, whose origin is where the odometer measures (the middle of
  /// the rear axle). Throws ConfigError.
  MonocularSlam(const MonocularSlamParams& params, const CameraCalibration& camera, const SE3& T_body_camera);

  /// From the reading before to `stamp_s` the vehicle drove `distance_m` (ahead positive) and turned to the left by
  /// `yaw_rate_radps` on average. It waits for images of that time, MonocularSlamParams::max_image_delay_s at most. The
  /// first reading only says when time begins. False, and counted, if it is refused.
  bool on_odometry(double stamp_s, double distance_m, double yaw_rate_radps);

  /// An image taken at `stamp_s` (the middle of its exposure). It is used as soon as the odometry up to then is there;
  /// its pixels are shared and must not change. False, and counted, if it is refused.
  bool on_image(double stamp_s, const cv::Mat& grey);

  /// Closes the segment here and now, with whatever may leave: at the end of a run. Images that wait are used first.
  void finish();

  /// Images are there and make no sense any more, contradict the odometer for longer than wheels slip, or are frozen
  /// for that long. What was exported stays right; go on with restart() and a new epoch.
  bool lost() const;
  /// Begins anew at the identity: state() and the abscissa begin at zero, segments not yet taken are gone.
  void restart();

  /// Called for each image that was used, from within on_odometry(), on_image() or finish().
  void on_report(ImageListener listener) { listener_ = std::move(listener); }

  FrontEndState<SE3> state() const override { return ekf_->state(); }
  bool scales_landmarks() const override { return ekf_->scales_landmarks(); }
  std::vector<Segment<SE3>> take_segments() override { return ekf_->take_segments(); }

  const MonocularFilter& filter() const { return ekf_->filter(); }
  const ActiveSearch& search() const { return search_; }
  const MonocularSlamCounters& counters() const { return counters_; }

 private:
  struct Track {
    ReferencePatch patch;
    double started_m = 0.0;         // abscissa
    int misses = 0;                 // in a row
    double footprint_misfit = 1e9;  // of its descriptor, from the best size
  };
  struct WaitingImage {
    double stamp_s = 0.0;
    cv::Mat grey;
  };
  struct Reading {
    double from_s = 0.0, to_s = 0.0;
    double v_mps = 0.0, yaw_rate_radps = 0.0;
  };

  void advance();
  void drive(const Reading& reading, double until_s);
  void use_images(double until_s);
  void use_image(const WaitingImage& image);
  bool is_frozen(const WaitingImage& image);
  void seek(const std::vector<FeaturePrediction>& predictions, ImageReport& report);
  std::optional<PatchPrediction> expectation(const FeaturePrediction& prediction, const ReferencePatch& patch) const;
  void start_tracks(ImageReport& report);
  void describe_landmarks(const std::vector<FeaturePrediction>& predictions, const ImageReport& report);
  void forget_tracks();

  MonocularSlamParams params_;
  CameraModel camera_;
  SE3 T_body_camera_;
  std::optional<MonocularEkf> ekf_;
  ImagePyramid pyramid_;
  ActiveSearch search_;
  CornerDetector corners_;
  std::map<std::uint64_t, Track> tracks_;
  std::uint64_t last_track_ = 0;
  std::deque<WaitingImage> waiting_;
  std::deque<Reading> readings_;      // that the filter has not made yet, or not to their end
  std::optional<double> odometry_s_;  // of the last reading
  double driven_s_ = 0.0;             // how far the filter is
  std::optional<double> image_s_;     // of the last that was accepted
  cv::Mat last_image_;                // that was used: a copy, since its owner may write to it again
  std::size_t last_features_ = 0;     // in it
  double last_image_m_ = 0.0;         // abscissa where it was taken
  int frozen_ = 0;                    // images since
  double frozen_m_ = 0.0;             // and path
  MonocularSlamCounters counters_;
  ImageListener listener_;
};

}  // namespace convoy
