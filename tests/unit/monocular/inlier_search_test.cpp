#include <convoy/monocular/inlier_search.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>
#include <Eigen/Cholesky>

namespace convoy {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/// Matches that share a 6-D error, each with noise of its own.
struct Frame {
  Frame(std::size_t matches, double outliers, std::uint64_t seed) {
    test::Random random(seed);
    const auto rows = 2 * static_cast<Index>(matches);
    MatrixXd shared(rows, 6);
    for (Index i = 0; i < rows; ++i) shared.row(i) = 8.0 * random.unit_normal<6>();
    S = shared * shared.transpose() + MatrixXd::Identity(rows, rows);
    r = shared * random.unit_normal<6>();
    for (Index i = 0; i < rows; ++i) r[i] += random.normal();
    for (std::size_t k = 0; k < matches; ++k) {
      if (random.uniform(0.0, 1.0) >= outliers) continue;
      outlying.push_back(k);
      r[2 * static_cast<Index>(k)] += random.uniform(20.0, 40.0);
    }
  }
  VectorXd r;
  MatrixXd S;
  std::vector<std::size_t> outlying;
};

TEST(InlierSearch, FindsMostInliersAndNearlyNoOutlier) {
  for (const double outliers : {0.0, 0.1, 0.4}) {
    std::size_t inliers = 0, found = 0, wrong = 0, outlying = 0;
    for (std::uint64_t seed = 1; seed <= 40; ++seed) {
      const Frame frame(30, outliers, seed);
      inliers += 30 - frame.outlying.size();
      outlying += frame.outlying.size();
      for (const std::size_t k : find_inliers(frame.r, frame.S, {})) {
        const bool out = std::find(frame.outlying.begin(), frame.outlying.end(), k) != frame.outlying.end();
        ++(out ? wrong : found);
      }
    }
    EXPECT_GT(static_cast<double>(found), 0.95 * static_cast<double>(inliers)) << outliers;
    EXPECT_LE(static_cast<double>(wrong), 0.05 * static_cast<double>(outlying)) << outliers;
  }
}

TEST(InlierSearch, OneMatchIsItsOwnConsensusAndNoneIsNone) {
  EXPECT_TRUE(find_inliers(VectorXd(), MatrixXd(0, 0), {}).empty());
  EXPECT_EQ(find_inliers(VectorXd::Zero(2), MatrixXd::Identity(2, 2), {}).size(), 1U);
  EXPECT_TRUE(find_inliers(VectorXd::Constant(2, 9.0), MatrixXd::Identity(2, 2), {}).empty());
}

TEST(InlierSearch, IsDeterministicAndAscending) {
  const Frame frame(40, 0.3, 5);
  const auto once = find_inliers(frame.r, frame.S, {});
  EXPECT_EQ(once, find_inliers(frame.r, frame.S, {}));
  EXPECT_TRUE(std::is_sorted(once.begin(), once.end()));
}

}  // namespace
}  // namespace convoy
