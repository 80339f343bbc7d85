#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/placement.hpp>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <utility>

namespace convoy {
namespace {

template <class G>
class Placer {
 public:
  Placer(const FactStore<G>& store, const Selection<G>& selection, const ProblemOptions& options,
         const std::vector<FixAtNode<G>>& fixes, const std::vector<EncounterAtNodes<G>>& encounters,
         Problem<G>& problem)
      : store_(store),
        selection_(selection),
        fixes_(fixes),
        encounters_(encounters),
        reference_(options.reference),
        enu_(options.common_frame_is_enu),
        plain_(options.plain),
        problem_(problem) {}

  PlacedChains place() {
    connect_chains();
    place_chains();
    if (!plain_) place_by_fixes();
    if (!plain_) place_by_encounters();
    return std::move(placed_);
  }

 private:
  const ChainId& chain_id(int chain) const { return problem_.chains[static_cast<std::size_t>(chain)].chain; }
  const PriorFact<G>* prior_of(int chain) const { return known_prior(store_, chain_id(chain)); }
  int group(int chain) const { return placed_.group[static_cast<std::size_t>(chain)]; }
  int chain_of(int node) const {
    return chain_number(problem_, problem_.nodes[static_cast<std::size_t>(node)].anchor.chain);
  }
  const G& initial(int node) const { return problem_.nodes[static_cast<std::size_t>(node)].initial; }

  // An accepted hypothesis between two chains.
  struct Link {
    const Hypothesis<G>* hypothesis;
    int a, b;
  };

  void connect_chains() {
    links_of_.resize(problem_.chains.size());
    std::vector<int>& group = placed_.group;
    group.resize(problem_.chains.size());
    std::iota(group.begin(), group.end(), 0);
    const auto root = [&](int chain) {
      while (group[static_cast<std::size_t>(chain)] != chain) chain = group[static_cast<std::size_t>(chain)];
      return chain;
    };
    for (const Hypothesis<G>& h : selection_.hypotheses) {
      if (h.state != HypothesisState::accepted || h.batch_a.chain == h.batch_b.chain) continue;
      const Link link{&h, chain_number(problem_, h.batch_a.chain), chain_number(problem_, h.batch_b.chain)};
      for (const int chain : {link.a, link.b})
        links_of_[static_cast<std::size_t>(chain)].push_back(static_cast<int>(links_.size()));
      links_.push_back(link);
      const int a = root(link.a), b = root(link.b);
      group[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
    }
    for (int& chain : group) chain = root(chain);
  }

  // The chain a group is placed from: the one whose static bias is known best, else the reference, else the smallest.
  int root_of(const std::vector<int>& members) const {
    int best = members.front();
    for (const int chain : members)
      if (chain_id(chain).vehicle == reference_ && chain_id(best).vehicle != reference_) best = chain;
    const auto trace = [&](int chain) {
      const PriorFact<G>* prior = prior_of(chain);
      return prior != nullptr ? prior->covariance.trace() : std::numeric_limits<double>::infinity();
    };
    for (const int chain : members)
      if (trace(chain) < trace(best)) best = chain;
    return best;
  }

  void place_chains() {
    base_.resize(problem_.chains.size());
    std::map<int, std::vector<int>> groups;
    for (int chain = 0; chain < static_cast<int>(problem_.chains.size()); ++chain)
      groups[group(chain)].push_back(chain);
    int common = -1;
    bool any_prior = false;
    const auto size = [&](int root) { return groups.at(root).size(); };
    for (const auto& [root, members] : groups) {
      const bool refers = reference_ == 0 || std::any_of(members.begin(), members.end(), [&](int chain) {
                            return chain_id(chain).vehicle == reference_;
                          });
      if (refers && (common < 0 || size(root) > size(common))) common = root;
      for (const int chain : members) any_prior = any_prior || prior_of(chain) != nullptr;
    }
    for (const auto& [root, members] : groups) {
      const int first = root_of(members);
      const PriorFact<G>* prior = prior_of(first);
      place_group(members, first, prior != nullptr ? prior->mean : levelled(first));
      if (prior == nullptr) placed_.gauges.push_back(first);
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
    for (const auto& [fix, node] : fixes_) {
      const Sight sight{initial(node) * fix->lever, fix->position, std::sqrt(fix->covariance.diagonal().maxCoeff())};
      const int chain = chain_of(node);
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
    if (enu_ || fixes_.empty()) return;
    problem_.datum = static_cast<int>(problem_.nodes.size());
    const Key last{{std::numeric_limits<VehicleId>::max(), std::numeric_limits<Epoch>::max()},
                   std::numeric_limits<std::uint32_t>::max()};
    problem_.nodes.push_back({last, {}, T_enu_common});
  }

  // Into the common frame, from one of its own: its gauge is no longer wanted.
  void move_chain(int chain, const G& T_common_here) {
    problem_.chains[static_cast<std::size_t>(chain)].aligned = true;
    problem_.chains[static_cast<std::size_t>(chain)].placed_from = {};
    if (std::erase(placed_.gauges, chain) > 0) placed_.floating.push_back(chain);
    each_node(chain, [&](Node<G>& node) { node.initial = T_common_here * node.initial; });
  }

  // What two chains say of the same point: the one in an aligned chain is "there".
  struct Meeting {
    Sight sight;
    int observer, other;  // nodes
  };

  // [group to be placed, what its encounter says]
  std::optional<std::pair<int, Meeting>> meeting_of(const EncounterAtNodes<G>& e) const {
    const int observer = chain_of(e.observer), other = chain_of(e.other);
    if (is_aligned(observer) == is_aligned(other)) return std::nullopt;
    const typename G::Point by_observer = initial(e.observer) * e.seen->position,
                            by_other = initial(e.other) * e.answer->mark;
    const double sigma_m = std::sqrt(e.seen->covariance.diagonal().maxCoeff());
    if (is_aligned(observer))
      return std::pair{group(other), Meeting{{by_other, by_observer, sigma_m}, e.observer, e.other}};
    return std::pair{group(observer), Meeting{{by_observer, by_other, sigma_m}, e.observer, e.other}};
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
      for (const EncounterAtNodes<G>& e : encounters_)
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
      if (group(chain) == root && prior_of(chain) != nullptr) return true;
    return false;
  }

  const FactStore<G>& store_;
  const Selection<G>& selection_;
  const std::vector<FixAtNode<G>>& fixes_;
  const std::vector<EncounterAtNodes<G>>& encounters_;
  VehicleId reference_;
  bool enu_, plain_;
  Problem<G>& problem_;
  PlacedChains placed_;
  std::vector<Link> links_;                 // in the order of the selection
  std::vector<std::vector<int>> links_of_;  // each chain
  std::vector<G> base_;                     // T_common_slam of each chain to start from
};

}  // namespace

template <class G>
PlacedChains place(const FactStore<G>& store, const Selection<G>& selection, const ProblemOptions& options,
                   const std::vector<FixAtNode<G>>& fixes, const std::vector<EncounterAtNodes<G>>& encounters,
                   Problem<G>& problem) {
  return Placer<G>(store, selection, options, fixes, encounters, problem).place();
}

#define CONVOY_INSTANTIATE(G)                                                                  \
  template PlacedChains place(const FactStore<G>&, const Selection<G>&, const ProblemOptions&, \
                              const std::vector<FixAtNode<G>>&, const std::vector<EncounterAtNodes<G>>&, Problem<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
