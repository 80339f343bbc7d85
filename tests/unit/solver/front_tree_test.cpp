// The tree against a dense solution, whatever comes, changes and goes.
#include <convoy/solver/front_tree.hpp>

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <map>
#include <random>

namespace convoy {
namespace {

// A tree, and what it should amount to.
class Grown {
 public:
  explicit Grown(unsigned seed) : random_(seed) {
    for (int k = 0; k < 5; ++k) add_unknown();
  }

  int below(int n) { return static_cast<int>(random_() % static_cast<unsigned>(n)); }

  void add_unknown() {
    const int size = 1 + below(6), u = tree.add_unknown(size);
    sizes_[u] = size;
    add_term({u});
    if (sizes_.size() > 1) add_term({u, any_but({u})});
  }

  void link() {
    std::vector<int> unknowns;
    for (int k = 2 + below(4); k > 0 && unknowns.size() < sizes_.size(); --k) unknowns.push_back(any_but(unknowns));
    add_term(unknowns);
  }

  void remove_unknown() {
    const int u = any_but({});
    for (const int t : std::vector<int>(tree.terms_of(u))) {
      std::vector<int> left = terms_.at(t).unknowns;
      std::erase(left, u);
      remove_term(t);
      if (!left.empty()) add_term(left);  // nothing is left without a term
    }
    tree.remove_unknown(u);
    sizes_.erase(u);
  }

  void remove_some_term() {
    const int t = std::next(terms_.begin(), below(static_cast<int>(terms_.size())))->first;
    if (terms_.at(t).unknowns.size() > 1) remove_term(t);  // those of one unknown keep H positive definite
  }

  void change_some_term() { change_term(std::next(terms_.begin(), below(static_cast<int>(terms_.size())))->first); }

  void reset_some() {  // as when it is linearised again
    const int u = any_but({});
    tree.reset(u);
    for (const int t : tree.terms_of(u)) change_term(t);
  }

  void expect_solved() const {
    std::map<int, Eigen::Index> offset;
    Eigen::Index n = 0;
    for (const auto& [u, size] : sizes_) {
      offset[u] = n;
      n += size;
    }
    Eigen::MatrixXd H = Eigen::MatrixXd::Zero(n, n);
    Eigen::VectorXd b = Eigen::VectorXd::Zero(n);
    for (const auto& [t, term] : terms_) {
      std::vector<Eigen::Index> rows;
      for (const int u : term.unknowns)
        for (int k = 0; k < sizes_.at(u); ++k) rows.push_back(offset.at(u) + k);
      for (std::size_t i = 0; i < rows.size(); ++i) {
        b[rows[i]] += term.b[static_cast<Eigen::Index>(i)];
        for (std::size_t j = 0; j < rows.size(); ++j)
          H(rows[i], rows[j]) +=
              term.H(static_cast<Eigen::Index>(std::max(i, j)), static_cast<Eigen::Index>(std::min(i, j)));
      }
    }
    const Eigen::MatrixXd P = H.inverse();
    const Eigen::VectorXd x = P * b;
    const double small = 1e-9 * P.norm();
    std::vector<int> some;
    for (const auto& [u, size] : sizes_) {
      ASSERT_LT((tree.solution(u) - x.segment(offset.at(u), size)).norm(), 1e-8 * (1.0 + x.norm())) << "unknown " << u;
      if (u % 3 == 0) some.push_back(u);
    }
    const auto factored = tree.factored();
    const Eigen::MatrixXd joint = factored->joint_covariance(some);
    Eigen::Index row = 0;
    for (const int u : some) {
      Eigen::Index column = 0;
      for (const int v : some) {
        const Eigen::MatrixXd expected = P.block(offset.at(u), offset.at(v), sizes_.at(u), sizes_.at(v));
        ASSERT_LT((factored->covariance(u, v) - expected).norm(), small) << u << ", " << v;
        ASSERT_LT((joint.block(row, column, expected.rows(), expected.cols()) - expected).norm(), small);
        column += expected.cols();
      }
      row += sizes_.at(u);
    }
  }

  FrontTree tree;

 private:
  int any_but(const std::vector<int>& without) {
    while (true) {
      const int u = std::next(sizes_.begin(), below(static_cast<int>(sizes_.size())))->first;
      if (std::find(without.begin(), without.end(), u) == without.end()) return u;
    }
  }
  LinearTerm random_term(const std::vector<int>& unknowns) {
    Eigen::Index n = 0;
    for (const int u : unknowns) n += sizes_.at(u);
    std::uniform_real_distribution<double> uniform(-1.0, 1.0);
    const auto number = [&] { return uniform(random_); };
    const Eigen::MatrixXd A = Eigen::MatrixXd::NullaryExpr(n, n, number);
    LinearTerm term{unknowns, A.transpose() * A, Eigen::VectorXd::NullaryExpr(n, number)};
    if (unknowns.size() == 1) term.H += Eigen::MatrixXd::Identity(n, n);
    return term;
  }
  void add_term(const std::vector<int>& unknowns) {
    const LinearTerm term = random_term(unknowns);
    terms_[tree.add_term(term)] = term;
  }
  void change_term(int t) {
    terms_.at(t) = random_term(terms_.at(t).unknowns);
    tree.change_term(t, terms_.at(t));
  }
  void remove_term(int t) {
    tree.remove_term(t);
    terms_.erase(t);
  }

  std::mt19937_64 random_;
  std::map<int, int> sizes_;
  std::map<int, LinearTerm> terms_;
};

class FrontTrees : public testing::TestWithParam<unsigned> {};

TEST_P(FrontTrees, EqualADenseSolutionAtEveryMoment) {
  Grown grown(GetParam());
  std::printf("seed %u\n", GetParam());
  std::vector<int> last;
  for (int round = 0; round < 60; ++round) {
    for (int k = grown.below(4); k >= 0; --k) {
      switch (grown.below(round < 20 ? 6 : 7)) {
        case 0:
        case 1: grown.add_unknown(); break;
        case 2: grown.link(); break;
        case 3: grown.change_some_term(); break;
        case 4: grown.remove_some_term(); break;
        case 5: grown.reset_some(); break;
        default: grown.remove_unknown();
      }
    }
    ASSERT_FALSE(grown.tree.update(last, 0.0).failed) << "round " << round;
    ASSERT_NO_FATAL_FAILURE(grown.expect_solved()) << "round " << round;
    last = {grown.below(8)};
  }
}

INSTANTIATE_TEST_SUITE_P(Seeds, FrontTrees, testing::Range(1U, 9U));

LinearTerm between(int u, int v, double stiffness) {
  Eigen::Matrix2d H;
  H << stiffness, -stiffness, -stiffness, stiffness;
  return {{u, v}, H, Eigen::Vector2d(0.0, 0.0)};
}

// Arms of many unknowns that meet in one.
TEST(FrontTree, FactorsWhatHasChangedAlone) {
  FrontTree tree;
  const int hub = tree.add_unknown(1);
  int some = 0, held = 0;
  for (int arm = 0; arm < 40; ++arm) {
    int before = hub;
    for (int k = 0; k < 50; ++k) {
      some = tree.add_unknown(1);
      held = tree.add_term({{some}, Eigen::MatrixXd::Identity(1, 1), Eigen::VectorXd::Ones(1)});
      tree.add_term(between(before, some, 1.0));
      before = some;
    }
  }
  const int all = tree.update({}, 0.0).fronts;
  EXPECT_EQ(tree.update({}, 0.0).fronts, 0);
  tree.change_term(held, {{some}, 2.0 * Eigen::MatrixXd::Identity(1, 1), Eigen::VectorXd::Ones(1)});
  const int few = tree.update({}, 0.0).fronts;
  EXPECT_GT(few, 0);
  EXPECT_LT(5 * few, all);
}

TEST(FrontTree, HandsStepsDownAsFarAsTheyMatter) {
  FrontTree tree;
  std::vector<int> chain;
  int first = 0;
  for (int k = 0; k < 200; ++k) {
    chain.push_back(tree.add_unknown(1));
    const int t = tree.add_term({{chain.back()}, Eigen::MatrixXd::Identity(1, 1), Eigen::VectorXd::Ones(1)});
    if (k == 0) first = t;
    else tree.add_term(between(chain[static_cast<std::size_t>(k - 1)], chain.back(), 1.0));
  }
  ASSERT_FALSE(tree.update({}, 0.0).failed);
  tree.change_term(first, {{chain[0]}, Eigen::MatrixXd::Identity(1, 1), 2.0 * Eigen::VectorXd::Ones(1)});
  ASSERT_FALSE(tree.update({}, 1e-6).failed);
  EXPECT_GT(tree.moved().size(), 3U);
  EXPECT_LT(tree.moved().size(), 100U);  // the influence of an end dies away
}

TEST(FrontTree, ALookStaysWhatItIs) {
  Grown grown(42);
  ASSERT_FALSE(grown.tree.update({}, 0.0).failed);
  const auto look = grown.tree.factored();
  const Eigen::MatrixXd before = look->joint_covariance({0, 1, 2, 3, 4});
  for (int k = 0; k < 20; ++k) grown.link();
  ASSERT_FALSE(grown.tree.update({}, 0.0).failed);
  EXPECT_EQ(look->joint_covariance({0, 1, 2, 3, 4}), before);
  EXPECT_GT((grown.tree.factored()->joint_covariance({0, 1, 2, 3, 4}) - before).norm(), 1e-6);
}

TEST(FrontTree, RecoversFromWhatIsNotPositiveDefinite) {
  FrontTree tree;
  const int u = tree.add_unknown(1), v = tree.add_unknown(1);
  const int held = tree.add_term({{u}, Eigen::MatrixXd::Identity(1, 1), Eigen::VectorXd::Ones(1)});
  tree.add_term(between(u, v, 1.0));
  ASSERT_FALSE(tree.update({}, 0.0).failed);
  EXPECT_NEAR(tree.solution(v)[0], 1.0, 1e-12);
  tree.change_term(held, {{u}, Eigen::MatrixXd::Zero(1, 1), Eigen::VectorXd::Ones(1)});
  EXPECT_TRUE(tree.update({}, 0.0).failed);
  EXPECT_NEAR(tree.solution(v)[0], 1.0, 1e-12);  // as before
  tree.change_term(held, {{u}, Eigen::MatrixXd::Identity(1, 1), 3.0 * Eigen::VectorXd::Ones(1)});
  EXPECT_FALSE(tree.update({}, 0.0).failed);
  EXPECT_NEAR(tree.solution(v)[0], 3.0, 1e-12);
}

}  // namespace
}  // namespace convoy
