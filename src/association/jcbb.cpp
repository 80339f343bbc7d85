#include <convoy/association/baselines.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <limits>

#include "baseline_parts.hpp"

namespace convoy {
namespace {

using namespace baseline;

template <class G>
class JointSearch {
 public:
  JointSearch(const Batch<G>& a, const Batch<G>& b, const RelativePrior<G>& prior, double confidence,
              std::uint64_t max_nodes)
      : a_(a), max_nodes_(max_nodes), used_(a.landmarks.size(), false), limit_{0.0} {
    start_.P = prior.covariance;
    const double middle_m = middle_abscissa(b);
    const IndividualCompatibility<G> compatible(prior, confidence);
    for (int j = 0; j < static_cast<int>(b.landmarks.size()); ++j) {
      Fresh fresh{j, predict(prior.mean, b, j, middle_m), {}};
      for (int i = 0; i < static_cast<int>(a.landmarks.size()); ++i)
        if (compatible(a.landmarks[at(i)], b.landmarks[at(j)])) fresh.compatible.push_back(i);
      if (fresh.compatible.empty()) continue;
      fresh_.push_back(std::move(fresh));
      limit_.push_back(chi2_quantile(confidence, static_cast<double>(G::Dim * fresh_.size())));
    }
  }

  SearchResult run() {
    recurse(0, start_, 0.0);
    return {best_, cut_off_, nodes_};
  }

 private:
  struct Fresh {  // a new landmark and those that eq. 5 allows it to be
    int j;
    Prediction<G> seen;
    std::vector<int> compatible;
  };

  bool better(std::size_t pairings, double chi2) const {
    return pairings > best_.size() || (pairings == best_.size() && chi2 < best_chi2_);
  }

  // Hypothesis H_ on the first k new landmarks, what it says of the alignment, and its joint chi-square.
  void recurse(std::size_t k, const Belief<G>& belief, double chi2) {
    if (nodes_ == max_nodes_) cut_off_ = true;
    if (cut_off_) return;
    ++nodes_;
    if (better(H_.size(), chi2)) {
      best_ = H_;
      best_chi2_ = chi2;
    }
    if (k == fresh_.size()) return;
    const std::size_t left = fresh_.size() - k - 1;
    for (const auto& [increase, i] : jointly_compatible(fresh_[k], belief, chi2)) {
      if (!better(H_.size() + 1 + left, chi2 + increase)) break;
      Belief<G> updated = belief;
      updated.update(a_.landmarks[at(i)], fresh_[k].seen);
      used_[at(i)] = true;
      H_.emplace_back(i, fresh_[k].j);
      recurse(k + 1, updated, chi2 + increase);
      H_.pop_back();
      used_[at(i)] = false;
    }
    if (better(H_.size() + left, chi2)) recurse(k + 1, belief, chi2);  // paired with none
  }

  // (what it adds to the joint chi-square, i), the least first: a good hypothesis found early bounds the rest.
  std::vector<std::pair<double, int>> jointly_compatible(const Fresh& fresh, const Belief<G>& belief,
                                                         double chi2) const {
    std::vector<std::pair<double, int>> found;
    for (const int i : fresh.compatible) {
      if (used_[at(i)]) continue;
      const double increase = belief.chi2(a_.landmarks[at(i)], fresh.seen);
      if (chi2 + increase < limit_[H_.size() + 1]) found.emplace_back(increase, i);
    }
    std::sort(found.begin(), found.end());
    return found;
  }

  const Batch<G>& a_;
  std::uint64_t max_nodes_;
  Belief<G> start_;
  std::vector<Fresh> fresh_;
  std::vector<bool> used_;
  std::vector<double> limit_;  // of the joint chi-square, by the number of pairings
  std::vector<IndexPairing> H_, best_;
  double best_chi2_ = std::numeric_limits<double>::infinity();
  std::uint64_t nodes_ = 0;
  bool cut_off_ = false;
};
}  // namespace

template <class G>
SearchResult jcbb(const Batch<G>& a, const Batch<G>& b, const std::optional<RelativePrior<G>>& prior, double confidence,
                  std::uint64_t max_nodes) {
  if (!prior) return {};
  return in_order_of_keys(a, b, prior, confidence, [&](const Batch<G>& near, const Batch<G>& fresh) {
    return JointSearch<G>(near, fresh, *prior, confidence, max_nodes).run();
  });
}

#define CONVOY_INSTANTIATE(G)                                                                                  \
  template SearchResult jcbb(const Batch<G>&, const Batch<G>&, const std::optional<RelativePrior<G>>&, double, \
                             std::uint64_t);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
