#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/problem.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <tuple>
#include <utility>
#include <vector>

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
  ProblemBuilder(const FactStore<G>& store, const Selection<G>& selection, VehicleId reference, bool common_frame_is_enu)
      : store_(store), selection_(selection), reference_(reference), enu_(common_frame_is_enu) {}

  Problem<G> build() {
    add_nodes();
    connect_chains();
    place_chains();
    place_by_fixes();
    add_priors_and_drifts();
    add_landmarks();
    add_fixes();
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
    std::map<Key, std::vector<const AbsoluteFixFact<G>*>> fixes_of;  // by anchor
    for (const Key& key : selection_.fixes) {
      wanted[key.chain].insert({0, fix(key).anchor});
      fixes_of[fix(key).anchor_key()].push_back(&fix(key));
    }
    for (const auto& [id, indices] : wanted) {
      ChainSpan span{id, static_cast<int>(problem_.nodes.size()), 0, false};
      for (const std::uint32_t index : indices) {
        const Key key{id, index};
        const AnchorFact<G>* anchor = store_.anchor(key);
        node_of_[key] = static_cast<int>(problem_.nodes.size());
        problem_.nodes.push_back({key, anchor != nullptr ? anchor->state : ChainState<G>{}, G()});  // index 0: origin
        if (const auto fixes = fixes_of.find(key); fixes != fixes_of.end()) add_fix_nodes(fixes->second);
      }
      span.end = static_cast<int>(problem_.nodes.size());
      chain_of_[id] = static_cast<int>(problem_.chains.size());
      problem_.chains.push_back(span);
    }
    parent_.resize(problem_.chains.size());
    for (std::size_t i = 0; i < parent_.size(); ++i) parent_[i] = static_cast<int>(i);
    base_.resize(problem_.chains.size());
  }

  // Behind the node of their anchor, in the order of driving. A fix is a place of its own: several that hang on one anchor
  // share the drift since then. Where the vehicle has not moved, neighbours share a node.
  void add_fix_nodes(std::vector<const AbsoluteFixFact<G>*>& fixes) {
    std::sort(fixes.begin(), fixes.end(), [](const auto* x, const auto* y) {
      return std::tie(x->state.abscissa_m, x->state.stamp_s, x->key) < std::tie(y->state.abscissa_m, y->state.stamp_s, y->key);
    });
    for (const AbsoluteFixFact<G>* f : fixes) {
      const ChainState<G>& last = problem_.nodes.back().slam;
      const bool moved = f->state.pose.translation() != last.pose.translation() ||
                         f->state.pose.rotation() != last.pose.rotation() || f->state.drift != last.drift;
      if (moved) problem_.nodes.push_back({problem_.nodes.back().anchor, f->state, G()});
      fix_node_[f->key] = static_cast<int>(problem_.nodes.size()) - 1;
    }
  }

  const AbsoluteFixFact<G>& fix(const Key& key) const {
    return store_.chains().at(key.chain).absolute_fixes.at(key.index);
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

  typename G::Point placed_antenna(const AbsoluteFixFact<G>& f) const {
    return problem_.nodes[static_cast<std::size_t>(fix_node_.at(f.key))].initial * f.lever;
  }

  struct Sight {
    typename G::Point here, there;  // where the antenna is, provisional frame and ENU
    double sigma_m;
  };

  static G turned_about_z(double yaw_rad) {
    typename G::Tangent d = G::Tangent::Zero();
    d[G::Dof - 1] = yaw_rad;
    return G::Exp(d);
  }

  // T_enu_here, yaw and position: of all pairs of fixes far enough apart, the one that suits the others best (least median of
  // squares), so that a gross error does not decide where to start from. Empty if no pair fixes the yaw to 0.3 rad.
  static std::optional<G> align_to_enu(const std::vector<Sight>& all) {
    constexpr double max_sigma_yaw_rad = 0.3;
    constexpr std::size_t most = 40;
    std::vector<Sight> some;
    const std::size_t stride = std::max<std::size_t>(1, (all.size() + most - 1) / most);
    for (std::size_t i = 0; i < all.size(); i += stride) some.push_back(all[i]);
    std::optional<G> best;
    double best_median = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < some.size(); ++i)
      for (std::size_t j = i + 1; j < some.size(); ++j) {
        const SE2::Point here = (some[j].here - some[i].here).template head<2>();
        const SE2::Point there = (some[j].there - some[i].there).template head<2>();
        const double baseline_m = std::min(here.norm(), there.norm());
        if (std::hypot(some[i].sigma_m, some[j].sigma_m) > max_sigma_yaw_rad * baseline_m) continue;
        const G turn = turned_about_z(std::atan2(there.y(), there.x()) - std::atan2(here.y(), here.x()));
        const typename G::Point mean_here = 0.5 * (some[i].here + some[j].here);
        const typename G::Point middle = 0.5 * (some[i].there + some[j].there) - turn * mean_here;
        const G T = G::from_rotation(turn.rotation(), middle);
        std::vector<double> distances;
        for (const Sight& s : some) distances.push_back((T * s.here - s.there).norm());
        const auto half = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2);
        std::nth_element(distances.begin(), half, distances.end());
        const double median = *half;
        if (median < best_median) {
          best = T;
          best_median = median;
        }
      }
    return best;
  }

  bool is_aligned(int chain) const { return problem_.chains[static_cast<std::size_t>(chain)].aligned; }

  void place_by_fixes() {
    std::map<int, std::vector<Sight>> sights;  // by group; -1: all that is aligned already
    for (const Key& key : selection_.fixes) {
      const AbsoluteFixFact<G>& f = fix(key);
      const int chain = chain_of_.at(key.chain);
      const Sight sight{placed_antenna(f), f.position, std::sqrt(f.covariance.diagonal().maxCoeff())};
      sights[is_aligned(chain) && !enu_ ? -1 : group(chain)].push_back(sight);
    }
    std::optional<G> T_enu_common = G();
    if (!enu_) T_enu_common = align_to_enu(sights[-1]);
    if (!T_enu_common) return;
    for (int chain = 0; chain < static_cast<int>(problem_.chains.size()); ++chain) {
      const bool stays = enu_ ? has_prior(group(chain)) : is_aligned(chain);
      const auto own = stays ? std::nullopt : align_to_enu(sights[group(chain)]);
      ChainSpan& span = problem_.chains[static_cast<std::size_t>(chain)];
      if (enu_) span.aligned = stays || own;
      if (!own) continue;
      span.aligned = true;
      if (std::erase(gauges_, chain) > 0) floating_.push_back(chain);
      const G move = T_enu_common->inverse() * *own;
      for (int n = span.first; n < span.end; ++n) {
        Node<G>& node = problem_.nodes[static_cast<std::size_t>(n)];
        node.initial = move * node.initial;
      }
    }
    if (enu_ || selection_.fixes.empty()) return;
    problem_.datum = static_cast<int>(problem_.nodes.size());
    const Key last{{std::numeric_limits<VehicleId>::max(), std::numeric_limits<Epoch>::max()},
                   std::numeric_limits<std::uint32_t>::max()};
    problem_.nodes.push_back({last, {}, *T_enu_common});
  }

  bool has_prior(int root) const {
    for (int chain = 0; chain < static_cast<int>(problem_.chains.size()); ++chain)
      if (group(chain) == root && known_prior(chain) != nullptr) return true;
    return false;
  }

  // So wide that it says nothing; it keeps apart from singular what a few fixes leave open.
  static typename G::Covariance flat(double tilt_rad) {
    typename G::Tangent variance = G::Tangent::Constant(tilt_rad * tilt_rad);
    variance.template head<G::Dim>().setConstant(1e10);
    variance[G::Dof - 1] = 100.0;
    return variance.asDiagonal();
  }

  void add_fixes() {
    if (problem_.datum < 0 && !enu_) return;
    // In space the common frame is taken for level to 0.1 rad: yaw and position are what is looked for.
    if (problem_.datum >= 0) problem_.priors.push_back({problem_.datum, problem_.nodes.back().initial, flat(0.1)});
    const typename G::PointCovariance floor = 1e-6 * G::PointCovariance::Identity();  // 1 mm: exact is not singular
    for (const Key& key : selection_.fixes) {
      if (!is_aligned(chain_of_.at(key.chain))) continue;
      const AbsoluteFixFact<G>& f = fix(key);
      problem_.fixes.push_back(
          {fix_node_.at(key), problem_.datum, key, f.lever, f.position, symmetrised(typename G::PointCovariance(f.covariance + floor))});
    }
  }

  void add_priors_and_drifts() {
    for (int c = 0; c < static_cast<int>(problem_.chains.size()); ++c) {
      const ChainSpan& span = problem_.chains[static_cast<std::size_t>(c)];
      if (const PriorFact<G>* prior = known_prior(c))
        problem_.priors.push_back({span.first, prior->mean, floored<G>(prior->covariance)});
      else if (std::find(gauges_.begin(), gauges_.end(), c) != gauges_.end())
        problem_.priors.push_back({span.first, G(), floored<G>(G::Covariance::Zero())});
      else if (std::find(floating_.begin(), floating_.end(), c) != floating_.end())
        problem_.priors.push_back({span.first, problem_.nodes[static_cast<std::size_t>(span.first)].initial, flat(10.0)});
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
  bool enu_;
  Problem<G> problem_;
  std::map<Key, int> node_of_;   // of anchors
  std::map<Key, int> fix_node_;  // of absolute fixes
  std::map<ChainId, int> chain_of_;
  std::vector<int> parent_;
  std::vector<G> base_;      // T_common_slam of each chain to start from
  std::vector<int> floating_;  // chains whose group is held by absolute fixes alone
  std::vector<int> gauges_;  // chains fixed at the identity for want of a static bias
};

}  // namespace

template <class G>
Problem<G> build_problem(const FactStore<G>& store, const Selection<G>& selection, VehicleId reference,
                         bool common_frame_is_enu) {
  return ProblemBuilder<G>(store, selection, reference, common_frame_is_enu).build();
}

#define CONVOY_INSTANTIATE(G) template Problem<G> build_problem(const FactStore<G>&, const Selection<G>&, VehicleId, bool);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
