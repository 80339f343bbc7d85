// SubmapManager: the submaps of all vehicles, kept complete, and the global map they amount to (paper, Fig. 3 and 4).
// It speaks through one SubmapExchange, repairs what is late or lost, and rebuilds the map from the set of facts.
#pragma once

#include <convoy/exchange/peer_guard.hpp>
#include <convoy/exchange/repair.hpp>
#include <convoy/exchange/submap_exchange.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/submap/journal.hpp>

#include <array>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <utility>
#include <variant>
#include <vector>

namespace convoy {

enum class MapBackend : std::uint8_t {
  sparse,  ///< sparse least squares; the default
  ekf,     ///< the paper's filter; a baseline
};

struct SubmapManagerParams {
  FactLimits limits;
  RepairParams repair;
  PeerLimits peers;
  SelectionParams selection;
  MapBackend backend = MapBackend::sparse;
  double map_period_s = 1.0;  ///< between two rebuilds at least, > 0; nothing is done while no fact is new
  /// Share of map_period_s that building the exact map may take, >= 0. Beyond it, what is new is worked into the last
  /// map at once, and the exact one is built when nothing new has come for a period, or after twenty times what it
  /// takes.
  double exact_share = 0.2;
  double encounter_period_s =
      2.0;                     ///< between two encounters with the same vehicle at least, >= 0; the others are not sent
  double stale_peer_s = 15.0;  ///< a vehicle not heard of for longer is reported as stale, > 0
  /// Somebody else who has spoken under this vehicle's id for so long is no echo of an earlier run: two processes
  /// claim one id, and the one that began later is refused. > 0
  double rival_s = 5.0;
  /// Taken in by one step(), about; the rest waits for the next, so that no step takes long. >= 1
  std::uint32_t facts_per_step = 2000;
  std::uint64_t seed = 1;  ///< of the repair protocol's jitter
};

/// A vehicle as this one knows it.
template <class G>
struct VehicleState {
  ChainId chain;
  ChainState<G> slam;                   ///< what its own SLAM said last
  std::optional<Estimate<G>> estimate;  ///< in the common frame, if aligned
  Integrity integrity = Integrity::unaligned;
  std::uint32_t reasons = reason_none;  ///< bits of IntegrityReason
  double heard_s = 0.0;                 ///< when, on this vehicle's clock
  /// How far this vehicle's clock is ahead of its, as far as messages tell: the network's least delay of the last
  /// minute or two is included. Nothing that is computed depends on it, but encounters want stamps of one clock.
  std::optional<double> clock_offset_s;
};

struct SubmapManagerCounters {
  std::uint64_t facts_published = 0;
  std::uint64_t facts_received = 0;        ///< taken in from others
  std::uint64_t facts_unfit = 0;           ///< of this vehicle's own making, and left out
  std::uint64_t fixes_thinned = 0;         ///< absolute fixes within the correlation time of one published: not needed
  std::uint64_t encounters_thinned = 0;    ///< within `encounter_period_s` of one published: not sent
  std::uint64_t live_unfit = 0;            ///< live poses that were not finite or beyond the limits
  std::uint64_t unknown_senders = 0;       ///< messages of vehicles that are not on the roster
  VehicleId last_unknown_sender = 0;       ///< whose the last of these was
  std::uint64_t facts_impersonated = 0;    ///< claimed to be this vehicle's own, and were not: refused
  std::uint64_t senders_impersonated = 0;  ///< messages that somebody else has sent under this vehicle's id
  std::uint64_t sends_withheld = 0;        ///< while refused: see SubmapManager::refused()
  std::uint64_t sends_rejected = 0;        ///< the network would not take it; repair makes up for it
  std::uint64_t dimension_mismatch = 0;    ///< digests of fleets of another dimension
  std::uint64_t disagreements = 0;         ///< digests with our facts and another map
  std::uint64_t contradictions = 0;        ///< marks of as many facts of a chain as are held, with other contents
  std::uint64_t maps_built = 0;
};

/// What it takes to build a map elsewhere.
template <class G>
struct MapOrder {
  std::vector<AnyFact<G>> news;  ///< facts that no order before it held
  std::uint64_t revision = 0;    ///< of the store that held them all
  bool exact = true;             ///< by MapBuilder::build(), not update()
};

/// Of an exact map: what vehicles compare.
struct MapDigests {
  Hash facts = 0, selection = 0, map = 0;
};

template <class G>
struct BuiltMap {
  /// Computes the digests of an exact map.
  BuiltMap(GlobalMap<G> built, std::uint64_t of_revision, double in_s = 0.0);

  GlobalMap<G> map;
  std::uint64_t revision;   ///< of its order
  double seconds;           ///< that it took
  MapDigests digests = {};  ///< of an exact map
};

/// Single-threaded, driven by calls that carry time on the vehicle's own clock, not decreasing.
template <class G>
class SubmapManager {
 public:
  /// `self`: this vehicle and an epoch it never used before. Throws ConfigError. `exchange` must outlive it. `backend`:
  /// instead of the one that the parameters name.
  SubmapManager(const ChainId& self, SubmapExchange<G>& exchange, const SubmapManagerParams& params,
                std::shared_ptr<const Backend<G>> backend = nullptr);

  const ChainId& self() const { return self_; }

  /// Takes in what the journal holds, and writes every fact to it from now on. Call before open_chain(). Throws
  /// ConfigError if it is damaged beyond use, or holds facts of this very chain, whose indices would be used twice.
  /// `journal` must outlive it.
  void keep_in(Journal<G>& journal);

  // ---- own facts, each stated once; indices are given here ----
  /// Opens the chain: the first anchor, and the static bias if the start is known. Call first, once. Throws ConfigError
  /// if the static bias is not finite or its covariance is none, or if `persistent` is out of range.
  void open_chain(double stamp_s, const std::optional<Estimate<G>>& static_bias,
                  const PersistentDrift& persistent = {});
  /// A closing anchor with its batch; key and anchor of the landmarks are set here, and they are rounded(). What is not
  /// fit to be a fact (not finite, no covariance) is left out and counted, and takes no index. Returns the index of
  /// each landmark given.
  std::vector<std::optional<std::uint32_t>> publish_segment(const ChainState<G>& closing,
                                                            std::vector<LandmarkFact<G>> batch);
  /// False if the same hypothesis is already held, or if there is none.
  bool publish_association(std::vector<Pairing> pairings);
  void publish_verdict(Hash hypothesis, bool veto);
  /// A receiver of absolute positions said where its antenna (`lever`, body frame) was when the SLAM was at `state`:
  /// `position`, east-north(-up) of the fleet's datum [m], `covariance` [m^2]. Call after open_chain(). False if it is
  /// not fit to be a fact. One that the map would not take beside the last one (`fix_correlation_s`) is not sent, and
  /// counted.
  bool publish_absolute_fix(const ChainState<G>& state, const typename G::Point& lever,
                            const typename G::Point& position, const typename G::PointCovariance& covariance);
  /// This vehicle, when its SLAM was at `state`, saw the mark of vehicle `other` at `position` in its own body frame
  /// [m], `covariance` [m^2]. False if it is not fit to be a fact.
  bool publish_encounter(const ChainState<G>& state, VehicleId other, const typename G::Point& position,
                         const typename G::PointCovariance& covariance);
  /// Encounters in which others saw this vehicle and that it has not answered yet, each handed out once. [key, stamp_s]
  std::vector<std::pair<Key, double>> take_unanswered() { return std::exchange(unanswered_, {}); }
  /// Answers one: where the SLAM was then, and the mark that others see, body frame [m]. False if it is not fit to be a
  /// fact.
  bool publish_waypoint(const ChainState<G>& state, const Key& encounter, const typename G::Point& mark);
  /// Where this vehicle is now: `state`, `remembered` and `shared` are the caller's. Not a fact: only the last one
  /// counts. Landmarks that are not fit (not finite, no covariance, too many) are left out and counted.
  void publish_live(LivePose<G> live);
  /// The same for this vehicle alone: nobody is told.
  void update_live(LivePose<G> live);

  /// Takes what has come in (SubmapManagerParams::facts_per_step of it), sends what is due (requests, answers, the
  /// digest).
  void step(double now_s);
  /// More has come in than the last step could take.
  bool busy() const { return !inbox_.empty(); }
  /// Builds the map anew if facts have come in and the period has passed, or if `force`. True if it did.
  bool rebuild(double now_s, bool force = false);

  // ---- the same in two steps, for a map that is built elsewhere (MapWorker) ----
  /// If rebuild() would build one: all facts at the first call, later those that have come in since the last order.
  std::optional<MapOrder<G>> order_map(double now_s);
  /// Takes the map of an order, unless there is one of more facts by now. Returns the one that is no longer needed.
  GlobalMap<G> adopt(BuiltMap<G> built);
  /// The last order came to nothing: it is due again after a period.
  void order_again() { ordered_revision_ = map_revision_; }
  const std::shared_ptr<const Backend<G>>& backend() const { return backend_; }

  const FactStore<G>& store() const { return store_; }
  const GlobalMap<G>& map() const { return map_; }
  /// Of the last exact map.
  const MapDigests& digests() const { return digests_; }
  /// Every chain heard of, this one included, in canonical order.
  std::vector<VehicleState<G>> vehicles(double now_s);
  /// Facts known to exist and neither held nor declared missing.
  std::uint64_t facts_missing() const { return store_.missing_count() - repair_.lost_count(); }
  /// Declared missing: their author is gone, and nobody has served them (RepairParams::lost_after_s).
  std::uint64_t facts_lost() const { return repair_.lost_count(); }
  /// Another process claims this vehicle's id, and began earlier or cannot be told apart: nothing is sent until it has
  /// been silent for `stale_peer_s`.
  bool refused() const;
  const SubmapManagerCounters& counters() const { return counters_; }
  const PeerGuardCounters& peer_counters() const { return guard_.counters(); }
  /// All peers that are heard said last that they hold the same facts as this vehicle.
  bool peers_agree() const { return repair_.all_agree(store_, now_s_); }
  const RepairCounters& repair_counters() const { return repair_.counters(); }
  ExchangeCounters exchange_counters() const { return exchange_.counters(); }
  /// Chains that something was heard of.
  std::size_t peers_heard() const { return peers_.size(); }

 private:
  // A live pose and where it is by a map: that takes a while, and is asked for more often than either changes.
  struct Live {
    LivePose<G> said;
    std::uint64_t map = 0;  // number of the map that `estimate` is by; 0: none
    std::optional<Estimate<G>> estimate = {};
  };
  /// The least of what came in during this minute and the one before.
  struct LeastDelay {
    double begun_s = -1e300, now = 1e300, before = 1e300;
    void add(double offset_s, double now_s);
    std::optional<double> value() const;
  };
  struct Peer {
    std::optional<Live> live;
    double live_s = 0.0;  // when it came
    double heard_s = 0.0;
    bool disagrees = false;
    std::set<ChainId> contradicts;  // of which it has other facts than this vehicle, under the same keys
    LeastDelay clock;
  };
  /// Somebody else under this vehicle's id.
  struct Rival {
    ChainId chain;
    double since_s = 0.0, heard_s = 0.0;
  };
  template <class Fact>
  bool make_fit(Fact& fact);
  template <class Fact>
  void publish(const Fact& fact);
  void send(Payload<G> payload);
  bool admit(const Message<G>& message, double now_s);
  void handle(const Message<G>& message, double now_s);
  template <class Fact>
  void take_in(FactKind kind, const Fact& fact);
  void take_in_live(const LivePose<G>& live, double now_s);
  void handle_digest(const ChainId& sender, const Digest& digest, double now_s);
  void note_rival(const ChainId& sender, double now_s);
  Peer& note_peer(const ChainId& chain);
  void compare(Peer& peer, const std::vector<ChainMark>& marks);
  void send_digest(std::vector<ChainMark> marks, double now_s);
  std::uint32_t reasons(const ChainId& chain, double heard_s, double now_s) const;
  bool map_due(double now_s) const;
  bool exact_is_due(double now_s, bool news) const;
  std::uint32_t anchor_before(const ChainState<G>& state) const;
  bool is_fit(const LivePose<G>& live) const;
  const std::optional<Estimate<G>>& locate(Live& live) const;
  template <class Fact>
  Insertion insert(const Fact& fact);

  ChainId self_;
  SubmapExchange<G>& exchange_;
  SubmapManagerParams params_;
  FactStore<G> store_;
  RepairProtocol<G> repair_;
  PeerGuard guard_;
  Journal<G>* journal_ = nullptr;
  double now_s_ = 0.0;            // of the last step
  std::vector<Rival> rivals_;     // those that began earlier, at most max_rivals
  std::deque<Message<G>> inbox_;  // came in, and waits for the next step
  std::shared_ptr<const Backend<G>> backend_;
  MapBuilder<G> builder_;
  GlobalMap<G> map_;
  MapDigests digests_;
  bool fits_ = true;                               // the last exact map: its facts agree with each other
  double exact_takes_s_ = 0.0, exact_s_ = -1e300;  // the last exact map: its cost, and when it was ordered
  std::uint64_t map_revision_ = 0;                 // of the facts in map_
  std::uint64_t ordered_revision_ = 0;             // of the facts in map_ or in the last order
  bool orders_given_ = false;
  std::vector<AnyFact<G>> news_;  // since the last order, if there was one
  double map_s_ = -1e300;
  std::array<std::uint32_t, fact_kind_count> next_index_{};
  std::optional<Live> live_;
  std::optional<double> fix_s_;              // stamp of the last absolute fix published
  std::map<VehicleId, double> encounter_s_;  // stamp of the last encounter published with each
  std::vector<std::pair<Key, double>> unanswered_;
  std::map<ChainId, Peer> peers_;
  double impersonated_s_ = -1e300;  // when that was noticed last
  SubmapManagerCounters counters_;
};

}  // namespace convoy
