#include <convoy/solver/block_cholesky.hpp>

#include <gtest/gtest.h>
#include <convoy/solver/dense_kernels.hpp>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cstring>
#include <limits>
#include <numeric>
#include <random>

namespace convoy {
namespace {

constexpr int kSizes[] = {2, 3, 6};

/// A random positive definite matrix: a chain with `links` more links, sum of J^T J of every link.
struct RandomMatrix {
  RandomMatrix(unsigned seed, int blocks, int links) : RandomMatrix(seed, blocks, links, {}) {}
  RandomMatrix(unsigned seed, int blocks, int links, std::vector<int> given_sizes) {
    std::mt19937_64 random(seed);
    sizes = std::move(given_sizes);
    while (static_cast<int>(sizes.size()) < blocks) sizes.push_back(kSizes[random() % 3]);
    offsets.assign(1, 0);
    for (const int s : sizes) offsets.push_back(offsets.back() + s);
    for (int i = 1; i < blocks; ++i)
      if (random() % 10) links_.emplace_back(i, i - 1);  // now and then the chain is cut: a forest
    for (int k = 0; k < links && blocks > 1; ++k) {
      const int i = static_cast<int>(random() % static_cast<unsigned>(blocks));
      const int j = static_cast<int>(random() % static_cast<unsigned>(blocks));
      if (i != j) links_.emplace_back(i, j);
    }
    dense = Eigen::MatrixXd::Identity(offsets.back(), offsets.back());
    std::uniform_real_distribution<double> unit(-1.0, 1.0);
    for (const auto& [i, j] : links_) {
      const Eigen::MatrixXd Ji = Eigen::MatrixXd::NullaryExpr(3, size(i), [&] { return unit(random); });
      const Eigen::MatrixXd Jj = Eigen::MatrixXd::NullaryExpr(3, size(j), [&] { return unit(random); });
      block(i, i) += Ji.transpose() * Ji;
      block(j, j) += Jj.transpose() * Jj;
      block(i, j) += Ji.transpose() * Jj;
      block(j, i) += Jj.transpose() * Ji;
    }
  }
  int size(int i) const { return sizes[static_cast<std::size_t>(i)]; }
  int offset(int i) const { return offsets[static_cast<std::size_t>(i)]; }
  Eigen::Block<Eigen::MatrixXd> block(int i, int j) { return dense.block(offset(i), offset(j), size(i), size(j)); }

  BlockPattern pattern() const {
    BlockPattern result(sizes);
    for (const auto& [i, j] : links_) result.add(i, j);
    return result;
  }
  void fill(BlockCholesky& solver) {
    solver.set_zero();
    const int n = static_cast<int>(sizes.size());
    for (int i = 0; i < n; ++i) solver.add(solver.slot(i, i), Eigen::MatrixXd(block(i, i)));
    std::vector<std::pair<int, int>> once = links_;
    for (auto& [i, j] : once)
      if (i > j && (i + j) % 2) std::swap(i, j);  // given in either orientation
    std::sort(once.begin(), once.end(),
              [](auto a, auto b) { return std::minmax(a.first, a.second) < std::minmax(b.first, b.second); });
    once.erase(
        std::unique(once.begin(), once.end(),
                    [](auto a, auto b) { return std::minmax(a.first, a.second) == std::minmax(b.first, b.second); }),
        once.end());
    for (const auto& [i, j] : once) solver.add(solver.slot(i, j), Eigen::MatrixXd(block(i, j)));
  }

  std::vector<int> sizes, offsets;
  std::vector<std::pair<int, int>> links_;
  Eigen::MatrixXd dense;
};

Eigen::VectorXd random_vector(int n) {
  std::mt19937_64 random(99);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  return Eigen::VectorXd::NullaryExpr(n, [&] { return unit(random); });
}

struct Shape {
  unsigned seed;
  int blocks, links;
};

class RandomMatrices : public testing::TestWithParam<Shape> {
 protected:
  RandomMatrix matrix{GetParam().seed, GetParam().blocks, GetParam().links};
};

TEST_P(RandomMatrices, SolveLikeDense) {
  BlockCholesky solver(matrix.pattern());
  matrix.fill(solver);
  ASSERT_TRUE(solver.factor().ok());
  const Eigen::VectorXd b = random_vector(solver.size());
  Eigen::VectorXd x = b;
  solver.solve(x);
  EXPECT_LT((x - matrix.dense.ldlt().solve(b)).norm(), 1e-11 * (1.0 + b.norm()));
}

TEST_P(RandomMatrices, MarginalsAreTheDiagonalOfTheInverse) {
  BlockCholesky solver(matrix.pattern());
  matrix.fill(solver);
  ASSERT_TRUE(solver.factor().ok());
  const Eigen::MatrixXd inverse = matrix.dense.inverse();
  const std::vector<double> marginals = solver.marginals();
  for (int b = 0; b < solver.blocks(); ++b) {
    const int s = solver.block_size(b);
    const Eigen::Map<const Eigen::MatrixXd> marginal(marginals.data() + solver.marginal_offset(b), s, s);
    EXPECT_LT((marginal - inverse.block(matrix.offset(b), matrix.offset(b), s, s)).norm(), 1e-11) << "block " << b;
  }
}

TEST_P(RandomMatrices, TheSelectedInverseIsTheInverseWhereverTheMatrixIsNotZero) {
  BlockCholesky solver(matrix.pattern());
  matrix.fill(solver);
  ASSERT_TRUE(solver.factor().ok());
  const Eigen::MatrixXd inverse = matrix.dense.inverse();
  const std::vector<double> values = solver.selected_inverse();
  for (int i = 0; i < solver.blocks(); ++i)
    for (int j = 0; j < solver.blocks(); ++j) {
      const int rows = solver.block_size(i), columns = solver.block_size(j);
      const auto H = matrix.dense.block(solver.offset(i), solver.offset(j), rows, columns);
      if (!solver.in_pattern(i, j)) {
        EXPECT_TRUE(H.isZero(0.0));
      } else {
        const Eigen::MatrixXd expected = inverse.block(solver.offset(i), solver.offset(j), rows, columns);
        const auto slot = solver.slot(i, j);
        const double* at = values.data() + slot.offset;
        const Eigen::MatrixXd found =
            slot.transposed ? Eigen::MatrixXd(Eigen::Map<const Eigen::MatrixXd>(at, columns, rows).transpose())
                            : Eigen::MatrixXd(Eigen::Map<const Eigen::MatrixXd>(at, rows, columns));
        EXPECT_LT((found - expected).norm(), 1e-9 * (1.0 + inverse.norm())) << i << " " << j;
      }
    }
}

TEST_P(RandomMatrices, JointCovarianceOfAnyTwo) {
  BlockCholesky solver(matrix.pattern());
  matrix.fill(solver);
  ASSERT_TRUE(solver.factor().ok());
  const Eigen::MatrixXd inverse = matrix.dense.inverse();
  const int n = solver.blocks();
  for (int k = 0; k < std::min(n, 12); ++k) {
    const int i = k, j = (k * 7 + n / 2) % n;
    const Eigen::MatrixXd expected = inverse.block(matrix.offset(i), matrix.offset(j), matrix.size(i), matrix.size(j));
    EXPECT_LT((solver.covariance(i, j) - expected).norm(), 1e-11) << i << ", " << j;
    if (i == j) continue;
    const Eigen::MatrixXd joint = solver.joint_covariance({i, j});
    EXPECT_LT((joint.topRightCorner(matrix.size(i), matrix.size(j)) - expected).norm(), 1e-11);
    EXPECT_EQ(joint, joint.transpose());
  }
}

TEST_P(RandomMatrices, JointCovarianceOfAnyNumber) {
  BlockCholesky solver(matrix.pattern());
  matrix.fill(solver);
  ASSERT_TRUE(solver.factor().ok());
  const Eigen::MatrixXd inverse = matrix.dense.inverse();
  std::vector<int> blocks;  // every other one, from the last
  for (int b = solver.blocks() - 1; b >= 0 && blocks.size() < 7; b -= 2) blocks.push_back(b);
  const Eigen::MatrixXd joint = solver.joint_covariance(blocks);
  EXPECT_EQ(joint, joint.transpose());
  int row = 0;
  for (const int i : blocks) {
    int column = 0;
    for (const int j : blocks) {
      const Eigen::MatrixXd expected =
          inverse.block(matrix.offset(i), matrix.offset(j), matrix.size(i), matrix.size(j));
      EXPECT_LT((joint.block(row, column, matrix.size(i), matrix.size(j)) - expected).norm(), 1e-11);
      column += matrix.size(j);
    }
    row += matrix.size(i);
  }
  ASSERT_EQ(row, joint.rows());
}

TEST_P(RandomMatrices, DampingScalesTheDiagonal) {
  BlockCholesky solver(matrix.pattern());
  matrix.fill(solver);
  ASSERT_TRUE(solver.factor(0.5).ok());
  const Eigen::VectorXd b = random_vector(solver.size());
  Eigen::VectorXd x = b;
  solver.solve(x);
  Eigen::MatrixXd damped = matrix.dense;
  damped.diagonal() *= 1.5;
  EXPECT_LT((damped * x - b).norm(), 1e-10 * (1.0 + b.norm()));
}

TEST_P(RandomMatrices, TheSameBitsAgainAndOnEveryProcessor) {
  const Eigen::VectorXd b = random_vector(static_cast<int>(matrix.dense.rows()));
  const auto result = [&](bool portable) {
    dense::use_portable_kernels(portable);
    BlockCholesky solver(matrix.pattern());
    matrix.fill(solver);
    EXPECT_TRUE(solver.factor().ok());
    Eigen::VectorXd x = b;
    solver.solve(x);
    std::vector<double> all = solver.marginals();
    all.insert(all.end(), x.data(), x.data() + x.size());
    dense::use_portable_kernels(false);
    return all;
  };
  const std::vector<double> first = result(false);
  EXPECT_EQ(first, result(false));
  EXPECT_EQ(first, result(true));
}

INSTANTIATE_TEST_SUITE_P(Shapes, RandomMatrices,
                         testing::Values(Shape{1, 1, 0}, Shape{2, 2, 1}, Shape{3, 3, 4}, Shape{4, 7, 3},
                                         Shape{5, 20, 8}, Shape{6, 50, 40}, Shape{7, 60, 600}, Shape{8, 200, 60},
                                         Shape{9, 150, 500}, Shape{10, 300, 0}),
                         [](const auto& i) {
                           return "Blocks" + std::to_string(i.param.blocks) + "Links" + std::to_string(i.param.links);
                         });

TEST(BlockCholesky, OfNothing) {
  BlockCholesky solver{BlockPattern()};
  EXPECT_TRUE(solver.factor().ok());
  EXPECT_TRUE(solver.marginals().empty());
}

TEST(BlockCholesky, ManyShapes) {
  for (unsigned seed = 100; seed < 200; ++seed) {
    RandomMatrix matrix(seed, 1 + static_cast<int>(seed % 40), static_cast<int>(seed * 7 % 60));
    BlockCholesky solver(matrix.pattern());
    matrix.fill(solver);
    ASSERT_TRUE(solver.factor().ok()) << "seed " << seed;
    const Eigen::VectorXd b = random_vector(solver.size());
    Eigen::VectorXd x = b;
    solver.solve(x);
    ASSERT_LT((matrix.dense * x - b).norm(), 1e-10 * (1.0 + b.norm())) << "seed " << seed;
  }
}

// The same matrix with its blocks named in another order has the same solution.
TEST(BlockCholesky, NamesOfBlocksDoNotMatter) {
  RandomMatrix matrix(11, 80, 60);
  const int n = 80;
  std::vector<int> name(80);
  std::iota(name.begin(), name.end(), 0);
  std::shuffle(name.begin(), name.end(), std::mt19937_64(5));
  std::vector<int> sizes(80);
  for (int i = 0; i < n; ++i) sizes[static_cast<std::size_t>(name[static_cast<std::size_t>(i)])] = matrix.size(i);
  BlockPattern pattern(sizes);
  for (const auto& [i, j] : matrix.links_)
    pattern.add(name[static_cast<std::size_t>(i)], name[static_cast<std::size_t>(j)]);
  BlockCholesky plain(matrix.pattern()), renamed(pattern);
  matrix.fill(plain);
  for (int i = 0; i < n; ++i)
    for (int j = 0; j <= i; ++j)
      if (i == j || std::any_of(matrix.links_.begin(), matrix.links_.end(),
                                [&](const auto& l) { return std::minmax(l.first, l.second) == std::minmax(i, j); }))
        renamed.add(renamed.slot(name[static_cast<std::size_t>(i)], name[static_cast<std::size_t>(j)]),
                    Eigen::MatrixXd(matrix.block(i, j)));
  ASSERT_TRUE(plain.factor().ok());
  ASSERT_TRUE(renamed.factor().ok());
  const Eigen::VectorXd b = random_vector(plain.size());
  Eigen::VectorXd x = b, y(plain.size());
  for (int i = 0; i < n; ++i)
    y.segment(renamed.offset(name[static_cast<std::size_t>(i)]), matrix.size(i)) =
        b.segment(matrix.offset(i), matrix.size(i));
  plain.solve(x);
  renamed.solve(y);
  for (int i = 0; i < n; ++i)
    EXPECT_LT((y.segment(renamed.offset(name[static_cast<std::size_t>(i)]), matrix.size(i)) -
               x.segment(matrix.offset(i), matrix.size(i)))
                  .norm(),
              1e-11);
}

TEST(BlockCholesky, FactorsNewValuesOfTheSamePattern) {
  RandomMatrix matrix(12, 70, 50);
  BlockCholesky solver(matrix.pattern());
  matrix.fill(solver);
  ASSERT_TRUE(solver.factor().ok());
  const Eigen::VectorXd b = random_vector(solver.size());
  Eigen::VectorXd before = b;
  solver.solve(before);
  matrix.dense *= 4.0;
  matrix.dense.diagonal().array() += 1.0;
  matrix.fill(solver);
  ASSERT_TRUE(solver.factor().ok());
  Eigen::VectorXd x = b;
  solver.solve(x);
  EXPECT_LT((matrix.dense * x - b).norm(), 1e-10);
  // And back: nothing of the values in between is left.
  matrix.dense.diagonal().array() -= 1.0;
  matrix.dense *= 0.25;
  RandomMatrix again(12, 70, 50);
  again.fill(solver);
  ASSERT_TRUE(solver.factor().ok());
  x = b;
  solver.solve(x);
  EXPECT_EQ(x, before);
}

TEST(BlockCholesky, ReportsTheBlockWhosePivotIsNotPositive) {
  RandomMatrix matrix(13, 40, 30);
  BlockCholesky solver(matrix.pattern());
  matrix.block(17, 17)(1, 1) = -5.0;
  matrix.fill(solver);
  EXPECT_EQ(solver.factor().failed_block, 17);
  matrix.block(17, 17)(1, 1) = std::numeric_limits<double>::quiet_NaN();
  matrix.fill(solver);
  EXPECT_FALSE(solver.factor().ok());
  RandomMatrix good(13, 40, 30);
  good.fill(solver);
  EXPECT_TRUE(solver.factor().ok());
}

// A chain of differences: nothing says where it is.
TEST(BlockCholesky, RefusesASingularMatrix) {
  const int n = 50;
  BlockPattern pattern(std::vector<int>(static_cast<std::size_t>(n), 3));
  for (int i = 1; i < n; ++i) pattern.add(i, i - 1);
  BlockCholesky solver(pattern);
  const auto fill = [&](double prior) {
    solver.set_zero();
    const Eigen::Matrix3d I = 0.3 * Eigen::Matrix3d::Identity();
    for (int i = 1; i < n; ++i) {
      solver.add(solver.slot(i, i), I);
      solver.add(solver.slot(i - 1, i - 1), I);
      solver.add(solver.slot(i, i - 1), -I);
    }
    solver.add(solver.slot(0, 0), prior * I);
  };
  fill(0.0);
  EXPECT_FALSE(solver.factor().ok());
  fill(1e-6);
  EXPECT_TRUE(solver.factor().ok());
}

// One dense block is a front with hundreds of columns: every path of the dense kernels.
TEST(BlockCholesky, OneFrontOfManyColumns) {
  for (const int n : {63, 64, 65, 130}) {
    RandomMatrix matrix(14, n, 40 * n, std::vector<int>(static_cast<std::size_t>(n), 3));
    BlockCholesky solver(matrix.pattern());
    matrix.fill(solver);
    ASSERT_TRUE(solver.factor().ok());
    const Eigen::VectorXd b = random_vector(solver.size());
    Eigen::VectorXd x = b;
    solver.solve(x);
    EXPECT_LT((matrix.dense * x - b).norm(), 1e-9);
    const Eigen::MatrixXd inverse = matrix.dense.inverse();
    const std::vector<double> marginals = solver.marginals();
    for (int k = 0; k < n; ++k)
      EXPECT_LT((Eigen::Map<const Eigen::Matrix3d>(marginals.data() + solver.marginal_offset(k)) -
                 inverse.block(3 * k, 3 * k, 3, 3))
                    .norm(),
                1e-11);
  }
}

}  // namespace
}  // namespace convoy
