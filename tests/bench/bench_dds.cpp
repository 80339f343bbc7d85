// Encoding and decoding of landmarks, per landmark. The baseline copies the same bytes.
#include <convoy/dds/convert.hpp>
#include <convoy/dds/guarded_type.hpp>
#include <convoy/geometry/se2.hpp>
#include <convoy/submap/rounding.hpp>

#include <benchmark/benchmark.h>

#include <cstdlib>
#include <cstring>

namespace {

using namespace convoy;
using dds::Guarded;
using Payload = eprosima::fastrtps::rtps::SerializedPayload_t;
using Type = dds::GuardedType<v1::LandmarkPubSubType>;

constexpr int batch_size = 20;

std::vector<LandmarkFact<SE2>> batch() {
  std::vector<LandmarkFact<SE2>> facts(batch_size);
  for (std::uint32_t i = 0; i < batch_size; ++i) {
    facts[i].key = {{1, 1}, i};
    facts[i].position.setConstant(i);
    facts[i].covariance.setIdentity();
    facts[i].loading.setConstant(0.02 + 1e-3 * i);
    facts[i] = rounded(facts[i]);
  }
  return facts;
}

void encode(Type& type, const std::vector<LandmarkFact<SE2>>& facts, Payload& payload) {
  v1::Landmark sample;
  if (dds::to_wire({1, 1}, std::span<const LandmarkFact<SE2>>(facts), sample) != dds::WireStatus::ok) std::abort();
  payload.reserve(type.getSerializedSizeProvider(&sample)());
  if (!type.serialize(&sample, &payload)) std::abort();
}

void per_landmark(benchmark::State& state, std::uint32_t bytes) {
  state.SetItemsProcessed(state.iterations() * batch_size);
  state.counters["bytes_per_landmark"] = static_cast<double>(bytes) / batch_size;
}

void BM_memcpy_baseline(benchmark::State& state) {
  Type type;
  Payload payload;
  encode(type, batch(), payload);
  std::vector<char> copy(payload.length);
  for (auto _ : state) {
    std::memcpy(copy.data(), payload.data, payload.length);
    benchmark::DoNotOptimize(copy.data());
    benchmark::ClobberMemory();
  }
  per_landmark(state, payload.length);
}
BENCHMARK(BM_memcpy_baseline);

void BM_encode(benchmark::State& state) {
  Type type;
  Payload payload;
  const auto facts = batch();
  for (auto _ : state) {
    encode(type, facts, payload);
    benchmark::DoNotOptimize(payload.data);
  }
  per_landmark(state, payload.length);
}
BENCHMARK(BM_encode);

void BM_scan(benchmark::State& state) {
  Type type;
  Payload payload;
  encode(type, batch(), payload);
  for (auto _ : state) benchmark::DoNotOptimize(dds::scan_payload<v1::Landmark>(payload.data, payload.length));
  per_landmark(state, payload.length);
}
BENCHMARK(BM_scan);

/// Scan, decode and conversion: all that happens to a sample in the receiving thread.
void BM_decode(benchmark::State& state) {
  Type type;
  Payload payload;
  encode(type, batch(), payload);
  for (auto _ : state) {
    Guarded<v1::Landmark> received;
    type.deserialize(&payload, &received);
    Message<SE2> message;
    if (dds::from_wire(received.sample, message) != dds::WireStatus::ok) std::abort();
    benchmark::DoNotOptimize(message);
  }
  per_landmark(state, payload.length);
}
BENCHMARK(BM_decode);

}  // namespace
