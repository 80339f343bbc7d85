// In which order blocks are eliminated.
#pragma once

#include <convoy/solver/block_cholesky.hpp>

namespace convoy {

/// Blocks in elimination order, by approximate minimum degree on the graph of blocks (Eigen's AMD: a third of the time
/// of an ordering of scalars, and as good). Deterministic.
std::vector<int> minimum_degree_order(const BlockPattern& pattern);

}  // namespace convoy
