// Repair by index (paper, Section III: "a request can be emitted ... which will respond with the missing landmark";
// DESIGN A3). Above any network: gaps and lost tails are found from indices and announced high-water marks, asked for
// with backoff, and served by whoever holds the facts. Pure: driven by messages and by the caller's clock.
#pragma once

#include <convoy/exchange/message.hpp>

#include <map>
#include <random>
#include <utility>
#include <vector>

namespace convoy {

struct RepairParams {
  double digest_period_s = 1.0;  ///< between two digests
  double grace_s = 0.5;          ///< a gap younger than this may just be late
  double backoff_min_s = 0.5;    ///< between two requests for the same sequence; doubles up to the maximum
  double backoff_max_s = 8.0;
  double relay_delay_s = 0.6;      ///< up to this long a relayer waits for the author or another to answer
  std::uint32_t max_ranges = 32;   ///< per request
  double answers_per_s = 500.0;    ///< facts served per second at most; the rest waits, nothing is forgotten
  std::uint32_t batch_limit = 16;  ///< landmarks per answering message
};

/// Throws RangeError.
void validate(const RepairParams& params);

struct RepairCounters {
  std::uint64_t requests_sent = 0;
  std::uint64_t requests_heard = 0;
  std::uint64_t facts_served = 0;
  std::uint64_t facts_relayed = 0;       ///< served on behalf of another author
  std::uint64_t answers_suppressed = 0;  ///< another vehicle was quicker
};

template <class G>
class RepairProtocol {
 public:
  /// `self` names this vehicle's own chain; `seed` draws the jitter.
  RepairProtocol(const ChainId& self, const RepairParams& params, std::uint64_t seed);

  void on_digest(FactStore<G>& store, const Digest& digest);
  void on_request(const FactStore<G>& store, const Request& request, double now_s);
  /// A fact was seen on the wire: nobody needs our answer with it any more.
  void on_fact_seen(FactKind kind, const Key& key);

  /// Messages due by `now_s`: requests for what is missing, answers to what was asked.
  std::vector<Payload<G>> due(const FactStore<G>& store, double now_s);

  const RepairCounters& counters() const { return counters_; }

 private:
  struct Wanted {
    double next_s = 0.0;
    double backoff_s = 0.0;
    std::uint32_t lacking = 0;  // progress on the gap resets the backoff
  };
  using SequenceId = std::pair<ChainId, FactKind>;
  double uniform();
  void request_missing(const FactStore<G>& store, double now_s, std::vector<Payload<G>>& out);
  void answer(const FactStore<G>& store, double now_s, std::vector<Payload<G>>& out);

  ChainId self_;
  RepairParams params_;
  std::mt19937_64 random_;
  std::map<SequenceId, Wanted> wanted_;
  std::map<std::pair<FactKind, Key>, double> answers_;  // fact -> when to serve it
  double last_s_ = 0.0;
  double allowance_ = 0.0;
  RepairCounters counters_;
};

}  // namespace convoy
