// How much of the chains an association looks at. New landmarks wait before they are searched for, so that sets are
// larger (paper, Section IV: the buffer): first in their batch, until that is complete; and a batch that says too
// little by itself waits for its neighbours on the chain and is searched again, joined with them.
#pragma once

#include <convoy/association/associate.hpp>

#include <cstdint>
#include <optional>
#include <vector>

namespace convoy {

/// Which of the batches beside it are searched together with a batch.
enum class Reach : std::uint8_t {
  alone,          ///< none
  with_previous,  ///< the one before it, if there is one
  with_both,      ///< the ones before and after it
};

/// The anchors whose batches belong to `reach` of `anchor`, in order.
std::vector<Key> batches_within(const Key& anchor, Reach reach);

/// Their landmarks in the frame of `anchor`, in index order. To what lies on another batch, the drift in between is
/// added, and nothing is taken to be in common. All must be complete().
template <class G>
Batch<G> joined_batch(const FactStore<G>& store, const Key& anchor, Reach reach);

/// Whether the two of one chain share no batch.
bool apart(const Key& a, const Key& b, Reach reach);

/// Batches a and b, each joined with what belongs to `reach`: where they lie on each other is decided by all landmarks,
/// but what is paired, and may be stated, are those of the batches a and b alone; fewer than `min_pairings` of them
/// come to `too_few_pairings` and no pairings. Everything else in the result is of all that was joined. They must be
/// apart(); what is not complete() is `unfit`.
template <class G>
AssociationResult<G> associate(const FactStore<G>& store, const Key& a, const Key& b, Reach reach,
                               const AssociationParams& params, const LooksAlike<G>& looks_alike = {});

/// All that this search needs of the store, so that it may take its time while others write there.
template <class G>
struct ReachedPair {
  Reach reach = Reach::alone;
  Batch<G> a, b;  ///< joined
  std::optional<RelativePrior<G>> prior = {};
  std::optional<Rejection> rejection = {};  ///< there is nothing to search
};
template <class G>
ReachedPair<G> reached_pair(const FactStore<G>& store, const Key& a, const Key& b, Reach reach,
                            const AssociationParams& params);
/// The same as above.
template <class G>
AssociationResult<G> associate(const ReachedPair<G>& pair, const AssociationParams& params,
                               const LooksAlike<G>& looks_alike = {});

/// The reach to search with next, once those batches are complete; empty if nothing is to be won by it: it is accepted,
/// too few of the landmarks of the two can be the same, or the world repeats itself there, which is to be stated at
/// once.
template <class G>
std::optional<Reach> next_reach(const AssociationResult<G>& result, const Key& a, const Key& b, Reach reach);

}  // namespace convoy
