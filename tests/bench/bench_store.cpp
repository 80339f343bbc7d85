// Keeping a landmark: insertion with all checks, the content hash that makes up the digest, and the high-water marks.
// The baseline keeps the same facts in a std::unordered_map, with no check and no digest.
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/fact_store.hpp>

#include <malloc.h>

#include <unordered_map>

#include "ratio.hpp"

namespace {

using namespace convoy;

constexpr int facts_per_call = 1000;
constexpr std::uint32_t batch_size = 16;

std::vector<LandmarkFact<SE2>> landmarks() {
  std::vector<LandmarkFact<SE2>> facts(facts_per_call);
  for (std::uint32_t i = 0; i < facts_per_call; ++i) {
    facts[i].key = {{1 + i % 5, 1}, i / 5};
    facts[i].anchor = 1 + facts[i].key.index / batch_size;
    facts[i].position = {0.1 * i, 3.0};
    facts[i].covariance = 0.04 * SE2::PointCovariance::Identity();
  }
  return facts;
}

double allocated_bytes() {
  const struct mallinfo2 info = mallinfo2();
  return static_cast<double>(info.uordblks + info.hblkhd);
}

struct KeyHash {
  std::size_t operator()(const Key& key) const {
    return std::hash<std::uint64_t>()((key.chain.epoch << 40) ^ (std::uint64_t{key.chain.vehicle} << 32) ^ key.index);
  }
};

void into_unordered_map(const std::vector<LandmarkFact<SE2>>& facts) {
  std::unordered_map<Key, LandmarkFact<SE2>, KeyHash> kept;
  for (const auto& fact : facts) kept.emplace(fact.key, fact);
  benchmark::DoNotOptimize(kept.size());
}

/// `subject` treats facts_per_call facts, and so does the baseline.
template <class Subject>
void against_unordered_map(benchmark::State& state, const std::vector<LandmarkFact<SE2>>& facts,
                           const Subject& subject) {
  convoy::bench::against(state, "std::unordered_map insertion of as many facts", subject,
                         [&] { into_unordered_map(facts); });
  state.SetItemsProcessed(state.iterations() * facts_per_call);
}

void BM_insert(benchmark::State& state) {
  const auto facts = landmarks();
  std::uint64_t kept = 0;
  against_unordered_map(state, facts, [&] {
    FactStore<SE2> store;
    for (const auto& fact : facts) store.insert(fact);
    kept = store.size();
    benchmark::DoNotOptimize(store.digest());
  });
  if (kept != facts_per_call) state.SkipWithError("facts were refused");
}
BENCHMARK(BM_insert)->Unit(benchmark::kMicrosecond);

/// A fact that is there already: what a duplicate or a relay costs.
void BM_insert_duplicate(benchmark::State& state) {
  const auto facts = landmarks();
  FactStore<SE2> store;
  for (const auto& fact : facts) store.insert(fact);
  against_unordered_map(state, facts, [&] {
    for (const auto& fact : facts) benchmark::DoNotOptimize(store.insert(fact));
  });
  if (store.size() != facts_per_call) state.SkipWithError("duplicates were kept");
}
BENCHMARK(BM_insert_duplicate)->Unit(benchmark::kMicrosecond);

void BM_digest(benchmark::State& state) {
  const auto facts = landmarks();
  against_unordered_map(state, facts, [&] {
    Hash digest = 0;
    for (const auto& fact : facts) digest += hash_of(fact);
    benchmark::DoNotOptimize(digest);
  });
}
BENCHMARK(BM_digest)->Unit(benchmark::kMicrosecond);

template <class G>
LandmarkFact<G> one_of_a_million(std::uint32_t i) {
  LandmarkFact<G> f;
  f.key = {{1 + i % 5, 1}, i / 5};
  f.anchor = 1 + f.key.index / batch_size;
  f.position.setConstant(0.1 * (i % 1000));
  f.covariance = 0.04 * G::PointCovariance::Identity();
  f.descriptor.kind = Descriptor::Kind::patch_8x8_4bit;
  f.descriptor.bytes.fill(static_cast<std::uint8_t>(i));
  return f;
}

template <class G>
double bytes_in_unordered_map(std::uint32_t total) {
  const double before = allocated_bytes();
  std::unordered_map<Key, LandmarkFact<G>, KeyHash> kept;
  for (std::uint32_t i = 0; i < total; ++i) kept.emplace(one_of_a_million<G>(i).key, one_of_a_million<G>(i));
  return allocated_bytes() - before;
}

// A million landmarks that nobody has associated, from five vehicles: what each of them takes of memory,
// patch, batches and indices included, and what the last of them cost against the first.
template <class G>
void BM_hold_a_million(benchmark::State& state) {
  constexpr std::uint32_t total = 1'000'000, sample = 100'000;
  for (auto _ : state) {
    const double before = allocated_bytes();
    FactStore<G> store;
    double first_s = 0.0, last_s = 0.0;
    for (std::uint32_t i = 0; i < total; ++i) {
      if (i == 0) first_s = -bench::cpu_s();
      if (i == sample) first_s += bench::cpu_s();
      if (i == total - sample) last_s = -bench::cpu_s();
      store.insert(one_of_a_million<G>(i));
    }
    last_s += bench::cpu_s();
    state.counters["bytes_each"] = (allocated_bytes() - before) / total;
    state.counters["ratio_to_baseline"] = last_s / first_s;
    if (store.size() != total) state.SkipWithError("facts were refused");
  }
  state.counters["baseline_bytes"] = bytes_in_unordered_map<G>(total) / total;
  state.SetLabel("against: the first tenth of them; memory: std::unordered_map");
}
BENCHMARK(BM_hold_a_million<SE2>)->Iterations(1)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_hold_a_million<SE3>)->Iterations(1)->Unit(benchmark::kMillisecond);

/// One call on a store of five chains, against keeping one fact.
void BM_marks(benchmark::State& state) {
  const auto facts = landmarks();
  FactStore<SE2> store;
  for (const auto& fact : facts) store.insert(fact);
  std::unordered_map<Key, LandmarkFact<SE2>, KeyHash> kept;
  convoy::bench::against(
      state, "std::unordered_map insertion of one fact", [&] { benchmark::DoNotOptimize(store.marks()); },
      [&] {
        for (const auto& fact : facts) kept.emplace(fact.key, fact);
        kept.clear();
      });
  state.counters["ratio_to_baseline"] = state.counters["ratio_to_baseline"].value * facts_per_call;
  state.counters["baseline_s"] = state.counters["baseline_s"].value / facts_per_call;
}
BENCHMARK(BM_marks);

}  // namespace
