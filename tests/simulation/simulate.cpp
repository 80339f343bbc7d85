// convoy_fleet_simulation FIRST COUNT: runs the seeds FIRST, FIRST + 1, ... and says which fail. One seed: all about
// it.
#include "fleet_simulation.hpp"

#include <cstdio>
#include <cstdlib>
#include <map>

using namespace convoy::simulation;

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: convoy_fleet_simulation FIRST COUNT\n");
    return 2;
  }
  const std::uint64_t first = std::strtoull(argv[1], nullptr, 10), count = std::strtoull(argv[2], nullptr, 10);
  std::uint64_t failed = 0, gone = 0, stated = 0;
  double worst_s = 0.0;
  for (std::uint64_t seed = first; seed < first + count; ++seed) {
    const Outcome outcome = simulate(seed);
    failed += !outcome.failures.empty();
    gone += outcome.facts_gone;
    stated += outcome.facts_stated;
    worst_s = outcome.settled_s > worst_s ? outcome.settled_s : worst_s;
    if (!outcome.failures.empty() || count == 1)
      std::printf("seed %llu: %s\n", static_cast<unsigned long long>(seed), to_string(outcome).c_str());
    if (count > 1 && (seed - first + 1) % 100 == 0)
      std::printf("%llu of %llu seeds, %llu failed\n", static_cast<unsigned long long>(seed - first + 1),
                  static_cast<unsigned long long>(count), static_cast<unsigned long long>(failed));
    std::fflush(stdout);
  }
  std::printf("%llu seeds from %llu: %llu failed; %llu facts, %llu gone with their authors; settled within %.2f s\n",
              static_cast<unsigned long long>(count), static_cast<unsigned long long>(first),
              static_cast<unsigned long long>(failed), static_cast<unsigned long long>(stated),
              static_cast<unsigned long long>(gone), worst_s);
  return failed == 0 ? 0 : 1;
}
