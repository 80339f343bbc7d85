#include <convoy/config_error.hpp>
#include <convoy/exchange/repair.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

constexpr std::size_t ranges_per_request = 64;  // what the wire holds
constexpr double silent_after = 3.0;            // idle periods without a digest: the peer is gone
constexpr double prompt_within = 0.2;           // s; a digest for somebody new
constexpr double lost_period_s = 60.0;          // between two requests for what is declared missing
constexpr std::uint32_t relay_block = 32;       // indices that one relayer answers at once

/// Calls visit(index) for each held index of `ranges`.
template <class Sequence, class Visit>
void for_each_held(const Sequence& held, const std::vector<IndexRange>& ranges, Visit visit) {
  for (const IndexRange& range : ranges)
    for (auto it = held.lower_bound(range.first); it != held.end() && it->first < range.end; ++it) visit(it->first);
}

}  // namespace

void validate(const RepairParams& p) {
  const auto demand = [](bool holds, const char* name, double value, const char* range) {
    if (!(holds && std::isfinite(value))) throw RangeError("repair", name, value, range);
  };
  demand(p.digest_period_s > 0.0, "digest_period_s", p.digest_period_s, "be > 0");
  demand(p.digest_idle_s >= p.digest_period_s, "digest_idle_s", p.digest_idle_s, "be at least digest_period_s");
  demand(p.max_chains >= 1 && p.max_chains <= 256, "max_chains", p.max_chains, "lie in 1..256");
  demand(p.grace_s >= 0.0, "grace_s", p.grace_s, "be >= 0");
  demand(p.backoff_min_s > 0.0, "backoff_min_s", p.backoff_min_s, "be > 0");
  demand(p.backoff_max_s >= p.backoff_min_s, "backoff_max_s", p.backoff_max_s, "be at least backoff_min_s");
  demand(p.relay_delay_s >= 0.0, "relay_delay_s", p.relay_delay_s, "be >= 0");
  demand(p.max_ranges >= 1 && p.max_ranges <= 4096, "max_ranges", p.max_ranges, "lie in 1..4096");
  demand(p.answers_per_s > 0.0, "answers_per_s", p.answers_per_s, "be > 0");
  demand(p.resend_s >= 0.0, "resend_s", p.resend_s, "be >= 0");
  demand(p.requests_per_s > 0.0, "requests_per_s", p.requests_per_s, "be > 0");
  demand(p.lost_after_s > 0.0, "lost_after_s", p.lost_after_s, "be > 0");
  demand(p.batch_limit >= 1 && p.batch_limit <= 64, "batch_limit", p.batch_limit, "lie in 1..64");
}

template <class G>
RepairProtocol<G>::RepairProtocol(const ChainId& self, const RepairParams& params, std::uint64_t seed)
    : self_(self), params_(params), random_(seed) {
  validate(params);
}

template <class G>
double RepairProtocol<G>::uniform() {
  return static_cast<double>(random_() >> 11) * 0x1.0p-53;
}

template <class G>
bool RepairProtocol<G>::Allowance::take(double per_s, double now_s) {
  left = std::min(std::max(1.0, per_s), left + per_s * (now_s - at_s));
  at_s = now_s;
  if (left < 1.0) return false;
  left -= 1.0;
  return true;
}

template <class G>
bool RepairProtocol<G>::heard_lately(const ChainId& chain, double now_s) const {
  const auto peer = peers_.find(chain);
  return peer != peers_.end() && now_s < peer->second.heard_s + silent_after * params_.digest_idle_s;
}

template <class G>
void RepairProtocol<G>::on_digest(FactStore<G>& store, const ChainId& sender, const Digest& digest, double now_s) {
  for (const ChainMark& mark : digest.marks) store.announce(mark.chain, mark.kind, mark.high_water);
  if (sender == self_) return;
  if (!heard_lately(sender, now_s)) prompt_s_ = std::min(prompt_s_, now_s + prompt_within * uniform());
  peers_[sender] = {digest.holdings, now_s};
}

// One request is answered for all who lack the same, so that the second who asks for it waits once.
template <class G>
void RepairProtocol<G>::put_off(const FactStore<G>& store, const Request& request, double now_s) {
  const auto it = wanted_.find({request.target, request.kind});
  if (it == wanted_.end() || it->second.put_off) return;
  const auto missing = store.missing(request.target, request.kind, 1);
  const bool same = !missing.empty() && std::any_of(request.ranges.begin(), request.ranges.end(), [&](const auto& r) {
    return r.first <= missing[0].first && missing[0].first < r.end;
  });
  if (!same) return;
  it->second.put_off = true;
  it->second.next_s = std::max(it->second.next_s, now_s + params_.backoff_min_s * (1.0 + uniform()));
  ++counters_.requests_suppressed;
}

template <class G>
void RepairProtocol<G>::on_request(const FactStore<G>& store, const ChainId& sender, const Request& request,
                                   double now_s) {
  ++counters_.requests_heard;
  if (!askers_[sender.vehicle].take(params_.requests_per_s, now_s)) {
    ++counters_.requests_refused;
    return;
  }
  if (static_cast<int>(request.kind) >= fact_kind_count) return;
  put_off(store, request, now_s);
  const auto chain = store.chains().find(request.target);
  if (chain == store.chains().end()) return;
  const bool own = request.target == self_;
  if (!own && !request.anybody) return;
  forget_served(now_s);
  // What lies together is drawn together: it fits one message.
  std::uint32_t block = ~std::uint32_t{0};
  double at_s = now_s;
  FactStore<G>::with_sequence(chain->second, request.kind, [&](const auto& held) {
    for_each_held(held, request.ranges, [&](std::uint32_t index) {
      const FactId fact{request.kind, Key{request.target, index}};
      if (served_.contains(fact)) return;
      if (!own && index / relay_block != block) at_s = relay_at(now_s);
      block = index / relay_block;
      answers_.try_emplace(fact, at_s);
    });
  });
}

// Few of many shall answer, whatever their number N: of delays relay_delay_s (1 + ln u / ln N) one on average is not
// above zero, and N^(t / relay_delay_s) are not above t (Nonnenmacher and Biersack, "Scalable feedback", 1999).
template <class G>
double RepairProtocol<G>::relay_at(double now_s) {
  const double crowd = static_cast<double>(std::max<std::size_t>(peers_.size(), 2));
  const double u = std::max(uniform(), 1e-9);
  return now_s + params_.relay_delay_s * std::max(0.0, 1.0 + std::log(u) / std::log(crowd));
}

template <class G>
void RepairProtocol<G>::on_fact_seen(FactKind kind, const Key& key) {
  counters_.answers_suppressed += answers_.erase({kind, key});
}

template <class G>
std::vector<Payload<G>> RepairProtocol<G>::due(const FactStore<G>& store, double now_s) {
  std::vector<Payload<G>> out;
  request_missing(store, now_s, out);
  answer(store, now_s, out);
  last_s_ = now_s;
  return out;
}

template <class G>
bool RepairProtocol<G>::all_agree(const FactStore<G>& store, double now_s) const {
  return std::all_of(peers_.begin(), peers_.end(), [&](const auto& peer) {
    return peer.second.holdings == store.holdings() || !heard_lately(peer.first, now_s);
  });
}

// One's own chain, which others hear of from nobody sooner, then the others in turn.
template <class G>
std::vector<ChainMark> RepairProtocol<G>::marks_to_tell(const FactStore<G>& store) {
  std::vector<ChainMark> marks = store.marks_of(self_);
  const auto& chains = store.chains();
  std::uint32_t told = chains.contains(self_);
  auto it = chains.upper_bound(turn_);
  for (std::size_t n = chains.size(); n > 0 && told < params_.max_chains; --n, ++it) {
    if (it == chains.end()) it = chains.begin();
    if (it->first == self_) continue;
    const auto more = store.marks_of(it->first);
    marks.insert(marks.end(), more.begin(), more.end());
    turn_ = it->first;
    ++told;
  }
  return marks;
}

template <class G>
std::optional<std::vector<ChainMark>> RepairProtocol<G>::digest_due(const FactStore<G>& store, double now_s) {
  const bool nothing_to_tell = store.revision() == told_revision_ && all_agree(store, now_s);
  const double period_s = nothing_to_tell ? params_.digest_idle_s : params_.digest_period_s;
  const bool prompt = now_s >= prompt_s_;
  if (!prompt && now_s < digest_s_ + period_s * digest_jitter_) return std::nullopt;
  digest_s_ = now_s;
  digest_jitter_ = 0.9 + 0.2 * uniform();
  prompt_s_ = std::numeric_limits<double>::infinity();
  std::erase_if(peers_, [&](const auto& peer) { return !heard_lately(peer.first, now_s); });
  if (nothing_to_tell && !prompt) return std::vector<ChainMark>{};
  told_revision_ = store.revision();
  return marks_to_tell(store);
}

template <class G>
void RepairProtocol<G>::request(const FactStore<G>& store, const SequenceId& sequence, bool anybody,
                                std::vector<Payload<G>>& out) {
  const auto ranges = store.missing(sequence.first, sequence.second, params_.max_ranges);
  for (std::size_t at = 0; at < ranges.size(); at += ranges_per_request) {
    const auto first = ranges.begin() + static_cast<std::ptrdiff_t>(at);
    const auto count = static_cast<std::ptrdiff_t>(std::min(ranges_per_request, ranges.size() - at));
    out.push_back(Request{sequence.first, sequence.second, {first, first + count}, anybody});
    ++counters_.requests_sent;
  }
}

template <class G>
void RepairProtocol<G>::request_missing(const FactStore<G>& store, double now_s, std::vector<Payload<G>>& out) {
  for (const auto& [id, chain] : store.chains()) {
    for (int k = 0; k < fact_kind_count; ++k) {
      const auto kind = static_cast<FactKind>(k);
      const ChainMark& mark = chain.marks[static_cast<std::size_t>(k)];
      if (mark.count == mark.high_water) {
        wanted_.erase({id, kind});
        continue;
      }
      auto [it, fresh] = wanted_.try_emplace({id, kind});
      Wanted& wanted = it->second;
      const std::uint32_t lacking = mark.high_water - mark.count;
      if (fresh) wanted = {now_s + params_.grace_s * (1.0 + uniform()), params_.backoff_min_s, lacking, now_s};
      else if (lacking < wanted.lacking)  // answers are flowing: give them time
        wanted = {now_s + params_.backoff_min_s * (0.5 + 0.5 * uniform()), params_.backoff_min_s, lacking, now_s};
      wanted.lacking = lacking;
      wanted.lost = now_s >= wanted.progress_s + params_.lost_after_s && !heard_lately(id, now_s);
      if (now_s < wanted.next_s) continue;
      request(store, {id, kind}, wanted.in_vain || !heard_lately(id, now_s), out);
      wanted.put_off = false;
      wanted.in_vain = true;
      wanted.next_s = now_s + (wanted.lost ? lost_period_s : wanted.backoff_s) * (0.75 + 0.5 * uniform());
      wanted.backoff_s = std::min(2.0 * wanted.backoff_s, params_.backoff_max_s);
    }
  }
}

template <class G>
std::uint64_t RepairProtocol<G>::lost_count() const {
  std::uint64_t sum = 0;
  for (const auto& [sequence, wanted] : wanted_) sum += wanted.lost ? wanted.lacking : 0;
  return sum;
}

template <class G>
std::uint64_t RepairProtocol<G>::lost_count(const ChainId& chain) const {
  std::uint64_t sum = 0;
  for (auto it = wanted_.lower_bound({chain, FactKind::anchor}); it != wanted_.end() && it->first.first == chain; ++it)
    sum += it->second.lost ? it->second.lacking : 0;
  return sum;
}

template <class G>
void RepairProtocol<G>::forget_served(double now_s) {
  for (; !order_.empty() && order_.front().first + params_.resend_s <= now_s; order_.pop_front()) {
    const auto served = served_.find(order_.front().second);
    if (served != served_.end() && served->second == order_.front().first) served_.erase(served);
  }
}

template <class G>
void RepairProtocol<G>::answer(const FactStore<G>& store, double now_s, std::vector<Payload<G>>& out) {
  allowance_ = std::min(std::max(1.0, params_.answers_per_s),
                        allowance_ + params_.answers_per_s * std::max(0.0, now_s - last_s_));
  LandmarkBatch<G> batch;
  const auto flush = [&] {
    if (!batch.landmarks.empty()) out.push_back(std::exchange(batch, {}));
  };
  const auto put = [&](const auto& fact) {
    if constexpr (kind_of<std::decay_t<decltype(fact)>> != FactKind::landmark) {
      out.push_back(fact);
    } else {
      const auto& open = batch.landmarks;
      if (!open.empty() && (open.back().anchor_key() != fact.anchor_key() || open.size() >= params_.batch_limit))
        flush();
      batch.landmarks.push_back(fact);
    }
  };
  for (auto it = answers_.begin(); it != answers_.end() && allowance_ >= 1.0;) {
    if (it->second > now_s) {
      ++it;
      continue;
    }
    const auto& [kind, key] = it->first;
    FactStore<G>::with_sequence(store.chains().at(key.chain), kind, [&](const auto& held) { put(held.at(key.index)); });
    ++counters_.facts_served;
    counters_.facts_relayed += key.chain != self_;
    allowance_ -= 1.0;
    served_[it->first] = now_s;
    order_.emplace_back(now_s, it->first);
    it = answers_.erase(it);
  }
  flush();
}

#define CONVOY_INSTANTIATE(G) template class RepairProtocol<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
