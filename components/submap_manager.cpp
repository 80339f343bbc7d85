#include <convoy/components/submap_manager.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/map/ekf_map.hpp>
#include <convoy/map/live_pose.hpp>
#include <convoy/map/sparse_map.hpp>
#include <convoy/submap/rounding.hpp>

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>

namespace convoy {
namespace {

constexpr std::size_t max_rivals = 8;

constexpr std::ptrdiff_t max_epochs_heard = 8;
constexpr double remembered_s = 60.0;  // that somebody spoke in this vehicle's name

template <class G>
std::shared_ptr<const Backend<G>> make_backend(MapBackend backend) {
  if (backend == MapBackend::ekf) return std::make_shared<EkfMap<G>>();
  return std::make_shared<SparseMap<G>>();
}

template <class G>
void validate(const ChainId& self, const SubmapManagerParams& p) {
  if (self.vehicle == 0) throw ConfigError("submap manager: vehicle id 0 means 'nobody'; use 1 or more");
  if (!(p.map_period_s > 0.0 && p.stale_peer_s > 0.0)) throw ConfigError("submap manager: periods must be > 0");
  if (!(p.exact_share >= 0.0)) throw ConfigError("submap manager: exact_share must be >= 0");
  if (!(p.rival_s > 0.0)) throw ConfigError("submap manager: rival_s must be > 0");
  if (p.facts_per_step < 1) throw ConfigError("submap manager: facts_per_step must be >= 1");
  if (!(p.encounter_period_s >= 0.0)) throw ConfigError("submap manager: encounter_period_s must be >= 0");
  const auto& roster = p.limits.roster;
  if (!roster.empty() && std::find(roster.begin(), roster.end(), self.vehicle) == roster.end())
    throw ConfigError("submap manager: vehicle " + std::to_string(self.vehicle) + " is not on its own roster");
}

// To the bit, as the wire has it: R D R^T is symmetric but for rounding. One that was so already stays as it is.
template <class Said>
void symmetrise(Said& said) {
  if constexpr (requires { said.state; }) said.state.drift = symmetrised(said.state.drift);
  if constexpr (requires { said.covariance; }) said.covariance = symmetrised(said.covariance);
  if constexpr (requires { said.shared; }) said.shared = symmetrised(said.shared);
  if constexpr (requires { said.remembered; })
    for (auto& landmark : said.remembered) symmetrise(landmark);
}

/// In facts, about.
template <class G>
std::size_t work_in(const Payload<G>& payload) {
  if (const auto* batch = std::get_if<LandmarkBatch<G>>(&payload)) return 1 + batch->landmarks.size();
  if (const auto* association = std::get_if<AssociationFact>(&payload)) return 1 + association->pairings.size() / 8;
  if (const auto* digest = std::get_if<Digest>(&payload)) return 1 + digest->marks.size();
  return std::holds_alternative<Request>(payload) ? 64 : 1;
}

}  // namespace

template <class G>
SubmapManager<G>::SubmapManager(const ChainId& self, SubmapExchange<G>& exchange, const SubmapManagerParams& params,
                                std::shared_ptr<const Backend<G>> backend)
    : self_(self),
      exchange_(exchange),
      params_(params),
      store_(params.limits),
      repair_(self, params.repair, params.seed + 0x9e3779b97f4a7c15U * self.vehicle),
      guard_(params.peers),
      backend_(backend ? std::move(backend) : make_backend<G>(params.backend)),
      builder_(params_.selection, *backend_) {
  validate<G>(self, params);
  store_.set_own(self);
  adopt({builder_.build(store_), 0, 0.0});
  counters_.maps_built = 0;
}

template <class G>
void SubmapManager<G>::keep_in(Journal<G>& journal) {
  journal.restore(store_);
  if (store_.chains().contains(self_))
    throw ConfigError("submap manager: the journal holds facts of vehicle " + std::to_string(self_.vehicle) +
                      " in epoch " + std::to_string(self_.epoch) +
                      ", which begins only now; take an epoch that was never used, or move the journal away");
  journal_ = &journal;
}

template <class G>
bool SubmapManager<G>::refused() const {
  return std::any_of(rivals_.begin(), rivals_.end(), [&](const Rival& rival) {
    return rival.heard_s >= rival.since_s + params_.rival_s && now_s_ <= rival.heard_s + params_.stale_peer_s;
  });
}

template <class G>
void SubmapManager<G>::send(Payload<G> payload) {
  if (refused()) {
    ++counters_.sends_withheld;
    return;
  }
  if (exchange_.send({self_, std::move(payload)}) != SendStatus::sent) ++counters_.sends_rejected;
}

template <class G>
template <class Fact>
Insertion SubmapManager<G>::insert(const Fact& fact) {
  const Insertion result = store_.insert(fact);
  if (result != Insertion::inserted) return result;
  if (orders_given_) news_.emplace_back(fact);
  if (journal_ != nullptr) journal_->append(fact, now_s_);
  return result;
}

// Judged as it came, then made symmetric; which may cost it what little it was a covariance by.
template <class G>
template <class Fact>
bool SubmapManager<G>::make_fit(Fact& fact) {
  bool fit = store_.check(fact) == Insertion::inserted;
  symmetrise(fact);
  fit = fit && store_.check(fact) == Insertion::inserted;
  counters_.facts_unfit += !fit;
  return fit;
}

template <class G>
template <class Fact>
void SubmapManager<G>::publish(const Fact& fact) {
  counters_.facts_published += insert(fact) == Insertion::inserted;
}

template <class G>
void SubmapManager<G>::open_chain(double stamp_s, const std::optional<Estimate<G>>& static_bias,
                                  const PersistentDrift& persistent) {
  AnchorFact<G> start;
  start.key = {self_, next_index_[static_cast<std::size_t>(FactKind::anchor)]++};
  start.state.stamp_s = stamp_s;
  PriorFact<G> prior;
  prior.key = {self_, next_index_[static_cast<std::size_t>(FactKind::prior)]++};
  if (static_bias) {
    prior.known = true;
    prior.mean = static_bias->mean;
    prior.covariance = static_bias->covariance;
  }
  prior.persistent = persistent;
  if (const Insertion fit = store_.check(prior); fit != Insertion::inserted)
    throw ConfigError(std::string("submap manager: the static bias is refused (") + to_string(fit) +
                      "); give a finite pose, a symmetric positive semidefinite covariance, and a persistent drift "
                      "within its ranges");
  symmetrise(prior);
  publish(start);
  publish(prior);
  send(start);
  send(prior);
}

template <class G>
std::vector<std::optional<std::uint32_t>> SubmapManager<G>::publish_segment(const ChainState<G>& closing,
                                                                            std::vector<LandmarkFact<G>> batch) {
  auto& next_anchor = next_index_[static_cast<std::size_t>(FactKind::anchor)];
  auto& next_landmark = next_index_[static_cast<std::size_t>(FactKind::landmark)];
  std::vector<std::optional<std::uint32_t>> indices(batch.size());
  AnchorFact<G> anchor{{self_, next_anchor}, closing, next_landmark, 0};
  if (!make_fit(anchor)) {
    counters_.facts_unfit += batch.size();
    return indices;
  }
  LandmarkBatch<G> fit;
  for (std::size_t i = 0; i < batch.size(); ++i) {
    batch[i].key = {self_, next_landmark};
    batch[i].anchor = next_anchor;
    if (!make_fit(batch[i])) continue;
    const LandmarkFact<G> landmark = rounded(batch[i]);
    if (!is_rounded(landmark) || store_.check(landmark) != Insertion::inserted) {
      ++counters_.facts_unfit;
      continue;
    }
    publish(landmark);
    indices[i] = next_landmark++;
    fit.landmarks.push_back(landmark);
  }
  anchor.landmark_count = static_cast<std::uint32_t>(fit.landmarks.size());
  ++next_anchor;
  publish(anchor);
  send(anchor);
  if (!fit.landmarks.empty()) send(std::move(fit));
  return indices;
}

template <class G>
bool SubmapManager<G>::publish_association(std::vector<Pairing> pairings) {
  pairings = canonical(std::move(pairings));
  if (store_.stated(hypothesis_id(pairings))) return false;
  auto& next = next_index_[static_cast<std::size_t>(FactKind::association)];
  const AssociationFact fact{{self_, next}, std::move(pairings)};
  if (store_.check(fact) != Insertion::inserted) {
    ++counters_.facts_unfit;
    return false;
  }
  ++next;
  publish(fact);
  send(fact);
  return true;
}

template <class G>
void SubmapManager<G>::publish_verdict(Hash hypothesis, bool veto) {
  const VerdictFact fact{{self_, next_index_[static_cast<std::size_t>(FactKind::verdict)]++}, hypothesis, veto};
  publish(fact);
  send(fact);
}

template <class G>
bool SubmapManager<G>::publish_absolute_fix(const ChainState<G>& state, const typename G::Point& lever,
                                            const typename G::Point& position,
                                            const typename G::PointCovariance& covariance) {
  auto& next = next_index_[static_cast<std::size_t>(FactKind::absolute_fix)];
  const std::uint32_t anchor = next_index_[static_cast<std::size_t>(FactKind::anchor)] - 1;
  AbsoluteFixFact<G> fact{{self_, next}, anchor, state, lever, position, covariance};
  if (!make_fit(fact)) return false;
  if (fix_s_ && std::abs(state.stamp_s - *fix_s_) < params_.selection.fix_correlation_s) {
    ++counters_.fixes_thinned;
    return true;
  }
  fix_s_ = state.stamp_s;
  ++next;
  publish(fact);
  send(fact);
  return true;
}

template <class G>
bool SubmapManager<G>::publish_encounter(const ChainState<G>& state, VehicleId other, const typename G::Point& position,
                                         const typename G::PointCovariance& covariance) {
  auto& next = next_index_[static_cast<std::size_t>(FactKind::encounter)];
  EncounterFact<G> fact{{self_, next}, anchor_before(state), state, other, position, covariance};
  if (!make_fit(fact)) return false;
  const auto [last, first_time] = encounter_s_.try_emplace(other, state.stamp_s);
  if (!first_time && std::abs(state.stamp_s - last->second) < params_.encounter_period_s) {
    ++counters_.encounters_thinned;
    return true;
  }
  last->second = state.stamp_s;
  ++next;
  publish(fact);
  send(fact);
  return true;
}

template <class G>
bool SubmapManager<G>::publish_waypoint(const ChainState<G>& state, const Key& encounter,
                                        const typename G::Point& mark) {
  auto& next = next_index_[static_cast<std::size_t>(FactKind::waypoint)];
  WaypointFact<G> fact{{self_, next}, anchor_before(state), state, encounter, mark};
  if (!make_fit(fact)) return false;
  ++next;
  publish(fact);
  send(fact);
  return true;
}

// The last own anchor that is not later than a state.
template <class G>
std::uint32_t SubmapManager<G>::anchor_before(const ChainState<G>& state) const {
  const auto own = store_.chains().find(self_);
  if (own == store_.chains().end()) return 0;
  const auto& anchors = own->second.anchors;
  for (auto it = anchors.rbegin(); it != anchors.rend(); ++it)
    if (it->second.state.stamp_s <= state.stamp_s) return it->first;
  return 0;
}

template <class G>
bool SubmapManager<G>::is_fit(const LivePose<G>& live) const {
  AnchorFact<G> state{{live.chain, 1}, live.state};
  bool fit = store_.check(state) == Insertion::inserted;
  state.state.drift = live.shared;
  fit = fit && store_.check(state) == Insertion::inserted && live.remembered.size() <= LivePose<G>::max_remembered;
  LandmarkFact<G> landmark;
  for (const RememberedLandmark<G>& l : live.remembered) {
    landmark.key = {live.chain, l.index};
    landmark.position = l.position;
    landmark.covariance = l.covariance;
    fit = fit && store_.check(landmark) == Insertion::inserted;
  }
  return fit;
}

template <class G>
void SubmapManager<G>::update_live(LivePose<G> live) {
  live.chain = self_;
  live.anchor = next_index_[static_cast<std::size_t>(FactKind::anchor)] - 1;
  live.reasons = reasons(self_, 0.0, 0.0);
  live.integrity = !map_.map->aligned(self_)     ? Integrity::unaligned
                   : live.reasons != reason_none ? Integrity::suspect
                                                 : Integrity::ok;
  bool fit = is_fit(live);
  symmetrise(live);
  fit = fit && is_fit(live);
  if (!fit) {
    ++counters_.live_unfit;
    live.remembered.clear();  // the SLAM's pose may still be: it is told as it is, and judged by whoever hears it
    live.shared.setZero();
  }
  live_ = Live{std::move(live)};
}

template <class G>
void SubmapManager<G>::publish_live(LivePose<G> live) {
  update_live(std::move(live));
  send(live_->said);
}

template <class G>
const std::optional<Estimate<G>>& SubmapManager<G>::locate(Live& live) const {
  if (live.map != counters_.maps_built) live.estimate = live_pose(map_, live.said);
  live.map = counters_.maps_built;
  return live.estimate;
}

template <class G>
void SubmapManager<G>::step(double now_s) {
  now_s_ = now_s;
  if (inbox_.empty())  // else what comes waits in the exchange, which has bounds
    for (Message<G>& message : exchange_.take(now_s))
      if (admit(message, now_s)) inbox_.push_back(std::move(message));
  for (std::size_t left = params_.facts_per_step; left > 0 && !inbox_.empty();) {
    const Message<G> message = std::move(inbox_.front());
    inbox_.pop_front();
    left -= std::min(left, work_in<G>(message.payload));
    handle(message, now_s);
  }
  const auto held_back = exchange_.counters().repeats_waiting;
  const Room room = !held_back ? Room::any : *held_back == 0 ? Room::one_block : Room::none;
  for (Payload<G>& payload : repair_.due(store_, now_s, room)) send(std::move(payload));
  if (auto marks = repair_.digest_due(store_, now_s)) send_digest(std::move(*marks), now_s);
  if (journal_ != nullptr) journal_->retry(now_s);
}

template <class G>
bool SubmapManager<G>::admit(const Message<G>& message, double now_s) {
  const auto& roster = params_.limits.roster;
  const VehicleId sender = message.sender.vehicle;
  if (sender == 0 || (!roster.empty() && std::find(roster.begin(), roster.end(), sender) == roster.end())) {
    ++counters_.unknown_senders;
    counters_.last_unknown_sender = sender;
    return false;
  }
  if (!guard_.admit(sender, now_s)) return false;
  if (sender == self_.vehicle) note_rival(message.sender, now_s);
  if (message.sender != self_) note_peer(message.sender).heard_s = now_s;
  return true;
}

template <class G>
void SubmapManager<G>::handle(const Message<G>& message, double now_s) {
  repair_.on_heard(message.sender, now_s);
  std::visit(
      [&](const auto& payload) {
        using P = std::decay_t<decltype(payload)>;
        if constexpr (std::is_same_v<P, LandmarkBatch<G>>) {
          for (const LandmarkFact<G>& landmark : payload.landmarks) take_in(FactKind::landmark, landmark);
        } else if constexpr (std::is_same_v<P, AnchorFact<G>>) {
          take_in(FactKind::anchor, payload);
        } else if constexpr (std::is_same_v<P, PriorFact<G>>) {
          take_in(FactKind::prior, payload);
        } else if constexpr (std::is_same_v<P, AssociationFact>) {
          take_in(FactKind::association, payload);
        } else if constexpr (std::is_same_v<P, VerdictFact>) {
          take_in(FactKind::verdict, payload);
        } else if constexpr (std::is_same_v<P, AbsoluteFixFact<G>>) {
          take_in(FactKind::absolute_fix, payload);
        } else if constexpr (std::is_same_v<P, EncounterFact<G>>) {
          take_in(FactKind::encounter, payload);
        } else if constexpr (std::is_same_v<P, WaypointFact<G>>) {
          take_in(FactKind::waypoint, payload);
        } else if constexpr (std::is_same_v<P, LivePose<G>>) {
          if (payload.chain != self_ && payload.chain == message.sender) take_in_live(payload, now_s);
        } else if constexpr (std::is_same_v<P, Request>) {
          repair_.on_request(store_, message.sender, payload, now_s);
        } else {
          handle_digest(message.sender, payload, now_s);
        }
      },
      message.payload);
}

template <class G>
template <class Fact>
void SubmapManager<G>::take_in(FactKind kind, const Fact& fact) {
  const bool own = fact.key.chain == self_;
  if (own && !store_.holds(fact)) {  // all that was ever said here is held; anything else was never said
    ++counters_.facts_impersonated;
    impersonated_s_ = now_s_;
    return;
  }
  const Insertion result = own ? Insertion::duplicate : insert(fact);
  const bool fresh = result == Insertion::inserted;
  if (fresh || result == Insertion::duplicate) repair_.on_fact_seen(kind, fact.key);  // what is refused is no answer
  counters_.facts_received += fresh;
  if constexpr (std::is_same_v<Fact, EncounterFact<G>>)
    if (fresh && fact.other == self_.vehicle) unanswered_.emplace_back(fact.key, fact.state.stamp_s);
}

// One that was overtaken on the way does not count, unless what is held is old: then that may have been untrue.
template <class G>
void SubmapManager<G>::take_in_live(const LivePose<G>& live, double now_s) {
  if (!is_fit(live)) {
    ++counters_.live_unfit;
    return;
  }
  Peer& peer = note_peer(live.chain);
  const bool overtaken = peer.live && now_s <= peer.live_s + params_.stale_peer_s &&
                         (live.state.stamp_s < peer.live->said.state.stamp_s || live.anchor < peer.live->said.anchor);
  if (overtaken) return;
  peer.live = Live{live};
  peer.live_s = now_s;
}

// The exchange does not hand back what this vehicle sent, and what it sent in an earlier epoch is repeated by others
// under their own names. So this is somebody else with the same id, or an echo of a run that has just ended.
template <class G>
void SubmapManager<G>::note_rival(const ChainId& sender, double now_s) {
  ++counters_.senders_impersonated;
  impersonated_s_ = now_s;
  if (sender.epoch > self_.epoch) return;  // it will be refused itself
  std::erase_if(rivals_, [&](const Rival& rival) { return now_s > rival.heard_s + params_.stale_peer_s; });
  const auto known =
      std::find_if(rivals_.begin(), rivals_.end(), [&](const Rival& rival) { return rival.chain == sender; });
  if (known != rivals_.end()) known->heard_s = now_s;
  else if (rivals_.size() < max_rivals) rivals_.push_back({sender, now_s, now_s});
}

// The guard bounds the vehicles; of each the epochs heard last are kept.
template <class G>
typename SubmapManager<G>::Peer& SubmapManager<G>::note_peer(const ChainId& chain) {
  if (const auto known = peers_.find(chain); known != peers_.end()) return known->second;
  const auto first = peers_.lower_bound({chain.vehicle, 0});
  auto end = first, oldest = first;
  for (; end != peers_.end() && end->first.vehicle == chain.vehicle; ++end)
    if (end->second.heard_s < oldest->second.heard_s) oldest = end;
  if (std::distance(first, end) >= max_epochs_heard) peers_.erase(oldest);
  return peers_[chain];
}

// As many facts of one chain, all there are, and other contents: its author has said two things under one key, and not
// all have heard the same.
template <class G>
void SubmapManager<G>::compare(Peer& peer, const std::vector<ChainMark>& marks) {
  std::set<ChainId> differ;
  for (const ChainMark& theirs : marks) {
    const auto chain = store_.chains().find(theirs.chain);
    if (chain == store_.chains().end()) continue;
    peer.contradicts.erase(theirs.chain);
    const ChainMark& ours = chain->second.marks[static_cast<std::size_t>(theirs.kind)];
    const bool all = ours.count == ours.high_water && theirs.count == theirs.high_water && ours.count == theirs.count;
    if (all && ours.hash != theirs.hash) differ.insert(theirs.chain);
  }
  counters_.contradictions += differ.size();
  peer.contradicts.merge(differ);
}

template <class G>
void SubmapManager<G>::LeastDelay::add(double offset_s, double now_s) {
  constexpr double window_s = 60.0;
  if (now_s > begun_s + window_s) {
    before = now_s > begun_s + 2.0 * window_s ? 1e300 : now;
    now = 1e300;
    begun_s = now_s;
  }
  now = std::min(now, offset_s);
}

template <class G>
std::optional<double> SubmapManager<G>::LeastDelay::value() const {
  const double least = std::min(now, before);
  return least < 1e300 ? std::optional<double>(least) : std::nullopt;
}

template <class G>
void SubmapManager<G>::handle_digest(const ChainId& sender, const Digest& digest, double now_s) {
  if (digest.dimension != G::Dim) {
    ++counters_.dimension_mismatch;
    return;
  }
  Digest others = digest;  // nobody can know more of this chain than this vehicle
  std::erase_if(others.marks, [&](const ChainMark& mark) { return mark.chain == self_; });
  repair_.on_digest(store_, sender, others, now_s);
  Peer& peer = note_peer(sender);
  compare(peer, digest.marks);
  peer.clock.add(now_s - digest.stamp_s, now_s);
  if (digest.map_facts != digests_.facts) return;  // maps of other facts say nothing
  peer.disagrees = digest.map != digests_.map;
  counters_.disagreements += peer.disagrees;
}

template <class G>
void SubmapManager<G>::send_digest(std::vector<ChainMark> marks, double now_s) {
  Digest digest;
  digest.dimension = G::Dim;
  digest.marks = std::move(marks);
  digest.stamp_s = now_s;
  digest.holdings = store_.holdings();
  digest.facts = store_.digest();
  digest.selection = digests_.selection;
  digest.map = digests_.map;
  digest.map_facts = digests_.facts;
  send(std::move(digest));
}

template <class G>
bool SubmapManager<G>::map_due(double now_s) const {
  return (store_.revision() != ordered_revision_ || !map_.exact) && now_s >= map_s_ + params_.map_period_s;
}

template <class G>
bool SubmapManager<G>::exact_is_due(double now_s, bool news) const {
  return !news || exact_takes_s_ <= params_.exact_share * params_.map_period_s ||
         now_s >= exact_s_ + 20.0 * exact_takes_s_;
}

template <class G>
bool SubmapManager<G>::rebuild(double now_s, bool force) {
  if (!map_due(now_s) && !force) return false;
  map_s_ = exact_s_ = now_s;
  ordered_revision_ = store_.revision();
  adopt({builder_.build(store_), store_.revision(), 0.0});
  return true;
}

template <class G>
std::optional<MapOrder<G>> SubmapManager<G>::order_map(double now_s) {
  if (!map_due(now_s)) return std::nullopt;
  map_s_ = now_s;
  MapOrder<G> order{std::exchange(news_, {}), store_.revision(),
                    exact_is_due(now_s, store_.revision() != ordered_revision_)};
  ordered_revision_ = store_.revision();
  if (order.exact) exact_s_ = now_s;
  if (orders_given_) return order;
  orders_given_ = true;
  store_.for_each_fact([&](const auto& fact) { order.news.emplace_back(fact); });
  return order;
}

template <class G>
BuiltMap<G>::BuiltMap(GlobalMap<G> built, std::uint64_t of_revision, double in_s)
    : map(std::move(built)), revision(of_revision), seconds(in_s) {
  if (map.exact) digests = {map.facts, map.selection.digest(), map.map->digest()};
}

// The chi-square of an exact map: that of others holds what they were not iterated for.
template <class G>
GlobalMap<G> SubmapManager<G>::adopt(BuiltMap<G> built) {
  if (built.revision < map_revision_) return std::move(built.map);
  map_revision_ = built.revision;
  ++counters_.maps_built;
  if (built.map.exact) {
    digests_ = built.digests;
    exact_takes_s_ = built.seconds;
    const SolveReport& report = built.map.map->report();
    fits_ =
        report.dof <= 0 || (report.converged && report.chi2 >= 0.0 && report.chi2 <= chi2_quantile(0.999, report.dof));
  }
  return std::exchange(map_, std::move(built.map));
}

template <class G>
std::uint32_t SubmapManager<G>::reasons(const ChainId& chain, double heard_s, double now_s) const {
  std::uint32_t reasons = reason_none;
  if (!fits_) reasons |= reason_innovation;
  if (chain != self_ && now_s > heard_s + params_.stale_peer_s) reasons |= reason_stale_peer;
  if (const auto it = store_.chains().find(chain); it != store_.chains().end()) {
    if (it->second.equivocated) reasons |= reason_equivocation;
    std::uint64_t missing = 0;
    for (const ChainMark& mark : it->second.marks) missing += mark.high_water - mark.count;
    if (missing > repair_.lost_count(chain)) reasons |= reason_missing_facts;
  }
  if (map_.drift_alarms.count(chain) != 0) reasons |= reason_drift;
  if (!map_.map->aligned(chain) && map_.unsettled.count(chain) != 0) reasons |= reason_ambiguous;
  if (chain == self_ && now_s_ <= impersonated_s_ + remembered_s) reasons |= reason_impersonated;
  if (const auto peer = peers_.find(chain); peer != peers_.end() && peer->second.live)
    reasons |= peer->second.live->said.reasons & reason_impersonated;  // nobody but the vehicle itself can know
  for (const auto& [id, peer] : peers_) {
    if (now_s_ > peer.heard_s + params_.stale_peer_s) continue;  // what it said of others no longer counts
    if (peer.disagrees && (id == chain || chain == self_)) reasons |= reason_disagreement;
    if (peer.contradicts.contains(chain)) reasons |= reason_equivocation;
  }
  return reasons;
}

template <class G>
std::vector<VehicleState<G>> SubmapManager<G>::vehicles(double now_s) {
  std::vector<VehicleState<G>> all;
  for (const auto& [id, chain] : store_.chains()) {
    VehicleState<G> vehicle;
    vehicle.chain = id;
    vehicle.heard_s = now_s;
    if (!chain.anchors.empty()) vehicle.slam = chain.anchors.rbegin()->second.state;
    Live* live = nullptr;  // null: nothing newer than the last anchor is known
    if (id == self_) {
      if (live_) live = &*live_;
    } else if (const auto peer = peers_.find(id); peer != peers_.end()) {
      vehicle.heard_s = peer->second.heard_s;
      vehicle.clock_offset_s = peer->second.clock.value();
      if (peer->second.live && peer->second.live->said.state.stamp_s >= vehicle.slam.stamp_s)
        live = &*peer->second.live;
    } else {
      vehicle.heard_s = -1e300;
    }
    if (live != nullptr) vehicle.slam = live->said.state;
    vehicle.reasons = reasons(id, vehicle.heard_s, now_s);
    if (map_.map->aligned(id)) {
      vehicle.estimate = live != nullptr ? locate(*live) : map_.map->pose(id, vehicle.slam);
      vehicle.integrity = vehicle.reasons == reason_none ? Integrity::ok : Integrity::suspect;
    }
    all.push_back(std::move(vehicle));
  }
  return all;
}

#define CONVOY_INSTANTIATE(G) template class SubmapManager<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
