// `convoy bench network`: what the exchange does on bad networks, measured with real processes on this machine.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace convoy::cli {

struct BenchNetworkOptions {
  std::filesystem::path out;       ///< folder of network.json and of what the processes say
  std::vector<std::string> cases;  ///< empty: all
};

/// In the order in which they run.
std::vector<std::string> bench_network_cases();

/// Prints a row per case and writes network.json. Returns the exit status: 1 if a figure was missed. Throws
/// ConfigError.
int run_bench_network(const BenchNetworkOptions& options);

}  // namespace convoy::cli
