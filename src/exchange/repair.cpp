#include <convoy/config_error.hpp>
#include <convoy/exchange/repair.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

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
  demand(p.grace_s >= 0.0, "grace_s", p.grace_s, "be >= 0");
  demand(p.backoff_min_s > 0.0, "backoff_min_s", p.backoff_min_s, "be > 0");
  demand(p.backoff_max_s >= p.backoff_min_s, "backoff_max_s", p.backoff_max_s, "be at least backoff_min_s");
  demand(p.relay_delay_s >= 0.0, "relay_delay_s", p.relay_delay_s, "be >= 0");
  demand(p.max_ranges >= 1 && p.max_ranges <= 64, "max_ranges", p.max_ranges, "lie in 1..64");
  demand(p.answers_per_s > 0.0, "answers_per_s", p.answers_per_s, "be > 0");
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
void RepairProtocol<G>::on_digest(FactStore<G>& store, const Digest& digest) {
  for (const ChainMark& mark : digest.marks) store.announce(mark.chain, mark.kind, mark.high_water);
}

template <class G>
void RepairProtocol<G>::on_request(const FactStore<G>& store, const Request& request, double now_s) {
  ++counters_.requests_heard;
  const auto chain = store.chains().find(request.target);
  if (chain == store.chains().end()) return;
  const bool own = request.target == self_;
  const auto schedule = [&](std::uint32_t index) {
    const double at = own ? now_s : now_s + params_.relay_delay_s * (0.25 + 0.75 * uniform());
    answers_.try_emplace({request.kind, Key{request.target, index}}, at);
  };
  switch (request.kind) {
    case FactKind::anchor: return for_each_held(chain->second.anchors, request.ranges, schedule);
    case FactKind::landmark: return for_each_held(chain->second.landmarks, request.ranges, schedule);
    case FactKind::prior: return for_each_held(chain->second.priors, request.ranges, schedule);
    case FactKind::association: return for_each_held(chain->second.associations, request.ranges, schedule);
    case FactKind::verdict: return for_each_held(chain->second.verdicts, request.ranges, schedule);
    case FactKind::absolute_fix: return for_each_held(chain->second.absolute_fixes, request.ranges, schedule);
    case FactKind::encounter: return for_each_held(chain->second.encounters, request.ranges, schedule);
    case FactKind::waypoint: return for_each_held(chain->second.waypoints, request.ranges, schedule);
  }
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
      if (fresh) wanted = {now_s + params_.grace_s * (1.0 + uniform()), params_.backoff_min_s, lacking};
      else if (lacking < wanted.lacking)  // answers are flowing: give them time
        wanted = {now_s + params_.backoff_min_s * (0.5 + 0.5 * uniform()), params_.backoff_min_s, lacking};
      wanted.lacking = lacking;
      if (now_s < wanted.next_s) continue;
      out.push_back(Request{id, kind, store.missing(id, kind, params_.max_ranges)});
      ++counters_.requests_sent;
      wanted.next_s = now_s + wanted.backoff_s * (0.75 + 0.5 * uniform());
      wanted.backoff_s = std::min(2.0 * wanted.backoff_s, params_.backoff_max_s);
    }
  }
}

template <class G>
void RepairProtocol<G>::answer(const FactStore<G>& store, double now_s, std::vector<Payload<G>>& out) {
  const double burst = std::max(1.0, params_.answers_per_s);
  allowance_ = std::min(burst, allowance_ + params_.answers_per_s * std::max(0.0, now_s - last_s_));
  LandmarkBatch<G> batch;
  const auto flush = [&] {
    if (!batch.landmarks.empty()) out.push_back(std::exchange(batch, {}));
  };
  for (auto it = answers_.begin(); it != answers_.end() && allowance_ >= 1.0;) {
    const auto& [fact, at] = *it;
    if (at > now_s) {
      ++it;
      continue;
    }
    const auto& [kind, key] = fact;
    const auto& chain = store.chains().at(key.chain);
    switch (kind) {
      case FactKind::anchor: out.push_back(chain.anchors.at(key.index)); break;
      case FactKind::prior: out.push_back(chain.priors.at(key.index)); break;
      case FactKind::association: out.push_back(chain.associations.at(key.index)); break;
      case FactKind::verdict: out.push_back(chain.verdicts.at(key.index)); break;
      case FactKind::absolute_fix: out.push_back(chain.absolute_fixes.at(key.index)); break;
      case FactKind::encounter: out.push_back(chain.encounters.at(key.index)); break;
      case FactKind::waypoint: out.push_back(chain.waypoints.at(key.index)); break;
      case FactKind::landmark: {
        const auto& landmark = chain.landmarks.at(key.index);
        const auto& open = batch.landmarks;
        if (!open.empty() && (open.back().anchor_key() != landmark.anchor_key() || open.size() >= params_.batch_limit))
          flush();
        batch.landmarks.push_back(landmark);
        break;
      }
    }
    ++counters_.facts_served;
    counters_.facts_relayed += key.chain != self_;
    allowance_ -= 1.0;
    it = answers_.erase(it);
  }
  flush();
}

#define CONVOY_INSTANTIATE(G) template class RepairProtocol<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
