#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/consensus.hpp>

#include <algorithm>

namespace convoy {
namespace {

// Maximum weight clique. Vertices are positions in `elements`.
class CliqueSearch {
 public:
  CliqueSearch(const Relation& related, const std::vector<std::size_t>& elements, const std::vector<int>& weights,
               std::uint64_t max_nodes)
      : related_(related), elements_(elements), weights_(weights), max_nodes_(max_nodes) {}

  std::vector<std::size_t> run() {
    std::vector<int> all(elements_.size());
    for (std::size_t v = 0; v < all.size(); ++v) all[v] = static_cast<int>(v);
    expand(all, 0);
    std::vector<std::size_t> clique;
    for (const int v : best_) clique.push_back(elements_[static_cast<std::size_t>(v)]);
    std::sort(clique.begin(), clique.end());
    return clique;
  }

 private:
  int weight(int v) const { return weights_[static_cast<std::size_t>(v)]; }
  bool related(int v, int w) const {
    return related_(elements_[static_cast<std::size_t>(v)], elements_[static_cast<std::size_t>(w)]);
  }

  // Of vertices of one colour no two are related, so at most the heaviest of them can be taken.
  struct Coloured {
    std::vector<int> vertices;  // by colour
    std::vector<int> bounds;    // of the vertices up to each
  };
  Coloured colour(std::vector<int> uncoloured) const {
    Coloured result;
    int bound = 0;
    while (!uncoloured.empty()) {
      const std::size_t first = result.vertices.size();
      std::vector<int> left;
      int heaviest = 0;
      for (const int v : uncoloured) {
        const bool alone = std::none_of(result.vertices.begin() + static_cast<std::ptrdiff_t>(first), result.vertices.end(),
                                        [&](int w) { return related(v, w); });
        if (!alone) {
          left.push_back(v);
          continue;
        }
        heaviest = std::max(heaviest, weight(v));
        result.vertices.push_back(v);
        result.bounds.push_back(bound + heaviest);
      }
      bound += heaviest;
      uncoloured = std::move(left);
    }
    return result;
  }

  void expand(const std::vector<int>& candidates, int weight_so_far) {
    if (weight_so_far > best_weight_) {
      best_ = clique_;
      best_weight_ = weight_so_far;
    }
    if (++nodes_ > max_nodes_) return;
    const Coloured coloured = colour(candidates);
    for (std::size_t k = coloured.vertices.size(); k-- > 0;) {
      if (weight_so_far + coloured.bounds[k] <= best_weight_ || nodes_ > max_nodes_) return;
      const int v = coloured.vertices[k];
      std::vector<int> next;
      for (std::size_t i = 0; i < k; ++i)
        if (related(v, coloured.vertices[i])) next.push_back(coloured.vertices[i]);
      clique_.push_back(v);
      expand(next, weight_so_far + weight(v));
      clique_.pop_back();
    }
  }

  const Relation& related_;
  const std::vector<std::size_t>& elements_;
  const std::vector<int>& weights_;
  std::uint64_t max_nodes_, nodes_ = 0;
  std::vector<int> clique_, best_;
  int best_weight_ = 0;
};

// Of (T Exp(e))^-1 T Exp(e) ... : a right perturbation of the left factor, seen behind the right one.
template <class G>
typename G::Covariance behind(const G& right, const typename G::Covariance& of_left) {
  const typename G::Adjoint Ad = right.inverse().adjoint();
  return Ad * of_left * Ad.transpose();
}

}  // namespace

template <class G>
double prior_chi2(const RelativePrior<G>& prior, const HypothesisAlignment<G>& alignment) {
  const typename G::Tangent r = (prior.mean.inverse() * alignment.T_a_b).Log();
  return squared_mahalanobis(r, symmetrised(typename G::Covariance(prior.covariance + alignment.covariance())));
}

template <class G>
double loop_chi2(const FactStore<G>& store, const Hypothesis<G>& h, const Hypothesis<G>& k, const DriftSlack& slack) {
  const auto to_h = *relative_prior(store, k.batch_a, h.batch_a, slack),
             from_h = *relative_prior(store, h.batch_b, k.batch_b, slack);
  const G rest = h.alignment.T_a_b * from_h.mean;
  RelativePrior<G> by_h;  // of the batches of k
  by_h.mean = to_h.mean * rest;
  by_h.covariance = behind(rest, to_h.covariance) + behind(from_h.mean, h.alignment.covariance()) + from_h.covariance;
  return prior_chi2(by_h, k.alignment);
}

std::vector<std::size_t> heaviest_clique(const Relation& related, const std::vector<std::size_t>& elements,
                                         const std::vector<int>& weights, std::uint64_t max_nodes) {
  return CliqueSearch(related, elements, weights, max_nodes).run();
}

#define CONVOY_INSTANTIATE(G)                                                               \
  template double prior_chi2(const RelativePrior<G>&, const HypothesisAlignment<G>&);       \
  template double loop_chi2(const FactStore<G>&, const Hypothesis<G>&, const Hypothesis<G>&, \
                            const DriftSlack&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
