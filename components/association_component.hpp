// AssociationComponent: looks for common landmarks between this vehicle's batches and all others, its own included
// (loop closures and meetings go through the same door), and states what it finds as facts (paper, Section IV).
#pragma once

#include <convoy/association/associate.hpp>
#include <convoy/components/submap_manager.hpp>

#include <array>
#include <set>
#include <vector>

namespace convoy {

struct AssociationCounters {
  std::uint64_t searches = 0;
  std::uint64_t accepted = 0;
  std::uint64_t already_stated = 0;                       ///< to be stated, and held already from another vehicle
  std::array<std::uint64_t, rejection_count> rejected{};  ///< by Rejection: why is there no association?
  std::uint64_t search_nodes = 0;
};

/// What it states depends on the facts of the two batches alone, not on when it looks: the same facts give the same
/// hypotheses on every vehicle and in every order of arrival.
template <class G>
class AssociationComponent {
 public:
  AssociationComponent(SubmapManager<G>& manager, const AssociationParams& params);

  /// Searches at most `max_searches` pairs of batches that are complete and were not compared yet. Returns how many
  /// it did; 0: nothing left to do.
  int step(int max_searches = 8);

  const AssociationCounters& counters() const { return counters_; }

 private:
  void queue_new_batches();
  void search(const Key& a, const Key& b);

  SubmapManager<G>& manager_;
  AssociationParams params_;
  std::set<Key> known_;                     // complete batches seen so far
  std::vector<std::pair<Key, Key>> queue_;  // pairs to search, newest last
  std::uint64_t revision_ = 0;
  AssociationCounters counters_;
};

}  // namespace convoy
