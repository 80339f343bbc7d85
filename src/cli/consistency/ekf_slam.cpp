#include "consistency/ekf_slam.hpp"

#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/polar.hpp>
#include <convoy/submap/rounding.hpp>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>

#include "consistency/draw.hpp"

namespace convoy::cli::consistency {
namespace {

constexpr double speed_mps = 2.0, step_m = 0.5;
constexpr int steps_per_sighting = 2;
constexpr double sight_m = 20.0, field_of_view_rad = 4.0;

ChainId chain(std::size_t v) { return {static_cast<VehicleId>(v + 1), 1}; }

RangeBearingEkfParams front_end_params(const EkfSlamParams& p) {
  RangeBearingEkfParams f;
  f.sigma_along_per_sqrt_m = p.noise * p.sigma_along_per_sqrt_m;
  f.sigma_across_per_sqrt_m = 1e-3;  // nothing slips sideways here
  f.sigma_heading_per_sqrt_m = p.noise * p.sigma_heading_per_sqrt_m;
  f.sigma_heading_per_sqrt_rad = 0.0;
  f.sigma_range_m = p.noise * p.sigma_range_m;
  f.sigma_bearing_rad = f.sigma_elevation_rad = p.noise * p.sigma_bearing_rad;
  // In space, tilt and height keep their defaults: no noise is drawn for them, the surface turns the vehicle. On the
  // loop its pitch changes by 0.043 rad RMS over the 25 m of a segment, as much as a walk of 0.0085 rad/sqrt(m) would.
  f.max_remembered = 0;     // the live pose is not judged here
  f.trail_spacing_m = 0.0;  // anchors are
  return f;
}

// A vehicle on its wheels at `s`: in space along the way, and upright on a surface without banks.
template <class G>
G standing_on(Path path, double s) {
  const G T = pose_on<G>(path, s);
  if constexpr (G::Dim == 2) {
    return T;
  } else {
    constexpr double h = 0.01;
    Eigen::Matrix3d R;
    R.col(0) = (pose_on<G>(path, s + h).translation() - pose_on<G>(path, s - h).translation()).normalized();
    R.col(1) = Eigen::Vector3d::UnitZ().cross(R.col(0)).normalized();
    R.col(2) = R.col(0).cross(R.col(1));
    return G::from_rotation(R, T.translation());
  }
}

// What an exact odometer says of a step from s: distance [m] and turn to the left [rad].
template <class G>
Eigen::Vector2d true_motion(Path path, double s) {
  const G T = standing_on<G>(path, s), T_next = standing_on<G>(path, s + step_m);
  if constexpr (G::Dim == 2) {
    return {step_m, wrap_angle(T.inverse().theta() + T_next.theta())};
  } else {
    const typename G::Tangent moved = (T.inverse() * T_next).Log();
    return {moved[0], moved[5]};
  }
}

template <class G>
class Driver {
 public:
  Driver(const EkfSlamParams& params, std::uint64_t seed, int run)
      : p_(params),
        draw_(seed, static_cast<std::uint32_t>(run), 20),
        points_(points_along<G>(p_.path, p_.landmarks_per_metre, p_.landmark_spacing_m, draw_)) {
    if (p_.repeat_m > 0.0) repeat();
  }

  typename SlamRun<G>::Vehicle drive(int v) {
    typename SlamRun<G>::Vehicle vehicle;
    const double start_m = p_.gap_m * v;
    vehicle.T_start = standing_on<G>(p_.path, start_m);
    const typename G::Tangent sigma = start_sigma(v);
    vehicle.start = {{chain(static_cast<std::size_t>(v)), 0}, true, G(), sigma.cwiseAbs2().asDiagonal()};
    vehicle.start.mean = vehicle.T_start * G::Exp(-sigma.cwiseProduct(draw_.template unit_normal<G::Dof>()));
    RangeBearingEkf<G> slam(front_end_params(p_));
    const int steps = static_cast<int>(length_m(p_.path) / step_m);
    for (int k = 0; k <= steps; ++k) {
      const double t = k * step_m / speed_mps;
      const Eigen::Vector2d moved = true_motion<G>(p_.path, start_m + k * step_m);
      const double rate = odometry_rate(moved[1]);  // drawn first: the order of arguments is the compiler's
      slam.on_odometry(t, odometry_speed(moved[0]), rate);
      collect(slam, vehicle, start_m);
      if (k % steps_per_sighting == 0) look(slam, t, standing_on<G>(p_.path, start_m + k * step_m));
      vehicle.states.push_back(slam.state());
    }
    slam.finish();
    collect(slam, vehicle, start_m);
    return vehicle;
  }

 private:
  typename G::Tangent start_sigma(int v) const {
    typename G::Tangent sigma;
    sigma.template head<G::Dim>().setConstant(v == 0 ? 0.01 : p_.start_sigma_m);
    // In space, a vehicle knows where down is.
    sigma.template tail<G::Dof - G::Dim>().setConstant(v == 0 ? 0.001 : 0.01);
    if (v > 0) sigma[G::Dof - 1] = p_.start_sigma_rad;
    return sigma;
  }

  // What stands along the first `repeat_m` of a straight stands along each further such length.
  void repeat() {
    std::vector<typename G::Point> pattern;
    for (const auto& p : points_)
      if (p.x() < p_.repeat_m) pattern.push_back(p);
    points_.clear();
    for (double x = 0.0; x < distinct_length_m(p_.path); x += p_.repeat_m)
      for (const auto& p : pattern) points_.push_back(p + x * G::Point::Unit(0));
  }

  double odometry_speed(double distance_m) {
    const double sigma = p_.noise * p_.sigma_along_per_sqrt_m * std::sqrt(step_m);
    return (distance_m + sigma * draw_.normal()) / (1.0 + p_.scale_error) * speed_mps / step_m;
  }
  double odometry_rate(double angle_rad) {
    const double sigma = p_.noise * p_.sigma_heading_per_sqrt_m * std::sqrt(step_m);
    return (angle_rad + sigma * draw_.normal() + p_.gyro_bias_rad_per_m * step_m) * speed_mps / step_m;
  }

  void look(RangeBearingEkf<G>& slam, double t, const G& T) {
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const typename G::Point polar = polar_of(typename G::Point(T.inverse() * points_[i]));
      if (polar[0] > sight_m || std::abs(polar[1]) > 0.5 * field_of_view_rad) continue;
      typename G::Point seen = polar;
      seen[0] += p_.noise * p_.sigma_range_m * draw_.normal();
      seen[1] = wrap_angle(polar[1] + p_.noise * p_.sigma_bearing_rad * draw_.normal());
      if constexpr (G::Dim == 3) seen[2] += p_.noise * p_.sigma_bearing_rad * draw_.normal();
      if (p_.outliers > 0.0 && draw_.uniform() < p_.outliers) {
        seen[0] = draw_.uniform(1.0, sight_m);
        seen[1] = draw_.uniform(-0.5, 0.5) * field_of_view_rad;
      }
      slam.on_sighting(t, i, seen);
    }
  }

  void collect(RangeBearingEkf<G>& slam, typename SlamRun<G>::Vehicle& vehicle, double start_m) {
    for (Segment<G>& segment : slam.take_segments()) {
      vehicle.truth.push_back(standing_on<G>(p_.path, start_m + speed_mps * segment.closing.stamp_s));
      vehicle.segments.emplace_back(vehicle.states.size(), std::move(segment));
    }
  }

  const EkfSlamParams& p_;
  Draw draw_;
  std::vector<typename G::Point> points_;
};

// The facts of a run under one drift model, as the components make them.
template <class G>
class FactMaker {
 public:
  FactMaker(const SlamRun<G>& run, const EkfSlamParams& params, const DriftParams<G>& drift, Draw lottery)
      : params_(params), drift_params_(drift), lottery_(std::move(lottery)) {
    for (std::size_t v = 0; v < run.vehicles.size(); ++v) add_chain(v, run.vehicles[v]);
    associate_all();
  }

  FactStore<G> store;
  std::vector<TrueTrack<G>> tracks;
  std::map<Key, std::uint64_t> thing_of;  // landmark -> what it truly is
  std::vector<Hash> true_sets, false_sets;

 private:
  bool arrives() { return params_.loss <= 0.0 || lottery_.uniform() >= params_.loss; }
  void insert(const auto& fact) {
    if (store.insert(fact) != Insertion::inserted) throw std::logic_error("consistency: a simulated fact was refused");
  }

  void add_chain(std::size_t v, const typename SlamRun<G>::Vehicle& vehicle) {
    insert(vehicle.start);
    insert(AnchorFact<G>{{chain(v), 0}, {}});
    tracks.push_back({chain(v), vehicle.start, {}});
    DriftAccumulator<G> drift(drift_params_);
    std::size_t state = 0;
    std::uint32_t next_landmark = 0, next_anchor = 1;
    for (std::size_t k = 0; k < vehicle.segments.size(); ++k) {
      const auto& [first_state, segment] = vehicle.segments[k];
      for (; state < first_state; ++state) advance(drift, vehicle.states[state]);
      AnchorFact<G> anchor{{chain(v), next_anchor++}, advance(drift, segment.closing)};
      anchor.first_landmark = next_landmark;
      anchor.landmark_count = static_cast<std::uint32_t>(segment.landmarks.size());
      tracks.back().steps.push_back({anchor.state, vehicle.truth[k]});
      if (arrives()) insert(anchor);
      const bool batch_arrives = arrives();
      for (const FrozenLandmark<G>& frozen : segment.landmarks) {
        LandmarkFact<G> l;
        l.key = {chain(v), next_landmark++};
        l.anchor = anchor.key.index;
        l.position = frozen.position;
        l.covariance = symmetrised(typename G::PointCovariance(drift_params_.landmark_inflation * frozen.covariance));
        l.loading = std::sqrt(drift_params_.landmark_inflation) * frozen.loading;
        thing_of[l.key] = frozen.track;
        if (batch_arrives) insert(rounded(l));
      }
    }
  }

  static ChainState<G> advance(DriftAccumulator<G>& drift, const FrontEndState<G>& s) {
    return drift.advance(s.stamp_s, s.abscissa_m, s.pose, s.slam_drift);
  }

  void associate_all() {
    std::vector<Key> batches;
    for (const auto& [id, facts] : store.chains())
      for (const auto& [anchor, landmarks] : facts.batches)
        if (complete(store, {id, anchor})) batches.push_back({id, anchor});
    std::uint32_t stated = 0;
    for (std::size_t i = 0; i < batches.size(); ++i)
      for (std::size_t j = i + 1; j < batches.size(); ++j) {
        const auto prior = relative_prior(store, batches[i], batches[j]);
        if (prior && far_apart(*prior)) continue;
        for (const std::vector<Pairing>& pairings : stated_of(batches[i], batches[j])) {
          if (!arrives()) continue;
          insert(AssociationFact{{chain(0), stated++}, pairings});
          const auto right = std::count_if(pairings.begin(), pairings.end(), [&](const Pairing& p) {
            return thing_of.at(p.first) == thing_of.at(p.second);
          });
          const bool is_true = 2 * static_cast<std::size_t>(right) > pairings.size();
          (is_true ? true_sets : false_sets).push_back(hypothesis_id(pairings));
        }
      }
  }

  // As AssociationComponent does it.
  std::vector<std::vector<Pairing>> stated_of(const Key& a, const Key& b) const {
    const auto arrived = [&](const Key& anchor, Reach reach) {
      const auto all = batches_within(anchor, reach);
      return std::all_of(all.begin(), all.end(), [&](const Key& batch) { return complete(store, batch); });
    };
    for (Reach reach = Reach::alone;;) {
      const auto found = associate(store, a, b, reach, AssociationParams{});
      const auto next = next_reach(found, a, b, reach);
      if (!next) return found.statements();
      if (!arrived(a, *next) || !arrived(b, *next)) return {};
      reach = *next;
    }
  }

  // Spares a search whose unary constraint leaves nothing: beyond eight standard deviations of a batch's reach.
  static bool far_apart(const RelativePrior<G>& prior) {
    const auto variance = prior.covariance.diagonal();
    const double sigma = std::sqrt(variance.template head<G::Dim>().sum() +
                                   variance.template tail<G::Dof - G::Dim>().sum() * sight_m * sight_m);
    return prior.mean.translation().norm() > 2.5 * sight_m + 8.0 * sigma;
  }

  const EkfSlamParams& params_;
  DriftParams<G> drift_params_;
  Draw lottery_;
};

}  // namespace

template <class G>
SlamRun<G> drive_ekf_slam(const EkfSlamParams& params, std::uint64_t seed, int run) {
  Driver<G> driver(params, seed, run);
  SlamRun<G> result;
  for (int v = 0; v < params.vehicles; ++v) result.vehicles.push_back(driver.drive(v));
  return result;
}

template <class G>
std::vector<TrueTrack<G>> raw_tracks(const SlamRun<G>& run) {
  std::vector<TrueTrack<G>> tracks;
  for (std::size_t v = 0; v < run.vehicles.size(); ++v) {
    const typename SlamRun<G>::Vehicle& vehicle = run.vehicles[v];
    tracks.push_back({chain(v), vehicle.start, {}});
    for (std::size_t k = 0; k < vehicle.segments.size(); ++k) {
      const FrontEndState<G>& s = vehicle.segments[k].second.closing;
      tracks.back().steps.push_back({{s.stamp_s, s.abscissa_m, s.pose, s.slam_drift}, vehicle.truth[k]});
    }
  }
  return tracks;
}

template <class G>
RunSample judge_ekf_slam(const SlamRun<G>& run, const EkfSlamParams& params, const DriftParams<G>& drift,
                         const Backend<G>& backend, std::uint64_t seed, int index) {
  const FactMaker<G> facts(run, params, drift, Draw(seed, static_cast<std::uint32_t>(index), 21));
  const GlobalMap<G> built = build_global_map(facts.store, SelectionParams{}, backend);
  RunSample sample = judge(*built.map, facts.tracks);
  for (const auto& members : built.selection.classes)
    sample.false_fusions += std::any_of(members.begin(), members.end(), [&](const Key& key) {
      return facts.thing_of.at(key) != facts.thing_of.at(members.front());
    });
  std::set<Hash> accepted;
  std::set<ChainId> linked;
  for (const auto& h : built.selection.hypotheses) {
    if (h.state != HypothesisState::accepted) continue;
    accepted.insert(h.id);
    if (h.batch_a.chain != h.batch_b.chain) linked.insert({h.batch_a.chain, h.batch_b.chain});
  }
  sample.unlinked = params.vehicles > 1 && static_cast<int>(linked.size()) < params.vehicles;
  if (sample.unlinked) sample.distance_errors_m.clear();
  sample.true_stated = static_cast<int>(facts.true_sets.size());
  sample.false_stated = static_cast<int>(facts.false_sets.size());
  for (const Hash id : facts.true_sets) sample.true_dropped += accepted.count(id) ? 0 : 1;
  return sample;
}

#define CONVOY_INSTANTIATE(G)                                                                                          \
  template SlamRun<G> drive_ekf_slam(const EkfSlamParams&, std::uint64_t, int);                                        \
  template std::vector<TrueTrack<G>> raw_tracks(const SlamRun<G>&);                                                    \
  template RunSample judge_ekf_slam(const SlamRun<G>&, const EkfSlamParams&, const DriftParams<G>&, const Backend<G>&, \
                                    std::uint64_t, int);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::consistency
