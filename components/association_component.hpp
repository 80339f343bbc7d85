// AssociationComponent: looks for common landmarks between this vehicle's batches and all others, its own included
// (loop closures and meetings go through the same door), and states what it finds as facts (paper, Section IV).
#pragma once

#include <convoy/association/reach.hpp>
#include <convoy/components/submap_manager.hpp>

#include <array>
#include <map>
#include <optional>
#include <set>
#include <vector>

namespace convoy {

struct AssociationCounters {
  std::uint64_t searches = 0;
  std::uint64_t accepted = 0;
  std::uint64_t already_stated = 0;                       ///< to be stated, and held already from another vehicle
  std::array<std::uint64_t, rejection_count> rejected{};  ///< by Rejection: why is there no association?
  std::uint64_t search_nodes = 0;
  std::uint64_t waiting = 0;  ///< pairs of batches that say too little as yet: they wait for their neighbours
};

/// A pair of batches is searched when both have arrived in full. If two places fit beyond chance, both are stated. If
/// that says too little, it is searched again joined with its neighbours on the chains (association/reach.hpp) as these
/// arrive; the last batch of a chain waits for one that may never come. What is stated depends on the facts alone, not
/// on when it looks: the same facts give the same hypotheses on every vehicle and in every order of arrival.
template <class G>
class AssociationComponent {
 public:
  /// `looks_alike`: a constraint of one's own. It must say the same of the same two facts on every vehicle, and is
  /// asked of every pair that the prior allows, so it should take no longer than a few nanoseconds.
  AssociationComponent(SubmapManager<G>& manager, const AssociationParams& params, LooksAlike<G> looks_alike = {});

  /// Does at most `max_searches` of what is due (what waited and can be done now, then what came last), and no more
  /// once they have come to `max_nodes` (about 10 ms). Returns how many it did; 0: nothing left to do.
  int step(int max_searches = 8, std::uint64_t max_nodes = 100'000);

  // ---- the same for one search at a time, of which the long part needs nobody's facts ----
  struct Search {
    Key a, b;  // a < b
    Reach reach = Reach::alone;
  };
  struct Work {
    Search search;
    ReachedPair<G> pair;
    AssociationResult<G> result = {};
  };
  /// Call it when facts have come, before begin().
  void find_new_batches();
  /// Empty: nothing left to do.
  std::optional<Work> begin();
  /// From any thread, while anything but this work is used.
  void search(Work& work) const { work.result = associate(work.pair, params_, looks_alike_); }
  void finish(const Work& work);

  const AssociationCounters& counters() const { return counters_; }

 private:
  struct Round {
    Key batch;
    std::size_t left;  // how many of `searched_` it is still to be compared with, the last of them first
  };
  std::optional<Search> next();
  void queue(const Search& search);

  SubmapManager<G>& manager_;
  AssociationParams params_;
  LooksAlike<G> looks_alike_;
  std::set<Key> known_;                         // complete batches seen so far
  std::vector<Key> searched_;                   // those of them that are large enough to decide anything
  std::vector<Round> rounds_;                   // newest last; one per batch, however many there are to compare it with
  std::vector<Search> queue_;                   // joined with neighbours that have arrived: before anything else
  std::map<Key, std::vector<Search>> waiting_;  // by a batch that is not complete yet
  std::uint64_t revision_ = 0;
  AssociationCounters counters_;
};

}  // namespace convoy
