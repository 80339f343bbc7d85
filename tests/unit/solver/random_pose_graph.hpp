// A drive on a small grid of streets with noisy odometry and noisy loops.
#pragma once

#include <convoy/geometry/groups.hpp>
#include <convoy/solver/pose_graph.hpp>

#include <cmath>
#include <random>
#include <vector>

namespace convoy::test {

struct RandomDrive {
  PoseGraph<SE2> graph;  ///< poses composed from odometry
  std::vector<SE2> truth;
};

/// n poses about 1 m apart; every pose is linked to the one before it, and, now and then, to an old one nearby.
inline RandomDrive random_drive(unsigned seed, int n, double sigma_m = 0.05, double sigma_rad = 0.01) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> unit;
  RandomDrive drive;
  SE2 T;
  const SE2::Tangent sigma(sigma_m, sigma_m, sigma_rad);
  const auto link = [&](int a, int b) {
    const SE2::Tangent noise = sigma.cwiseProduct(SE2::Tangent(unit(random), unit(random), unit(random)));
    SE2::Covariance information = sigma.cwiseAbs2().cwiseInverse().asDiagonal();
    information(0, 2) = information(2, 0) = 0.2 / (sigma_m * sigma_rad);
    const auto at = [&](int k) { return drive.truth[static_cast<std::size_t>(k)]; };
    drive.graph.factors.push_back({a, b, at(a).inverse() * at(b) * SE2::Exp(noise), information});
  };
  for (int k = 0; k < n; ++k) {
    drive.truth.push_back(T);
    if (k > 0) link(k - 1, k);
    for (int o = 0; o < k - 5; ++o)
      if ((drive.truth[static_cast<std::size_t>(o)].translation() - T.translation()).norm() < 1.5 &&
          random() % 4 == 0) {
        if (random() % 2) link(o, k);
        else link(k, o);
      }
    double turn = 0.0;
    if (k % 5 == 4) turn = (static_cast<double>(random() % 3) - 1.0) * M_PI / 2.0;
    if (T.translation().norm() > 15.0 && k % 5 == 4) turn = M_PI / 2.0;
    T = T * SE2(1.0, 0.0, turn);
  }
  drive.graph.poses.assign(drive.truth.size(), SE2());
  drive.graph.poses = composed_poses(drive.graph);
  return drive;
}

}  // namespace convoy::test
