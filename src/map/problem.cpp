#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/problem.hpp>

#include <algorithm>
#include <limits>
#include <map>
#include <optional>
#include <set>

namespace convoy {
namespace {

// "Exactly known" is kept apart from singular: (0.1 mm)^2 and (10 urad)^2.
template <class G>
typename G::Covariance floored(typename G::Covariance P) {
  P.diagonal().template head<G::Dim>().array() += 1e-8;
  P.diagonal().template tail<G::Dof - G::Dim>().array() += 1e-10;
  return P;
}

template <class G>
class ProblemBuilder {
 public:
  ProblemBuilder(const FactStore<G>& store, const Selection<G>& selection, VehicleId reference)
      : store_(store), selection_(selection), reference_(reference) {}

  Problem<G> build() {
    add_nodes();
    connect_chains();
    place_chains();
    add_priors_and_drifts();
    add_landmarks();
    return std::move(problem_);
  }

 private:
  const ChainId& chain_id(int chain) const { return problem_.chains[static_cast<std::size_t>(chain)].chain; }
  const PriorFact<G>* known_prior(int chain) const {
    const PriorFact<G>* prior = store_.prior(chain_id(chain));
    return prior != nullptr && prior->known ? prior : nullptr;
  }

  void add_nodes() {
    std::map<ChainId, std::set<std::uint32_t>> wanted;
    for (const auto& [id, chain] : store_.chains())
      if (!chain.anchors.empty() || !chain.priors.empty()) wanted[id].insert(0);
    for (const auto& members : selection_.classes)
      for (const Key& key : members) {
        const LandmarkFact<G>& landmark = *store_.landmark(key);
        wanted[key.chain].insert({0, landmark.anchor});
      }
    for (const auto& [id, indices] : wanted) {
      ChainSpan span{id, static_cast<int>(problem_.nodes.size()), 0, false};
      for (const std::uint32_t index : indices) {
        const Key key{id, index};
        const AnchorFact<G>* anchor = store_.anchor(key);
        node_of_[key] = static_cast<int>(problem_.nodes.size());
        problem_.nodes.push_back({key, anchor != nullptr ? anchor->state : ChainState<G>{}, G()});  // index 0: origin
      }
      span.end = static_cast<int>(problem_.nodes.size());
      chain_of_[id] = static_cast<int>(problem_.chains.size());
      problem_.chains.push_back(span);
    }
    parent_.resize(problem_.chains.size());
    for (std::size_t i = 0; i < parent_.size(); ++i) parent_[i] = static_cast<int>(i);
    base_.resize(problem_.chains.size());
  }

  int group(int chain) const {
    while (parent_[static_cast<std::size_t>(chain)] != chain) chain = parent_[static_cast<std::size_t>(chain)];
    return chain;
  }

  void connect_chains() {
    for (const Hypothesis<G>& h : selection_.hypotheses) {
      if (h.state != HypothesisState::accepted) continue;
      const int a = group(chain_of_.at(h.batch_a.chain)), b = group(chain_of_.at(h.batch_b.chain));
      parent_[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);  // the root is the smallest chain
    }
  }

  // The chain a group is placed from: the one whose static bias is known best, else the reference, else the smallest.
  int root_of(const std::vector<int>& members) const {
    int best = members.front();
    for (const int chain : members)
      if (chain_id(chain).vehicle == reference_ && chain_id(best).vehicle != reference_) best = chain;
    const auto trace = [&](int chain) {
      const PriorFact<G>* prior = known_prior(chain);
      return prior != nullptr ? prior->covariance.trace() : std::numeric_limits<double>::infinity();
    };
    for (const int chain : members)
      if (trace(chain) < trace(best)) best = chain;
    return best;
  }

  void place_chains() {
    std::map<int, std::vector<int>> groups;
    for (int chain = 0; chain < static_cast<int>(parent_.size()); ++chain) groups[group(chain)].push_back(chain);
    int common = -1;
    bool any_prior = false;
    const auto size = [&](int root) { return groups.at(root).size(); };
    for (const auto& [root, members] : groups) {
      const bool refers = reference_ == 0 || std::any_of(members.begin(), members.end(), [&](int chain) {
                            return chain_id(chain).vehicle == reference_;
                          });
      if (refers && (common < 0 || size(root) > size(common))) common = root;
      for (const int chain : members) any_prior = any_prior || known_prior(chain) != nullptr;
    }
    for (const auto& [root, members] : groups) {
      const int first = root_of(members);
      const PriorFact<G>* prior = known_prior(first);
      place_group(members, first, prior != nullptr ? prior->mean : G());
      if (prior == nullptr) gauges_.push_back(first);
      const bool aligned = any_prior ? prior != nullptr : root == common;
      for (const int chain : members) problem_.chains[static_cast<std::size_t>(chain)].aligned = aligned;
    }
  }

  // Breadth first along the accepted hypotheses in their canonical order, strongest first.
  void place_group(const std::vector<int>& members, int first, const G& base) {
    base_[static_cast<std::size_t>(first)] = base;
    std::set<int> placed{first};
    for (bool progress = true; progress && placed.size() < members.size();) {
      progress = false;
      for (const Hypothesis<G>& h : selection_.hypotheses) {
        if (h.state != HypothesisState::accepted) continue;
        const int a = chain_of_.at(h.batch_a.chain), b = chain_of_.at(h.batch_b.chain);
        if (placed.count(a) == placed.count(b)) continue;
        const G Xa = store_.anchor(h.batch_a)->state.pose, Xb = store_.anchor(h.batch_b)->state.pose;
        const G& z = h.alignment.T_a_b;
        if (placed.count(a)) base_[static_cast<std::size_t>(b)] = base_[static_cast<std::size_t>(a)] * Xa * z * Xb.inverse();
        else base_[static_cast<std::size_t>(a)] = base_[static_cast<std::size_t>(b)] * Xb * z.inverse() * Xa.inverse();
        placed.insert({a, b});
        problem_.placed_by.insert(h.id);
        progress = true;
        break;
      }
    }
    for (const int chain : members) {
      const ChainSpan& span = problem_.chains[static_cast<std::size_t>(chain)];
      for (int n = span.first; n < span.end; ++n) {
        Node<G>& node = problem_.nodes[static_cast<std::size_t>(n)];
        node.initial = base_[static_cast<std::size_t>(chain)] * node.slam.pose;
      }
    }
  }

  void add_priors_and_drifts() {
    for (int c = 0; c < static_cast<int>(problem_.chains.size()); ++c) {
      const ChainSpan& span = problem_.chains[static_cast<std::size_t>(c)];
      if (const PriorFact<G>* prior = known_prior(c))
        problem_.priors.push_back({span.first, prior->mean, floored<G>(prior->covariance)});
      else if (std::find(gauges_.begin(), gauges_.end(), c) != gauges_.end())
        problem_.priors.push_back({span.first, G(), floored<G>(G::Covariance::Zero())});
      for (int n = span.first + 1; n < span.end; ++n) {
        const auto step = increment(problem_.nodes[static_cast<std::size_t>(n) - 1].slam,
                                    problem_.nodes[static_cast<std::size_t>(n)].slam);
        problem_.drifts.push_back({n - 1, n, step.motion, step.covariance});
      }
    }
  }

  void add_landmarks() {
    for (const auto& members : selection_.classes) {
      const int point = static_cast<int>(problem_.points.size());
      typename G::Point mean = G::Point::Zero();
      for (const Key& key : members) {
        const LandmarkFact<G>& landmark = *store_.landmark(key);
        const int node = node_of_.at(landmark.anchor_key());
        mean += problem_.nodes[static_cast<std::size_t>(node)].initial * landmark.position;
        const typename G::PointCovariance floor = 1e-6 * G::PointCovariance::Identity();  // 1 mm: exact is not singular
        problem_.landmarks.push_back(
            {node, point, key, landmark.position, landmark.covariance + floor, landmark.loading});
      }
      problem_.points.push_back(mean / static_cast<double>(members.size()));
    }
  }

  const FactStore<G>& store_;
  const Selection<G>& selection_;
  VehicleId reference_;
  Problem<G> problem_;
  std::map<Key, int> node_of_;
  std::map<ChainId, int> chain_of_;
  std::vector<int> parent_;
  std::vector<G> base_;      // T_common_slam of each chain to start from
  std::vector<int> gauges_;  // chains fixed at the identity for want of a static bias
};

}  // namespace

template <class G>
Problem<G> build_problem(const FactStore<G>& store, const Selection<G>& selection, VehicleId reference) {
  return ProblemBuilder<G>(store, selection, reference).build();
}

#define CONVOY_INSTANTIATE(G) template Problem<G> build_problem(const FactStore<G>&, const Selection<G>&, VehicleId);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
