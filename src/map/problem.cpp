#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/problem.hpp>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
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
  return P;
}

// The same for points, (1 mm)^2. Below variances of 1000 m^2 what rounding left is less than that.
template <class G>
typename G::PointCovariance floored_point(const typename G::PointCovariance& P) {
  const typename G::PointCovariance floor = 1e-6 * G::PointCovariance::Identity();
  return (P.cwiseAbs().maxCoeff() < 500.0 ? P : positive_part(P)) + floor;
}

template <class G>
class ProblemBuilder {
 public:
  ProblemBuilder(const FactStore<G>& store, const Selection<G>& selection, const ProblemOptions& options,
                 const Problem<G>* before)
      : store_(store),
        selection_(selection),
        before_(before),
        reference_(options.reference),
        enu_(options.common_frame_is_enu),
        plain_(options.plain) {}

  Problem<G> build() {
    find_known_classes();
    add_nodes();
    connect_chains();
    place_chains();
    if (!plain_) place_by_fixes();
    if (!plain_) place_by_encounters();
    add_priors();
    add_drifts();
    add_landmarks();
    if (!plain_) add_fixes();
    if (!plain_) add_encounters();
    return std::move(problem_);
  }

 private:
  const ChainId& chain_id(int chain) const { return problem_.chains[static_cast<std::size_t>(chain)].chain; }
  const PriorFact<G>* known_prior(int chain) const {
    const PriorFact<G>* prior = store_.prior(chain_id(chain));
    return prior != nullptr && prior->known ? prior : nullptr;
  }

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
    WaypointsByAnchor waypoints;
    if (!plain_) waypoints = waypoints_of_selection();
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
      if (const PriorFact<G>* prior = store_.prior(id); prior != nullptr && !plain_)
        span.persistent = prior->persistent;
      chain_of_[id] = static_cast<int>(problem_.chains.size());
      problem_.chains.push_back(span);
    }
    parent_.resize(problem_.chains.size());
    for (std::size_t i = 0; i < parent_.size(); ++i) parent_[i] = static_cast<int>(i);
    base_.resize(problem_.chains.size());
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

  // A place on the way between two anchors that a fact is about.
  struct Waypoint {
    FactKind kind;
    Key key;  // of the fact
    const ChainState<G>* state;
  };
  using WaypointsByAnchor = std::map<Key, std::vector<Waypoint>>;

  WaypointsByAnchor waypoints_of_selection() const {
    WaypointsByAnchor all;
    const auto add = [&](FactKind kind, const auto& fact) {
      all[fact.anchor_key()].push_back({kind, fact.key, &fact.state});
    };
    for (const Key& key : selection_.fixes) add(FactKind::absolute_fix, fix(key));
    for (const SelectedEncounter& e : selection_.encounters) {
      add(FactKind::encounter, encounter(e));
      add(FactKind::waypoint, waypoint(e));
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
      waypoint_node_[{w.kind, w.key}] = static_cast<int>(problem_.nodes.size()) - 1;
    }
  }

  const AbsoluteFixFact<G>& fix(const Key& key) const {
    return store_.chains().at(key.chain).absolute_fixes.at(key.index);
  }
  const EncounterFact<G>& encounter(const SelectedEncounter& e) const {
    return store_.chains().at(e.encounter.chain).encounters.at(e.encounter.index);
  }
  const WaypointFact<G>& waypoint(const SelectedEncounter& e) const {
    return store_.chains().at(e.waypoint.chain).waypoints.at(e.waypoint.index);
  }
  int node_of_waypoint(FactKind kind, const Key& key) const { return waypoint_node_.at({kind, key}); }
  const G& initial(int node) const { return problem_.nodes[static_cast<std::size_t>(node)].initial; }

  int group(int chain) const {
    while (parent_[static_cast<std::size_t>(chain)] != chain) chain = parent_[static_cast<std::size_t>(chain)];
    return chain;
  }

  // An accepted hypothesis between two chains.
  struct Link {
    const Hypothesis<G>* hypothesis;
    int a, b;
  };

  void connect_chains() {
    links_of_.resize(problem_.chains.size());
    for (const Hypothesis<G>& h : selection_.hypotheses) {
      if (h.state != HypothesisState::accepted || h.batch_a.chain == h.batch_b.chain) continue;
      const Link link{&h, chain_of_.at(h.batch_a.chain), chain_of_.at(h.batch_b.chain)};
      for (const int chain : {link.a, link.b})
        links_of_[static_cast<std::size_t>(chain)].push_back(static_cast<int>(links_.size()));
      links_.push_back(link);
      const int a = group(link.a), b = group(link.b);
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
      place_group(members, first, prior != nullptr ? prior->mean : levelled(first));
      if (prior == nullptr) gauges_.push_back(first);
      const bool aligned = any_prior ? prior != nullptr : root == common;
      for (const int chain : members) {
        problem_.chains[static_cast<std::size_t>(chain)].aligned = aligned;
        problem_.chains[static_cast<std::size_t>(chain)].placed_from = chain_id(first);
      }
    }
  }

  // A frame to start in: that of the chain, turned so that what it says is up is up.
  G levelled(int chain) const {
    if constexpr (G::Dim == 3) {
      const PersistentDrift& p = problem_.chains[static_cast<std::size_t>(chain)].persistent;
      if (p.bounded())
        return G::from_rotation(Eigen::Quaterniond::FromTwoVectors(p.up, Eigen::Vector3d::UnitZ()).toRotationMatrix(),
                                Eigen::Vector3d::Zero());
    }
    return G();
  }

  // Along the accepted hypotheses in their canonical order: of those with one end placed, the strongest is next.
  void place_group(const std::vector<int>& members, int first, const G& base) {
    std::set<int> placed;
    std::set<int> ready;  // links of what is placed
    const auto place = [&](int chain, const G& at) {
      base_[static_cast<std::size_t>(chain)] = at;
      placed.insert(chain);
      const std::vector<int>& links = links_of_[static_cast<std::size_t>(chain)];
      ready.insert(links.begin(), links.end());
    };
    place(first, base);
    while (placed.size() < members.size()) {
      const auto& [h, a, b] = links_[static_cast<std::size_t>(ready.extract(ready.begin()).value())];
      if (placed.count(a) == placed.count(b)) continue;
      const G Xa = store_.anchor(h->batch_a)->state.pose, Xb = store_.anchor(h->batch_b)->state.pose;
      const G& z = h->alignment.T_a_b;
      if (placed.count(a)) place(b, base_[static_cast<std::size_t>(a)] * Xa * z * Xb.inverse());
      else place(a, base_[static_cast<std::size_t>(b)] * Xb * z.inverse() * Xa.inverse());
      problem_.placed_by.insert(h->id);
    }
    for (const int chain : members)
      each_node(chain, [&](Node<G>& node) { node.initial = base_[static_cast<std::size_t>(chain)] * node.slam.pose; });
  }

  template <class Change>
  void each_node(int chain, const Change& change) {
    const ChainSpan& span = problem_.chains[static_cast<std::size_t>(chain)];
    for (int n = span.first; n < span.end; ++n) change(problem_.nodes[static_cast<std::size_t>(n)]);
  }

  typename G::Point placed_antenna(const AbsoluteFixFact<G>& f) const {
    return initial(node_of_waypoint(FactKind::absolute_fix, f.key)) * f.lever;
  }

  struct Sight {
    typename G::Point here, there;  // the same point in both frames
    double sigma_m;
  };

  static G turned_about_z(double yaw_rad) {
    typename G::Tangent d = G::Tangent::Zero();
    d[G::Dof - 1] = yaw_rad;
    return G::Exp(d);
  }

  struct Aligned {
    G T_there_here;
    double median_m;  // of what the points lie apart then
  };

  // T_there_here, yaw and position: of all pairs of fixes far enough apart, the one that suits the others best (least
  // median of squares), so that a gross error does not decide where to start from. Empty if no pair fixes the yaw to
  // 0.3 rad.
  static std::optional<Aligned> align_sights(const std::vector<Sight>& all) {
    constexpr double max_sigma_yaw_rad = 0.3;
    constexpr std::size_t most = 40;
    std::vector<Sight> some;
    const std::size_t stride = std::max<std::size_t>(1, (all.size() + most - 1) / most);
    for (std::size_t i = 0; i < all.size(); i += stride) some.push_back(all[i]);
    std::optional<Aligned> best;
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
        if (!best || *half < best->median_m) best = Aligned{T, *half};
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
    std::optional<Aligned> common = Aligned{G(), 0.0};
    if (!enu_) common = align_sights(sights[-1]);
    if (!common) return;
    const G& T_enu_common = common->T_there_here;
    for (int chain = 0; chain < static_cast<int>(problem_.chains.size()); ++chain) {
      const bool stays = enu_ ? has_prior(group(chain)) : is_aligned(chain);
      const auto own = stays ? std::nullopt : align_sights(sights[group(chain)]);
      ChainSpan& span = problem_.chains[static_cast<std::size_t>(chain)];
      if (enu_) span.aligned = stays || own;
      if (!own) continue;
      move_chain(chain, T_enu_common.inverse() * own->T_there_here);
    }
    if (enu_ || selection_.fixes.empty()) return;
    problem_.datum = static_cast<int>(problem_.nodes.size());
    const Key last{{std::numeric_limits<VehicleId>::max(), std::numeric_limits<Epoch>::max()},
                   std::numeric_limits<std::uint32_t>::max()};
    problem_.nodes.push_back({last, {}, T_enu_common});
  }

  // Into the common frame, from one of its own: its gauge is no longer wanted.
  void move_chain(int chain, const G& T_common_here) {
    problem_.chains[static_cast<std::size_t>(chain)].aligned = true;
    problem_.chains[static_cast<std::size_t>(chain)].placed_from = {};
    if (std::erase(gauges_, chain) > 0) floating_.push_back(chain);
    each_node(chain, [&](Node<G>& node) { node.initial = T_common_here * node.initial; });
  }

  // What two chains say of the same point: the one in an aligned chain is "there".
  struct Meeting {
    Sight sight;
    int observer, other;  // nodes
  };

  std::optional<std::pair<int, Meeting>> meeting_of(const SelectedEncounter& e) const {
    const int observer = chain_of_.at(e.encounter.chain), other = chain_of_.at(e.waypoint.chain);
    if (is_aligned(observer) == is_aligned(other)) return std::nullopt;
    const EncounterFact<G>& seen = encounter(e);
    const int node_o = node_of_waypoint(FactKind::encounter, e.encounter),
              node_w = node_of_waypoint(FactKind::waypoint, e.waypoint);
    const typename G::Point by_observer = initial(node_o) * seen.position,
                            by_other = initial(node_w) * waypoint(e).mark;
    const double sigma_m = std::sqrt(seen.covariance.diagonal().maxCoeff());
    if (is_aligned(observer)) return std::pair{group(other), Meeting{{by_other, by_observer, sigma_m}, node_o, node_w}};
    return std::pair{group(observer), Meeting{{by_observer, by_other, sigma_m}, node_o, node_w}};
  }

  // Variance of a position at the last of some nodes of a chain, seen from the first: the way may have bent so far.
  // [m^2]
  double bend(std::vector<int> nodes) const {
    const auto [first, last] = std::minmax_element(nodes.begin(), nodes.end());
    const auto Q = increment(problem_.nodes[static_cast<std::size_t>(*first)].slam,
                             problem_.nodes[static_cast<std::size_t>(*last)].slam);
    return Q.covariance.template topLeftCorner<G::Dim, G::Dim>().trace();
  }

  // An alignment that at least half of the meetings agree with, as far as drift lets them.
  std::optional<Aligned> align_meetings(const std::vector<Meeting>& meetings) const {
    constexpr std::size_t fewest = 3;  // any two points fit any two others
    if (meetings.size() < fewest) return std::nullopt;
    std::vector<Sight> sights;
    std::vector<double> variances;
    std::map<ChainId, std::vector<int>> nodes;
    for (const Meeting& m : meetings) {
      sights.push_back(m.sight);
      variances.push_back(m.sight.sigma_m * m.sight.sigma_m);
      for (const int n : {m.observer, m.other})
        nodes[problem_.nodes[static_cast<std::size_t>(n)].anchor.chain].push_back(n);
    }
    const auto half = variances.begin() + static_cast<std::ptrdiff_t>(variances.size() / 2);
    std::nth_element(variances.begin(), half, variances.end());
    double variance = *half;
    for (const auto& [chain, list] : nodes) variance += bend(list);
    const auto aligned = align_sights(sights);
    return aligned && aligned->median_m < 3.0 * std::sqrt(variance) ? aligned : std::nullopt;
  }

  // One group after the other, the one with most encounters first: it may bring others within reach. What contradicts
  // the map that comes of it is found there.
  void place_by_encounters() {
    while (true) {
      std::map<int, std::vector<Meeting>> meetings;
      for (const SelectedEncounter& e : selection_.encounters)
        if (const auto meeting = meeting_of(e)) meetings[meeting->first].push_back(meeting->second);
      int best = -1;
      std::optional<Aligned> alignment;
      for (const auto& [root, list] : meetings) {
        if (best >= 0 && list.size() <= meetings.at(best).size()) continue;
        const auto aligned = align_meetings(list);
        if (!aligned) continue;
        best = root;
        alignment = aligned;
      }
      if (best < 0) return;
      for (int chain = 0; chain < static_cast<int>(problem_.chains.size()); ++chain)
        if (group(chain) == best && !is_aligned(chain)) move_chain(chain, alignment->T_there_here);
    }
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
    for (const Key& key : selection_.fixes) {
      if (!is_aligned(chain_of_.at(key.chain))) continue;
      const AbsoluteFixFact<G>& f = fix(key);
      problem_.fixes.push_back({node_of_waypoint(FactKind::absolute_fix, key), problem_.datum, key, f.lever, f.position,
                                floored_point<G>(f.covariance)});
    }
  }

  void add_encounters() {
    for (const SelectedEncounter& e : selection_.encounters) {
      const int a = chain_of_.at(e.encounter.chain), b = chain_of_.at(e.waypoint.chain);
      const bool one_frame =
          (is_aligned(a) && is_aligned(b)) || (is_aligned(a) == is_aligned(b) && group(a) == group(b));
      if (!one_frame) continue;
      const EncounterFact<G>& f = encounter(e);
      problem_.encounters.push_back({node_of_waypoint(FactKind::encounter, e.encounter),
                                     node_of_waypoint(FactKind::waypoint, e.waypoint), e.encounter, waypoint(e).mark,
                                     f.position, floored_point<G>(f.covariance)});
    }
  }

  void add_priors() {
    for (int c = 0; c < static_cast<int>(problem_.chains.size()); ++c) {
      const int first = problem_.chains[static_cast<std::size_t>(c)].first;
      if (const PriorFact<G>* prior = known_prior(c))
        problem_.priors.push_back({first, prior->mean, floored<G>(prior->covariance)});
      else if (std::find(gauges_.begin(), gauges_.end(), c) != gauges_.end())
        problem_.priors.push_back({first, initial(first), floored<G>(gauge_covariance(c))});
      else if (std::find(floating_.begin(), floating_.end(), c) != floating_.end())
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
  VehicleId reference_;
  bool enu_, plain_;
  Problem<G> problem_;
  std::vector<std::size_t> known_class_;    // of each class, the first of its factors in before_; none: it is new
  std::vector<int> node_before_;            // of each node, its number in before_, if it is an anchor that was there
  std::vector<int> node_now_;               // the other way round
  std::size_t next_known_ = 0;              // of the nodes of before_
  std::vector<Link> links_;                 // in the order of the selection
  std::vector<std::vector<int>> links_of_;  // each chain
  std::map<ChainId, std::vector<std::pair<std::uint32_t, int>>> node_of_;  // of anchors, by their index
  std::map<std::pair<FactKind, Key>, int> waypoint_node_;  // of absolute fixes, encounters and waypoints
  std::map<ChainId, int> chain_of_;
  std::vector<int> parent_;
  std::vector<G> base_;        // T_common_slam of each chain to start from
  std::vector<int> floating_;  // chains whose group is held by absolute fixes alone
  std::vector<int> gauges_;    // chains fixed at the identity for want of a static bias
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
    const auto information = [&](double sigma) { return sigma > 0.0 ? 1.0 / (fresh * sigma * sigma) : 0.0; };
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
