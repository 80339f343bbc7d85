// A fleet of known truth and its facts, drawn from the model that the map assumes.
#pragma once

#include <convoy/drift/drift_model.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include "../random_world.hpp"
#include "../sample_facts.hpp"

#include <map>
#include <vector>

namespace convoy::test {

class SampleFleet {
 public:
  /// `scale`: of all errors drawn, not of the covariances stated.
  /// `shared_m`: of the error that a batch has in common.
  explicit SampleFleet(std::uint64_t seed, double scale = 1.0, double shared_m = 0.1)
      : random_(seed), scale_(scale), shared_m_(shared_m), points_(scattered(random_, 400, 100.0, 2.0)) {}

  /// A chain begins. `sigma`: of the static bias (m, m, rad); zero: the start is not known to anybody.
  void start(VehicleId v, const SE2& T_world_start, const SE2::Tangent& sigma = SE2::Tangent::Zero()) {
    chains_[v] = {T_world_start, 0};
    truth[key_of(v, 0)] = T_world_start;
    anchors_[v].push_back(Anchor{key_of(v, 0), {}});
    facts.emplace_back(anchors_[v].back());
    Prior prior{key_of(v, 0), false, SE2()};
    if (!sigma.isZero(0.0)) {
      prior.known = true;
      prior.mean = T_world_start * SE2::Exp(scale_ * sigma.cwiseProduct(random_.unit_normal<3>()));
      prior.covariance = sigma.cwiseAbs2().asDiagonal();
    }
    facts.emplace_back(prior);
  }

  /// The vehicle moves to T_world_anchor and freezes every point within 20 m there. Returns the anchor's key.
  Key stop(VehicleId v, const SE2& T_world_anchor) {
    Chain& chain = chains_.at(v);
    const Anchor last = anchors_[v].back();
    const SE2 motion = chain.pose.inverse() * T_world_anchor;
    const double length = motion.translation().norm() + 0.1;
    const SE2::Covariance Q = (length * SE2::Tangent(4e-4, 4e-4, 4e-6)).asDiagonal();
    const SE2 U = motion * SE2::Exp(scale_ * random_.draw<3>(Q)).inverse();  // T_b = T_a U Exp(eta)
    Anchor anchor{key_of(v, last.key.index + 1), {}};
    anchor.state.stamp_s = last.state.stamp_s + length / 2.0;
    anchor.state.abscissa_m = last.state.abscissa_m + length;
    anchor.state.pose = last.state.pose * U;
    const SE2::Adjoint Ad = anchor.state.pose.adjoint();
    anchor.state.drift = last.state.drift + Ad * Q * Ad.transpose();
    chain.pose = T_world_anchor;
    truth[anchor.key] = T_world_anchor;

    Points seen;
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

  Store store() const { return store_of(facts); }
  static Store store_of(const std::vector<Fact>& list) {
    Store store;
    for (const Fact& fact : list) insert(store, fact);
    return store;
  }
  const Anchor& anchor(const Key& key) const { return anchors_.at(key.chain.vehicle).at(key.index); }
  Random& random() { return random_; }

  std::vector<Fact> facts;
  std::map<Key, SE2> truth;  ///< T_world_anchor
  std::map<Key, SE2::Point> point_of;

 private:
  struct Chain {
    SE2 pose;
    std::uint32_t next_landmark = 0;
  };
  Random random_;
  double scale_, shared_m_;
  Points points_;
  std::map<VehicleId, Chain> chains_;
  std::map<VehicleId, std::vector<Anchor>> anchors_;
  std::map<Key, std::map<std::size_t, Key>> landmarks_;
  std::map<VehicleId, std::uint32_t> associations_, verdicts_;
};

inline const SE2::Tangent paper_bias(15.0, 15.0, 0.2);
inline const SE2::Tangent fair_start(0.5, 0.5, 0.02);
inline const SE2::Tangent known_start(0.01, 0.01, 0.001);

struct StreetOptions {
  double scale = 1.0;
  double shared_m = 0.1;
  bool associated = true;
  SE2::Tangent bias = paper_bias;  ///< of vehicles 2 and 3; vehicle 1 knows its start
};

/// Three vehicles on one street, one behind the other, who meet in several places.
inline SampleFleet street_fleet(std::uint64_t seed, const StreetOptions& options = {}) {
  SampleFleet fleet(seed, options.scale, options.shared_m);
  std::map<VehicleId, std::vector<Key>> stops;
  for (const VehicleId v : {1U, 2U, 3U}) {
    const double x0 = -60.0 - 15.0 * v;
    fleet.start(v, SE2(x0, 2.0 * v, 0.05 * v), v == 1 ? known_start : options.bias);
    for (int k = 1; k <= 5; ++k)
      stops[v].push_back(fleet.stop(v, SE2(x0 + 25.0 * k, 2.0 * v + 3.0 * (k % 2), 0.2 * k - 0.5)));
  }
  if (!options.associated) return fleet;
  for (const auto& [a, b] : {std::pair{1U, 2U}, std::pair{2U, 3U}, std::pair{1U, 3U}})
    for (const Key& p : stops[a])
      for (const Key& q : stops[b])
        if (const auto pairs = fleet.common(p, q); pairs.size() >= 5) fleet.associate(b, pairs);
  return fleet;
}

inline GlobalMap<SE2> built(const Store& store, const SelectionParams& params = {}) {
  return build_global_map(store, params, SparseMap<SE2>());
}

}  // namespace convoy::test
