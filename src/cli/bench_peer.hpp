// One process of `convoy bench network`: the exchange of a vehicle, without its map.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace convoy::cli {

struct BenchPeerOptions {
  std::string profile;
  std::uint32_t domain = 0;
  std::uint32_t vehicle = 1;
  std::string impair;                ///< see Impairments::parse; empty: none
  std::vector<std::string> servers;  ///< Discovery Servers, ADDRESS:PORT
  bool alone = false;                ///< without the repair protocol: what the middleware does by itself
  double budget_bytes_per_s = 0.0;   ///< 0: no limit
};

/// Reads lines from standard input until they end; answers are JSON objects, one a line. Times are microseconds of the
/// monotonic clock, which all processes of a machine share.
///   write COUNT RATE [bare]  landmarks, RATE per second, 20 to an anchor; bare: without a loading
///   live RATE          live poses per second
///   block V, unblock V nothing is heard of vehicle V any more, or again
///   state              what it holds, and what that has cost so far
///   times              when each own landmark was written, and when each of the others was first held
/// Returns the exit status. Throws ConfigError.
int run_bench_peer(const BenchPeerOptions& options);

}  // namespace convoy::cli
