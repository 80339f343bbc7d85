// What landmarks say of themselves beside where they are: their kind, and what they look like. A prefilter for the
// association, and a weight for what is rare; geometry decides.
#pragma once

#include <convoy/association/constraints.hpp>

#include <optional>

namespace convoy {

/// Zero-mean normalised cross-correlation of two patches, [-1, 1]; empty if there is nothing to compare: no patch, one
/// of another kind, or one without any contrast.
std::optional<double> similarity(const Descriptor& a, const Descriptor& b);

/// Landmarks of two kinds are not the same thing; nor are two that can be compared and are less similar than that.
/// Empty if no landmark of a or none of b says anything of itself.
template <class G>
LooksAlike<G> alike_by_appearance(const Batch<G>& a, const Batch<G>& b, double min_similarity);

}  // namespace convoy
