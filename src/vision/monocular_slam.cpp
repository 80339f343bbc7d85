#include <convoy/config_error.hpp>
#include <convoy/vision/monocular_slam.hpp>
#include <convoy/vision/patch_warp.hpp>

#include <opencv2/core.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>
#include <utility>

namespace convoy {

namespace {

// A descriptor is taken where its footprint has about this size: fine enough, and what another vehicle will see, too.
constexpr double best_footprint_px = 32.0;

double milliseconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

const MonocularSlamParams& checked(const MonocularSlamParams& params, const CameraCalibration& camera) {
  validate(camera);
  validate(params, camera.width, camera.height);
  return params;
}

}  // namespace

void validate(const MonocularSlamParams& p, int width, int height) {
  const auto require = [](bool ok, const char* name, double value, const char* range) {
    if (!ok) throw RangeError("monocular SLAM", name, value, range);
  };
  validate(p.filter);
  validate(p.search);
  validate(p.corners, width, height);
  require(p.features >= 12 && p.features <= 400, "features", p.features, "be 12..400");
  require(p.new_features >= 1 && p.new_features <= 100, "new_features", p.new_features, "be 1..100");
  require(p.candidate_length_m > 0 && std::isfinite(p.candidate_length_m), "candidate_length_m", p.candidate_length_m,
          "be > 0");
  require(p.standstill_yaw_radps >= 0 && std::isfinite(p.standstill_yaw_radps), "standstill_yaw_radps",
          p.standstill_yaw_radps, "be >= 0");
  require(p.max_image_delay_s >= 0 && p.max_image_delay_s <= 10, "max_image_delay_s", p.max_image_delay_s,
          "lie in [0, 10]");
  require(p.max_waiting_images >= 1 && p.max_waiting_images <= 100, "max_waiting_images", p.max_waiting_images,
          "be 1..100");
}

std::vector<NewTrack> find_new_tracks(const ImagePyramid& image, const std::vector<TrackedFeature>& features,
                                      std::size_t most, CornerDetector& corners, const ActiveSearch& search) {
  std::vector<int> cells(static_cast<std::size_t>(corners.cells()));
  std::iota(cells.begin(), cells.end(), 0);
  std::vector<Eigen::Vector2d> taken;
  for (const TrackedFeature& f : features) {
    taken.push_back(f.pixel);
    std::erase(cells, corners.cell_of(f.pixel));
  }
  std::vector<Corner> found = corners.detect(image, cells, taken);
  std::stable_sort(found.begin(), found.end(),
                   [](const Corner& a, const Corner& b) { return a.strength > b.strength; });
  std::vector<NewTrack> tracks;
  for (const Corner& corner : found) {
    if (tracks.size() == most) break;
    const auto patch = ReferencePatch::take(image, corner.pixel);
    if (patch && search.judge(*patch) == PatchMatch::Status::found) tracks.push_back({*patch, corner.pixel});
  }
  return tracks;
}

MonocularSlam::MonocularSlam(const MonocularSlamParams& params, const CameraCalibration& camera,
                             const SE3& T_body_camera)
    : params_(checked(params, camera)),
      camera_(camera),
      T_body_camera_(T_body_camera),
      ekf_(std::in_place, params.filter, camera_, T_body_camera),
      pyramid_(camera.width, camera.height),
      search_(params.search),
      corners_(camera.width, camera.height, params.corners) {}

// ---- time ----

bool MonocularSlam::on_odometry(double stamp_s, double distance_m, double yaw_rate_radps) {
  const bool later = !odometry_s_ || stamp_s > *odometry_s_;
  if (!std::isfinite(stamp_s) || !std::isfinite(distance_m) || !std::isfinite(yaw_rate_radps) || !later) {
    ++counters_.odometry_refused;
    return false;
  }
  if (!odometry_s_) {
    counters_.images_refused += std::erase_if(waiting_, [&](const WaitingImage& w) { return w.stamp_s < stamp_s; });
    ekf_->on_odometry(stamp_s, 0.0, 0.0);
    driven_s_ = stamp_s;
  } else {
    const bool stands = distance_m == 0.0 && std::abs(yaw_rate_radps) < params_.standstill_yaw_radps;
    const double v_mps = distance_m / (stamp_s - *odometry_s_);
    readings_.push_back({*odometry_s_, stamp_s, v_mps, stands ? 0.0 : yaw_rate_radps});
  }
  odometry_s_ = stamp_s;
  advance();
  return true;
}

bool MonocularSlam::on_image(double stamp_s, const cv::Mat& grey) {
  const bool fits = grey.type() == CV_8UC1 && grey.cols == pyramid_.width() && grey.rows == pyramid_.height();
  const bool later = (!image_s_ || stamp_s > *image_s_) && (!odometry_s_ || stamp_s >= driven_s_);
  if (!std::isfinite(stamp_s) || !fits || !later) {
    ++counters_.images_refused;
    return false;
  }
  image_s_ = stamp_s;
  waiting_.push_back({stamp_s, grey});
  advance();
  if (waiting_.size() > static_cast<std::size_t>(params_.max_waiting_images)) {
    waiting_.pop_front();
    ++counters_.images_refused;
  }
  return true;
}

// As far as the images are there, or need not be waited for any longer.
void MonocularSlam::advance() {
  if (!odometry_s_) return;
  const double given_up_s = *odometry_s_ - params_.max_image_delay_s;
  const double until_s = std::min(*odometry_s_, std::max(image_s_.value_or(given_up_s), given_up_s));
  use_images(driven_s_);
  while (!readings_.empty() && readings_.front().from_s < until_s) {
    drive(readings_.front(), std::min(readings_.front().to_s, until_s));
    if (driven_s_ < readings_.front().to_s) break;
    readings_.pop_front();
  }
}

// In steps that the filter does not take for a silent odometer.
void MonocularSlam::drive(const Reading& reading, double until_s) {
  ekf_->on_odometry(driven_s_, reading.v_mps, reading.yaw_rate_radps);
  const double longest_s = 0.5 * params_.filter.max_odometry_gap_s;
  while (driven_s_ < until_s) {
    driven_s_ = std::min(until_s, driven_s_ + longest_s);
    use_images(driven_s_);
    ekf_->on_time(driven_s_);
  }
}

void MonocularSlam::use_images(double until_s) {
  while (!waiting_.empty() && waiting_.front().stamp_s <= until_s) {
    const WaitingImage image = std::move(waiting_.front());
    waiting_.pop_front();
    use_image(image);
  }
}

void MonocularSlam::finish() {
  for (const Reading& reading : std::exchange(readings_, {})) drive(reading, reading.to_s);
  if (odometry_s_)
    for (const WaitingImage& image : std::exchange(waiting_, {})) use_image(image);
  ekf_->finish();
}

bool MonocularSlam::lost() const {
  return ekf_->lost() || (frozen_ >= params_.filter.lost_frames && frozen_m_ >= params_.filter.lost_length_m);
}

void MonocularSlam::restart() {
  ++counters_.restarts;
  frozen_ = 0;
  last_image_m_ = frozen_m_ = 0.0;
  tracks_.clear();
  ekf_.emplace(params_.filter, camera_, T_body_camera_);
  if (odometry_s_) ekf_->on_odometry(driven_s_, 0.0, 0.0);
}

// ---- one image ----

// A camera that hangs sends its last image again: it looks like wheels that slip, and is none. What has nothing in it,
// in the dark or against the sun, looks the same though the camera is well.
bool MonocularSlam::is_frozen(const WaitingImage& image) {
  constexpr double least_m = 0.05;  // an encoder's tick comes when it comes
  ekf_->on_time(image.stamp_s);
  const double here_m = ekf_->state().abscissa_m;
  const bool same = !last_image_.empty() && last_features_ >= static_cast<std::size_t>(params_.filter.min_inliers) &&
                    cv::norm(image.grey, last_image_, cv::NORM_INF) == 0.0;
  if (same && here_m > last_image_m_ + least_m) {
    ++counters_.images_frozen;
    ++frozen_;
    frozen_m_ = here_m - last_image_m_;
    return true;
  }
  frozen_ = 0;
  frozen_m_ = 0.0;
  last_image_m_ = here_m;
  if (!same) image.grey.copyTo(last_image_);
  return false;
}

void MonocularSlam::use_image(const WaitingImage& image) {
  const auto start = std::chrono::steady_clock::now();
  ImageReport report;
  report.stamp_s = image.stamp_s;
  if (is_frozen(image)) return;
  if (pyramid_.set(image.grey) != ImagePyramid::Status::ok) {
    ++counters_.images_refused;
    return;
  }
  ++counters_.images;
  const std::vector<FeaturePrediction> predictions = ekf_->predictions(image.stamp_s);
  seek(predictions, report);
  describe_landmarks(predictions, report);
  start_tracks(report);
  std::vector<FeatureObservation> observations;
  for (const TrackedFeature& f : report.features) observations.push_back({f.track, f.pixel});
  last_features_ = report.features.size();
  if (const auto filtered = ekf_->update(image.stamp_s, observations)) report.filter = *filtered;
  forget_tracks();
  report.took_ms = milliseconds_since(start);
  if (listener_) listener_(report, image.grey);
}

void MonocularSlam::seek(const std::vector<FeaturePrediction>& predictions, ImageReport& report) {
  for (const FeaturePrediction& prediction : predictions) {
    const auto track = tracks_.find(prediction.track);
    if (track == tracks_.end()) continue;
    const auto expected = expectation(prediction, track->second.patch);
    if (!expected) continue;
    ++report.sought;
    const PatchMatch result = search_.find(pyramid_, track->second.patch, *expected);
    if (result.status != PatchMatch::Status::found) continue;
    report.features.push_back(
        {prediction.track, result.pixel, result.score, prediction.landmark, prediction.converged});
  }
}

std::optional<PatchPrediction> MonocularSlam::expectation(const FeaturePrediction& prediction,
                                                          const ReferencePatch& patch) const {
  const double distance_m = (prediction.T_camera_first.inverse() * prediction.p_camera).norm();
  const auto warp = warp_of_plane(camera_, patch.pixel(), 1.0 / distance_m, prediction.T_camera_first);
  if (!warp) return std::nullopt;
  return PatchPrediction{prediction.pixel, prediction.covariance, warp->now_from_ref};
}

// `converged` was said before this image, and both lists are in the same order.
void MonocularSlam::describe_landmarks(const std::vector<FeaturePrediction>& predictions, const ImageReport& report) {
  const double focal_px = std::sqrt(camera_.calibration().fx * camera_.calibration().fy);
  auto prediction = predictions.begin();
  for (const TrackedFeature& feature : report.features) {
    while (prediction->track != feature.track) ++prediction;
    if (!feature.converged) continue;
    Track& track = tracks_.at(feature.track);
    const double depth_m = prediction->p_camera.z();
    const double misfit = std::abs(std::log(focal_px * descriptor_footprint_m / depth_m / best_footprint_px));
    if (!(misfit < 0.9 * track.footprint_misfit)) continue;
    const DescriptorResult made = describe(pyramid_, feature.pixel, depth_m, focal_px);
    if (made.status != DescriptorResult::Status::made || !ekf_->describe(feature.track, made.descriptor)) continue;
    if (track.footprint_misfit > 1e8) ++counters_.descriptors;
    track.footprint_misfit = misfit;
  }
}

void MonocularSlam::start_tracks(ImageReport& report) {
  const int room = std::min(params_.features - static_cast<int>(report.features.size()), params_.new_features);
  if (room <= 0) return;
  const auto most = static_cast<std::size_t>(room);
  for (const NewTrack& found : find_new_tracks(pyramid_, report.features, most, corners_, search_)) {
    ++counters_.tracks_started;
    tracks_.emplace(++last_track_, Track{found.patch, ekf_->state().abscissa_m});
    report.features.push_back({last_track_, found.pixel});
  }
}

// What the filter has let go, and what has had no depth for too long: it is too far away.
void MonocularSlam::forget_tracks() {
  const double oldest_m = ekf_->state().abscissa_m - params_.candidate_length_m;
  std::erase_if(tracks_, [&](const auto& t) {
    const bool candidate = !ekf_->filter().state().find_landmark(t.first);
    return !ekf_->follows(t.first) || (candidate && t.second.started_m < oldest_m);
  });
}

}  // namespace convoy
