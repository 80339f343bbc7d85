// The paths of the consistency suite, and the worlds along them.
#pragma once

#include <convoy/geometry/groups.hpp>

#include <string>
#include <vector>

#include "consistency/draw.hpp"

namespace convoy::cli::consistency {

enum class Path {
  straight,      ///< 400 m
  loop,          ///< a circle of 340 m, and 60 m of it again
  figure_eight,  ///< two circles of 200 m, and 60 m of the first again
  far_origin,    ///< 1 km straight, then a circle of 200 m, and 60 m of it again: the start frame's origin is far away
};
std::string to_string(Path path);

double length_m(Path path);           ///< of one vehicle's drive
double distinct_length_m(Path path);  ///< before the path comes back onto itself
double curvature_per_m(Path path, double abscissa_m);

/// T_common_body at `abscissa_m` >= 0. In space with heights, pitches and rolls along it.
template <class G>
G pose_on(Path path, double abscissa_m);

/// Points 4 to 15 m beside the path, `per_metre` of its distinct length on average, no two closer than `spacing_m`.
template <class G>
std::vector<typename G::Point> points_along(Path path, double per_metre, double spacing_m, Draw& draw);

}  // namespace convoy::cli::consistency
