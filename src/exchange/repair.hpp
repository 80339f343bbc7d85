// Repair by index (paper, Section III: "a request can be emitted ... which will respond with the missing landmark";
// DESIGN A3). Above any network: gaps and lost tails are found from indices and announced high-water marks, asked for
// with backoff, and served by whoever holds the facts. Pure: driven by messages and by the caller's clock.
#pragma once

#include <convoy/exchange/message.hpp>

#include <deque>
#include <limits>
#include <map>
#include <optional>
#include <random>
#include <set>
#include <utility>
#include <vector>

namespace convoy {

struct RepairParams {
  double digest_period_s = 1.0;  ///< between two digests while facts are new, or a peer holds others
  double digest_idle_s = 5.0;    ///< while nothing is new and all peers hold the same; at least digest_period_s
  std::uint32_t max_chains =
      10;                      ///< told of in one digest, so that it fits a frame: its own first, then others in turn
  double grace_s = 0.5;        ///< a gap younger than this may just be late
  double backoff_min_s = 0.5;  ///< between two requests for the same sequence; doubles up to the maximum
  double backoff_max_s = 8.0;
  double relay_delay_s = 0.6;        ///< up to this long one who is not the author waits for another to answer
  std::uint32_t max_ranges = 256;    ///< asked for at once, in requests of at most 64; the next ones in the next turn
  double asks_per_s = 200.0;         ///< sequences asked for per second at most; the others wait for their turn
  double answers_per_s = 500.0;      ///< facts served per second at most; the rest waits, nothing is forgotten
  double resend_s = 0.3;             ///< a fact served within this time is on its way, and not served again
  std::uint32_t batch_limit = 64;    ///< landmarks per answering message
  double requests_per_s = 400.0;     ///< of one peer that are listened to; more are counted and passed over
  std::uint32_t max_answers = 4096;  ///< facts that wait to be served to one peer; more are asked for again
  double lost_after_s = 60.0;        ///< what nobody has served for so long, its author being gone, is declared missing
};

/// Throws RangeError.
void validate(const RepairParams& params);

/// The same for a vehicle that may send so many bytes per second: a block of facts takes its time, and who is to be
/// heard with it before others answer must be given that time. 0: no limit, nothing changes.
RepairParams under_budget(RepairParams params, double bytes_per_s);

struct RepairCounters {
  std::uint64_t requests_sent = 0;
  std::uint64_t requests_heard = 0;
  std::uint64_t requests_refused = 0;     ///< of a peer that asks too often
  std::uint64_t requests_suppressed = 0;  ///< put off, since another vehicle has just asked for the same
  std::uint64_t requests_waiting = 0;     ///< times that something was due to be asked for and had to wait its turn
  std::uint64_t facts_served = 0;
  std::uint64_t facts_relayed = 0;       ///< served on behalf of another author
  std::uint64_t answers_suppressed = 0;  ///< another vehicle was quicker
};

/// How many answers the network can take now.
enum class Room : std::uint8_t { none, one_block, any };

template <class G>
class RepairProtocol {
 public:
  /// `self` names this vehicle's own chain; `seed` draws the jitter.
  RepairProtocol(const ChainId& self, const RepairParams& params, std::uint64_t seed);

  /// `sender` knows of these facts to exist.
  void on_digest(FactStore<G>& store, const ChainId& sender, const Digest& digest, double now_s);
  void on_request(const FactStore<G>& store, const ChainId& sender, const Request& request, double now_s);
  /// A peer whose digests are known said something, whatever it was.
  void on_heard(const ChainId& sender, double now_s);
  /// A fact that is held was seen on the wire: nobody needs our answer with it any more.
  void on_fact_seen(FactKind kind, const Key& key);

  /// Messages due by `now_s`: requests for what is missing, answers to what was asked. An answer that waits for a byte
  /// budget can no longer be suppressed when another vehicle is quicker, so that no more is handed out than can be
  /// sent.
  std::vector<Payload<G>> due(const FactStore<G>& store, double now_s, Room room = Room::any);

  /// The marks to announce if a digest is due by `now_s`. None of them, if it would tell peers nothing: then the digest
  /// of the whole set says that this vehicle is there, and agrees.
  std::optional<std::vector<ChainMark>> digest_due(const FactStore<G>& store, double now_s);

  /// All peers that are heard said last that they hold what is in the store.
  bool all_agree(const FactStore<G>& store, double now_s) const;

  /// Facts known to exist and declared missing (RepairParams::lost_after_s). They go on being asked for, once a minute,
  /// in case somebody comes back who holds them; while some of a sequence come, the others of it are not lost.
  std::uint64_t lost_count() const;
  std::uint64_t lost_count(const ChainId& chain) const;

  const RepairCounters& counters() const { return counters_; }

 private:
  struct Wanted {
    double next_s = 0.0;
    double backoff_s = 0.0;
    std::uint32_t lacking = 0;  // progress on the gap resets the backoff
    double progress_s = 0.0;    // when there was some last, or the author
    std::uint32_t asked = 0;    // lacking at the last request of our own
    std::uint32_t from = 0;     // where the next request begins
    std::uint8_t in_vain = 0;   // requests since the last that was answered well
    bool put_off = false;       // since the last request of our own
    bool lost = false;
    bool given_up = false;  // it was lost before, and the author has not been there since
  };
  using SequenceId = std::pair<ChainId, FactKind>;
  using FactId = std::pair<FactKind, Key>;
  struct Peer {
    Hash holdings = 0;
    double heard_s = 0.0;
  };
  /// So many at once, and so many per second.
  struct Allowance {
    double left = 0.0, at_s = -std::numeric_limits<double>::infinity();
    bool take(double per_s, double now_s);
    void spend(double share, double per_s, double now_s);
    void refill(double per_s, double now_s);
  };
  /// What waits to be served goes in turns, a block of each asker, so that who asks for much does not keep others
  /// waiting.
  struct Asker {
    Allowance requests;
    std::set<std::pair<double, FactId>> queue;  // by when it is due
  };
  struct Answer {
    VehicleId asker = 0;
    double at_s = 0.0;
    bool insist = false;  // whoever else is seen to answer
  };
  double uniform();
  double crowd() const;
  bool heard_lately(const ChainId& chain, double now_s) const;
  void tell_soon(double now_s);
  void ask_again(double now_s);
  void forget_rumours(FactStore<G>& store);
  double relay_at(double now_s);
  void enqueue(VehicleId asker, const FactId& fact, double at_s, bool insist);
  bool serve_block(const FactStore<G>& store, Asker& asker, double now_s, std::vector<Payload<G>>& out);
  std::vector<ChainMark> marks_to_tell(const FactStore<G>& store, double now_s);
  void note_told(const FactStore<G>& store, const std::vector<ChainMark>& marks, double now_s);
  void ask_for_lost(const FactStore<G>& store, const ChainMark& mark, double now_s);
  void put_off(const FactStore<G>& store, const Request& request, double now_s);
  void request_missing(const FactStore<G>& store, double now_s, std::vector<Payload<G>>& out);
  void request_missing(const FactStore<G>& store, const SequenceId& sequence, const ChainMark& mark, double now_s,
                       std::vector<Payload<G>>& out);
  void request(const FactStore<G>& store, const SequenceId& sequence, Wanted& wanted, bool author_is_there,
               std::vector<Payload<G>>& out);
  void answer(const FactStore<G>& store, double now_s, Room room, std::vector<Payload<G>>& out);
  void forget_served(double now_s);

  ChainId self_;
  RepairParams params_;
  std::mt19937_64 random_;
  std::map<SequenceId, Wanted> wanted_;
  std::map<FactId, Answer> answers_;             // to be served
  std::map<FactId, double> served_;              // lately: when
  std::deque<std::pair<double, FactId>> order_;  // of served_, by time
  std::map<ChainId, Peer> peers_;
  std::map<VehicleId, Asker> askers_;
  VehicleId served_last_ = 0;
  ChainId asked_last_;
  Allowance asks_, least_asks_;      // of the fleet; of this vehicle, whatever the others ask for
  std::uint64_t told_revision_ = 0;  // of the facts that the last digest with marks spoke of
  double digest_s_ = -std::numeric_limits<double>::infinity();
  double digest_jitter_ = 1.0;
  double prompt_s_ = std::numeric_limits<double>::infinity();  // a digest out of turn, for somebody new
  ChainId turn_;                                               // the chain that the last digest ended with
  bool told_of_others_ = false;
  std::map<ChainId, double> told_s_;  // when somebody, this vehicle too, told what is held here of the chain
  double last_s_ = 0.0;
  double allowance_ = 0.0;
  RepairCounters counters_;
};

}  // namespace convoy
