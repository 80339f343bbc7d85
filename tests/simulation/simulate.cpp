// convoy_fleet_simulation FIRST COUNT: runs the seeds FIRST, FIRST + 1, ... and says which fail. One seed: all about
// it.
#include "fleet_simulation.hpp"

#include <charconv>
#include <cstdio>
#include <cstring>
#include <limits>
#include <optional>

using namespace convoy::simulation;

namespace {

constexpr const char* usage =
    "usage: convoy_fleet_simulation FIRST COUNT\n"
    "Simulates the fleets of the seeds FIRST, FIRST + 1, ..., COUNT of them (1 or more), on a virtual clock. What "
    "fails\n"
    "is told with its seed, and happens again with `convoy_fleet_simulation SEED 1` of the same commit. Exit status: "
    "0,\n"
    "all was as it should be; 1, a seed failed; 2, the arguments are wrong.\n";

std::optional<std::uint64_t> whole_number(const char* text) {
  std::uint64_t value = 0;
  const char* const end = text + std::strlen(text);
  const auto [rest, error] = std::from_chars(text, end, value);
  if (error != std::errc() || rest != end) return std::nullopt;
  return value;
}

int refuse(const char* what) {
  std::fprintf(stderr, "convoy_fleet_simulation: %s\n%s", what, usage);
  return 2;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 2 && (std::strcmp(argv[1], "--help") == 0 || std::strcmp(argv[1], "-h") == 0)) {
    std::fputs(usage, stdout);
    return 0;
  }
  if (argc != 3) return refuse("two arguments are needed");
  const auto from = whole_number(argv[1]), how_many = whole_number(argv[2]);
  if (!from || !how_many) return refuse("FIRST and COUNT are whole numbers from 0 on");
  if (*how_many == 0) return refuse("COUNT must be 1 or more: no seed proves nothing");
  if (*from > std::numeric_limits<std::uint64_t>::max() - *how_many) return refuse("FIRST + COUNT is too large");
  const std::uint64_t first = *from, count = *how_many;
  std::uint64_t failed = 0, gone = 0, stated = 0;
  double worst_s = 0.0;
  for (std::uint64_t seed = first; seed < first + count; ++seed) {
    const Outcome outcome = simulate(seed);
    failed += !outcome.failures.empty();
    gone += outcome.facts_gone;
    stated += outcome.facts_stated;
    worst_s = outcome.settled_s > worst_s ? outcome.settled_s : worst_s;
    if (!outcome.failures.empty() || count == 1) std::printf("%s\n", report(seed, outcome).c_str());
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
