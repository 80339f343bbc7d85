// Rounding of landmarks. A fact is the same on every vehicle, to the bit, so what is not sent must not be in it: its
// author rounds a landmark before anybody gets to see it. What that changes is put down to the landmark's own error.
#pragma once

#include <convoy/submap/facts.hpp>

#include <array>
#include <cstdint>
#include <optional>

namespace convoy {

/// A loading in block floating point: it has an exponent, each column how far it is below that, each entry eight bits.
/// Entry (r, k) is mantissa[Dim k + r] * 2^(exponent - shift[k] - 64). There is one form of each loading: the exponent
/// lies in 0..127, mantissas in -127..127, shifts in 0..15 and not above the exponent; each column has a mantissa of 64
/// or more (or -64 or less), or the largest possible shift; a column with such a mantissa and no shift exists unless
/// the exponent is 0.
template <class G>
struct BlockLoading {
  static constexpr std::size_t columns = static_cast<std::size_t>(G::Shared);
  static constexpr std::size_t rows = static_cast<std::size_t>(G::Dim);
  std::uint8_t exponent = 0;
  std::array<std::uint8_t, columns> shift{};
  std::array<std::int8_t, columns * rows> mantissa{};
  bool operator==(const BlockLoading&) const = default;
};

/// The nearest one: off by at most 1/127 of the largest entry of the column, 1/4000000 of the largest of all, or 2^-65
/// m, whichever is most. Nothing if an entry is not finite or beyond 1e21 m.
template <class G>
std::optional<BlockLoading<G>> block_loading(const typename G::Loading& loading);
template <class G>
typename G::Loading loading_of(const BlockLoading<G>& block);

/// How many columns remain without the zero ones at the end.
template <class G>
std::size_t columns_of(const typename G::Loading& loading);

/// The landmark as it may be stated: its position in single precision (off by 4e-6 m within 100 m of the anchor), its
/// loading in block floating point, its covariance in single precision; a descriptor of no kind has no bytes.
///
/// With D what was added to the loading, the landmark's own covariance grows by 8 D D^T, and by some 1e-7 of the whole
/// covariance, so that it stays positive semidefinite: the covariance of the difference of two landmarks of a batch is
/// never stated smaller than 4/5 of what it was. A landmark that is_rounded() is left as it is. So is one that
/// cannot be rounded, since it has a number that is not finite or beyond single precision.
template <class G>
[[nodiscard]] LandmarkFact<G> rounded(LandmarkFact<G> landmark);

/// Whether a landmark takes the wire without loss.
template <class G>
[[nodiscard]] bool is_rounded(const LandmarkFact<G>& landmark);

}  // namespace convoy
