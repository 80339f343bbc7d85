// SubmapExchange: the only seam between vehicles (paper, Fig. 4: the arrows between the submaps). The middleware
// implements it, and an in-process network does for tests; one battery of contract tests runs on every implementation.
#pragma once

#include <convoy/exchange/message.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace convoy {

enum class SendStatus : std::uint8_t {
  sent,      ///< handed to the network; that says nothing about who got it
  rejected,  ///< the network would not take it now (full, blocked); the repair protocol makes up for it
  closed,    ///< the exchange is not open
  unfit,     ///< the network cannot carry this, now or ever: to send it again is of no use
};

/// Of two messages that go together: what may go another time is told before what is unfit.
inline SendStatus of_both(SendStatus a, SendStatus b) {
  return a == SendStatus::sent || (a == SendStatus::unfit && b != SendStatus::sent) ? b : a;
}

/// Counters of one exchange, all since it was opened.
struct ExchangeCounters {
  std::uint64_t messages_sent = 0;
  std::uint64_t messages_taken = 0;
  std::uint64_t bytes_sent = 0;  ///< on the wire where the network can tell, with every overhead; else 0
  std::uint64_t send_rejected = 0;
  std::uint64_t undecodable = 0;         ///< samples that could not be decoded
  std::uint64_t hostile = 0;             ///< decoded, but beyond the bounds of the wire format
  std::uint64_t dropped = 0;             ///< lost on purpose by an impairment, or for want of room in the queue
  std::uint64_t incompatible_peers = 0;  ///< endpoints whose quality of service does not match ours: nothing passes
  std::uint64_t unauthorised = 0;        ///< peers and messages that the rules of a secured fleet refuse
  std::string last_unauthorised;         ///< who that was last, and why; empty if nothing tells
  /// Facts repeated for others that a byte budget holds back now; nothing: there is no budget.
  std::optional<std::uint64_t> repeats_waiting;
};

/// An implementation serves two threads, one that sends and one that takes.
template <class G>
class SubmapExchange {
 public:
  virtual ~SubmapExchange() = default;

  /// Offers a message to all peers. Never blocks longer than the implementation states; never throws.
  [[nodiscard]] virtual SendStatus send(const Message<G>& message) = 0;

  /// The same of several, in as few pieces as the network can. Where some were sent and others not, they may all be
  /// offered again.
  [[nodiscard]] virtual SendStatus send_together(std::span<const Message<G>> messages) {
    SendStatus status = SendStatus::sent;
    for (const Message<G>& message : messages) status = of_both(status, send(message));
    return status;
  }

  /// All messages that have come in by `now_s` (the caller's clock); never one's own. Of one sender and kind, they are
  /// in order of arrival, apart from what is said again (Message::repeated). Does not block.
  virtual std::vector<Message<G>> take(double now_s) = 0;

  virtual ExchangeCounters counters() const = 0;

  /// How many peers the network knows to be there, if it can tell.
  virtual std::optional<std::size_t> live_peers() const { return std::nullopt; }
};

}  // namespace convoy
