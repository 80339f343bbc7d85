#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/conditioning.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/placement.hpp>
#include <convoy/map/problem.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <ranges>
#include <set>
#include <span>
#include <tuple>
#include <utility>
#include <vector>

namespace convoy {
namespace {

// "Exactly known" is kept apart from singular: (0.1 mm)^2 and (10 urad)^2. What rounding left below zero, which a fact
// may hold (is_covariance()), would else be negative information.
template <class G>
typename G::Covariance floored(typename G::Covariance P) {
  P = positive_part(P);
  P.diagonal().template head<G::Dim>().array() += 1e-8;
  P.diagonal().template tail<G::Dof - G::Dim>().array() += 1e-10;
  return invertible(P);
}

// The same for points, (1 mm)^2. Below variances of 1000 m^2 what rounding left is less than that.
template <class G>
typename G::PointCovariance floored_point(const typename G::PointCovariance& P) {
  const typename G::PointCovariance floor = 1e-6 * G::PointCovariance::Identity();
  return (P.cwiseAbs().maxCoeff() < 500.0 ? P : invertible(P)) + floor;
}

template <class G>
class ProblemBuilder {
 public:
  ProblemBuilder(const FactStore<G>& store, const Selection<G>& selection, const ProblemOptions& options,
                 const Problem<G>* before)
      : store_(store), selection_(selection), before_(before), options_(options) {}

  Problem<G> build() {
    find_known_classes();
    add_nodes();
    placed_ = place(store_, selection_, options_, fixes_, encounters_, problem_);
    add_priors();
    add_drifts();
    add_landmarks();
    add_fixes();
    add_encounters();
    return std::move(problem_);
  }

 private:
  static constexpr std::size_t none = std::numeric_limits<std::size_t>::max();

  std::size_t end_of_known_class(std::size_t first) const {
    const std::vector<LandmarkFactor<G>>& known = before_->landmarks;
    std::size_t end = first;
    while (end < known.size() && known[end].point == known[first].point) ++end;
    return end;
  }

  // Classes that the problem before had, with the same members.
  void find_known_classes() {
    known_class_.assign(selection_.classes.size(), none);
    if (before_ == nullptr) return;
    const std::vector<LandmarkFactor<G>>& known = before_->landmarks;
    std::size_t first = 0;
    for (std::size_t c = 0; c < known_class_.size(); ++c) {
      const std::span<const Key> members = selection_.classes[c];
      while (first < known.size() && known[first].landmark < members.front()) first = end_of_known_class(first);
      if (first == known.size() || known[first].landmark != members.front()) continue;
      const std::size_t end = end_of_known_class(first);
      if (std::ranges::equal(members, std::span(known).subspan(first, end - first), {}, {},
                             &LandmarkFactor<G>::landmark))
        known_class_[c] = first;
      first = end;
    }
  }

  using WantedAnchors = std::map<ChainId, std::vector<std::uint32_t>>;  // indices, by chain

  WantedAnchors wanted_anchors() const {
    WantedAnchors wanted;
    for (const auto& [id, chain] : store_.chains())
      if (!chain.anchors.empty() || !chain.priors.empty()) wanted[id] = {0};
    auto chain = wanted.begin();
    const auto want = [&](const Key& anchor) {
      if (chain == wanted.end() || chain->first != anchor.chain)
        chain = wanted.try_emplace(anchor.chain, std::vector{0U}).first;
      chain->second.push_back(anchor.index);
    };
    std::vector<bool> known(before_ == nullptr ? 0 : before_->nodes.size(), false);
    for (std::size_t c = 0; c < known_class_.size(); ++c) {
      if (known_class_[c] == none)
        for (std::size_t l = selection_.classes.begin_of(c); l < selection_.classes.end_of(c); ++l)
          want(selection_.landmarks[l]->anchor_key());
      else
        for (std::size_t l = known_class_[c]; l < end_of_known_class(known_class_[c]); ++l)
          known[static_cast<std::size_t>(before_->landmarks[l].node)] = true;
    }
    for (std::size_t n = 0; n < known.size(); ++n)
      if (known[n]) want(before_->nodes[n].anchor);
    return wanted;
  }

  void add_nodes() {
    WantedAnchors wanted = wanted_anchors();
    if (!options_.plain) find_facts_on_the_way();
    WaypointsByAnchor waypoints = waypoints_by_anchor();
    for (const auto& [anchor, list] : waypoints)
      wanted.try_emplace(anchor.chain, std::vector{0U}).first->second.push_back(anchor.index);
    node_now_.assign(before_ == nullptr ? 0 : before_->nodes.size(), -1);
    for (auto& [id, indices] : wanted) {
      std::sort(indices.begin(), indices.end());
      indices.erase(std::unique(indices.begin(), indices.end()), indices.end());
      ChainSpan span{id, static_cast<int>(problem_.nodes.size()), 0, false};
      std::vector<std::pair<std::uint32_t, int>>& nodes = node_of_[id];
      for (const std::uint32_t index : indices) {
        const Key key{id, index};
        nodes.emplace_back(index, static_cast<int>(problem_.nodes.size()));
        add_anchor_node(key);
        if (const auto found = waypoints.find(key); found != waypoints.end()) add_waypoint_nodes(found->second);
      }
      span.end = static_cast<int>(problem_.nodes.size());
      if (const PriorFact<G>* prior = store_.prior(id); prior != nullptr && !options_.plain)
        span.persistent = prior->persistent;
      problem_.chains.push_back(span);
    }
  }

  // Anchors come in order. The start of a chain may have stood in for its anchor until that came.
  void add_anchor_node(const Key& key) {
    while (next_known_ < node_now_.size() && before_->nodes[next_known_].anchor < key) ++next_known_;
    const bool known = next_known_ < node_now_.size() && before_->nodes[next_known_].anchor == key;
    if (known) node_now_[next_known_] = static_cast<int>(problem_.nodes.size());
    if (known && key.index != 0) {
      node_before_.push_back(static_cast<int>(next_known_));
      problem_.nodes.push_back(before_->nodes[next_known_]);
      return;
    }
    const AnchorFact<G>* anchor = store_.anchor(key);
    node_before_.push_back(-1);
    problem_.nodes.push_back({key, anchor != nullptr ? anchor->state : ChainState<G>{}, G()});  // index 0: origin
  }

  void find_facts_on_the_way() {
    for (const Key& key : selection_.fixes)
      fixes_.push_back({&store_.chains().at(key.chain).absolute_fixes.at(key.index), -1});
    for (const SelectedEncounter& e : selection_.encounters)
      encounters_.push_back({&store_.chains().at(e.encounter.chain).encounters.at(e.encounter.index),
                             &store_.chains().at(e.waypoint.chain).waypoints.at(e.waypoint.index), -1, -1});
  }

  // A place on the way between two anchors that a fact is about.
  struct Waypoint {
    FactKind kind;
    Key key;  // of the fact
    const ChainState<G>* state;
    int* node;  // to be told
  };
  using WaypointsByAnchor = std::map<Key, std::vector<Waypoint>>;

  WaypointsByAnchor waypoints_by_anchor() {
    WaypointsByAnchor all;
    const auto add = [&](FactKind kind, const auto& fact, int& node) {
      all[fact.anchor_key()].push_back({kind, fact.key, &fact.state, &node});
    };
    for (auto& [fix, node] : fixes_) add(FactKind::absolute_fix, *fix, node);
    for (auto& [seen, answer, observer, other] : encounters_) {
      add(FactKind::encounter, *seen, observer);
      add(FactKind::waypoint, *answer, other);
    }
    return all;
  }

  // Behind the node of their anchor, in the order of driving. Each is a place of its own: several that hang on one
  // anchor share the drift since then. Where the vehicle has not moved, neighbours share a node.
  void add_waypoint_nodes(std::vector<Waypoint>& waypoints) {
    std::sort(waypoints.begin(), waypoints.end(), [](const Waypoint& x, const Waypoint& y) {
      return std::tie(x.state->abscissa_m, x.state->stamp_s, x.kind, x.key) <
             std::tie(y.state->abscissa_m, y.state->stamp_s, y.kind, y.key);
    });
    for (const Waypoint& w : waypoints) {
      const ChainState<G>& last = problem_.nodes.back().slam;
      const bool moved = w.state->pose.translation() != last.pose.translation() ||
                         w.state->pose.rotation() != last.pose.rotation() || w.state->drift != last.drift;
      if (moved) {
        problem_.nodes.push_back({problem_.nodes.back().anchor, *w.state, G()});
        node_before_.push_back(-1);
      }
      *w.node = static_cast<int>(problem_.nodes.size()) - 1;
    }
  }

  const G& initial(int node) const { return problem_.nodes[static_cast<std::size_t>(node)].initial; }

  // So wide that it says nothing; it keeps apart from singular what a few fixes leave open.
  static typename G::Covariance flat(double tilt_rad) {
    typename G::Tangent variance = G::Tangent::Constant(tilt_rad * tilt_rad);
    variance.template head<G::Dim>().setConstant(1e10);
    variance[G::Dof - 1] = 100.0;
    return variance.asDiagonal();
  }

  bool is_aligned(int chain) const { return problem_.chains[static_cast<std::size_t>(chain)].aligned; }
  int chain_of(int node) const {
    return chain_number(problem_, problem_.nodes[static_cast<std::size_t>(node)].anchor.chain);
  }

  void add_fixes() {
    if (problem_.datum < 0 && !options_.common_frame_is_enu) return;
    // In space the common frame is taken for level to 0.1 rad: yaw and position are what is looked for.
    if (problem_.datum >= 0) problem_.priors.push_back({problem_.datum, problem_.nodes.back().initial, flat(0.1)});
    for (const auto& [fix, node] : fixes_)
      if (is_aligned(chain_of(node)))
        problem_.fixes.push_back(
            {node, problem_.datum, fix->key, fix->lever, fix->position, floored_point<G>(fix->covariance)});
  }

  void add_encounters() {
    const auto group = [&](int chain) { return placed_.group[static_cast<std::size_t>(chain)]; };
    for (const auto& [seen, answer, observer, other] : encounters_) {
      const int a = chain_of(observer), b = chain_of(other);
      const bool one_frame =
          (is_aligned(a) && is_aligned(b)) || (is_aligned(a) == is_aligned(b) && group(a) == group(b));
      if (one_frame)
        problem_.encounters.push_back(
            {observer, other, seen->key, answer->mark, seen->position, floored_point<G>(seen->covariance)});
    }
  }

  void add_priors() {
    for (int c = 0; c < static_cast<int>(problem_.chains.size()); ++c) {
      const int first = problem_.chains[static_cast<std::size_t>(c)].first;
      if (const PriorFact<G>* prior = known_prior(store_, problem_.chains[static_cast<std::size_t>(c)].chain))
        problem_.priors.push_back({first, prior->mean, floored<G>(prior->covariance)});
      else if (std::ranges::find(placed_.gauges, c) != placed_.gauges.end())
        problem_.priors.push_back({first, initial(first), floored<G>(gauge_covariance(c))});
      else if (std::ranges::find(placed_.floating, c) != placed_.floating.end())
        problem_.priors.push_back({first, initial(first), flat(10.0)});
    }
  }

  // Where a chain knows what is up, the frame is level, and the chain may begin with a tilt.
  typename G::Covariance gauge_covariance(int chain) const {
    typename G::Covariance P = G::Covariance::Zero();
    if constexpr (G::Dim == 3) {
      const PersistentDrift& p = problem_.chains[static_cast<std::size_t>(chain)].persistent;
      if (p.tilt_rad > 0.0)
        P.template bottomRightCorner<3, 3>() = Eigen::Matrix3d::Identity() - p.up * p.up.transpose();
    }
    return P;
  }

  void add_drifts() {
    std::vector<const DriftFactor<G>*> known(node_now_.size(), nullptr);  // by the node it leads to
    if (before_ != nullptr)
      for (const DriftFactor<G>& f : before_->drifts) known[static_cast<std::size_t>(f.b)] = &f;
    problem_.drifts.reserve(problem_.nodes.size());
    for (ChainSpan& span : problem_.chains) {
      add_constants(span);
      const bool unchanged = had_the_same_drift(span);
      const auto slam = [&](int n) -> const ChainState<G>& { return problem_.nodes[static_cast<std::size_t>(n)].slam; };
      if (span.persistent.bounded()) add_bounded(span, nullptr, span.first);
      for (int n = span.first + 1; n < span.end; ++n) {
        const int m = node_before_[static_cast<std::size_t>(n)], m_from = node_before_[static_cast<std::size_t>(n - 1)];
        const bool is_known = unchanged && m_from >= 0 && m == m_from + 1;
        problem_.drifts.push_back(is_known ? *known[static_cast<std::size_t>(m)]
                                           : drift_between(slam(n - 1), slam(n), span));
        DriftFactor<G>& f = problem_.drifts.back();
        f.a = n - 1;
        f.b = n;
        f.constants = span.constants;
        if (span.persistent.bounded()) add_bounded(span, &slam(n - 1), n);
      }
    }
  }

  bool had_the_same_drift(const ChainSpan& span) const {
    if (before_ == nullptr) return false;
    const auto old = std::ranges::lower_bound(before_->chains, span.chain, {}, &ChainSpan::chain);
    return old != before_->chains.end() && old->chain == span.chain && old->persistent == span.persistent;
  }

  void add_bounded(const ChainSpan& span, const ChainState<G>* before, int node) {
    BoundedFactor f = bounded_between(before, problem_.nodes[static_cast<std::size_t>(node)].slam, span);
    f.a = before == nullptr ? -1 : node - 1;
    f.b = node;
    problem_.bounded.push_back(f);
  }

  void add_constants(ChainSpan& span) {
    const PersistentDrift& p = span.persistent;
    if (!p.bounded() && !p.constant()) return;
    span.constants = static_cast<int>(problem_.constants.size());
    ConstantsFactor<G> f;
    constexpr double floor = 1e-9;  // exact is not singular
    f.mean.setZero();
    f.sigma.setOnes();
    f.sigma.template head<2>() << std::max(floor, p.scale), std::max(floor, p.heading_rad_per_m);
    if constexpr (G::Dim == 3) {
      if (p.height_m > 0.0) {
        f.mean[2] = initial(span.first).translation().z();
        f.sigma[2] = 1e5;  // whatever it is
      }
    }
    problem_.constants.push_back(f);
  }

  void add_landmarks() {
    const std::size_t members = selection_.classes.members().size();
    problem_.landmarks.reserve(members);
    problem_.loadings.reserve(members);
    problem_.points.reserve(selection_.classes.size());
    scale_of_landmarks_.assign(problem_.nodes.size(), -1);
    for (const ChainSpan& span : problem_.chains)
      if (span.persistent.scales_landmarks)
        std::fill_n(scale_of_landmarks_.begin() + span.first, span.end - span.first, span.constants);
    const bool start_as_before = known_nodes_start_as_before();
    for (std::size_t c = 0; c < selection_.classes.size(); ++c) {
      const std::size_t first = problem_.landmarks.size();
      if (known_class_[c] == none) add_class(c);
      else add_known_class(known_class_[c]);
      if (known_class_[c] != none && start_as_before)
        problem_.points.push_back(before_->points[static_cast<std::size_t>(before_->landmarks[known_class_[c]].point)]);
      else problem_.points.push_back(mean_of_members(first));
    }
  }

  void add_class(std::size_t c) {
    for (std::size_t l = selection_.classes.begin_of(c); l < selection_.classes.end_of(c); ++l) {
      const LandmarkFact<G>& landmark = *selection_.landmarks[l];
      add_landmark(
          {node_of(landmark.anchor_key()), 0, landmark.key, landmark.position, floored_point<G>(landmark.covariance)},
          landmark.loading.isZero(0.0) ? nullptr : &landmark.loading);
    }
  }

  void add_known_class(std::size_t first) {
    for (std::size_t l = first; l < end_of_known_class(first); ++l) {
      LandmarkFactor<G> f = before_->landmarks[l];
      f.node = node_now_[static_cast<std::size_t>(f.node)];
      add_landmark(f, f.loading < 0 ? nullptr : &before_->loadings[static_cast<std::size_t>(f.loading)]);
    }
  }

  // Of the point that is next.
  void add_landmark(LandmarkFactor<G> f, const typename G::Loading* loading) {
    f.point = static_cast<int>(problem_.points.size());
    f.loading = loading == nullptr ? -1 : static_cast<int>(problem_.loadings.size());
    f.constants = scale_of_landmarks_[static_cast<std::size_t>(f.node)];
    problem_.landmarks.push_back(f);
    if (loading != nullptr) problem_.loadings.push_back(*loading);
  }

  typename G::Point mean_of_members(std::size_t first) const {
    typename G::Point sum = G::Point::Zero();
    for (std::size_t l = first; l < problem_.landmarks.size(); ++l)
      sum += initial(problem_.landmarks[l].node) * problem_.landmarks[l].position;
    return sum / static_cast<double>(problem_.landmarks.size() - first);
  }

  bool known_nodes_start_as_before() const {
    for (std::size_t m = 0; m < node_now_.size(); ++m) {
      if (node_now_[m] < 0) continue;
      const G &then = before_->nodes[m].initial, &now = initial(node_now_[m]);
      if (then.translation() != now.translation() || then.rotation() != now.rotation()) return false;
    }
    return true;
  }

  int node_of(const Key& anchor) const {
    const auto& nodes = node_of_.at(anchor.chain);
    return std::lower_bound(nodes.begin(), nodes.end(), std::pair(anchor.index, 0))->second;
  }

  const FactStore<G>& store_;
  const Selection<G>& selection_;
  const Problem<G>* before_;  // null: none is known
  const ProblemOptions& options_;
  Problem<G> problem_;
  std::vector<std::size_t> known_class_;  // of each class, the first of its factors in before_; none: it is new
  std::vector<int> node_before_;          // of each node, its number in before_, if it is an anchor that was there
  std::vector<int> node_now_;             // the other way round
  std::size_t next_known_ = 0;            // of the nodes of before_
  std::map<ChainId, std::vector<std::pair<std::uint32_t, int>>> node_of_;  // of anchors, by their index
  std::vector<int> scale_of_landmarks_;  // of each node, whose constants its landmarks scale with; -1: nobody's
  std::vector<FixAtNode<G>> fixes_;
  std::vector<EncounterAtNodes<G>> encounters_;
  PlacedChains placed_;
};

// What the drift of a chain says of bounded components is not used.
template <class G>
typename G::Covariance opened(typename G::Covariance Q, const G& motion, const G& pose, const PersistentDrift& p) {
  if constexpr (G::Dim == 3) {
    constexpr double any_m = 100.0, any_rad = 1.0;
    const Eigen::Vector3d up = pose.rotation().transpose() * p.up;
    const Eigen::Matrix3d along = up * up.transpose();
    // A tilt that is wrong for a moment moves the end of the next piece of the way up or down, as seen from its start.
    double height_m = p.height_m > 0.0 ? any_m : 0.0;
    if (p.tilt_rad > 0.0) {
      height_m += p.tilt_rad * motion.translation().norm();
      Q.template bottomRightCorner<3, 3>() += any_rad * any_rad * (Eigen::Matrix3d::Identity() - along);
    }
    Q.template topLeftCorner<3, 3>() += height_m * height_m * along;
  }
  return Q;
}

}  // namespace

template <class G>
State<G> start_of(const Problem<G>& problem) {
  State<G> state;
  for (const Node<G>& node : problem.nodes) state.poses.push_back(node.initial);
  state.points = problem.points;
  for (const ConstantsFactor<G>& f : problem.constants) state.constants.push_back(f.mean);
  return state;
}

template <class G>
std::vector<int> unknown_sizes(const Problem<G>& problem) {
  std::vector<int> sizes(problem.nodes.size(), G::Dof);
  sizes.resize(sizes.size() + problem.points.size(), G::Dim);
  sizes.resize(sizes.size() + problem.constants.size(), Constants<G>::RowsAtCompileTime);
  return sizes;
}

template <class G>
DriftFactor<G> drift_between(const ChainState<G>& a, const ChainState<G>& b, const ChainSpan& span) {
  const Increment<G> step = increment(a, b);
  DriftFactor<G> f{0, 0, step.motion, step.covariance, span.constants};
  if (span.persistent.bounded()) f.covariance = opened(f.covariance, step.motion, b.pose, span.persistent);
  f.covariance = invertible(f.covariance);
  f.A.template leftCols<2>() = step.constants;
  return f;
}

template <class G>
BoundedFactor bounded_between(const ChainState<G>* a, const ChainState<G>& b, const ChainSpan& span) {
  BoundedFactor f;
  if constexpr (G::Dim == 3) {
    const PersistentDrift& p = span.persistent;
    const auto up = [&](const ChainState<G>& s) -> Eigen::Vector3d { return s.pose.rotation().transpose() * p.up; };
    f.constants = span.constants;
    f.up_b = up(b);
    f.height_b = p.up.dot(b.pose.translation());
    double fresh = 1.0;  // variance, in units of sigma^2
    if (a != nullptr) {
      f.up_a = up(*a);
      f.height_a = p.up.dot(a->pose.translation());
      const double ds = std::max(0.0, b.abscissa_m - a->abscissa_m) / p.correlation_m;
      f.phi = std::exp(-ds);
      fresh = std::max(1e-9, -std::expm1(-2.0 * ds));  // 1 - phi^2
    }
    const auto information = [&](double sigma) {
      constexpr double floor = 1e-5;  // exact is not singular
      return sigma > 0.0 ? 1.0 / (fresh * std::max(floor, sigma) * std::max(floor, sigma)) : 0.0;
    };
    f.information << information(p.tilt_rad), information(p.tilt_rad), information(p.height_m);
  }
  return f;
}

template <class G>
Problem<G> build_problem(const FactStore<G>& store, const Selection<G>& selection, const ProblemOptions& options,
                         const Problem<G>* before) {
  return ProblemBuilder<G>(store, selection, options, before).build();
}

#define CONVOY_INSTANTIATE(G)                                                                           \
  template State<G> start_of(const Problem<G>&);                                                        \
  template std::vector<int> unknown_sizes(const Problem<G>&);                                           \
  template DriftFactor<G> drift_between(const ChainState<G>&, const ChainState<G>&, const ChainSpan&);  \
  template BoundedFactor bounded_between(const ChainState<G>*, const ChainState<G>&, const ChainSpan&); \
  template Problem<G> build_problem(const FactStore<G>&, const Selection<G>&, const ProblemOptions&, const Problem<G>*);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
