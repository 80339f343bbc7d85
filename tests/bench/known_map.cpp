// A yardstick for the live distances of an MR.CLAM run: the same sensors in a filter that is told the true map and its
// true start. Whatever is known to the vehicles, no filter that runs forward in time has more to go by.
//
//   convoy_known_map MRCLAM_FOLDER [FROM_S]     distances from FROM_S on, default 250 s
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>

#include <Eigen/LU>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <map>

#include "evaluate/truth.hpp"
#include "scenario/mrclam.hpp"

namespace {

using namespace convoy;
using namespace convoy::cli;

// Noise and scales: those that `convoy demo --dataset mrclam` uses.
constexpr double distance_scale = 0.97, angle_scale = 0.95, sighting_interval_s = 1.0;

class KnownMapFilter {
 public:
  KnownMapFilter(const SE2& start, const std::vector<TruthLandmark<SE2>>& landmarks) : pose_(start) {
    for (const TruthLandmark<SE2>& l : landmarks) map_[l.id] = l.p_world_m;
    P_.diagonal() << 1e-4, 1e-4, 1e-4;
  }

  void read(const SensorEvent& event) {
    const double dt = std::min(event.t_s - t_s_, 2.0);
    if (dt > 0.0 && (v_ != 0.0 || omega_ != 0.0)) move(v_ * dt, omega_ * dt);
    t_s_ = event.t_s;
    if (event.kind == SensorEvent::Kind::odometry) {
      v_ = distance_scale * event.v_m_s;
      omega_ = angle_scale * event.omega_rad_s;
    } else if (event.kind == SensorEvent::Kind::sighting) {
      see(event);
    }
  }
  const SE2& pose() const { return pose_; }

 private:
  void move(double distance, double angle) {
    const SE2 step = SE2::Exp({distance, 0.0, angle});
    pose_ = pose_ * step;
    const SE2::Adjoint Ad = step.inverse().adjoint();
    P_ = Ad * P_ * Ad.transpose();
    const double length = std::abs(distance), turned = std::abs(angle);
    P_(0, 0) += 9e-4 * length + 9e-4 * turned;
    P_(1, 1) += 2.5e-5 * length;
    P_(2, 2) += 6.4e-3 * length + 1e-2 * turned;
  }

  void see(const SensorEvent& event) {
    const auto landmark = map_.find(event.track);
    if (landmark == map_.end()) return;
    if (const auto last = last_s_.find(event.track);
        last != last_s_.end() && event.t_s < last->second + sighting_interval_s)
      return;
    const Eigen::Vector2d y = pose_.inverse() * landmark->second;
    const double range = y.norm(), sigma_range = 0.1 + 0.05 * range;
    Eigen::Matrix2d polar;
    polar << y.x() / range, y.y() / range, -y.y() / (range * range), y.x() / (range * range);
    Eigen::Matrix<double, 2, 3> H;  // of a right perturbation: dy = -rho - theta J y
    H << -polar, polar * Eigen::Vector2d(y.y(), -y.x());
    const Eigen::Matrix2d noise = Eigen::Vector2d(sigma_range * sigma_range, 9e-4).asDiagonal();
    const Eigen::Matrix2d S = symmetrised(Eigen::Matrix2d(H * P_ * H.transpose() + noise));
    const Eigen::Vector2d innovation(event.range_m - range, wrap_angle(event.bearing_rad - std::atan2(y.y(), y.x())));
    if (squared_mahalanobis(innovation, S) > chi2_quantile(0.999, 2)) return;
    const Eigen::Matrix<double, 3, 2> K = P_ * H.transpose() * S.inverse();
    pose_ = pose_ * SE2::Exp(K * innovation);
    P_ = symmetrised(SE2::Covariance(P_ - K * S * K.transpose()));
    last_s_[event.track] = event.t_s;
  }

  std::map<std::uint32_t, Eigen::Vector2d> map_;
  std::map<std::uint32_t, double> last_s_;
  SE2 pose_;
  SE2::Covariance P_ = SE2::Covariance::Zero();
  double t_s_ = 0.0, v_ = 0.0, omega_ = 0.0;
};

struct Second {
  Eigen::Vector2d estimate, truth;
};

std::map<int, Second> drive(const VehicleLog<SE2>& log, const std::vector<TruthLandmark<SE2>>& landmarks) {
  std::map<int, Second> seconds;
  std::optional<KnownMapFilter> filter;
  int next = 0;
  for (const SensorEvent& event : log.sensors) {
    if (!filter) {
      const auto start = truth_at(log.truth, event.t_s);
      if (!start) continue;
      filter.emplace(*start, landmarks);
      next = static_cast<int>(std::ceil(event.t_s));
    }
    filter->read(event);
    if (event.t_s < next) continue;
    if (const auto truth = truth_at(log.truth, event.t_s))
      seconds[next] = {filter->pose().translation(), truth->translation()};
    next = static_cast<int>(std::floor(event.t_s)) + 1;
  }
  return seconds;
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc < 2) return std::fprintf(stderr, "usage: convoy_known_map MRCLAM_FOLDER [FROM_S]\n"), 2;
  const Scenario<SE2> scenario = load_mrclam(argv[1]);
  const int from_s = argc > 2 ? std::atoi(argv[2]) : 250;
  std::map<VehicleId, std::map<int, Second>> driven;
  for (const VehicleLog<SE2>& log : scenario.vehicles) {
    driven[log.id] = drive(log, scenario.landmarks);
    double sum = 0.0;
    for (const auto& [t, s] : driven[log.id]) sum += (s.estimate - s.truth).squaredNorm();
    std::printf("vehicle %u: position %.3f m RMSE over %zu s\n", log.id,
                std::sqrt(sum / static_cast<double>(std::max<std::size_t>(1, driven[log.id].size()))),
                driven[log.id].size());
  }
  for (const auto& [a, of_a] : driven)
    for (const auto& [b, of_b] : driven) {
      double sum = 0.0;
      int count = 0;
      for (const auto& [t, s] : of_a) {
        const auto other = of_b.find(t);
        if (a >= b || t < from_s || other == of_b.end()) continue;
        const double error = (s.estimate - other->second.estimate).norm() - (s.truth - other->second.truth).norm();
        sum += error * error;
        ++count;
      }
      if (count > 0)
        std::printf("distance %u-%u: %.3f m RMSE over %d s from %d s on\n", a, b, std::sqrt(sum / count), count,
                    from_s);
    }
  return 0;
} catch (const std::exception& error) {
  return std::fprintf(stderr, "convoy_known_map: %s\n", error.what()), 2;
}
