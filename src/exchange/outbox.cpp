#include <convoy/config_error.hpp>
#include <convoy/exchange/outbox.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/LU>

#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

constexpr std::size_t max_requests = 64;  // they are repeated

template <class Fact>
struct IsLandmarks : std::false_type {};
template <class G>
struct IsLandmarks<LandmarkBatch<G>> : std::true_type {};

}  // namespace

void validate(const BudgetParams& p) {
  const auto demand = [](bool holds, const char* name, double value, const char* range) {
    if (!(holds && std::isfinite(value))) throw RangeError("budget", name, value, range);
  };
  demand(p.bytes_per_s >= 0.0, "bytes_per_s", p.bytes_per_s, "be >= 0");
  demand(p.burst_s > 0.0, "burst_s", p.burst_s, "be > 0");
  demand(p.batch_limit >= 1 && p.batch_limit <= 64, "batch_limit", p.batch_limit, "lie in 1..64");
  demand(p.max_waiting >= 1, "max_waiting", static_cast<double>(p.max_waiting), "be >= 1");
}

template <class G>
Outbox<G>::Outbox(const BudgetParams& params) : params_(params), tokens_(params.bytes_per_s * params.burst_s) {
  validate(params);
}

template <class G>
bool Outbox<G>::note(FactKind kind, const Key& key) {
  if (waiting_.contains({kind, key})) {
    ++counters_.repeats;
    return false;
  }
  if (waiting_.size() >= params_.max_waiting) {
    ++counters_.dropped;
    return false;
  }
  waiting_.insert({kind, key});
  counters_.facts_waiting = waiting_.size();
  return true;
}

template <class G>
template <class Fact>
bool Outbox<G>::put_fact(const ChainId& sender, const Fact& fact) {
  const std::uint64_t dropped = counters_.dropped;
  if (note(kind_of<Fact>, fact.key)) facts_.push_back({sender, fact});
  return counters_.dropped == dropped;
}

template <class G>
bool Outbox<G>::put_landmarks(const ChainId& sender, const LandmarkBatch<G>& batch) {
  const std::uint64_t dropped = counters_.dropped;
  for (const LandmarkFact<G>& landmark : batch.landmarks) {
    if (!note(FactKind::landmark, landmark.key)) continue;
    Batch& place = batches_[landmark.anchor_key()];
    place.sender = sender;
    const double spread = std::log(std::max(landmark.covariance.determinant(), 1e-300));
    place.landmarks.emplace(spread, landmark);
  }
  return counters_.dropped == dropped;
}

template <class G>
bool Outbox<G>::put(Message<G> message) {
  return std::visit(
      [&](const auto& payload) {
        using P = std::decay_t<decltype(payload)>;
        if constexpr (std::is_same_v<P, Digest>) {
          counters_.replaced += digest_.has_value();
          digest_ = std::move(message);
        } else if constexpr (std::is_same_v<P, LivePose<G>>) {
          counters_.replaced += live_.has_value();
          live_ = std::move(message);
        } else if constexpr (std::is_same_v<P, Request>) {
          requests_.push_back(std::move(message));
          if (requests_.size() > max_requests) {
            requests_.pop_front();
            ++counters_.replaced;
          }
        } else if constexpr (IsLandmarks<P>::value) {
          return put_landmarks(message.sender, payload);
        } else {
          return put_fact(message.sender, payload);
        }
        return true;
      },
      message.payload);
}

template <class G>
void Outbox<G>::put_back(Message<G> message) {
  const bool superseded = (std::holds_alternative<Digest>(message.payload) && digest_) ||
                          (std::holds_alternative<LivePose<G>>(message.payload) && live_);
  if (superseded) ++counters_.replaced;
  else put(std::move(message));
}

template <class G>
bool Outbox<G>::waits(Traffic traffic) const {
  switch (traffic) {
    case control: return digest_.has_value() || !requests_.empty();
    case facts: return !facts_.empty() || !batches_.empty();
    case live: break;
  }
  return live_.has_value();
}

template <class G>
bool Outbox<G>::empty() const {
  return !waits(control) && !waits(facts) && !waits(live);
}

template <class G>
void Outbox<G>::spend(double now_s, std::uint64_t bytes_sent) {
  const double bytes = static_cast<double>(bytes_sent - std::min(bytes_sent, bytes_sent_));
  bytes_sent_ = bytes_sent;
  if (last_) spent_[*last_] += bytes / weight[*last_];
  last_.reset();
  const double passed_s = at_s_ ? std::max(0.0, now_s - *at_s_) : 0.0;
  at_s_ = now_s;
  tokens_ = std::min(params_.bytes_per_s * params_.burst_s, tokens_ + params_.bytes_per_s * passed_s) - bytes;
}

template <class G>
std::optional<Message<G>> Outbox<G>::next(double now_s, std::uint64_t bytes_sent) {
  spend(now_s, bytes_sent);
  if (params_.bytes_per_s > 0.0 && tokens_ <= 0.0) return std::nullopt;
  std::optional<Traffic> chosen;
  for (const Traffic traffic : {control, facts, live})
    if (waits(traffic) && (!chosen || spent_[traffic] < spent_[*chosen])) chosen = traffic;
  if (!chosen) return std::nullopt;
  // Who did not use its share does not save it up.
  for (double& spent : spent_) spent = std::max(spent, spent_[*chosen]);
  last_ = chosen;
  return take(*chosen);
}

template <class G>
Message<G> Outbox<G>::take(Traffic traffic) {
  const auto pop = [](std::deque<Message<G>>& queue) {
    Message<G> message = std::move(queue.front());
    queue.pop_front();
    return message;
  };
  const auto hand_over = [](std::optional<Message<G>>& place) {
    Message<G> message = std::move(*place);
    place.reset();
    return message;
  };
  if (traffic == live) return hand_over(live_);
  if (traffic == control) return requests_.empty() ? hand_over(digest_) : pop(requests_);
  if (facts_.empty()) return take_landmarks();
  Message<G> message = pop(facts_);
  std::visit(
      [&](const auto& fact) {
        if constexpr (requires { fact.key; }) waiting_.erase({kind_of<std::decay_t<decltype(fact)>>, fact.key});
      },
      message.payload);
  counters_.facts_waiting = waiting_.size();
  return message;
}

template <class G>
Message<G> Outbox<G>::take_landmarks() {
  const auto best = std::min_element(batches_.begin(), batches_.end(), [](const auto& a, const auto& b) {
    return a.second.landmarks.begin()->first < b.second.landmarks.begin()->first;
  });
  auto& landmarks = best->second.landmarks;
  LandmarkBatch<G> batch;
  while (!landmarks.empty() && batch.landmarks.size() < params_.batch_limit) {
    waiting_.erase({FactKind::landmark, landmarks.begin()->second.key});
    batch.landmarks.push_back(std::move(landmarks.begin()->second));
    landmarks.erase(landmarks.begin());
  }
  Message<G> message{best->second.sender, std::move(batch)};
  if (landmarks.empty()) batches_.erase(best);
  counters_.facts_waiting = waiting_.size();
  return message;
}

#define CONVOY_INSTANTIATE(G) template class Outbox<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
