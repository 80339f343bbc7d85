#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/factors.hpp>
#include <convoy/map/hypothesis_graph.hpp>
#include <convoy/map/sparse_map.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {

template <class G>
HypothesisGraph<G>::HypothesisGraph(const Map<G>& map, const Selection<G>& selection)
    : problem_(map.problem()), stated_(selection.hypotheses.size()) {
  problem_.points.clear();
  problem_.landmarks.clear();
  problem_.loadings.clear();
  for (std::size_t n = 0; n < problem_.nodes.size(); ++n) problem_.nodes[n].initial = map.poses()[n];
  const auto node_of = [&](const Key& anchor) {
    const auto it = std::lower_bound(problem_.nodes.begin(), problem_.nodes.end(), anchor,
                                     [](const Node<G>& node, const Key& key) { return node.anchor < key; });
    return static_cast<int>(it - problem_.nodes.begin());
  };
  for (std::size_t k = 0; k < stated_; ++k) {
    const Hypothesis<G>& h = selection.hypotheses[k];
    if (h.state != HypothesisState::accepted) continue;
    z_.push_back({node_of(h.batch_a), node_of(h.batch_b), h.alignment.T_a_b, h.alignment.covariance()});
    ids_.push_back(h.id);
    number_of_.push_back(k);
  }
}

template <class G>
Problem<G> HypothesisGraph<G>::weighted(const std::vector<double>& weights) const {
  Problem<G> problem = problem_;
  for (std::size_t k = 0; k < z_.size(); ++k) {
    if (weights[k] <= 0.0) continue;
    problem.drifts.push_back(z_[k]);
    problem.drifts.back().covariance /= weights[k];
  }
  return problem;
}

template <class G>
std::vector<std::pair<double, int>> HypothesisGraph<G>::leave_one_out() const {
  std::vector<std::pair<double, int>> result(stated_, {0.0, 0});
  if (z_.empty()) return result;
  const auto map = SparseMap<G>().solve(weighted(std::vector<double>(z_.size(), 1.0)));
  for (std::size_t k = 0; k < z_.size(); ++k) result[number_of_[k]] = map->contradiction(z_[k]);
  return result;
}

template <class G>
std::set<Hash> HypothesisGraph<G>::outliers(double confidence) const {
  constexpr double growth = 1.4;
  const double limit = chi2_quantile(confidence, G::Dof);
  std::vector<double> weights(z_.size(), 1.0);
  double mu = 0.0;
  for (bool settled = false; !settled;) {
    const auto map = SparseMap<G>().solve(weighted(weights));
    std::vector<double> chi2;
    for (const DriftFactor<G>& z : z_) {
      const DriftResidual<G> one(z, map->poses()[static_cast<std::size_t>(z.a)],
                                 map->poses()[static_cast<std::size_t>(z.b)]);
      chi2.push_back(squared_mahalanobis(one.r, z.covariance));
    }
    const double largest = chi2.empty() ? 0.0 : *std::max_element(chi2.begin(), chi2.end());
    if (mu == 0.0 && largest <= limit) break;  // convex enough: nothing to truncate
    mu = mu == 0.0 ? limit / std::max(limit, 2.0 * largest - limit) : growth * mu;
    settled = true;
    for (std::size_t k = 0; k < z_.size(); ++k) {
      double& w = weights[k];
      if (chi2[k] >= (mu + 1.0) / mu * limit) w = 0.0;
      else if (chi2[k] <= mu / (mu + 1.0) * limit) w = 1.0;
      else w = std::sqrt(limit * mu * (mu + 1.0) / chi2[k]) - mu;
      settled = settled && (w == 0.0 || w == 1.0);
    }
    if (mu > 1e6) break;
  }
  std::set<Hash> outliers;
  for (std::size_t k = 0; k < z_.size(); ++k)
    if (weights[k] < 0.5) outliers.insert(ids_[k]);
  return outliers;
}

#define CONVOY_INSTANTIATE(G) template class HypothesisGraph<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
