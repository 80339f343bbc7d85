// The section "Real drift" of the page of `convoy consistency`.
#pragma once

#include <string>

#include "consistency/real_drift.hpp"

namespace convoy::cli::consistency {

/// <section>...</section>: what the models cover, drawings over the length of a span, the halves and their tables; or
/// the one line that says why it is left out.
std::string real_drift_section(const RealDrift& drift);

}  // namespace convoy::cli::consistency
