// The one conversion between the int that counts unknowns and the std::size_t that the standard containers ask for.
#pragma once

#include <cstddef>

namespace convoy {

/// i as an index; i >= 0.
constexpr std::size_t at(int i) { return static_cast<std::size_t>(i); }

}  // namespace convoy
