// Seeded loss, duplication, delay and reordering of messages, on the receiving side of any exchange.
#pragma once

#include <convoy/exchange/submap_exchange.hpp>

#include <map>
#include <memory>
#include <random>
#include <string_view>

namespace convoy {

/// What an impaired network does to each message, independently.
struct Impairment {
  double loss = 0.0;       ///< probability in [0, 1) that a message is lost
  double duplicate = 0.0;  ///< probability in [0, 1] that it comes twice
  double delay_s = 0.0;    ///< every message is late by this, [0, 3600]
  double jitter_s = 0.0;   ///< and by a uniform share of this more, [0, 3600], so that messages overtake each other
  std::uint64_t seed = 1;
  bool any() const { return loss > 0 || duplicate > 0 || delay_s > 0 || jitter_s > 0; }

  /// From "loss=0.3,duplicate=0.2,delay=0.1,jitter=0.5,seed=7" (seconds). Throws ConfigError that names the entry.
  static Impairment parse(std::string_view text);
};

/// Throws ConfigError that names the first value out of its range.
void validate(const Impairment& impairment);

/// Holds messages back by an Impairment. Messages with equal due times leave in order of arrival.
template <class G>
class ImpairedQueue {
 public:
  /// Throws ConfigError; see validate().
  explicit ImpairedQueue(const Impairment& impairment) : impairment_(impairment), random_(impairment.seed) {
    validate(impairment);
  }
  void push(Message<G> message, double now_s);
  std::vector<Message<G>> take(double now_s);
  std::uint64_t lost() const { return lost_; }

 private:
  double uniform();

  Impairment impairment_;
  std::mt19937_64 random_;
  std::multimap<double, Message<G>> due_;
  std::uint64_t lost_ = 0;
};

/// Any exchange, with what it receives impaired.
template <class G>
class ImpairedExchange final : public SubmapExchange<G> {
 public:
  ImpairedExchange(std::unique_ptr<SubmapExchange<G>> inner, const Impairment& impairment)
      : inner_(std::move(inner)), queue_(impairment) {}
  SendStatus send(const Message<G>& message) override { return inner_->send(message); }
  std::vector<Message<G>> take(double now_s) override;
  ExchangeCounters counters() const override;

 private:
  std::unique_ptr<SubmapExchange<G>> inner_;
  ImpairedQueue<G> queue_;
};

}  // namespace convoy
