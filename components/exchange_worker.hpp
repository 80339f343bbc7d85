// ExchangeWorker: an exchange with a thread of its own, so that nobody who sends ever waits for the network. It keeps
// to a byte budget (Outbox), and opens the network anew when it has gone deaf or mute (Watchdog). Facts are not lost by
// that: they are in the stores, and the repair protocol brings them.
#pragma once

#include <convoy/components/failures.hpp>
#include <convoy/exchange/outbox.hpp>
#include <convoy/exchange/watchdog.hpp>

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

namespace convoy {

struct ExchangeWorkerCounters {
  OutboxCounters outbox;
  std::uint64_t reopened = 0;       ///< times the network was opened anew
  std::uint64_t reopen_failed = 0;  ///< times that failed; it is tried again
  Ailment last_ailment = Ailment::none;
  std::string last_error;  ///< of the last of these; empty: none
  Failures failures;       ///< a network that threw where it must not
};

template <class G>
class ExchangeWorker final : public SubmapExchange<G> {
 public:
  using Open = std::function<std::unique_ptr<SubmapExchange<G>>()>;

  /// Calls `open`, which may throw ConfigError, and again from its own thread whenever the network ails. Throws
  /// RangeError.
  ExchangeWorker(Open open, const BudgetParams& budget, const WatchdogParams& watchdog);
  /// Sends what the budget allows at once, then closes the network. After a second no more is begun.
  ~ExchangeWorker() override;
  ExchangeWorker(const ExchangeWorker&) = delete;
  ExchangeWorker& operator=(const ExchangeWorker&) = delete;

  SendStatus send(const Message<G>& message) override;
  /// Nothing while the network is being opened anew.
  std::vector<Message<G>> take(double now_s) override;
  /// Of all networks opened so far.
  ExchangeCounters counters() const override;
  std::optional<std::size_t> live_peers() const override;
  ExchangeWorkerCounters worker_counters() const;

 private:
  void run();
  void send_what_may(std::unique_lock<std::mutex>& lock);
  void watch(std::unique_lock<std::mutex>& lock, double now_s);
  void reopen(std::unique_lock<std::mutex>& lock, double now_s);
  ExchangeCounters counters_locked() const;

  Open open_;
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  std::shared_ptr<SubmapExchange<G>> network_;  // null while it is being opened
  Outbox<G> outbox_;
  Watchdog watchdog_;
  ExchangeCounters closed_;  // of the networks before
  ExchangeWorkerCounters counters_;
  double listened_s_ = -1e300;  // when somebody last took
  bool stop_ = false;
  double stop_by_s_ = 0.0;
  std::thread thread_;
};

}  // namespace convoy
