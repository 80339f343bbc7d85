#include "scenario/street.hpp"

#include <algorithm>
#include <cmath>
#include <convoy/config_error.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/polar.hpp>

#include "scenario/counter_rng.hpp"

namespace convoy::cli {
namespace {

// The numbers are part of what a seed means; append, never renumber.
enum Stream : std::uint32_t {
  landmark_stream,
  speed_variation_stream,
  detectability_stream,
  dropout_stream,
  range_stream,
  bearing_stream,
  speed_scale_stream,
  speed_stream,
  yaw_rate_stream,
  yaw_bias_stream,
  elevation_stream,
};

constexpr VehicleId front_vehicle = 1;
constexpr VehicleId back_vehicle = 2;

void require(bool condition, const char* what) {
  if (!condition) throw ConfigError(std::string("street scenario: ") + what);
}

void check(const StreetParams& p) {
  require(!p.straights_m.empty() && p.turns.size() + 1 == p.straights_m.size(),
          "turns must be one fewer than straights_m");
  for (const double straight : p.straights_m) require(straight > 0.0, "straights_m must be above 0");
  for (const int turn : p.turns) require(turn == 1 || turn == -1, "turns must be +1 or -1");
  require(p.bend_radius_m > 0.0, "bend_radius_m must be above 0");
  require(p.gap_m >= 0.0, "gap_m must not be negative");
  require(p.speed_m_s > 0.0 && p.bend_speed_m_s > 0.0, "speeds must be above 0");
  require(p.acceleration_m_s2 > 0.0, "acceleration_m_s2 must be above 0");
  require(p.speed_variation >= 0.0 && p.speed_variation <= 0.5, "speed_variation must be 0 to 0.5");
  require(p.landmarks_per_metre >= 0.0 && p.landmarks_per_metre <= 2.0, "landmarks_per_metre must be 0 to 2");
  require(p.landmark_spacing_m >= 0.0, "landmark_spacing_m must not be negative");
  require(p.landmark_near_m >= 0.0 && p.landmark_far_m > p.landmark_near_m,
          "landmark_far_m must be above landmark_near_m");
  require(p.max_grade >= 0.0 && p.max_grade <= 0.3 && p.grade_wave_m > 0.0,
          "max_grade must be 0 to 0.3 and grade_wave_m above 0");
  require(p.landmark_height_m >= 0.0, "landmark_height_m must not be negative");
  require(p.odometry_rate_hz > 0.0 && p.camera_rate_hz > 0.0, "rates must be above 0");
  const double ratio = p.odometry_rate_hz / p.camera_rate_hz;
  require(std::abs(ratio - std::round(ratio)) < 1e-9 && ratio >= 1.0,
          "odometry_rate_hz must be a multiple of camera_rate_hz");
  require(p.range_min_m >= 0.0 && p.range_max_m > p.range_min_m, "range_max_m must be above range_min_m");
  require(p.detectability >= 0.0 && p.detectability <= 1.0, "detectability must be 0 to 1");
  require(p.dropout >= 0.0 && p.dropout < 1.0, "dropout must be 0 to below 1");
  for (const double sigma :
       {p.range_sigma_m, p.range_sigma_share, p.bearing_sigma_rad, p.elevation_sigma_rad, p.speed_scale_sigma,
        p.speed_sigma_m_s, p.yaw_rate_density_rad_sqrt_s, p.yaw_bias_sigma_rad_s, p.yaw_bias_walk_rad_s_sqrt_s,
        p.prior_circle_m, p.prior_heading_sigma_rad, p.prior_height_sigma_m, p.prior_tilt_sigma_rad})
    require(sigma >= 0.0, "a standard deviation must not be negative");
}

double rounded(double value) { return std::round(value * 1e6) / 1e6; }

/// The centre line seen from above, by curvilinear abscissa s; s = 0 is the origin, s < 0 lies on the straight behind
/// it.
class Course {
 public:
  explicit Course(const StreetParams& p) {
    SE2 T;
    for (std::size_t i = 0; i < p.straights_m.size(); ++i) {
      append(T, p.straights_m[i], 0.0);
      if (i < p.turns.size()) append(T, 0.5 * M_PI * p.bend_radius_m, p.turns[i] / p.bend_radius_m);
    }
  }

  double length_m() const { return pieces_.back().begin_m + pieces_.back().length_m; }

  SE2 at(double s_m) const {
    const Piece& piece = piece_at(s_m);
    const double ds = s_m - piece.begin_m;
    return piece.T_begin * SE2::Exp({ds, 0.0, ds * piece.curvature});
  }

  /// What the driver may do at s, given that he brakes in time for the bends ahead.
  double speed_limit(double s_m, const StreetParams& p) const {
    double limit = p.speed_m_s * (1.0 + p.speed_variation);
    for (const Piece& piece : pieces_) {
      if (piece.curvature == 0.0 || s_m > piece.begin_m + piece.length_m) continue;
      const double ahead_m = std::max(0.0, piece.begin_m - s_m);
      limit = std::min(limit, std::sqrt(p.bend_speed_m_s * p.bend_speed_m_s + 2.0 * p.acceleration_m_s2 * ahead_m));
    }
    return limit;
  }

 private:
  struct Piece {
    SE2 T_begin;
    double begin_m, length_m, curvature;
  };

  void append(SE2& T, double length_m, double curvature) {
    pieces_.push_back({T, pieces_.empty() ? 0.0 : this->length_m(), length_m, curvature});
    T = T * SE2::Exp({length_m, 0.0, length_m * curvature});
  }

  const Piece& piece_at(double s_m) const {
    std::size_t i = 0;
    while (i + 1 < pieces_.size() && s_m >= pieces_[i + 1].begin_m) ++i;
    return pieces_[i];
  }

  std::vector<Piece> pieces_;
};

/// Of the road at s. [m]
double height_m(const StreetParams& p, double s_m) {
  const double wave = 2.0 * M_PI / p.grade_wave_m;
  return p.max_grade / wave * (1.0 - std::cos(wave * s_m));
}

/// A vehicle at s: in space with the height and the pitch of the road.
template <class G>
G pose_at(const StreetParams& p, const Course& course, double s_m) {
  const SE2 from_above = course.at(s_m);
  if constexpr (G::Dim == 2) {
    return from_above;
  } else {
    typename G::Tangent yaw = G::Tangent::Zero(), pitch = G::Tangent::Zero();
    yaw[5] = from_above.theta();
    pitch[4] = -std::atan(p.max_grade * std::sin(2.0 * M_PI * s_m / p.grade_wave_m));  // uphill the nose is up
    const Eigen::Vector2d& t = from_above.translation();
    return G(typename G::Quaternion(1.0, 0.0, 0.0, 0.0), {t.x(), t.y(), height_m(p, s_m)}) * G::Exp(yaw) *
           G::Exp(pitch);
  }
}

/// Poisson disc by dart throwing: as many as asked for, or as many as find room in a bounded number of throws.
template <class G>
std::vector<TruthLandmark<G>> throw_landmarks(const StreetParams& p, const Course& course, std::uint64_t seed) {
  const double begin_m = -p.gap_m - 5.0, end_m = p.distance_m + p.range_max_m;
  std::vector<Eigen::Vector2d> centre_line;
  for (double s = begin_m; s <= end_m + p.landmark_far_m; s += 0.5) centre_line.push_back(course.at(s).translation());

  const auto wanted = static_cast<std::size_t>(std::lround(p.landmarks_per_metre * (end_m - begin_m)));
  const CounterRng rng(seed, 0, landmark_stream);
  std::vector<TruthLandmark<G>> landmarks;
  for (std::uint32_t dart = 0; landmarks.size() < wanted && dart < 200 * wanted; ++dart) {
    const double s = begin_m + (end_m - begin_m) * rng.uniform(dart, 0);
    const double side = rng.uniform(dart, 1) < 0.5 ? -1.0 : 1.0;
    const double offset = p.landmark_near_m + (p.landmark_far_m - p.landmark_near_m) * rng.uniform(dart, 2);
    const Eigen::Vector2d foot = course.at(s) * Eigen::Vector2d(0.0, side * offset);
    typename G::Point place;
    if constexpr (G::Dim == 3) place.z() = height_m(p, s) + p.landmark_height_m * rng.uniform(dart, 3);
    place.template head<2>() = foot;
    const bool on_street = std::any_of(centre_line.begin(), centre_line.end(),
                                       [&](const auto& c) { return (foot - c).norm() < p.landmark_near_m - 0.05; });
    const bool crowded = std::any_of(landmarks.begin(), landmarks.end(), [&](const auto& l) {
      return (place - l.p_world_m).norm() < p.landmark_spacing_m;
    });
    if (on_street || crowded) continue;
    landmarks.push_back({static_cast<std::uint32_t>(landmarks.size() + 1), place.unaryExpr(&rounded)});
  }
  return landmarks;
}

/// Drives the course from rest and keeps the true abscissa at every odometry tick.
class Driver {
 public:
  Driver(const StreetParams& p, const Course& course, std::uint64_t seed, VehicleId id, double start_m)
      : p_(p), course_(course), rng_(seed, id, speed_variation_stream), abscissas_m_{start_m} {}

  void step() {
    const double dt = 1.0 / p_.odometry_rate_hz, s = abscissas_m_.back();
    const double t = dt * static_cast<double>(abscissas_m_.size() - 1);
    const double wish = std::min(cruising_speed(t), course_.speed_limit(s, p_));
    const double change = p_.acceleration_m_s2 * dt;
    const double next_speed = std::clamp(wish, std::max(0.0, speed_ - 2.0 * change), speed_ + change);
    abscissas_m_.push_back(s + 0.5 * (speed_ + next_speed) * dt);
    speed_ = next_speed;
  }

  const std::vector<double>& abscissas_m() const { return abscissas_m_; }

 private:
  /// Two slow waves with random phases: no two drivers are alike.
  double cruising_speed(double t_s) const {
    const double wave = 0.5 * std::sin(2.0 * M_PI * (t_s / 31.0 + rng_.uniform(0))) +
                        0.5 * std::sin(2.0 * M_PI * (t_s / 13.0 + rng_.uniform(1)));
    return p_.speed_m_s * (1.0 + p_.speed_variation * wave);
  }

  const StreetParams& p_;
  const Course& course_;
  CounterRng rng_;
  std::vector<double> abscissas_m_;
  double speed_ = 0.0;
};

class Sensors {
 public:
  Sensors(const StreetParams& p, std::uint64_t seed, VehicleId id)
      : p_(p),
        detectability_(seed, id, detectability_stream),
        dropout_(seed, id, dropout_stream),
        range_(seed, id, range_stream),
        bearing_(seed, id, bearing_stream),
        elevation_(seed, id, elevation_stream),
        speed_(seed, id, speed_stream),
        yaw_rate_(seed, id, yaw_rate_stream),
        yaw_bias_(seed, id, yaw_bias_stream),
        speed_scale_(1.0 + p.speed_scale_sigma * CounterRng(seed, id, speed_scale_stream).normal(0)),
        bias_rad_s_(p.yaw_bias_sigma_rad_s * yaw_bias_.normal(0)) {}

  template <class G>
  SensorEvent odometry(std::uint32_t tick, const G& T_world_now, const G& T_world_next) {
    const double dt = 1.0 / p_.odometry_rate_hz;
    const typename G::Tangent moved = (T_world_now.inverse() * T_world_next).Log();
    const double v = speed_scale_ * moved[0] / dt + p_.speed_sigma_m_s * speed_.normal(tick);
    const double omega =
        moved[G::Dof - 1] / dt + bias_rad_s_ + p_.yaw_rate_density_rad_sqrt_s / std::sqrt(dt) * yaw_rate_.normal(tick);
    bias_rad_s_ += p_.yaw_bias_walk_rad_s_sqrt_s * std::sqrt(dt) * yaw_bias_.normal(tick + 1);
    return SensorEvent::odometry(rounded(tick * dt), rounded(v), rounded(omega));
  }

  template <class G>
  void look(std::uint32_t tick, const G& T_world_body, const std::vector<TruthLandmark<G>>& landmarks,
            std::vector<SensorEvent>& events) const {
    const double t_s = rounded(tick / p_.odometry_rate_hz);
    for (const TruthLandmark<G>& landmark : landmarks) {
      if (detectability_.uniform(landmark.id) >= p_.detectability) continue;
      const typename G::Point polar = polar_of(typename G::Point(T_world_body.inverse() * landmark.p_world_m));
      const double range = polar[0], bearing = polar[1];
      if (range < p_.range_min_m || range > p_.range_max_m || std::abs(bearing) > 0.5 * p_.field_of_view_rad) continue;
      if (dropout_.uniform(tick, landmark.id) < p_.dropout) continue;
      const double noisy_range =
          range + (p_.range_sigma_m + p_.range_sigma_share * range) * range_.normal(tick, landmark.id);
      const double noisy_bearing = bearing + p_.bearing_sigma_rad * bearing_.normal(tick, landmark.id);
      double noisy_elevation = 0.0;
      if constexpr (G::Dim == 3)
        noisy_elevation = polar[2] + p_.elevation_sigma_rad * elevation_.normal(tick, landmark.id);
      if (noisy_range <= 0.0 || std::abs(noisy_elevation) > 0.5 * M_PI) continue;
      events.push_back(SensorEvent::sighting(t_s, landmark.id, rounded(noisy_range), rounded(noisy_bearing),
                                             rounded(noisy_elevation)));
    }
  }

 private:
  const StreetParams& p_;
  CounterRng detectability_, dropout_, range_, bearing_, elevation_, speed_, yaw_rate_, yaw_bias_;
  double speed_scale_;
  double bias_rad_s_;
};

template <class G>
VehicleLog<G> record(const StreetParams& p, const Course& course, const std::vector<double>& abscissas_m,
                     const std::vector<TruthLandmark<G>>& landmarks, std::uint64_t seed, VehicleId id) {
  VehicleLog<G> log;
  log.id = id;
  Sensors sensors(p, seed, id);
  const auto ticks_per_image = static_cast<std::uint32_t>(std::lround(p.odometry_rate_hz / p.camera_rate_hz));
  for (std::uint32_t tick = 0; tick + 1 < abscissas_m.size(); ++tick) {
    const G T_world_now = pose_at<G>(p, course, abscissas_m[tick]),
            T_world_next = pose_at<G>(p, course, abscissas_m[tick + 1]);
    log.truth.push_back({rounded(tick / p.odometry_rate_hz), T_world_now});
    log.sensors.push_back(sensors.odometry(tick, T_world_now, T_world_next));
    if (tick % ticks_per_image == 0) sensors.look(tick, T_world_now, landmarks, log.sensors);
  }
  return log;
}

template <class G>
typename G::Tangent prior_sigma(const StreetParams& p) {
  const double sigma_m = p.prior_circle_m / std::sqrt(chi2_quantile(0.95, 2.0));
  typename G::Tangent sigma;
  if constexpr (G::Dim == 3)
    sigma << 0.0, 0.0, p.prior_height_sigma_m, p.prior_tilt_sigma_rad, p.prior_tilt_sigma_rad, 0.0;
  sigma[0] = sigma[1] = sigma_m;
  sigma[G::Dof - 1] = p.prior_heading_sigma_rad;
  return sigma;
}

std::string describe(const StreetParams& p, int dimension) {
  const auto in_tenths = [](double value) {
    const std::string text = std::to_string(std::round(value * 10.0) / 10.0);
    return text.substr(0, text.find('.') + 2);
  };
  return "simulated street, " + in_tenths(p.distance_m) + " m at " + in_tenths(p.speed_m_s) + " m/s, gap " +
         in_tenths(p.gap_m) + " m" +
         (dimension == 2 ? "" : ", in space, grades up to " + in_tenths(100.0 * p.max_grade) + " %");
}

}  // namespace

template <class G>
Scenario<G> make_street(const StreetParams& params, std::uint64_t seed) {
  check(params);
  const Course course(params);
  require(params.distance_m > 0.0 && params.distance_m <= course.length_m(),
          "distance_m must be above 0 and at most the length of the course");

  Scenario<G> scenario;
  scenario.name = "street";
  scenario.source = describe(params, G::Dim);
  scenario.seed = seed;
  scenario.common_frame_vehicle = front_vehicle;
  scenario.landmarks = throw_landmarks<G>(params, course, seed);

  Driver front(params, course, seed, front_vehicle, 0.0);
  Driver back(params, course, seed, back_vehicle, -params.gap_m);
  while (front.abscissas_m().back() < params.distance_m) {
    front.step();
    back.step();
  }
  scenario.vehicles.push_back(record(params, course, front.abscissas_m(), scenario.landmarks, seed, front_vehicle));
  scenario.vehicles.push_back(record(params, course, back.abscissas_m(), scenario.landmarks, seed, back_vehicle));
  scenario.vehicles[0].prior = StaticPrior<G>{};
  scenario.vehicles[1].prior = StaticPrior<G>{G(), prior_sigma<G>(params)};
  scenario.duration_s = scenario.vehicles[0].sensors.back().t_s;
  return scenario;
}

#define CONVOY_INSTANTIATE(G) template Scenario<G> make_street(const StreetParams&, std::uint64_t);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
