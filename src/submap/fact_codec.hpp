// Facts as bytes: what the journal keeps. Little-endian, every double to the bit; the order of fields is that of
// fact_fields.hpp.
#pragma once

#include <convoy/submap/facts.hpp>

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace convoy {

using Bytes = std::vector<std::uint8_t>;

/// Appends the fact, its kind first.
template <class G>
void encode(const AnyFact<G>& fact, Bytes& out);

/// Nothing if the bytes are not exactly one fact of this group. Whether it is plausible is for FactStore to say.
template <class G>
std::optional<AnyFact<G>> decode(std::span<const std::uint8_t> bytes);

}  // namespace convoy
