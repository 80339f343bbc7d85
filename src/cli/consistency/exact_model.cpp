#include "consistency/exact_model.hpp"

#include <convoy/geometry/covariance.hpp>
#include <convoy/map/global_map.hpp>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>

namespace convoy::cli::consistency {
namespace {

constexpr double sub_step_m = 2.5;  // of the drift: fine enough that where it happens is exact
constexpr std::size_t least_pairings = 5;

template <class G>
typename G::Tangent each(double translation, double rotation) {
  typename G::Tangent d;
  d.template head<G::Dim>().setConstant(translation);
  d.template tail<G::Dof - G::Dim>().setConstant(rotation);
  return d;
}

// Tilt and height of a SLAM that measures them all the time: AR(1) errors about the truth, whatever its drift says.
template <class G>
class BoundedErrors {
 public:
  BoundedErrors(const PersistentDrift& persistent, Draw& draw) : p_(persistent), draw_(draw) {}

  void start(const G& T) {
    if constexpr (G::Dim == 3) {
      e_ = sigma().cwiseProduct(draw_.unit_normal<3>());
      up_ = said_up(T);
      start_m_ = T.translation().z() - e_.z();
    }
  }
  const Eigen::Vector3d& up() const { return up_; }  ///< slam frame; zero: nothing is bounded

  /// X, turned and lifted to where these errors put it.
  G after(double ds_m, const G& X, const G& T) {
    if constexpr (G::Dim == 3) {
      const double phi = std::exp(-ds_m / p_.correlation_m);
      e_ = phi * e_ + std::sqrt(1.0 - phi * phi) * sigma().cwiseProduct(draw_.unit_normal<3>());
      const Eigen::Vector3d now = X.rotation().transpose() * up_;
      const Eigen::Matrix3d turn = Eigen::Quaterniond::FromTwoVectors(said_up(T), now).toRotationMatrix();
      const double height_m = T.translation().z() - start_m_ - e_.z();
      const Eigen::Vector3d t = X.translation() + (height_m - up_.dot(X.translation())) * up_;
      return G::from_rotation(X.rotation() * turn, t);
    } else {
      (void)T;
      return X * G::Exp(0.0 * ds_m * G::Tangent::Zero());
    }
  }

 private:
  Eigen::Vector3d sigma() const { return {p_.tilt_rad, p_.tilt_rad, p_.height_m}; }
  // What the SLAM takes for up, body frame: said x up = (e_x, e_y).
  Eigen::Vector3d said_up(const G& T) const {
    const Eigen::Vector3d up = T.rotation().transpose().col(2);
    // d perpendicular to up, with (d x up) x up = -d.
    Eigen::Vector3d d(-e_.x(), -e_.y(), 0.0);
    d.z() = -(d.x() * up.x() + d.y() * up.y()) / up.z();
    return (up + d.cross(up)).normalized();
  }

  const PersistentDrift& p_;
  Draw& draw_;
  Eigen::Vector3d e_ = Eigen::Vector3d::Zero(), up_ = Eigen::Vector3d::Zero();  // (tilt, tilt, height), slam frame
  double start_m_ = 0.0;
};

template <class G>
class ExactFleetMaker {
 public:
  ExactFleetMaker(const ExactModelParams& params, const DriftParams<G>& drift, std::uint64_t seed, int run)
      : p_(params), drift_params_(drift), draw_(seed, static_cast<std::uint32_t>(run), G::Dim) {
    points_ = points_along<G>(p_.path, 0.35, 0.5, draw_);
    for (int a = 0; a < p_.aliases; ++a) add_alias(a);
  }

  ExactFleet<G> make() {
    for (int v = 0; v < p_.vehicles; ++v) drive(v);
    state_associations();
    return std::move(fleet_);
  }

 private:
  struct SeenBatch {
    std::map<std::size_t, Key> landmark_of;  // point -> landmark
  };

  ChainId chain(int v) const { return {static_cast<VehicleId>(v + 1), 1}; }
  void insert(const auto& fact) {
    if (fleet_.store.insert(fact) != Insertion::inserted)
      throw std::logic_error("consistency: a drawn fact was refused");
  }
  int anchors() const { return static_cast<int>(length_m(p_.path) / p_.anchor_spacing_m); }

  // Points around the anchors of vehicle 1 on one stretch are copied, to the bit, around those of vehicle 2 on another.
  void add_alias(int alias) {
    const int places = p_.alias_places;
    const int half = std::max(1, anchors() / 2 - places);
    const int from = 1 + (alias * (places + 1) + static_cast<int>(draw_.uniform() * 2.0)) % half;
    const int to = from + anchors() / 2 - (draw_.uniform() < 0.5 ? 1 : 0);
    // One transformation for the whole stretch: its false sets agree with each other.
    const double s_from = p_.anchor_spacing_m * from, s_to = p_.gap_m + p_.anchor_spacing_m * to;
    const G T = pose_on<G>(p_.path, s_to) * pose_on<G>(p_.path, s_from).inverse();
    std::map<std::size_t, std::size_t> copies;
    for (int k = 0; k < places; ++k) {
      const auto centre = pose_on<G>(p_.path, s_from + k * p_.anchor_spacing_m).translation();
      for (std::size_t i = 0, n = points_.size(); i < n; ++i) {
        if ((points_[i] - centre).norm() > 0.7 * p_.range_m || copies.count(i) || is_copy_.count(i)) continue;
        copies[i] = points_.size();
        is_copy_.insert(points_.size());
        points_.push_back(T * points_[i]);
      }
      aliases_.push_back({from + k, to + k, {}});
    }
    for (std::size_t k = aliases_.size() - static_cast<std::size_t>(places); k < aliases_.size(); ++k)
      aliases_[k].copies = copies;
  }

  void drive(int v) {
    const double start_m = p_.gap_m * v;
    const Key origin{chain(v), 0};
    const G T_start = pose_on<G>(p_.path, start_m);
    PriorFact<G> prior{origin, true, G()};
    typename G::Tangent sigma_start = each<G>(0.01, 0.001);
    if (v > 0) {
      sigma_start = each<G>(p_.start_sigma_m, 0.01);  // in space, a vehicle knows where down is
      sigma_start[G::Dof - 1] = p_.start_sigma_rad;
    }
    prior.covariance = sigma_start.cwiseAbs2().asDiagonal();
    prior.mean = T_start * G::Exp(-sigma_start.cwiseProduct(draw_.template unit_normal<G::Dof>()));
    // What the SLAM does not know: scale and turning of its odometer, and what is up at its start.
    const PersistentDrift& persistent = p_.persistent;
    Eigen::Vector2d constants(persistent.scale, persistent.heading_rad_per_m);
    if (persistent.constant()) constants = constants.cwiseProduct(draw_.template unit_normal<2>()).eval();
    BoundedErrors<G> bounded(persistent, draw_);
    if (persistent.bounded()) bounded.start(T_start);
    prior.persistent = drift_params_.persistent;
    if (prior.persistent.bounded()) prior.persistent.up = bounded.up();
    insert(prior);
    insert(AnchorFact<G>{origin, {}});
    TrueTrack<G> track{chain(v), prior, {}};

    DriftAccumulator<G> drift(drift_params_);
    typename G::Covariance slam_drift = G::Covariance::Zero();
    G T = T_start, X;
    std::uint32_t next_landmark = 0;
    const int steps = static_cast<int>(p_.anchor_spacing_m / sub_step_m);
    for (int k = 1; k <= anchors(); ++k) {
      ChainState<G> state;
      for (int j = 1; j <= steps; ++j) {
        const double s = p_.anchor_spacing_m * (k - 1) + sub_step_m * j;
        const G T_next = pose_on<G>(p_.path, start_m + s);
        // T_next = T U Exp(eta), eta ~ N(0, gamma S + ds Qv): U is drawn around the true motion.
        const typename G::Tangent variance =
            p_.noise * p_.noise * sub_step_m * each<G>(p_.drift_m2_per_m, p_.drift_rad2_per_m);
        const typename G::Tangent eta = variance.cwiseSqrt().cwiseProduct(draw_.template unit_normal<G::Dof>());
        const G motion = T.inverse() * T_next * G::Exp(eta).inverse();
        X = X * motion * G::Exp(effect_of(constants, motion)).inverse();
        T = T_next;
        if (persistent.bounded()) X = bounded.after(sub_step_m, X, T);
        const typename G::Adjoint Ad = X.adjoint();
        const typename G::Covariance S = (0.5 * variance).asDiagonal();
        slam_drift += Ad * S * Ad.transpose();
        state = drift.advance(s, s, X, slam_drift);
        if (2 * j == steps || j == steps) track.steps.push_back({state, T});
      }
      const double landmark_scale = persistent.scales_landmarks ? 1.0 + constants[0] : 1.0;
      next_landmark = close_batch(v, k, state, T, landmark_scale, next_landmark);
    }
    fleet_.tracks.push_back(std::move(track));
  }

  // A c of F1, over a step so short that it is straight.
  static typename G::Tangent effect_of(const Eigen::Vector2d& constants, const G& motion) {
    typename G::Tangent d = G::Tangent::Zero();
    d.template head<G::Dim>() = constants[0] * (motion.rotation().transpose() * motion.translation());
    d[G::Dof - 1] = constants[1] * sub_step_m;
    return d;
  }

  std::uint32_t close_batch(int v, int k, const ChainState<G>& state, const G& T, double landmark_scale,
                            std::uint32_t first) {
    std::vector<std::pair<double, std::size_t>> near;
    for (std::size_t i = 0; i < points_.size(); ++i)
      if (const double d = (points_[i] - T.translation()).norm(); d < p_.range_m) near.emplace_back(d, i);
    std::sort(near.begin(), near.end());
    if (near.size() > p_.max_batch) near.resize(p_.max_batch);
    AnchorFact<G> anchor{{chain(v), static_cast<std::uint32_t>(k)}, state};
    anchor.first_landmark = first;
    anchor.landmark_count = static_cast<std::uint32_t>(near.size());
    insert(anchor);
    const typename G::SharedVector shared = draw_.template unit_normal<G::Shared>();
    const double own = p_.noise * p_.landmark_sigma_m;
    SeenBatch& seen = batches_[anchor.key];
    for (const auto& [d, i] : near) {
      LandmarkFact<G> l;
      l.key = {chain(v), first++};
      l.anchor = static_cast<std::uint32_t>(k);
      for (Eigen::Index c = 0; c < l.loading.size(); ++c)
        l.loading.data()[c] = p_.noise * p_.loading_sigma_m * draw_.normal();
      l.covariance = symmetrised(
          typename G::PointCovariance(own * own * G::PointCovariance::Identity() + l.loading * l.loading.transpose()));
      l.position =
          (T.inverse() * points_[i]) / landmark_scale + own * draw_.template unit_normal<G::Dim>() + l.loading * shared;
      insert(l);
      seen.landmark_of[i] = l.key;
    }
    return first;
  }

  void state_associations() {
    for (auto a = batches_.begin(); a != batches_.end(); ++a)
      for (auto b = std::next(a); b != batches_.end(); ++b) {
        std::vector<Pairing> pairs;
        for (const auto& [point, landmark] : a->second.landmark_of)
          if (const auto it = b->second.landmark_of.find(point); it != b->second.landmark_of.end())
            pairs.emplace_back(landmark, it->second);
        state(std::move(pairs), fleet_.true_sets);
      }
    for (const Alias& alias : aliases_) {
      const auto a = batches_.find({chain(0), static_cast<std::uint32_t>(alias.from)});
      const auto b = batches_.find({chain(1), static_cast<std::uint32_t>(alias.to)});
      if (a == batches_.end() || b == batches_.end()) continue;
      std::vector<Pairing> pairs;
      for (const auto& [original, copy] : alias.copies) {
        const auto i = a->second.landmark_of.find(original), j = b->second.landmark_of.find(copy);
        if (i != a->second.landmark_of.end() && j != b->second.landmark_of.end())
          pairs.emplace_back(i->second, j->second);
      }
      state(std::move(pairs), fleet_.false_sets);
    }
  }

  void state(std::vector<Pairing> pairs, std::vector<Hash>& sets) {
    if (pairs.size() < least_pairings) return;
    AssociationFact fact{{chain(0), associations_++}, canonical(std::move(pairs))};
    insert(fact);
    sets.push_back(hypothesis_id(fact.pairings));
  }

  struct Alias {
    int from, to;  // anchors of vehicle 1 and 2
    std::map<std::size_t, std::size_t> copies;
  };

  const ExactModelParams& p_;
  DriftParams<G> drift_params_;
  Draw draw_;
  std::vector<typename G::Point> points_;
  std::set<std::size_t> is_copy_;
  std::vector<Alias> aliases_;
  ExactFleet<G> fleet_;
  std::map<Key, SeenBatch> batches_;
  std::uint32_t associations_ = 0;
};

template <class G>
void count_sets(const ExactFleet<G>& fleet, const Selection<G>& selection, RunSample& sample) {
  std::set<Hash> accepted;
  for (const Hypothesis<G>& h : selection.hypotheses)
    if (h.state == HypothesisState::accepted) accepted.insert(h.id);
  sample.true_stated = static_cast<int>(fleet.true_sets.size());
  sample.false_stated = static_cast<int>(fleet.false_sets.size());
  for (const Hash id : fleet.true_sets) sample.true_dropped += accepted.count(id) ? 0 : 1;
  for (const Hash id : fleet.false_sets) sample.false_fusions += accepted.count(id) ? 1 : 0;
}

}  // namespace

template <class G>
DriftParams<G> matching_drift(const ExactModelParams& p, DriftModel model) {
  DriftParams<G> drift;
  drift.model = model;
  drift.gamma = 1.0;
  drift.landmark_inflation = 1.0;
  const double share = model == DriftModel::local ? 0.5 : 1.0;
  drift.rate = share * p.noise * p.noise * each<G>(p.drift_m2_per_m, p.drift_rad2_per_m);
  if (model == DriftModel::local) drift.persistent = p.persistent;
  return drift;
}

template <class G>
ExactFleet<G> draw_exact_fleet(const ExactModelParams& params, const DriftParams<G>& drift, std::uint64_t seed,
                               int run) {
  return ExactFleetMaker<G>(params, drift, seed, run).make();
}

template <class G>
RunSample judge_stated(const ExactFleet<G>& fleet, const Backend<G>& backend) {
  const Selection<G> selection = select(fleet.store, SelectionParams{});
  const auto map = backend.solve(build_problem<G>(fleet.store, selection, {0, false, !backend.takes_every_factor()}));
  RunSample sample = judge(*map, fleet.tracks);
  count_sets(fleet, selection, sample);
  return sample;
}

template <class G>
RunSample judge_global_map(const ExactFleet<G>& fleet, const Backend<G>& backend) {
  const GlobalMap<G> built = build_global_map(fleet.store, SelectionParams{}, backend);
  RunSample sample = judge(*built.map, fleet.tracks);
  count_sets(fleet, built.selection, sample);
  return sample;
}

#define CONVOY_INSTANTIATE(G)                                                                                  \
  template DriftParams<G> matching_drift<G>(const ExactModelParams&, DriftModel);                              \
  template ExactFleet<G> draw_exact_fleet(const ExactModelParams&, const DriftParams<G>&, std::uint64_t, int); \
  template RunSample judge_stated(const ExactFleet<G>&, const Backend<G>&);                                    \
  template RunSample judge_global_map(const ExactFleet<G>&, const Backend<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::consistency
