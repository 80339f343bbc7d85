// Any exchange, under a byte budget. For one thread; a Vehicle has a thread of its own for this (ExchangeWorker).
#pragma once

#include <convoy/exchange/outbox.hpp>

#include <memory>

namespace convoy {

template <class G>
class PacedExchange final : public SubmapExchange<G> {
 public:
  /// Throws RangeError.
  PacedExchange(std::unique_ptr<SubmapExchange<G>> inner, const BudgetParams& params)
      : inner_(std::move(inner)), outbox_(params) {}

  SendStatus send(const Message<G>& message) override {
    return outbox_.put(message) ? SendStatus::sent : SendStatus::rejected;
  }
  /// Also sends what the budget allows by now.
  std::vector<Message<G>> take(double now_s) override {
    for (;;) {
      auto messages = outbox_.next(now_s, inner_->counters().bytes_sent);
      if (messages.empty()) break;
      const SendStatus status = inner_->send_together(messages);
      if (status == SendStatus::unfit) outbox_.give_up();
      if (status == SendStatus::sent || status == SendStatus::unfit) continue;
      outbox_.put_back(std::move(messages));
      break;
    }
    return inner_->take(now_s);
  }
  ExchangeCounters counters() const override {
    ExchangeCounters counters = inner_->counters();
    counters.repeats_waiting = outbox_.repeats_waiting();
    return counters;
  }
  const OutboxCounters& outbox_counters() const { return outbox_.counters(); }

 private:
  std::unique_ptr<SubmapExchange<G>> inner_;
  Outbox<G> outbox_;
};

}  // namespace convoy
