// The bounds of convoy.idl, which the generated code does not offer.
#pragma once

#include <cstdint>

namespace convoy::dds::bounds {

inline constexpr std::uint32_t group = 7;              // coordinates of a group element
inline constexpr std::uint32_t group_covariance = 21;  // packed
inline constexpr std::uint32_t tangent = 6;
inline constexpr std::uint32_t point = 3;
inline constexpr std::uint32_t point_covariance = 6;  // packed
inline constexpr std::uint32_t landmarks = 64;
inline constexpr std::uint32_t descriptors = 32 * landmarks;  // bytes
inline constexpr std::uint32_t points = point * landmarks;
inline constexpr std::uint32_t point_covariances = point_covariance * landmarks;
inline constexpr std::uint32_t loadings = (1 + 6 + 24) * landmarks;  // bytes
inline constexpr std::uint32_t pairing_groups = 64;
inline constexpr std::uint32_t pairs = 4096;  // in one group and in all groups of an association together
inline constexpr std::uint32_t remembered = 8;
inline constexpr std::uint32_t remembered_points = 72;
inline constexpr std::uint32_t ranges = 64;
inline constexpr std::uint32_t repeated_bytes = 36864;  // of one fact
inline constexpr std::uint32_t repeated = 64;           // facts
inline constexpr std::uint32_t chains = 256;
inline constexpr std::uint32_t kinds = 8;

}  // namespace convoy::dds::bounds
