// A fleet in one thread on a virtual clock: real front-end components, submap managers, associations, repair, journals
// and maps, over the in-process exchange, while loss, duplicates, delays, reordering, partitions, crashes, restarts,
// full and damaged disks, byte budgets and clocks that differ are drawn from one seed. Whatever fails can be replayed
// from the seed and the commit.
#pragma once

#include <convoy/submap/facts.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace convoy::simulation {

struct Outcome {
  std::vector<std::string> failures;         ///< what did not hold; empty: all did
  Hash facts = 0, map = 0;                   ///< that all vehicles end with
  Hash trace = 0;                            ///< of every message that was taken, in order, with its time
  double settled_s = -1.0;                   ///< after the faults stopped; -1: never
  std::uint64_t facts_stated = 0;            ///< by all vehicles in all epochs
  std::uint64_t facts_gone = 0;              ///< that nobody who was left had when the faults stopped
  std::uint64_t facts_declared_missing = 0;  ///< of these; of the others nobody who was left had ever heard
  int vehicles = 0, crashes = 0, restarts = 0, partitions = 0, damaged_journals = 0, full_disks = 0;
  std::uint64_t messages_lost = 0, requests = 0, relayed = 0;
  bool operator==(const Outcome&) const = default;
};

/// Once faults stop, all maps must be equal within this time [s].
inline constexpr double liveness_s = 60.0;

Outcome simulate(std::uint64_t seed);

std::string to_string(const Outcome& outcome);

/// What became of the seed with its digest, and if something failed, the command that replays it.
std::string report(std::uint64_t seed, const Outcome& outcome);

}  // namespace convoy::simulation
