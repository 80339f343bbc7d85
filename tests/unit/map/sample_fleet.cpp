#include "sample_fleet.hpp"

#include <convoy/geometry/groups.hpp>

#include <cmath>
#include <utility>

namespace convoy::test {

template <class G>
typename G::Tangent each(double translation, double rotation) {
  typename G::Tangent d;
  d.template head<G::Dim>().setConstant(translation);
  d.template tail<G::Dof - G::Dim>().setConstant(rotation);
  return d;
}

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
SampleFleetOf<G>::SampleFleetOf(std::uint64_t seed, double scale, double shared_m)
    : random_(seed), scale_(scale), shared_m_(shared_m), points_(scattered<G>(random_, 400, 100.0, 2.0)) {}

template <class G>
SampleFleetOf<G>::SampleFleetOf(const SampleFleetOf&) = default;
template <class G>
SampleFleetOf<G>::~SampleFleetOf() = default;

template <class G>
void SampleFleetOf<G>::start(VehicleId v, const G& T_world_start, const typename G::Tangent& sigma) {
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

template <class G>
Key SampleFleetOf<G>::stop(VehicleId v, const G& T_world_anchor) {
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

template <class G>
std::vector<Pairing> SampleFleetOf<G>::common(const Key& a, const Key& b, std::size_t count) const {
  std::vector<Pairing> list;
  for (const auto& [id, landmark] : landmarks_.at(a))
    if (const auto it = landmarks_.at(b).find(id); it != landmarks_.at(b).end() && list.size() < count)
      list.emplace_back(landmark, it->second);
  return canonical(std::move(list));
}

template <class G>
Hash SampleFleetOf<G>::associate(VehicleId author, const std::vector<Pairing>& pairings) {
  facts.emplace_back(association(author, associations_[author]++, pairings));
  return hypothesis_id(pairings);
}

template <class G>
void SampleFleetOf<G>::judge(VehicleId author, Hash hypothesis, bool veto) {
  facts.emplace_back(verdict(author, verdicts_[author]++, hypothesis, veto));
}

template <class G>
Key SampleFleetOf<G>::fix(const Key& at, const typename G::Point& error, double sigma_m,
                          std::optional<std::uint32_t> hung_on) {
  const VehicleId v = at.chain.vehicle;
  AbsoluteFixFact<G> f{key_of(v, fixes_[v]++), hung_on.value_or(at.index), anchor(at).state};
  f.lever.setConstant(0.5);
  f.position = enu_of_world() * (truth.at(at) * f.lever) + error;
  f.covariance = sigma_m * sigma_m * G::PointCovariance::Identity();
  facts.emplace_back(f);
  return f.key;
}

template <class G>
Key SampleFleetOf<G>::fix(const Key& at, double sigma_m, std::optional<std::uint32_t> hung_on) {
  const typename G::Point error = scale_ * sigma_m * random_.unit_normal<G::Dim>();
  return fix(at, error, sigma_m, hung_on);
}

template <class G>
G SampleFleetOf<G>::enu_of_world() {
  typename G::Tangent turn = G::Tangent::Zero(), shift = G::Tangent::Zero();
  turn[G::Dof - 1] = 0.8;
  shift.template head<2>() << 300.0, -120.0;
  return G::Exp(shift) * G::Exp(turn);
}

template <class G>
FactStore<G> SampleFleetOf<G>::store_of(const std::vector<AnyFact<G>>& list) {
  FactStore<G> store;
  for (const AnyFact<G>& fact : list) insert(store, fact);
  return store;
}

template <class G>
SampleFleetOf<G> street_fleet(std::uint64_t seed, const std::type_identity_t<StreetOptionsOf<G>>& options) {
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

template <class G>
GlobalMap<G> built(const FactStore<G>& store, const SelectionParams& params) {
  return build_global_map(store, params, SparseMap<G>());
}

#define CONVOY_INSTANTIATE(G)                                                                                \
  template G::Tangent each<G>(double, double);                                                               \
  template G on_the_street<G>(double, double, double);                                                       \
  template class SampleFleetOf<G>;                                                                           \
  template SampleFleetOf<G> street_fleet<G>(std::uint64_t, const std::type_identity_t<StreetOptionsOf<G>>&); \
  template GlobalMap<G> built<G>(const FactStore<G>&, const SelectionParams&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::test
