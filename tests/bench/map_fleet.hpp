// A fleet on a street grid, as facts: every 10 m an anchor with the landmarks of its place, and a hypothesis for every
// link of StreetFleet, which pairs all that both of its batches saw. In space the streets are level and their landmarks
// up to 10 m high; drift goes in all six directions.
#pragma once

#include <convoy/drift/drift_model.hpp>
#include <convoy/submap/fact_store.hpp>

#include <algorithm>
#include <map>
#include <random>
#include <variant>
#include <vector>

#include "street_fleet.hpp"

namespace convoy::bench {

template <class G>
class MapFleet {
 public:
  using Fact = std::variant<AnchorFact<G>, LandmarkFact<G>, PriorFact<G>, AssociationFact>;

  MapFleet(int vehicles, int anchors, int links, int intersections, int landmarks_per_place = 8)
      : street_(vehicles, anchors, links, intersections), per_place_(landmarks_per_place) {
    for (const SE2& pose : street_.poses) poses_.push_back(on_the_ground(pose));
    for (int v = 0; v < vehicles; ++v) add_chain(v, anchors);
    for (const auto& [a, b] : street_.links) associate(a, b);
  }

  /// Chains whole, then hypotheses in no particular order.
  std::vector<Fact> chains;
  std::vector<AssociationFact> hypotheses;

  FactStore<G> store(std::size_t hypotheses_held) const {
    FactStore<G> store;
    for (const Fact& fact : chains) std::visit([&](const auto& f) { store.insert(f); }, fact);
    for (std::size_t h = 0; h < hypotheses_held; ++h) store.insert(hypotheses[h]);
    return store;
  }

 private:
  static ChainId chain(int v) { return {static_cast<VehicleId>(v + 1), 1}; }
  static G on_the_ground(const SE2& pose) {
    typename G::Tangent turn = G::Tangent::Zero();
    turn[G::Dof - 1] = pose.theta();
    typename G::Point place = G::Point::Zero();
    place.template head<2>() = pose.translation();
    return G::from_rotation(G::Exp(turn).rotation(), place);
  }

  template <int N>
  Eigen::Matrix<double, N, 1> noise() {
    Eigen::Matrix<double, N, 1> n;
    for (int i = 0; i < N; ++i) n[i] = unit_(random_);
    return n;
  }

  // The landmarks around a place, at least 2 m from each other, the same whoever comes by.
  const std::vector<typename G::Point>& around(const typename G::Point& place) {
    auto& points = points_[{place.x(), place.y()}];
    std::uniform_real_distribution<double> metres(-5.0, 5.0);
    while (points.size() < static_cast<std::size_t>(per_place_)) {
      typename G::Point p = place;
      for (int i = 0; i < 2; ++i) p[i] += metres(random_);
      if constexpr (G::Dim == 3) p[2] += 5.0 + metres(random_);
      if (std::all_of(points.begin(), points.end(), [&](const typename G::Point& q) { return (p - q).norm() > 2.0; }))
        points.push_back(p);
    }
    return points;
  }

  void add_chain(int v, int anchors) {
    typename G::Tangent rate = G::Tangent::Constant(1e-4);  // m^2 and rad^2 per metre
    rate.template tail<G::Dof - G::Dim>().setConstant(1e-6);
    PriorFact<G> prior{{chain(v), 0}, v == 0, poses_[static_cast<std::size_t>(v * anchors)]};
    if (v == 0) prior.covariance = rate.asDiagonal();
    else prior.mean = G();
    AnchorFact<G> anchor{{chain(v), 0}, {}};
    std::uint32_t landmark = 0;
    chains.emplace_back(anchor);
    chains.emplace_back(prior);
    for (int k = 1; k < anchors; ++k) {
      const std::size_t node = static_cast<std::size_t>(v * anchors + k);
      const typename G::Covariance Q = (10.0 * rate).asDiagonal();
      const G U =
          poses_[node - 1].inverse() * poses_[node] * G::Exp((10.0 * rate).cwiseSqrt().cwiseProduct(noise<G::Dof>()));
      anchor.key.index = static_cast<std::uint32_t>(k);
      anchor.state.stamp_s += 1.0;
      anchor.state.abscissa_m += 10.0;
      anchor.state.pose = anchor.state.pose * U;
      const typename G::Adjoint Ad = anchor.state.pose.adjoint();
      anchor.state.drift += Ad * Q * Ad.transpose();
      anchor.first_landmark = landmark;
      anchor.landmark_count = static_cast<std::uint32_t>(per_place_);
      chains.emplace_back(anchor);
      const typename G::Point shared = 0.05 * noise<G::Dim>();
      for (const typename G::Point& p : around(poses_[node].translation())) {
        LandmarkFact<G> l;
        l.key = {chain(v), landmark++};
        l.anchor = anchor.key.index;
        l.loading.template leftCols<G::Dim>() = 0.05 * G::PointCovariance::Identity();
        l.position = poses_[node].inverse() * p + 0.1 * noise<G::Dim>() + shared;
        l.covariance = 0.01 * G::PointCovariance::Identity() + l.loading * l.loading.transpose();
        chains.emplace_back(l);
      }
    }
    anchors_ = anchors;
  }

  void associate(int node_a, int node_b) {
    const int ka = node_a % anchors_, kb = node_b % anchors_;
    if (ka == 0 || kb == 0) return;  // the start of a chain has no batch
    std::vector<Pairing> pairings;
    for (int i = 0; i < per_place_; ++i)
      pairings.emplace_back(Key{chain(node_a / anchors_), static_cast<std::uint32_t>((ka - 1) * per_place_ + i)},
                            Key{chain(node_b / anchors_), static_cast<std::uint32_t>((kb - 1) * per_place_ + i)});
    const ChainId author = chain(node_b / anchors_);
    hypotheses.push_back({{author, next_[author]++}, canonical(std::move(pairings))});
  }

  StreetFleet street_;
  std::vector<G> poses_;  // of street_
  int per_place_, anchors_ = 0;
  std::mt19937_64 random_{5};
  std::normal_distribution<double> unit_;
  std::map<std::pair<double, double>, std::vector<typename G::Point>> points_;
  std::map<ChainId, std::uint32_t> next_;
};

}  // namespace convoy::bench
