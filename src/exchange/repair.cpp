#include <convoy/config_error.hpp>
#include <convoy/exchange/repair.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>
#include <tuple>

namespace convoy {
namespace {

constexpr std::size_t ranges_per_request = 64;  // what the wire holds
constexpr double silent_after = 3.0;            // idle periods without a digest: the peer is gone
constexpr double prompt_within = 0.2;           // s; a digest for somebody new
constexpr double prompt_apart = 0.5;            // s; however many are new
constexpr double lost_period_s = 60.0;          // between two requests for what is declared missing
constexpr double relapse_after = 2.0;           // longest backoffs without more of what was declared missing
constexpr double share_of_asks = 0.8;  // that another's request takes from this vehicle's: it is answered for all
constexpr double least_share = 0.05;   // of them is left to each, whatever others ask for
constexpr std::uint32_t block = 32;    // indices that one answers at once
constexpr std::size_t max_known_peers = 1024;

/// Calls visit(index) for each held index of `ranges`, ascending, each once, as long as it says true.
template <class Sequence, class Visit>
void for_each_held(const Sequence& held, const std::vector<IndexRange>& ranges, Visit visit) {
  std::uint32_t next = 0;
  for (const IndexRange& range : ranges) {
    for (auto it = held.lower_bound(std::max(range.first, next)); it != held.end() && it->first < range.end; ++it)
      if (!visit(it->first)) return;
    next = std::max(next, range.end);
  }
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
  demand(p.asks_per_s > 0.0, "asks_per_s", p.asks_per_s, "be > 0");
  demand(p.max_answers >= 1, "max_answers", p.max_answers, "be >= 1");
  demand(p.answers_per_s > 0.0, "answers_per_s", p.answers_per_s, "be > 0");
  demand(p.resend_s >= 0.0, "resend_s", p.resend_s, "be >= 0");
  demand(p.requests_per_s > 0.0, "requests_per_s", p.requests_per_s, "be > 0");
  demand(p.lost_after_s > 0.0, "lost_after_s", p.lost_after_s, "be > 0");
  demand(p.batch_limit >= 1 && p.batch_limit <= 64, "batch_limit", p.batch_limit, "lie in 1..64");
}

RepairParams under_budget(RepairParams params, double bytes_per_s) {
  if (bytes_per_s <= 0.0) return params;
  constexpr double landmark_bytes = 60.0, share_of_facts = 2.0 / 3.0;
  const double block_s = block * landmark_bytes / (share_of_facts * bytes_per_s);
  params.relay_delay_s = std::max(params.relay_delay_s, 2.0 * block_s);
  params.resend_s = std::max(params.resend_s, 2.0 * block_s);
  params.asks_per_s = std::min(params.asks_per_s, 50.0);
  return params;
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
void RepairProtocol<G>::Allowance::refill(double per_s, double now_s) {
  left = std::min(std::max(1.0, per_s), left + per_s * (now_s - at_s));
  at_s = now_s;
}

template <class G>
void RepairProtocol<G>::Allowance::spend(double share, double per_s, double now_s) {
  refill(per_s, now_s);
  left = std::max(-per_s, left - share);
}

template <class G>
bool RepairProtocol<G>::Allowance::take(double per_s, double now_s) {
  refill(per_s, now_s);
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
  if (store.is_full_of_rumours()) forget_rumours(store);
  std::array<std::uint32_t, fact_kind_count> own{};
  bool speaks_of_itself = false;
  for (const ChainMark& mark : digest.marks) {
    ask_for_lost(store, mark, now_s);
    if (mark.chain != sender) {
      store.announce(mark.chain, mark.kind, mark.high_water);
    } else if (static_cast<int>(mark.kind) < fact_kind_count) {
      speaks_of_itself = true;
      own[static_cast<std::size_t>(mark.kind)] = mark.high_water;
    }
  }
  // What it does not list of its own it has none of, whatever others say.
  for (int k = 0; speaks_of_itself && k < fact_kind_count; ++k)
    store.announce_own(sender, static_cast<FactKind>(k), own[static_cast<std::size_t>(k)]);
  note_told(store, digest.marks, now_s);
  if (sender == self_ || (peers_.size() >= max_known_peers && !peers_.contains(sender))) return;
  if (!heard_lately(sender, now_s)) {
    tell_soon(now_s);
    ask_again(now_s);
  }
  peers_[sender] = {digest.holdings, now_s};
}

// What was given up is held by somebody after all.
template <class G>
void RepairProtocol<G>::ask_for_lost(const FactStore<G>& store, const ChainMark& mark, double now_s) {
  const auto wanted = wanted_.find({mark.chain, mark.kind});
  if (wanted == wanted_.end() || !wanted->second.lost) return;
  const auto chain = store.chains().find(mark.chain);
  if (chain == store.chains().end()) return;
  if (mark.count > chain->second.marks[static_cast<std::size_t>(mark.kind)].count)
    wanted->second.next_s = std::min(wanted->second.next_s, now_s + params_.grace_s * (1.0 + uniform()));
}

// Notes the chains of which the marks, which of one chain lie together, say what is held here, too.
template <class G>
void RepairProtocol<G>::note_told(const FactStore<G>& store, const std::vector<ChainMark>& marks, double now_s) {
  for (auto begin = marks.begin(); begin != marks.end();) {
    const ChainId chain = begin->chain;
    const auto end = std::find_if(begin, marks.end(), [&](const ChainMark& mark) { return mark.chain != chain; });
    if (store.chains().contains(chain)) {
      const auto held = store.marks_of(chain);
      if (std::equal(begin, end, held.begin(), held.end())) told_s_[chain] = now_s;
    }
    begin = end;
  }
}

template <class G>
void RepairProtocol<G>::tell_soon(double now_s) {
  prompt_s_ = std::min(prompt_s_, std::max(now_s + prompt_within * uniform(), digest_s_ + prompt_apart));
}

// Somebody new may hold what nobody else does.
template <class G>
void RepairProtocol<G>::ask_again(double now_s) {
  for (auto& [sequence, wanted] : wanted_) {
    wanted.next_s = std::min(wanted.next_s, now_s + params_.grace_s * (1.0 + uniform()));
    wanted.backoff_s = params_.backoff_min_s;
  }
}

// Chains of which nobody has served anything for so long that they are given up.
template <class G>
void RepairProtocol<G>::forget_rumours(FactStore<G>& store) {
  for (auto it = wanted_.begin(); it != wanted_.end();) {
    const ChainId chain = it->first.first;
    const auto end = wanted_.upper_bound({chain, static_cast<FactKind>(fact_kind_count)});
    const bool lost = std::all_of(it, end, [](const auto& wanted) { return wanted.second.lost; });
    if (lost && store.chains().at(chain).facts == 0) {
      wanted_.erase(it, end);
      store.forget_rumours(chain);
    }
    it = end;
  }
}

// One request is answered for all who lack the same, so that the second who asks for it waits once.
template <class G>
void RepairProtocol<G>::put_off(const FactStore<G>& store, const Request& request, double now_s) {
  const auto it = wanted_.find({request.target, request.kind});
  if (it == wanted_.end() || it->second.put_off) return;
  auto missing = store.missing(request.target, request.kind, 1, it->second.from);
  if (missing.empty()) missing = store.missing(request.target, request.kind, 1);
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
  if (askers_.size() >= max_known_peers) std::erase_if(askers_, [](const auto& a) { return a.second.queue.empty(); });
  if (!askers_[sender.vehicle].requests.take(params_.requests_per_s, now_s)) {
    ++counters_.requests_refused;
    return;
  }
  if (static_cast<int>(request.kind) >= fact_kind_count) return;
  put_off(store, request, now_s);
  asks_.spend(share_of_asks, params_.asks_per_s, now_s);
  const auto chain = store.chains().find(request.target);
  if (chain == store.chains().end()) return;
  const bool own = request.target == self_;
  if (own && !request.ranges.empty() &&
      request.ranges.back().end > chain->second.marks[static_cast<std::size_t>(request.kind)].high_water)
    tell_soon(now_s);  // who asks for what was never written has been misled
  if (!own && request.in_vain == 0) return;
  forget_served(now_s);
  // What lies together is drawn together: it fits one message.
  std::uint32_t drawn = ~std::uint32_t{0};
  double at_s = now_s;
  bool insist = false;
  const auto& queue = askers_[sender.vehicle].queue;
  FactStore<G>::with_sequence(chain->second, request.kind, [&](const auto& held) {
    for_each_held(held, request.ranges, [&](std::uint32_t index) {
      const FactId fact{request.kind, Key{request.target, index}};
      if (!own && index / block != drawn) {
        at_s = relay_at(now_s);
        insist = request.in_vain >= 3 && uniform() * crowd() < 3.0;
      }
      drawn = index / block;
      if (!served_.contains(fact)) enqueue(sender.vehicle, fact, at_s, insist);
      return queue.size() < params_.max_answers;
    });
  });
}

// A fact that several ask for is served in the turn of whoever has the shortest queue.
template <class G>
void RepairProtocol<G>::enqueue(VehicleId asker, const FactId& fact, double at_s, bool insist) {
  const auto [it, fresh] = answers_.try_emplace(fact, Answer{asker, at_s, insist});
  Answer& answer = it->second;
  if (!fresh) {
    answer.insist |= insist;
    auto& theirs = askers_[answer.asker].queue;
    if (askers_[asker].queue.size() >= theirs.size()) return;
    theirs.erase({answer.at_s, fact});
    answer.asker = asker;
  }
  askers_[asker].queue.insert({answer.at_s, fact});
}

template <class G>
double RepairProtocol<G>::crowd() const {
  return static_cast<double>(std::max<std::size_t>(peers_.size(), 2));
}

// Few of many shall answer, whatever their number N: of delays relay_delay_s (1 + ln u / ln N) one on average is not
// above zero, and N^(t / relay_delay_s) are not above t (Nonnenmacher and Biersack, "Scalable feedback", 1999).
template <class G>
double RepairProtocol<G>::relay_at(double now_s) {
  const double u = std::max(uniform(), 1e-9);
  return now_s + params_.relay_delay_s * std::max(0.0, 1.0 + std::log(u) / std::log(crowd()));
}

template <class G>
void RepairProtocol<G>::on_heard(const ChainId& sender, double now_s) {
  if (const auto peer = peers_.find(sender); peer != peers_.end()) peer->second.heard_s = now_s;
}

template <class G>
void RepairProtocol<G>::on_fact_seen(FactKind kind, const Key& key) {
  const auto it = answers_.find({kind, key});
  if (it == answers_.end() || it->second.insist) return;
  askers_[it->second.asker].queue.erase({it->second.at_s, it->first});
  answers_.erase(it);
  ++counters_.answers_suppressed;
}

template <class G>
std::vector<Payload<G>> RepairProtocol<G>::due(const FactStore<G>& store, double now_s, Room room) {
  std::vector<Payload<G>> out;
  request_missing(store, now_s, out);
  answer(store, now_s, room, out);
  last_s_ = now_s;
  return out;
}

template <class G>
bool RepairProtocol<G>::all_agree(const FactStore<G>& store, double now_s) const {
  return std::all_of(peers_.begin(), peers_.end(), [&](const auto& peer) {
    return peer.second.holdings == store.holdings() || !heard_lately(peer.first, now_s);
  });
}

// One's own chain, which others hear of from nobody sooner. Then half of the others in turn, and half of them those of
// which nobody has told the same for longest: so a fleet tells each chain once, and not each vehicle all of them, as
// far as they hear each other.
template <class G>
std::vector<ChainMark> RepairProtocol<G>::marks_to_tell(const FactStore<G>& store, double now_s) {
  std::vector<ChainMark> marks = store.marks_of(self_);
  const auto& chains = store.chains();
  std::uint32_t told = marks.empty() ? 0 : 1;
  const auto tell = [&](const ChainId& chain) {
    const auto more = chain == self_ ? std::vector<ChainMark>{} : store.marks_of(chain);
    marks.insert(marks.end(), more.begin(), more.end());
    told_s_[chain] = now_s;
    told += !more.empty();
  };
  // Not all begin with the same one.
  auto it = chains.upper_bound(turn_);
  if (!std::exchange(told_of_others_, true))
    it = std::next(chains.begin(), static_cast<std::ptrdiff_t>(uniform() * static_cast<double>(chains.size())));
  const std::uint32_t in_turn = chains.size() <= params_.max_chains ? params_.max_chains : (params_.max_chains + 2) / 2;
  for (std::size_t n = chains.size(); n > 0 && told < in_turn; --n, ++it) {
    if (it == chains.end()) it = chains.begin();
    turn_ = it->first;
    tell(turn_);
  }
  if (told_s_.size() > chains.size()) std::erase_if(told_s_, [&](const auto& c) { return !chains.contains(c.first); });
  std::vector<std::pair<double, ChainId>> untold;
  if (told < params_.max_chains)
    for (const auto& [chain, held] : chains)
      if (const auto told_s = told_s_.try_emplace(chain, -1.0).first->second; told_s < now_s)
        untold.emplace_back(told_s, chain);
  std::sort(untold.begin(), untold.end());
  // Others choose from the same at the same time.
  const double choice = crowd() * static_cast<double>(params_.max_chains - told);
  untold.resize(std::min(untold.size(), static_cast<std::size_t>(choice)));
  for (; !untold.empty() && told < params_.max_chains; untold.pop_back()) {
    std::swap(untold[static_cast<std::size_t>(uniform() * static_cast<double>(untold.size()))], untold.back());
    tell(untold.back().second);
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
  return marks_to_tell(store, now_s);
}

// From where the last request ended, so that what nobody has does not keep the rest from being asked for.
template <class G>
void RepairProtocol<G>::request(const FactStore<G>& store, const SequenceId& sequence, Wanted& wanted,
                                bool author_is_there, std::vector<Payload<G>>& out) {
  const auto& [chain, kind] = sequence;
  auto ranges = store.missing(chain, kind, params_.max_ranges, wanted.from);
  if (ranges.empty()) ranges = store.missing(chain, kind, params_.max_ranges);
  wanted.from = ranges.size() < params_.max_ranges ? 0 : ranges.back().end;
  const auto in_vain = std::max(wanted.in_vain, static_cast<std::uint8_t>(author_is_there ? 0 : 1));
  for (std::size_t at = 0; at < ranges.size(); at += ranges_per_request) {
    const auto first = ranges.begin() + static_cast<std::ptrdiff_t>(at);
    const auto count = static_cast<std::ptrdiff_t>(std::min(ranges_per_request, ranges.size() - at));
    out.push_back(Request{chain, kind, {first, first + count}, in_vain});
    ++counters_.requests_sent;
  }
}

// In turns, so that no sequence is left out when all that is missing cannot be asked for at once.
template <class G>
void RepairProtocol<G>::request_missing(const FactStore<G>& store, double now_s, std::vector<Payload<G>>& out) {
  const auto& chains = store.chains();
  auto it = chains.upper_bound(asked_last_);
  for (std::size_t n = chains.size(); n > 0; --n, ++it) {
    if (it == chains.end()) it = chains.begin();
    for (int k = 0; k < fact_kind_count; ++k)
      request_missing(store, {it->first, static_cast<FactKind>(k)}, it->second.marks[static_cast<std::size_t>(k)],
                      now_s, out);
  }
}

template <class G>
void RepairProtocol<G>::request_missing(const FactStore<G>& store, const SequenceId& sequence, const ChainMark& mark,
                                        double now_s, std::vector<Payload<G>>& out) {
  if (mark.count == mark.high_water) {
    wanted_.erase(sequence);
    return;
  }
  auto [it, fresh] = wanted_.try_emplace(sequence);
  Wanted& wanted = it->second;
  const std::uint32_t lacking = mark.high_water - mark.count;
  const auto wait = [&](double delay_s) {
    wanted.next_s = now_s + delay_s;
    wanted.backoff_s = params_.backoff_min_s;
    wanted.progress_s = now_s;
  };
  if (fresh) wait(params_.grace_s * (1.0 + uniform()));
  else if (lacking < wanted.lacking) wait(params_.backoff_min_s * (0.5 + 0.5 * uniform()));  // answers are flowing
  wanted.lacking = lacking;
  const bool author_is_there = heard_lately(sequence.first, now_s);
  if (author_is_there) {
    wanted.progress_s = now_s;
    wanted.given_up = false;
  }
  // Some that came after all say little of the rest.
  const double relapse_s = std::min(params_.lost_after_s, relapse_after * params_.backoff_max_s);
  const double patience_s = wanted.given_up ? relapse_s : params_.lost_after_s;
  wanted.lost = now_s >= wanted.progress_s + patience_s || store.is_full(sequence.first);
  wanted.given_up = wanted.given_up || wanted.lost;
  if (now_s < wanted.next_s) return;
  if (!asks_.take(params_.asks_per_s, now_s) && !least_asks_.take(least_share * params_.asks_per_s, now_s)) {
    ++counters_.requests_waiting;
    return;
  }
  asked_last_ = sequence.first;
  // Half of what was asked for, or all that can be served meanwhile, is a good answer.
  const std::uint32_t got = wanted.asked - std::min(wanted.asked, lacking);
  if (2 * got >= std::min(wanted.asked, 200U)) wanted.in_vain = 0;
  else if (got > 0) wanted.in_vain = std::min<std::uint8_t>(wanted.in_vain, 1);  // served slowly, on a short budget
  else wanted.in_vain += wanted.in_vain < 255;
  wanted.asked = lacking;
  request(store, sequence, wanted, author_is_there, out);
  wanted.put_off = false;
  wanted.next_s = now_s + (wanted.lost ? lost_period_s : wanted.backoff_s) * (0.75 + 0.5 * uniform());
  wanted.backoff_s = std::min(2.0 * wanted.backoff_s, params_.backoff_max_s);
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

// A block of each who asks, in turns.
template <class G>
void RepairProtocol<G>::answer(const FactStore<G>& store, double now_s, Room room, std::vector<Payload<G>>& out) {
  allowance_ = std::min(std::max(1.0, params_.answers_per_s),
                        allowance_ + params_.answers_per_s * std::max(0.0, now_s - last_s_));
  auto it = askers_.upper_bound(served_last_);
  for (std::size_t idle = 0; room != Room::none && idle < askers_.size() && allowance_ >= 1.0; ++it) {
    if (it == askers_.end()) it = askers_.begin();
    idle = serve_block(store, it->second, now_s, out) ? 0 : idle + 1;
    if (idle > 0) continue;
    served_last_ = it->first;
    if (room == Room::one_block) room = Room::none;
  }
}

/// False if nothing is due.
template <class G>
bool RepairProtocol<G>::serve_block(const FactStore<G>& store, Asker& asker, double now_s,
                                    std::vector<Payload<G>>& out) {
  const auto block_of = [](const FactId& fact) {
    return std::tuple(fact.first, fact.second.chain, fact.second.index / block);
  };
  std::optional<decltype(block_of(FactId{}))> of;
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
  while (!asker.queue.empty() && asker.queue.begin()->first <= now_s && allowance_ >= 1.0) {
    const FactId fact = asker.queue.begin()->second;
    if (of && *of != block_of(fact)) break;
    of = block_of(fact);
    const auto& [kind, key] = fact;
    FactStore<G>::with_sequence(store.chains().at(key.chain), kind, [&](const auto& held) { put(held.at(key.index)); });
    ++counters_.facts_served;
    counters_.facts_relayed += key.chain != self_;
    allowance_ -= 1.0;
    served_[fact] = now_s;
    order_.emplace_back(now_s, fact);
    asker.queue.erase(asker.queue.begin());
    answers_.erase(fact);
  }
  flush();
  return of.has_value();
}

#define CONVOY_INSTANTIATE(G) template class RepairProtocol<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
