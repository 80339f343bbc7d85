#include <convoy/config_error.hpp>
#include <convoy/exchange/outbox.hpp>
#include <convoy/geometry/groups.hpp>

#include <Eigen/LU>

#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

constexpr std::size_t max_requests = 64;             // they are repeated
constexpr std::size_t at_once_without_budget = 500;  // the size of what is said again in one go, in landmarks
constexpr double reserved = 0.1;     // share of the budget that what the network spends by itself cannot take
constexpr double max_debt_s = 10.0;  // of the budget, that what it spends by itself can lead to

template <class Fact>
struct IsLandmarks : std::false_type {};
template <class G>
struct IsLandmarks<LandmarkBatch<G>> : std::true_type {};

/// How many landmarks take about as many bytes: an anchor as many as four, what a batch has in common three, seven
/// pairings one.
template <class G>
std::size_t size_in_landmarks(const Message<G>& message) {
  if (const auto* batch = std::get_if<LandmarkBatch<G>>(&message.payload)) return 3 + batch->landmarks.size();
  const auto* association = std::get_if<AssociationFact>(&message.payload);
  return 4 + (association != nullptr ? association->pairings.size() / 7 : 0);
}

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
Outbox<G>::Outbox(const BudgetParams& params)
    : params_(params), tokens_(params.bytes_per_s * params.burst_s), reserve_(reserved * tokens_) {
  validate(params);
}

// Own facts are handed in once, in their order; whatever comes again was asked for.
template <class G>
auto Outbox<G>::place_of(const ChainId& sender, FactKind kind, const Key& key) -> Facts& {
  std::uint32_t& next = next_news_[static_cast<std::size_t>(kind)];
  const bool fresh = returning_ ? news_were_last_ : key.chain == sender && key.index >= next;
  if (key.chain == sender) next = std::max(next, key.index + 1);
  return fresh ? news_ : repeats_;
}

template <class G>
bool Outbox<G>::note(FactKind kind, const Key& key) {
  if (waiting_.contains({kind, key}) || (!returning_ && away_.contains({kind, key}))) {
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
  if (note(kind_of<Fact>, fact.key)) {
    auto& queue = place_of(sender, kind_of<Fact>, fact.key).others;
    queue.insert(returning_ ? queue.begin() : queue.end(), {sender, fact});
  }
  return counters_.dropped == dropped;
}

template <class G>
bool Outbox<G>::put_landmarks(const ChainId& sender, const LandmarkBatch<G>& batch) {
  const std::uint64_t dropped = counters_.dropped;
  for (const LandmarkFact<G>& landmark : batch.landmarks) {
    if (!note(FactKind::landmark, landmark.key)) continue;
    Batch& place = place_of(sender, FactKind::landmark, landmark.key).batches[landmark.anchor_key()];
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
std::optional<std::uint64_t> Outbox<G>::repeats_waiting() const {
  if (params_.bytes_per_s <= 0.0) return std::nullopt;
  std::uint64_t sum = repeats_.others.size();
  for (const auto& [anchor, batch] : repeats_.batches) sum += batch.landmarks.size();
  return sum;
}

template <class G>
void Outbox<G>::put_back(std::vector<Message<G>> messages) {
  for (auto message = messages.rbegin(); message != messages.rend(); ++message) put_back(std::move(*message));
}

template <class G>
void Outbox<G>::put_back(Message<G> message) {
  const bool superseded = (std::holds_alternative<Digest>(message.payload) && digest_) ||
                          (std::holds_alternative<LivePose<G>>(message.payload) && live_);
  if (superseded) {
    ++counters_.replaced;
    return;
  }
  returning_ = true;
  put(std::move(message));
  returning_ = false;
}

template <class G>
bool Outbox<G>::waits(Traffic traffic) const {
  switch (traffic) {
    case control: return digest_.has_value() || !requests_.empty();
    case facts: return !news_.empty() || !repeats_.empty();
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
  const double passed_s = at_s_ ? std::max(0.0, now_s - *at_s_) : 0.0;
  at_s_ = now_s;
  const double rate = params_.bytes_per_s;
  tokens_ = std::min(rate * params_.burst_s, tokens_ + rate * passed_s);
  reserve_ = std::min(reserved * rate * params_.burst_s, reserve_ + reserved * rate * passed_s);
  if (last_) {
    spent_[*last_] += bytes / weight[*last_];
    tokens_ -= bytes;
    reserve_ =
        std::max(reserve_ - bytes, -std::max(rate, bytes));  // who speaks as usual lives on less within ten seconds
  } else {
    tokens_ = std::max(tokens_ - bytes, std::min(tokens_, -max_debt_s * rate));
  }
  last_.reset();
}

template <class G>
std::vector<Message<G>> Outbox<G>::next(double now_s, std::uint64_t bytes_sent) {
  spend(now_s, bytes_sent);
  away_.clear();
  const bool in_debt = params_.bytes_per_s > 0.0 && tokens_ <= 0.0;
  if (in_debt && reserve_ <= 0.0) return {};
  std::optional<Traffic> chosen;
  for (const Traffic traffic : {control, facts, live})
    if (waits(traffic) && (!chosen || spent_[traffic] < spent_[*chosen])) chosen = traffic;
  if (!chosen) return {};
  // Who did not use its share does not save it up.
  for (double& spent : spent_) spent = std::max(spent, spent_[*chosen]);
  last_ = chosen;
  std::vector<Message<G>> messages = take(*chosen);
  if (in_debt) counters_.in_debt += messages.size();
  return messages;
}

namespace {

template <class M>
M pop(std::deque<M>& queue) {
  M message = std::move(queue.front());
  queue.pop_front();
  return message;
}

template <class M>
M hand_over(std::optional<M>& place) {
  M message = std::move(*place);
  place.reset();
  return message;
}

}  // namespace

template <class G>
std::vector<Message<G>> Outbox<G>::take(Traffic traffic) {
  if (traffic == facts) return take_facts();
  return {traffic == control ? take_control() : hand_over(live_)};
}

template <class G>
Message<G> Outbox<G>::take_control() {
  digest_was_last_ = digest_ && (requests_.empty() || !digest_was_last_);
  return digest_was_last_ ? hand_over(digest_) : pop(requests_);
}

// News go singly, so that what is refused is no more than what goes again. Without a budget nothing waits for its turn,
// and what is said again fills its frames.
template <class G>
std::vector<Message<G>> Outbox<G>::take_facts() {
  const bool both_wait = !news_.empty() && !repeats_.empty();
  news_were_last_ = !news_.empty() && (!both_wait || news_ahead_ <= 0);
  Facts& from = news_were_last_ ? news_ : repeats_;
  const std::size_t of_repeats = params_.bytes_per_s > 0.0 ? params_.batch_limit : at_once_without_budget;
  const std::size_t limit = news_were_last_ ? 1 : of_repeats;
  std::vector<Message<G>> messages;
  std::size_t size = 0;
  for (; !from.empty() && size < limit; size += size_in_landmarks(messages.back())) messages.push_back(take_fact(from));
  const auto taken = static_cast<std::int64_t>(size);
  news_ahead_ = both_wait ? news_ahead_ + (news_were_last_ ? taken : -taken) : 0;
  return messages;
}

template <class G>
Message<G> Outbox<G>::take_fact(Facts& from) {
  Message<G> message = from.others.empty() ? take_landmarks(from.batches) : pop(from.others);
  message.repeated = !news_were_last_;
  std::visit(
      [&](const auto& fact) {
        if constexpr (requires { fact.key; })
          away_.insert(waiting_.extract({kind_of<std::decay_t<decltype(fact)>>, fact.key}));
      },
      message.payload);
  counters_.facts_waiting = waiting_.size();
  return message;
}

template <class G>
Message<G> Outbox<G>::take_landmarks(std::map<Key, Batch>& batches) {
  const auto best = std::min_element(batches.begin(), batches.end(), [](const auto& a, const auto& b) {
    return a.second.landmarks.begin()->first < b.second.landmarks.begin()->first;
  });
  auto& landmarks = best->second.landmarks;
  LandmarkBatch<G> batch;
  while (!landmarks.empty() && batch.landmarks.size() < params_.batch_limit) {
    away_.insert(waiting_.extract({FactKind::landmark, landmarks.begin()->second.key}));
    batch.landmarks.push_back(std::move(landmarks.begin()->second));
    landmarks.erase(landmarks.begin());
  }
  Message<G> message{best->second.sender, std::move(batch)};
  if (landmarks.empty()) batches.erase(best);
  counters_.facts_waiting = waiting_.size();
  return message;
}

#define CONVOY_INSTANTIATE(G) template class Outbox<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
