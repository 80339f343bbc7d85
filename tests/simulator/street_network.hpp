// Where the roads are, and how high the ground is.
#pragma once

#include "street_plan.hpp"

#include <cstdint>
#include <map>
#include <utility>
#include <vector>

namespace convoy::simulator {

/// Distance to the kerbs of a set of streets, corners at junctions rounded.
class StreetNetwork {
 public:
  explicit StreetNetwork(const std::vector<Street>& streets);

  /// Distance to the nearest kerb [m]: negative on the road, positive beside it, `far_m` where no street is near.
  double beyond_kerb_m(const Eigen::Vector2d& point) const;
  /// The same for all streets but `street`, and without yards' entrances: negative where that one is crossed.
  double beyond_others_m(const Eigen::Vector2d& point, std::size_t street) const;

  static constexpr double far_m = 16.0;
  static constexpr double entrance_half_width_m = 3.0;

 private:
  struct Segment {
    Eigen::Vector2d from, along;  ///< along: unit
    double length, half_width;
    std::size_t street;
  };
  static double distance_m(const Segment& segment, const Eigen::Vector2d& point);
  const std::vector<std::size_t>& near(const Eigen::Vector2d& point) const;

  std::vector<Segment> segments_;
  std::map<std::pair<int, int>, std::vector<std::size_t>> cells_;
};

/// Gently sloping ground with uneven roads; pavements lie a kerb higher. Level beyond its bounds.
class Terrain : public Ground {
 public:
  Terrain(std::uint32_t seed, const Eigen::Vector2d& low, const Eigen::Vector2d& high, StreetNetwork network)
      : seed_(seed), low_(low), high_(high), network_(std::move(network)) {}

  double height_m(double x_m, double y_m) const override;
  /// Height without kerbs.
  double bed_m(double x_m, double y_m) const;
  const StreetNetwork& network() const { return network_; }
  const Eigen::Vector2d& low() const { return low_; }
  const Eigen::Vector2d& high() const { return high_; }

  static constexpr double kerb_m = 0.12;

 private:
  std::uint32_t seed_;
  Eigen::Vector2d low_, high_;
  StreetNetwork network_;
};

}  // namespace convoy::simulator
