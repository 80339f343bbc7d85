// A short street of painted boards, for tests of the renderer and for measurements that need no map.
#pragma once

#include "scene.hpp"

#include <vector>

namespace convoy::simulator {

/// Walls on both sides of x, 10 m off, `length_m` long from x = 0, with windows that repeat; a road with markings as
/// decals; a box beside the road, as object 0; a wall across the end. `triangles_per_metre` of each wall, for load.
Scene test_street(double length_m = 120.0, int triangles_per_metre = 2);

/// A camera on the road, 1.5 m up, which looks along x and, by degrees, to the left.
Eigen::Isometry3d test_pose(double x_m, double y_m = 0.0, double left_deg = 0.0);

}  // namespace convoy::simulator
