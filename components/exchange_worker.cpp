#include <convoy/components/exchange_worker.hpp>
#include <convoy/geometry/groups.hpp>

#include <chrono>

namespace convoy {
namespace {

// Wall time: what the network and its users' patience are measured by.
double steady_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

ExchangeCounters sum(ExchangeCounters a, const ExchangeCounters& b) {
  a.messages_sent += b.messages_sent;
  a.messages_taken += b.messages_taken;
  a.bytes_sent += b.bytes_sent;
  a.send_rejected += b.send_rejected;
  a.undecodable += b.undecodable;
  a.hostile += b.hostile;
  a.dropped += b.dropped;
  a.incompatible_peers += b.incompatible_peers;
  a.unauthorised += b.unauthorised;
  if (!b.last_unauthorised.empty()) a.last_unauthorised = b.last_unauthorised;
  return a;
}

constexpr std::chrono::milliseconds waiting_for_budget{5}, idle{200};
constexpr double watch_period_s = 0.5;
constexpr double farewell_s = 1.0;  // to send what waits when it ends

}  // namespace

template <class G>
ExchangeWorker<G>::ExchangeWorker(Open open, const BudgetParams& budget, const WatchdogParams& watchdog)
    : open_(std::move(open)), outbox_(budget), watchdog_(watchdog) {
  network_ = open_();
  thread_ = std::thread([this] { run(); });
}

template <class G>
ExchangeWorker<G>::~ExchangeWorker() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
    stop_by_s_ = steady_s() + farewell_s;
  }
  wake_.notify_one();
  thread_.join();
}

template <class G>
SendStatus ExchangeWorker<G>::send(const Message<G>& message) {
  bool taken = false;
  {
    const std::lock_guard lock(mutex_);
    taken = outbox_.put(message);
  }
  wake_.notify_one();
  return taken ? SendStatus::sent : SendStatus::rejected;
}

template <class G>
std::vector<Message<G>> ExchangeWorker<G>::take(double now_s) {
  std::shared_ptr<SubmapExchange<G>> network;
  {
    const std::lock_guard lock(mutex_);
    network = network_;
  }
  if (!network) return {};
  auto messages = network->take(now_s);
  const std::lock_guard lock(mutex_);
  listened_s_ = steady_s();
  return messages;
}

template <class G>
ExchangeCounters ExchangeWorker<G>::counters_locked() const {
  return network_ ? sum(closed_, network_->counters()) : closed_;
}

template <class G>
ExchangeCounters ExchangeWorker<G>::counters() const {
  const std::lock_guard lock(mutex_);
  ExchangeCounters counters = counters_locked();
  counters.repeats_waiting = outbox_.repeats_waiting();
  return counters;
}

template <class G>
std::optional<std::size_t> ExchangeWorker<G>::live_peers() const {
  const std::lock_guard lock(mutex_);
  return network_ ? network_->live_peers() : std::optional<std::size_t>(0);
}

template <class G>
ExchangeWorkerCounters ExchangeWorker<G>::worker_counters() const {
  const std::lock_guard lock(mutex_);
  ExchangeWorkerCounters counters = counters_;
  counters.outbox = outbox_.counters();
  return counters;
}

template <class G>
void ExchangeWorker<G>::run() {
  std::unique_lock lock(mutex_);
  double watched_s = steady_s();
  while (!stop_) {
    attempt(counters_.failures, lock, [&] { send_what_may(lock); });
    if (const double now_s = steady_s(); now_s >= watched_s + watch_period_s) {
      watched_s = now_s;
      attempt(counters_.failures, lock, [&] { watch(lock, now_s); });
    }
    if (outbox_.empty()) wake_.wait_for(lock, idle, [this] { return stop_ || !outbox_.empty(); });
    else wake_.wait_for(lock, waiting_for_budget, [this] { return stop_; });
  }
  attempt(counters_.failures, lock, [&] { send_what_may(lock); });
  network_.reset();
}

// The lock is open while the network has the messages.
template <class G>
void ExchangeWorker<G>::send_what_may(std::unique_lock<std::mutex>& lock) {
  while (network_ && !(stop_ && steady_s() >= stop_by_s_)) {
    auto messages = outbox_.next(steady_s(), counters_locked().bytes_sent);
    if (messages.empty()) return;
    const auto network = network_;
    lock.unlock();
    const SendStatus status = network->send_together(messages);
    lock.lock();
    if (status == SendStatus::unfit) outbox_.give_up();
    if (status == SendStatus::sent || status == SendStatus::unfit) continue;
    outbox_.put_back(std::move(messages));
    return;
  }
}

template <class G>
void ExchangeWorker<G>::watch(std::unique_lock<std::mutex>& lock, double now_s) {
  if (!network_) {
    if (watchdog_.rested(now_s)) reopen(lock, now_s);
    return;
  }
  const Ailment ailment = watchdog_.observe(now_s, network_->live_peers(), counters_locked(), listened_s_);
  if (ailment == Ailment::none) return;
  counters_.last_ailment = ailment;
  reopen(lock, now_s);
}

template <class G>
void ExchangeWorker<G>::reopen(std::unique_lock<std::mutex>& lock, double now_s) {
  auto old = std::exchange(network_, nullptr);
  if (old) closed_ = sum(closed_, old->counters());
  lock.unlock();
  old.reset();  // if somebody is taking from it right now, it goes when that is done
  std::shared_ptr<SubmapExchange<G>> network;
  Failures failures;
  try {
    network = open_();
  } catch (...) {
    add_current(failures);
  }
  lock.lock();
  network_ = std::move(network);
  watchdog_.reopened(now_s);
  ++(network_ ? counters_.reopened : counters_.reopen_failed);
  if (!network_) counters_.last_error = failures.last_error;
}

#define CONVOY_INSTANTIATE(G) template class ExchangeWorker<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
