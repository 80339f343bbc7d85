// A street for the monocular front end: points on both sides of a course with turns, a camera that sees them with
// exactly the noise that the filter is told, unless said otherwise, and an image side that follows them by the filter's
// predictions.
#pragma once

#include <convoy/frontend/odometry_noise.hpp>
#include <convoy/monocular/monocular_ekf.hpp>

#include "../random_world.hpp"

#include <algorithm>
#include <functional>
#include <map>
#include <set>

namespace convoy::test {

struct MonocularWorldParams {
  double length_m = 300.0;
  double outliers = 0.0;      ///< share of the pixels that lie anywhere within 30 px
  double dropout = 0.1;       ///< share of the pixels that are not found
  double noise_px = 0.0;      ///< standard deviation of a pixel; 0: what the filter is told
  double noise_frames = 0.0;  ///< over which the errors of one track's pixels hang together; 0: each errs anew
  double scale_error = 0.0;   ///< true distance is (1 + this) times what the odometer says
  bool draw_scale = false;    ///< from what the filter is told, instead
  std::size_t tracks = 40;    ///< followed at once
  double points_per_m = 5.0;
  /// Speed that the odometer says, of the true one, at this time.
  std::function<double(double)> slip = [](double) { return 1.0; };
  /// Whether the image of this time is lost.
  std::function<bool(double)> lost = [](double) { return false; };
  /// Whether every pixel of this time's image is anywhere.
  std::function<bool(double)> nonsense = [](double) { return false; };
  /// Of the true speed at this time.
  std::function<double(double)> throttle = [](double) { return 1.0; };
  /// Turned on top of the course's curvature, at this time [rad/s].
  std::function<double(double)> spin = [](double) { return 0.0; };
};

inline CameraCalibration street_camera() {
  CameraCalibration c;
  c.width = 640;
  c.height = 480;
  c.fx = c.fy = 370.0;
  c.cx = 319.5;
  c.cy = 239.5;
  c.coefficients << -0.06, 0.01, 0.0005, -0.0005, 0.0;
  return c;
}

/// 1.5 m above the ground and 1 m ahead of the axle, looking ahead.
inline SE3 street_mount() {
  Eigen::Matrix3d R;
  R << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return SE3::from_rotation(R, {1.0, 0.1, 1.5});
}

class MonocularWorld {
 public:
  MonocularWorld(const MonocularParams& params, const MonocularWorldParams& world, std::uint64_t seed)
      : params_(params), world_(world), random_(seed), camera_(street_camera()), ekf_(params, camera_, street_mount()) {
    bias_ = random_.normal(params.sigma_yaw_bias_radps);
    scale_ = world.draw_scale ? random_.normal(params.sigma_scale) : world.scale_error;
    drive_in_truth();
    lay_out_street();
  }

  MonocularEkf& ekf() { return ekf_; }
  const SE3& truth() const { return course_[tick_].truth; }
  double now_s() const { return dt_s * static_cast<double>(tick_); }
  double driven_m() const { return course_[tick_].driven_m; }
  const std::vector<Eigen::Vector3d>& points() const { return points_; }
  /// The point that a track follows.
  std::size_t point_of(std::uint64_t track) const { return followed_.at(track); }
  /// Truth at every frame.
  const std::map<double, SE3>& passed() const { return passed_; }
  /// Truth at the last image.
  const SE3& seen_from() const { return seen_from_; }
  std::vector<FrameReport> reports;
  std::size_t largest_state = 0;

  /// The whole course, calling after_input() after each input to the filter.
  void run(const std::function<void()>& after_input = [] {}) {
    while (driven_m() < world_.length_m && !ekf_.lost()) {
      if (tick_ % 5 == 0) look(after_input);
      const Tick& from = course_[tick_];
      ekf_.on_odometry(now_s(), from.v * world_.slip(now_s()), from.omega);
      ++tick_;
      ekf_.on_time(now_s());
      after_input();
    }
  }

  void look(const std::function<void()>& after_input = [] {}) {
    passed_[now_s()] = truth();
    if (world_.lost(now_s())) return;
    std::vector<FeatureObservation> found;
    std::set<std::size_t> active;
    for (const FeaturePrediction& p : ekf_.predictions(now_s())) {
      const auto pixel = pixel_of(followed_.at(p.track));
      if (!pixel) continue;
      active.insert(followed_.at(p.track));
      if (random_.uniform(0.0, 1.0) >= world_.dropout) found.push_back({p.track, measured(p.track, *pixel)});
    }
    start_tracks(active, found);
    const auto report = ekf_.update(now_s(), found);
    if (report) reports.push_back(*report);
    seen_from_ = truth();
    largest_state = std::max(largest_state, static_cast<std::size_t>(ekf_.filter().state().covariance().rows()));
    after_input();
  }

  static constexpr double dt_s = 0.02;

 private:
  struct Tick {  // from here on, for dt_s
    SE3 truth;
    double driven_m = 0.0, v = 0.0, omega = 0.0;
  };

  // Straight for 40 m, then a quarter turn of 10 m radius, to the left and to the right in turns.
  static double curvature(double s) {
    const double leg = 40.0 + 5.0 * M_PI, in_leg = std::fmod(s, leg);
    if (in_leg < 40.0) return 0.0;
    return static_cast<int>(s / leg) % 2 == 0 ? 0.1 : -0.1;
  }

  void drive_in_truth() {
    Tick now;
    while (now.driven_m < world_.length_m + 45.0) {
      const double t = dt_s * static_cast<double>(course_.size());
      now.v = world_.throttle(t) * (3.5 + 1.5 * std::sin(0.05 * now.driven_m));
      now.omega = now.v * curvature(now.driven_m) + world_.spin(t);
      course_.push_back(now);
      now.truth = now.truth * noisy_step(now.v, now.omega);
      now.driven_m += now.v * dt_s;
    }
  }

  SE3 noisy_step(double v, double omega) {
    SE3::Tangent u = SE3::Tangent::Zero();
    if (v == 0.0 && omega == 0.0) return SE3();
    u[0] = (1.0 + scale_) * v * dt_s;
    u[5] = (omega - bias_) * dt_s;
    const SE3::Tangent variance = odometry_variance<SE3>(params_, std::abs(v) * dt_s, std::abs(omega) * dt_s, dt_s);
    return SE3::Exp(u) * SE3::Exp(variance.cwiseSqrt().cwiseProduct(random_.unit_normal<6>()));
  }

  // The points stand beside the way that the vehicle really goes: a street rises and leans with its road.
  void lay_out_street() {
    double s = 0.0;
    for (const Tick& at : course_)
      for (; s < at.driven_m; s += 1.0 / world_.points_per_m) {
        const double side = random_.uniform(0.0, 1.0) < 0.5 ? -1.0 : 1.0;
        points_.push_back(at.truth *
                          Eigen::Vector3d(0.0, side * random_.uniform(3.0, 12.0), random_.uniform(-0.2, 7.0)));
        places_.push_back(s);
      }
  }

  std::optional<Eigen::Vector2d> pixel_of(std::size_t i) const {
    const Eigen::Vector3d p = (truth() * street_mount()).inverse() * points_[i];
    if (p.z() < 1.5 || p.norm() > 35.0) return std::nullopt;
    const auto at = camera_.project(p);
    if (!at || !camera_.in_image(at->pixel, 8.0)) return std::nullopt;
    return at->pixel;
  }

  Eigen::Vector2d measured(std::uint64_t track, const Eigen::Vector2d& pixel) {
    Eigen::Vector2d z = pixel + (world_.noise_px > 0.0 ? world_.noise_px : params_.sigma_pixel) * noise_of(track);
    if (world_.nonsense(now_s())) return {random_.uniform(0.0, 639.0), random_.uniform(0.0, 479.0)};
    if (random_.uniform(0.0, 1.0) < world_.outliers)
      z = pixel + Eigen::Vector2d(random_.uniform(-30.0, 30.0), random_.uniform(-30.0, 30.0));
    return camera_.in_image(z) ? z : pixel;
  }

  // An AR(1) process along the frames a track is found in, of variance 1.
  Eigen::Vector2d noise_of(std::uint64_t track) {
    const Eigen::Vector2d fresh = random_.unit_normal<2>();
    const auto [at, is_new] = noise_.try_emplace(track, fresh);
    const double phi = world_.noise_frames > 0.0 ? std::exp(-1.0 / world_.noise_frames) : 0.0;
    if (!is_new) at->second = phi * at->second + std::sqrt(1.0 - phi * phi) * fresh;
    return at->second;
  }

  void start_tracks(const std::set<std::size_t>& active, std::vector<FeatureObservation>& found) {
    std::vector<std::pair<std::size_t, Eigen::Vector2d>> fresh;
    for (std::size_t i = 0; i < points_.size(); ++i) {
      if (std::abs(places_[i] - driven_m()) > 50.0 || active.count(i) > 0) continue;
      if (const auto pixel = pixel_of(i)) fresh.emplace_back(i, *pixel);
    }
    for (std::size_t n = active.size(); n < world_.tracks && !fresh.empty(); ++n) {
      const auto k = static_cast<std::size_t>(random_.integer(0, static_cast<int>(fresh.size()) - 1));
      followed_[++last_track_] = fresh[k].first;
      found.push_back({last_track_, measured(last_track_, fresh[k].second)});
      fresh.erase(fresh.begin() + static_cast<std::ptrdiff_t>(k));
    }
  }

  MonocularParams params_;
  MonocularWorldParams world_;
  Random random_;
  CameraModel camera_;
  MonocularEkf ekf_;
  std::vector<Tick> course_;
  SE3 seen_from_;
  double bias_ = 0.0, scale_ = 0.0;
  std::vector<Eigen::Vector3d> points_;
  std::vector<double> places_;  // along the course
  std::map<std::uint64_t, std::size_t> followed_;
  std::map<std::uint64_t, Eigen::Vector2d> noise_;  // of each track's last pixel
  std::map<double, SE3> passed_;
  std::uint64_t last_track_ = 0;
  std::size_t tick_ = 0;
};

}  // namespace convoy::test
