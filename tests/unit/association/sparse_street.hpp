// Two vehicles that drive along one street, and of what they pass freeze a part each: batches that have little in
// common.
#pragma once

#include <convoy/submap/fact_store.hpp>

#include "../random_world.hpp"

#include <map>
#include <variant>
#include <vector>

namespace convoy::test {

template <class G>
struct SparseStreet {
  using Fact = std::variant<AnchorFact<G>, LandmarkFact<G>, PriorFact<G>>;
  static constexpr int stops = 4;

  /// `kept`: the share of the landmarks that each of them freezes; `noise_m`: of each landmark.
  SparseStreet(std::uint64_t seed, double kept, double noise_m) : random(seed) {
    points = scattered<G>(random, 240, 40.0, 2.0);
    for (VehicleId v : {1U, 2U}) drive(v, kept, noise_m);
  }

  ChainId chain(VehicleId v) const { return {v, 1}; }
  FactStore<G> store() const {
    FactStore<G> all;
    for (const Fact& fact : facts) std::visit([&](const auto& f) { all.insert(f); }, fact);
    return all;
  }
  bool is_true(const std::vector<Pairing>& pairings) const {
    int right = 0;
    for (const auto& [i, j] : pairings) right += thing_of.at(i) == thing_of.at(j) ? 1 : 0;
    return 10 * right >= 7 * static_cast<int>(pairings.size());
  }

  Random random;
  PointsOf<G> points;
  std::vector<Fact> facts;
  std::map<Key, std::size_t> thing_of;  // landmark -> what it truly is
  std::map<Key, G> truth;               // anchor -> T_world_anchor

 private:
  static G at(double x_m) {
    typename G::Tangent d = G::Tangent::Zero();
    d[0] = x_m;
    return G::Exp(d);
  }

  void drive(VehicleId v, double kept, double noise_m) {
    typename G::Tangent sigma = G::Tangent::Constant(v == 1 ? 1e-3 : 0.01);
    if (v == 2) sigma.template head<2>().setConstant(9.0), sigma[G::Dof - 1] = 0.15;
    const G T_world_start = at(-40.0);
    PriorFact<G> prior{
        {chain(v), 0}, true, T_world_start * G::Exp(sigma.cwiseProduct(random.template unit_normal<G::Dof>()))};
    prior.covariance = sigma.cwiseAbs2().asDiagonal();
    facts.emplace_back(prior);
    facts.emplace_back(AnchorFact<G>{{chain(v), 0}, {}});
    const double step_m = 80.0 / stops;
    const typename G::Tangent drift = G::Tangent::Constant(0.03);  // standard deviation from one stop to the next
    G said, T_world_body = T_world_start;
    typename G::Covariance C = G::Covariance::Zero();
    std::uint32_t next = 0;
    for (std::uint32_t k = 1; k <= stops; ++k) {
      T_world_body = T_world_body * at(step_m);
      typename G::Tangent error = drift.cwiseProduct(random.template unit_normal<G::Dof>());
      error.template tail<G::Dof - G::Dim>() *= 0.1;
      said = said * at(step_m) * G::Exp(error);
      typename G::Covariance Q = drift.cwiseAbs2().asDiagonal();
      Q.template bottomRightCorner<G::Dof - G::Dim, G::Dof - G::Dim>() *= 0.01;
      C += said.adjoint() * Q * said.adjoint().transpose();
      PointsOf<G> seen;
      std::vector<std::size_t> ids;
      for (std::size_t p = 0; p < points.size(); ++p) {
        const double behind_m = T_world_body.translation().x() - points[p].x();
        if (behind_m < 0.0 || behind_m >= step_m || random.uniform(0.0, 1.0) > kept) continue;
        seen.push_back(points[p]);
        ids.push_back(p);
      }
      AnchorFact<G> anchor{{chain(v), k}, {10.0 * k, step_m * k, said, symmetrised_(C)}};
      anchor.first_landmark = next;
      anchor.landmark_count = static_cast<std::uint32_t>(seen.size());
      truth[anchor.key] = T_world_body;
      facts.emplace_back(anchor);
      const auto batch = frozen_batch(random, anchor.key, T_world_body, seen, {noise_m, 0.05}, next);
      for (std::size_t l = 0; l < ids.size(); ++l) {
        thing_of[batch.landmarks[l].key] = ids[l];
        facts.emplace_back(batch.landmarks[l]);
      }
      next += anchor.landmark_count;
    }
  }
  static typename G::Covariance symmetrised_(const typename G::Covariance& C) { return 0.5 * (C + C.transpose()); }
};

}  // namespace convoy::test
