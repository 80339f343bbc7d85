#include "consistency/ekf_slam.hpp"

#include <convoy/geometry/covariance.hpp>

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
  f.sigma_bearing_rad = p.noise * p.sigma_bearing_rad;
  f.max_remembered = 0;      // the live pose is not judged here
  f.trail_spacing_m = 0.0;   // anchors are
  return f;
}

class Driver {
 public:
  Driver(const EkfSlamParams& params, std::uint64_t seed, int run)
      : p_(params), draw_(seed, static_cast<std::uint32_t>(run), 20),
        points_(points_along<SE2>(p_.path, p_.landmarks_per_metre, p_.landmark_spacing_m, draw_)) {
    if (p_.repeat_m > 0.0) repeat();
  }

  SlamRun::Vehicle drive(int v) {
    SlamRun::Vehicle vehicle;
    const double start_m = p_.gap_m * v;
    vehicle.T_start = pose_on<SE2>(p_.path, start_m);
    const SE2::Tangent sigma = v == 0 ? SE2::Tangent(0.01, 0.01, 0.001)
                                      : SE2::Tangent(p_.start_sigma_m, p_.start_sigma_m, p_.start_sigma_rad);
    vehicle.start = {{chain(static_cast<std::size_t>(v)), 0}, true, SE2(), sigma.cwiseAbs2().asDiagonal()};
    vehicle.start.mean = vehicle.T_start * SE2::Exp(-sigma.cwiseProduct(draw_.unit_normal<3>()));
    RangeBearingEkf slam(front_end_params(p_));
    const int steps = static_cast<int>(length_m(p_.path) / step_m);
    for (int k = 0; k <= steps; ++k) {
      const double t = k * step_m / speed_mps;
      slam.on_odometry(t, odometry_speed(), odometry_rate(start_m + k * step_m));
      collect(slam, vehicle, start_m);
      if (k % steps_per_sighting == 0) look(slam, t, pose_on<SE2>(p_.path, start_m + k * step_m));
      vehicle.states.push_back(slam.state());
    }
    slam.finish();
    collect(slam, vehicle, start_m);
    return vehicle;
  }

 private:
  // What stands along the first `repeat_m` of a straight stands along each further such length.
  void repeat() {
    std::vector<Eigen::Vector2d> pattern;
    for (const Eigen::Vector2d& p : points_)
      if (p.x() < p_.repeat_m) pattern.push_back(p);
    points_.clear();
    for (double x = 0.0; x < distinct_length_m(p_.path); x += p_.repeat_m)
      for (const Eigen::Vector2d& p : pattern) points_.emplace_back(p.x() + x, p.y());
  }

  double odometry_speed() {
    const double sigma = p_.noise * p_.sigma_along_per_sqrt_m * std::sqrt(step_m);
    return (step_m + sigma * draw_.normal()) / (1.0 + p_.scale_error) * speed_mps / step_m;
  }
  double odometry_rate(double s) {
    const double sigma = p_.noise * p_.sigma_heading_per_sqrt_m * std::sqrt(step_m);
    const double angle = pose_on<SE2>(p_.path, s).inverse().theta() + pose_on<SE2>(p_.path, s + step_m).theta();
    return (wrap_angle(angle) + sigma * draw_.normal() + p_.gyro_bias_rad_per_m * step_m) * speed_mps / step_m;
  }

  void look(RangeBearingEkf& slam, double t, const SE2& T) {
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const Eigen::Vector2d y = T.inverse() * points_[i];
      const double range = y.norm(), bearing = std::atan2(y.y(), y.x());
      if (range > sight_m || std::abs(bearing) > 0.5 * field_of_view_rad) continue;
      double seen_range = range + p_.noise * p_.sigma_range_m * draw_.normal();
      double seen_bearing = wrap_angle(bearing + p_.noise * p_.sigma_bearing_rad * draw_.normal());
      if (p_.outliers > 0.0 && draw_.uniform() < p_.outliers) {
        seen_range = draw_.uniform(1.0, sight_m);
        seen_bearing = draw_.uniform(-0.5, 0.5) * field_of_view_rad;
      }
      slam.on_sighting(t, i, seen_range, seen_bearing);
    }
  }

  void collect(RangeBearingEkf& slam, SlamRun::Vehicle& vehicle, double start_m) {
    for (Segment<SE2>& segment : slam.take_segments()) {
      vehicle.truth.push_back(pose_on<SE2>(p_.path, start_m + speed_mps * segment.closing.stamp_s));
      vehicle.segments.emplace_back(vehicle.states.size(), std::move(segment));
    }
  }

  const EkfSlamParams& p_;
  Draw draw_;
  std::vector<Eigen::Vector2d> points_;
};

// The facts of a run under one drift model, as the components make them.
class FactMaker {
 public:
  FactMaker(const SlamRun& run, const EkfSlamParams& params, const DriftParams<SE2>& drift, Draw lottery)
      : params_(params), drift_params_(drift), lottery_(std::move(lottery)) {
    for (std::size_t v = 0; v < run.vehicles.size(); ++v) add_chain(v, run.vehicles[v]);
    associate_all();
  }

  FactStore<SE2> store;
  std::vector<TrueTrack<SE2>> tracks;
  std::map<Key, std::uint64_t> thing_of;  // landmark -> what it truly is
  std::vector<Hash> true_sets, false_sets;

 private:
  bool arrives() { return params_.loss <= 0.0 || lottery_.uniform() >= params_.loss; }
  void insert(const auto& fact) {
    if (store.insert(fact) != Insertion::inserted) throw std::logic_error("consistency: a simulated fact was refused");
  }

  void add_chain(std::size_t v, const SlamRun::Vehicle& vehicle) {
    insert(vehicle.start);
    insert(AnchorFact<SE2>{{chain(v), 0}, {}});
    tracks.push_back({chain(v), vehicle.start, {}});
    DriftAccumulator<SE2> drift(drift_params_);
    std::size_t state = 0;
    std::uint32_t next_landmark = 0, next_anchor = 1;
    for (std::size_t k = 0; k < vehicle.segments.size(); ++k) {
      const auto& [first_state, segment] = vehicle.segments[k];
      for (; state < first_state; ++state) advance(drift, vehicle.states[state]);
      AnchorFact<SE2> anchor{{chain(v), next_anchor++}, advance(drift, segment.closing)};
      anchor.first_landmark = next_landmark;
      anchor.landmark_count = static_cast<std::uint32_t>(segment.landmarks.size());
      tracks.back().steps.push_back({anchor.state, vehicle.truth[k]});
      if (arrives()) insert(anchor);
      const bool batch_arrives = arrives();
      for (const FrozenLandmark<SE2>& frozen : segment.landmarks) {
        LandmarkFact<SE2> l;
        l.key = {chain(v), next_landmark++};
        l.anchor = anchor.key.index;
        l.position = frozen.position;
        l.covariance = symmetrised(SE2::PointCovariance(drift_params_.landmark_inflation * frozen.covariance));
        l.loading = std::sqrt(drift_params_.landmark_inflation) * frozen.loading;
        thing_of[l.key] = frozen.track;
        if (batch_arrives) insert(l);
      }
    }
  }

  static ChainState<SE2> advance(DriftAccumulator<SE2>& drift, const FrontEndState<SE2>& s) {
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
        const auto found = associate(batch_of(store, batches[i]), batch_of(store, batches[j]), prior, AssociationParams{});
        for (const std::vector<Pairing>& pairings : found.statements()) {
          if (!arrives()) continue;
          insert(AssociationFact{{chain(0), stated++}, pairings});
          const auto right = std::count_if(pairings.begin(), pairings.end(),
                                           [&](const Pairing& p) { return thing_of.at(p.first) == thing_of.at(p.second); });
          const bool is_true = 2 * static_cast<std::size_t>(right) > pairings.size();
          (is_true ? true_sets : false_sets).push_back(hypothesis_id(pairings));
        }
      }
  }

  // Spares a search whose unary constraint leaves nothing: beyond eight standard deviations of a batch's reach.
  static bool far_apart(const RelativePrior<SE2>& prior) {
    const double sigma = std::sqrt(prior.covariance.topLeftCorner<2, 2>().trace() +
                                   prior.covariance(2, 2) * sight_m * sight_m);
    return prior.mean.translation().norm() > 2.5 * sight_m + 8.0 * sigma;
  }

  const EkfSlamParams& params_;
  DriftParams<SE2> drift_params_;
  Draw lottery_;
};

}  // namespace

SlamRun drive_ekf_slam(const EkfSlamParams& params, std::uint64_t seed, int run) {
  Driver driver(params, seed, run);
  SlamRun result;
  for (int v = 0; v < params.vehicles; ++v) result.vehicles.push_back(driver.drive(v));
  return result;
}

std::vector<TrueTrack<SE2>> raw_tracks(const SlamRun& run) {
  std::vector<TrueTrack<SE2>> tracks;
  for (std::size_t v = 0; v < run.vehicles.size(); ++v) {
    const SlamRun::Vehicle& vehicle = run.vehicles[v];
    tracks.push_back({chain(v), vehicle.start, {}});
    for (std::size_t k = 0; k < vehicle.segments.size(); ++k) {
      const FrontEndState<SE2>& s = vehicle.segments[k].second.closing;
      tracks.back().steps.push_back({{s.stamp_s, s.abscissa_m, s.pose, s.slam_drift}, vehicle.truth[k]});
    }
  }
  return tracks;
}

RunSample judge_ekf_slam(const SlamRun& run, const EkfSlamParams& params, const DriftParams<SE2>& drift,
                         const Backend<SE2>& backend, std::uint64_t seed, int index) {
  const FactMaker facts(run, params, drift, Draw(seed, static_cast<std::uint32_t>(index), 21));
  const GlobalMap<SE2> built = build_global_map(facts.store, SelectionParams{}, backend);
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

}  // namespace convoy::cli::consistency
