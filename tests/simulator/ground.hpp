// The ground that vehicles drive on, and the ways through it.
#pragma once

#include <Eigen/Core>

#include <string>
#include <vector>

namespace convoy::simulator {

/// Height of the driven surface. Uneven roads and kerbs are part of it.
class Ground {
 public:
  virtual ~Ground() = default;
  /// z of the ground at (x, y), world frame [m]. Anywhere: beyond the district it goes on level.
  virtual double height_m(double x_m, double y_m) const = 0;
};

/// A line to follow, world frame [m]: the middle of the lane, neighbours 0.2 to 1 m apart, bends as a car can drive
/// them.
struct Route {
  std::string name;
  std::vector<Eigen::Vector2d> points;
  bool closed = false;  ///< the last point leads to the first again
};

}  // namespace convoy::simulator
