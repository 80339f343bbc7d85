// Outbox: what waits to be sent under a byte budget, in the order of its worth (DESIGN A5). A token bucket over the
// bytes that the network says it has sent, whatever for: discovery, heartbeats and repeats are paid from it, too.
// Pure: driven by the caller's clock.
#pragma once

#include <convoy/exchange/submap_exchange.hpp>

#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <utility>

namespace convoy {

struct BudgetParams {
  double bytes_per_s = 0.0;        ///< of this vehicle, everything included, >= 0; 0: no limit
  double burst_s = 1.0;            ///< a budget unused for so long may be spent at once, > 0
  std::uint32_t batch_limit = 20;  ///< landmarks per message; on a budget, also of what is said again in one go; 1..64
  std::size_t max_waiting = 1'000'000;  ///< facts; what comes beyond is left to the repair protocol, >= 1
};

/// Throws RangeError.
void validate(const BudgetParams& params);

struct OutboxCounters {
  std::uint64_t facts_waiting = 0;
  std::uint64_t repeats = 0;   ///< facts that were waiting already, or that the network had just been given
  std::uint64_t replaced = 0;  ///< digests, live poses and requests that a newer one took the place of
  std::uint64_t dropped = 0;   ///< facts beyond max_waiting
  std::uint64_t in_debt = 0;   ///< messages sent although the network by itself had spent the budget
  std::uint64_t unfit = 0;     ///< messages that the network cannot carry (SendStatus::unfit): they are not tried again
};

/// Kinds of traffic share a short budget: of six bytes, four are for facts, one for digests and requests, one for live
/// poses; what one kind does not use is the others'. A digest and the requests take turns, and so do the sender's own
/// news and what it repeats for others. Of either, landmarks come last, those with the smallest covariance first. Of
/// digests and live poses only the last one waits.
///
/// What the network spends by itself (discovery, heartbeats) nobody can hold back. Where it takes the whole budget, a
/// tenth of it goes on messages nevertheless, and debts beyond ten seconds of it are forgiven.
template <class G>
class Outbox {
 public:
  explicit Outbox(const BudgetParams& params);

  /// False if it was dropped.
  bool put(Message<G> message);

  /// What goes out next, if the budget allows anything: one message, or a few facts that are said again. `bytes_sent`:
  /// ExchangeCounters::bytes_sent of the network, as of now.
  std::vector<Message<G>> next(double now_s, std::uint64_t bytes_sent);

  /// What next() handed out last and the network did not take goes back to its place, unless something newer has it.
  void put_back(std::vector<Message<G>> messages);
  /// It cannot be carried at all.
  void give_up() { ++counters_.unfit; }

  bool empty() const;
  const OutboxCounters& counters() const { return counters_; }
  /// Facts repeated for others that the budget holds back; nothing: there is no budget.
  std::optional<std::uint64_t> repeats_waiting() const;

 private:
  using FactId = std::pair<FactKind, Key>;
  enum Traffic : std::uint8_t { control, facts, live };
  static constexpr std::array<double, 3> weight = {1.0, 4.0, 1.0};

  struct Batch {
    ChainId sender;
    std::multimap<double, LandmarkFact<G>> landmarks;  // by log det of the covariance
  };
  struct Facts {
    std::deque<Message<G>> others;  // all but landmarks
    std::map<Key, Batch> batches;   // by anchor
    bool empty() const { return others.empty() && batches.empty(); }
  };

  template <class Fact>
  bool put_fact(const ChainId& sender, const Fact& fact);
  bool put_landmarks(const ChainId& sender, const LandmarkBatch<G>& batch);
  bool note(FactKind kind, const Key& key);
  bool waits(Traffic traffic) const;
  void spend(double now_s, std::uint64_t bytes_sent);
  std::vector<Message<G>> take(Traffic traffic);
  Message<G> take_control();
  std::vector<Message<G>> take_facts();
  Message<G> take_fact(Facts& from);
  void put_back(Message<G> message);

  BudgetParams params_;
  std::optional<Message<G>> digest_, live_;
  std::deque<Message<G>> requests_;
  Facts& place_of(const ChainId& sender, FactKind kind, const Key& key);
  Message<G> take_landmarks(std::map<Key, Batch>& batches);
  Facts news_, repeats_;
  std::array<std::uint32_t, fact_kind_count> next_news_{};  // the sender's own facts begin here to be news
  bool digest_was_last_ = false, news_were_last_ = false;
  bool returning_ = false;       // what put() is given now has been handed out before
  std::int64_t news_ahead_ = 0;  // of what is said again, while both wait; in landmarks
  std::set<FactId> waiting_;
  std::set<FactId> away_;          // handed out by the last next(): the network may yet refuse them
  std::array<double, 3> spent_{};  // bytes over weight
  std::optional<Traffic> last_;    // what the bytes since then are put down to
  double tokens_, reserve_;        // bytes that may be spent; that may be, whatever the network spends by itself
  std::optional<double> at_s_;
  std::uint64_t bytes_sent_ = 0;
  OutboxCounters counters_;
};

}  // namespace convoy
