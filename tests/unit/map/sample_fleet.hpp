// A fleet of known truth and its facts, drawn from the model that the map assumes.
#pragma once

#include <convoy/drift/drift_model.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "../random_world.hpp"
#include "../sample_facts.hpp"

#include <cmath>
#include <map>
#include <optional>
#include <type_traits>
#include <vector>

namespace convoy::test {

/// One number for every translation, another for every rotation.
template <class G>
typename G::Tangent each(double translation, double rotation) {
  typename G::Tangent d;
  d.template head<G::Dim>().setConstant(translation);
  d.template tail<G::Dof - G::Dim>().setConstant(rotation);
  return d;
}

/// A pose on the street; in space, with some height, pitch and roll to it.
template <class G>
G on_the_street(double x_m, double y_m, double theta_rad) {
  if constexpr (G::Dim == 2) {
    return {x_m, y_m, theta_rad};
  } else {
    SE3::Tangent turn = SE3::Tangent::Zero();
    turn.tail<3>() << 0.1 * std::sin(x_m), 0.1 * std::cos(0.1 * x_m), theta_rad;
    return SE3::from_rotation(SE3::Exp(turn).rotation(), {x_m, y_m, std::sin(0.05 * x_m)});
  }
}

template <class G>
class SampleFleetOf {
 public:
  /// `scale`: of all errors drawn, not of the covariances stated.
  /// `shared_m`: of the error that a batch has in common.
  explicit SampleFleetOf(std::uint64_t seed, double scale = 1.0, double shared_m = 0.1)
      : random_(seed), scale_(scale), shared_m_(shared_m), points_(scattered<G>(random_, 400, 100.0, 2.0)) {}

  /// A chain begins. `sigma`: of the static bias (m, m, rad); zero: the start is not known to anybody.
  void start(VehicleId v, const G& T_world_start, const typename G::Tangent& sigma = G::Tangent::Zero()) {
    chains_[v] = {T_world_start, 0};
    truth[key_of(v, 0)] = T_world_start;
    anchors_[v].push_back(AnchorFact<G>{key_of(v, 0), {}});
    facts.emplace_back(anchors_[v].back());
    PriorFact<G> prior{key_of(v, 0), false, G()};
    if (!sigma.isZero(0.0)) {
      prior.known = true;
      prior.mean = T_world_start * G::Exp(scale_ * sigma.cwiseProduct(random_.unit_normal<G::Dof>()));
      prior.covariance = sigma.cwiseAbs2().asDiagonal();
    }
    facts.emplace_back(prior);
  }

  /// The vehicle moves to T_world_anchor and freezes every point within 20 m there. Returns the anchor's key.
  Key stop(VehicleId v, const G& T_world_anchor) {
    Chain& chain = chains_.at(v);
    const AnchorFact<G> last = anchors_[v].back();
    const G motion = chain.pose.inverse() * T_world_anchor;
    const double length = motion.translation().norm() + 0.1;
    const typename G::Covariance Q = (length * each<G>(4e-4, 4e-6)).asDiagonal();
    const G U = motion * G::Exp(scale_ * random_.draw<G::Dof>(Q)).inverse();  // T_b = T_a U Exp(eta)
    AnchorFact<G> anchor{key_of(v, last.key.index + 1), {}};
    anchor.state.stamp_s = last.state.stamp_s + length / 2.0;
    anchor.state.abscissa_m = last.state.abscissa_m + length;
    anchor.state.pose = last.state.pose * U;
    const typename G::Adjoint Ad = anchor.state.pose.adjoint();
    anchor.state.drift = last.state.drift + Ad * Q * Ad.transpose();
    chain.pose = T_world_anchor;
    truth[anchor.key] = T_world_anchor;

    PointsOf<G> seen;
    std::vector<std::size_t> ids;
    for (std::size_t k = 0; k < points_.size(); ++k)
      if ((points_[k] - T_world_anchor.translation()).norm() < 20.0) seen.push_back(points_[k]), ids.push_back(k);
    const auto batch =
        frozen_batch(random_, anchor.key, T_world_anchor, seen, {0.1, shared_m_, scale_}, chain.next_landmark);
    anchor.first_landmark = chain.next_landmark;
    anchor.landmark_count = static_cast<std::uint32_t>(seen.size());
    chain.next_landmark += anchor.landmark_count;
    facts.emplace_back(anchor);
    for (std::size_t k = 0; k < ids.size(); ++k) {
      facts.emplace_back(batch.landmarks[k]);
      landmarks_[anchor.key][ids[k]] = batch.landmarks[k].key;
      point_of[batch.landmarks[k].key] = points_[ids[k]];
    }
    anchors_[v].push_back(anchor);
    return anchor.key;
  }

  /// What two batches have in common, at most `count`.
  std::vector<Pairing> common(const Key& a, const Key& b, std::size_t count = 1000) const {
    std::vector<Pairing> list;
    for (const auto& [id, landmark] : landmarks_.at(a))
      if (const auto it = landmarks_.at(b).find(id); it != landmarks_.at(b).end() && list.size() < count)
        list.emplace_back(landmark, it->second);
    return canonical(std::move(list));
  }

  Hash associate(VehicleId author, const std::vector<Pairing>& pairings) {
    facts.emplace_back(association(author, associations_[author]++, pairings));
    return hypothesis_id(pairings);
  }
  void judge(VehicleId author, Hash hypothesis, bool veto) {
    facts.emplace_back(verdict(author, verdicts_[author]++, hypothesis, veto));
  }

  /// A receiver says where its antenna was at that anchor, east-north(-up) being enu_of_world() of the world. `error`:
  /// of the position [m]. `hung_on`: the anchor to refer to, if it is another one before.
  Key fix(const Key& at, const typename G::Point& error, double sigma_m, std::optional<std::uint32_t> hung_on = {}) {
    const VehicleId v = at.chain.vehicle;
    AbsoluteFixFact<G> f{key_of(v, fixes_[v]++), hung_on.value_or(at.index), anchor(at).state};
    f.lever.setConstant(0.5);
    f.position = enu_of_world() * (truth.at(at) * f.lever) + error;
    f.covariance = sigma_m * sigma_m * G::PointCovariance::Identity();
    facts.emplace_back(f);
    return f.key;
  }
  Key fix(const Key& at, double sigma_m, std::optional<std::uint32_t> hung_on = {}) {
    const typename G::Point error = scale_ * sigma_m * random_.unit_normal<G::Dim>();
    return fix(at, error, sigma_m, hung_on);
  }
  /// Turned about z, and far away.
  static G enu_of_world() {
    typename G::Tangent turn = G::Tangent::Zero(), shift = G::Tangent::Zero();
    turn[G::Dof - 1] = 0.8;
    shift.template head<2>() << 300.0, -120.0;
    return G::Exp(shift) * G::Exp(turn);
  }

  FactStore<G> store() const { return store_of(facts); }
  static FactStore<G> store_of(const std::vector<AnyFact<G>>& list) {
    FactStore<G> store;
    for (const AnyFact<G>& fact : list) insert(store, fact);
    return store;
  }
  const AnchorFact<G>& anchor(const Key& key) const { return anchors_.at(key.chain.vehicle).at(key.index); }
  Random& random() { return random_; }

  std::vector<AnyFact<G>> facts;
  std::map<Key, G> truth;  ///< T_world_anchor
  std::map<Key, typename G::Point> point_of;

 private:
  struct Chain {
    G pose;
    std::uint32_t next_landmark = 0;
  };
  Random random_;
  double scale_, shared_m_;
  PointsOf<G> points_;
  std::map<VehicleId, Chain> chains_;
  std::map<VehicleId, std::vector<AnchorFact<G>>> anchors_;
  std::map<Key, std::map<std::size_t, Key>> landmarks_;
  std::map<VehicleId, std::uint32_t> associations_, verdicts_, fixes_;
};

using SampleFleet = SampleFleetOf<SE2>;

template <class G>
inline const typename G::Tangent paper_bias_of = each<G>(15.0, 0.2);
template <class G>
inline const typename G::Tangent fair_start_of = each<G>(0.5, 0.02);
template <class G>
inline const typename G::Tangent known_start_of = each<G>(0.01, 0.001);
inline const SE2::Tangent paper_bias = each<SE2>(15.0, 0.2), fair_start = each<SE2>(0.5, 0.02),
                          known_start = each<SE2>(0.01, 0.001);

template <class G>
struct StreetOptionsOf {
  double scale = 1.0;
  double shared_m = 0.1;
  bool associated = true;
  typename G::Tangent bias = paper_bias_of<G>;  ///< of vehicles 2 and 3; vehicle 1 knows its start
};
using StreetOptions = StreetOptionsOf<SE2>;

/// Three vehicles on one street, one behind the other, who meet in several places.
template <class G = SE2>
SampleFleetOf<G> street_fleet(std::uint64_t seed, const std::type_identity_t<StreetOptionsOf<G>>& options = {}) {
  SampleFleetOf<G> fleet(seed, options.scale, options.shared_m);
  std::map<VehicleId, std::vector<Key>> stops;
  for (const VehicleId v : {1U, 2U, 3U}) {
    const double x0 = -60.0 - 15.0 * v;
    fleet.start(v, on_the_street<G>(x0, 2.0 * v, 0.05 * v), v == 1 ? known_start_of<G> : options.bias);
    for (int k = 1; k <= 5; ++k)
      stops[v].push_back(fleet.stop(v, on_the_street<G>(x0 + 25.0 * k, 2.0 * v + 3.0 * (k % 2), 0.2 * k - 0.5)));
  }
  if (!options.associated) return fleet;
  for (const auto& [a, b] : {std::pair{1U, 2U}, std::pair{2U, 3U}, std::pair{1U, 3U}})
    for (const Key& p : stops[a])
      for (const Key& q : stops[b])
        if (const auto pairs = fleet.common(p, q); pairs.size() >= 5) fleet.associate(b, pairs);
  return fleet;
}

/// One hypothesis is enough to link two vehicles, however uncertain their starts are.
inline const SelectionParams unconfirmed_too = [] {
  SelectionParams params;
  params.min_confirmed = 1;
  return params;
}();

template <class G>
GlobalMap<G> built(const FactStore<G>& store, const SelectionParams& params = {}) {
  return build_global_map(store, params, SparseMap<G>());
}

}  // namespace convoy::test
