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
               std::uint64_t max_lookups)
      : related_(related), elements_(elements), weights_(weights), max_lookups_(max_lookups) {}

  std::vector<std::size_t> run() {
    std::vector<int> left(elements_.size());
    for (std::size_t v = 0; v < left.size(); ++v) left[v] = static_cast<int>(v);
    take_dominant(left);
    take_greedily(left);
    expand(left, base_weight_);
    std::vector<std::size_t> clique;
    for (const int v : best_) clique.push_back(elements_[static_cast<std::size_t>(v)]);
    std::sort(clique.begin(), clique.end());
    return clique;
  }

 private:
  int weight(int v) const { return weights_[static_cast<std::size_t>(v)]; }
  bool related(int v, int w) const {
    ++lookups_;
    return related_(elements_[static_cast<std::size_t>(v)], elements_[static_cast<std::size_t>(w)]);
  }

  // What outweighs all that it contradicts belongs to a heaviest clique; as a rule that is nearly everything.
  void take_dominant(std::vector<int>& left) {
    for (bool taken = true; taken;) {
      taken = false;
      for (std::size_t k = 0; k < left.size(); ++k) {
        const int v = left[k];
        int against = 0;
        for (const int w : left)
          if (w != v && !related(v, w)) against += weight(w);
        if (against > weight(v)) continue;
        clique_.push_back(v);
        base_weight_ += weight(v);
        std::erase_if(left, [&](int w) { return w == v || !related(v, w); });
        taken = true;
        --k;
      }
    }
  }

  // Where the search begins: one after the other that fits, those that contradict least first.
  void take_greedily(const std::vector<int>& left) {
    std::vector<int> order = left, against(elements_.size(), 0);
    for (const int v : left)
      for (const int w : left)
        if (w != v && !related(v, w)) against[static_cast<std::size_t>(v)] += weight(w);
    std::stable_sort(order.begin(), order.end(), [&](int v, int w) {
      return against[static_cast<std::size_t>(v)] < against[static_cast<std::size_t>(w)];
    });
    best_ = clique_;
    best_weight_ = base_weight_;
    std::vector<int> taken;
    for (const int v : order) {
      if (!std::all_of(taken.begin(), taken.end(), [&](int w) { return related(v, w); })) continue;
      taken.push_back(v);
      best_.push_back(v);
      best_weight_ += weight(v);
    }
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
        const bool alone = std::none_of(result.vertices.begin() + static_cast<std::ptrdiff_t>(first),
                                        result.vertices.end(), [&](int w) { return related(v, w); });
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
    if (lookups_ > max_lookups_) return;
    const Coloured coloured = colour(candidates);
    for (std::size_t k = coloured.vertices.size(); k-- > 0;) {
      if (weight_so_far + coloured.bounds[k] <= best_weight_ || lookups_ > max_lookups_) return;
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
  std::uint64_t max_lookups_;
  mutable std::uint64_t lookups_ = 0;
  std::vector<int> clique_, best_;
  int base_weight_ = 0, best_weight_ = 0;
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
                                         const std::vector<int>& weights, std::uint64_t max_lookups) {
  return CliqueSearch(related, elements, weights, max_lookups).run();
}

#define CONVOY_INSTANTIATE(G)                                                         \
  template double prior_chi2(const RelativePrior<G>&, const HypothesisAlignment<G>&); \
  template double loop_chi2(const FactStore<G>&, const Hypothesis<G>&, const Hypothesis<G>&, const DriftSlack&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
