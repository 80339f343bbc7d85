#include <convoy/association/baselines.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <set>
#include <string>

namespace convoy {
namespace {

const Key anchor_a{{1, 1}, 1}, anchor_b{{2, 1}, 1};
constexpr double confidence = 0.99;
constexpr std::uint64_t plenty = 1'000'000;

template <class G>
struct Problem {
  Batch<G> a{anchor_a, {}}, b{anchor_b, {}};
  std::optional<RelativePrior<G>> prior;
  std::vector<IndexPairing> truth;
};

template <class G>
struct Method {
  std::string name;
  std::function<SearchResult(const Problem<G>&)> run;
};

template <class G>
std::vector<Method<G>> methods(const ConfigurationParams& params = {}, std::uint64_t max_nodes = plenty) {
  return {{"jcbb", [=](const Problem<G>& p) { return jcbb(p.a, p.b, p.prior, confidence, max_nodes); }},
          {"triplets", [=](const Problem<G>& p) { return triplets(p.a, p.b, p.prior, confidence, params); }},
          {"delaunay", [=](const Problem<G>& p) { return delaunay(p.a, p.b, p.prior, confidence, params); }}};
}

// Anywhere, turned about the vertical alone.
template <class G>
G level_pose(test::Random& random) {
  typename G::Tangent turn = G::Tangent::Zero(), shift = G::Tangent::Zero();
  turn[G::Dof - 1] = random.uniform(-3.1, 3.1);
  for (int k = 0; k < G::Dim; ++k) shift[k] = random.uniform(-100.0, 100.0);
  return G::Exp(shift) * G::Exp(turn);
}

// Less than it is stated to be: at the gate's confidence some of what is planted would be missed.
const test::BatchNoise little{0.002, 0.0, 0.3};

// `common` landmarks that both have, the first of each; then `others` of each one's own.
template <class G>
Problem<G> planted(std::uint64_t seed, std::size_t common, std::size_t others, const test::BatchNoise& noise) {
  test::Random random(seed);
  const G T_w_a = level_pose<G>(random), T_w_b = level_pose<G>(random);
  const test::PointsOf<G> points = test::scattered<G>(random, common + 2 * others, 20.0);
  const auto first = points.begin() + static_cast<std::ptrdiff_t>(common);
  const auto middle = first + static_cast<std::ptrdiff_t>(others);
  test::PointsOf<G> in_a(points.begin(), middle), in_b(points.begin(), first);
  in_b.insert(in_b.end(), middle, points.end());
  Problem<G> p;
  p.a = test::frozen_batch(random, anchor_a, T_w_a, in_a, noise);
  p.b = test::frozen_batch(random, anchor_b, T_w_b, in_b, noise);
  RelativePrior<G> prior;
  prior.covariance.diagonal().template head<G::Dim>().setConstant(0.25);
  prior.covariance.diagonal().template tail<G::Dof - G::Dim>().setConstant(1e-6);
  const typename G::Tangent error = 0.5 * random.draw<G::Dof>(prior.covariance);
  prior.mean = T_w_a.inverse() * T_w_b * G::Exp(error);
  p.prior = prior;
  for (int k = 0; k < static_cast<int>(common); ++k) p.truth.emplace_back(k, k);
  return p;
}

template <class G>
void expect_valid(const Problem<G>& p, const SearchResult& result) {
  std::set<int> is, js;
  for (const auto& [i, j] : result.pairings) {
    EXPECT_TRUE(i >= 0 && i < static_cast<int>(p.a.landmarks.size()) && is.insert(i).second);
    EXPECT_TRUE(j >= 0 && j < static_cast<int>(p.b.landmarks.size()) && js.insert(j).second);
  }
  EXPECT_TRUE(std::is_sorted(result.pairings.begin(), result.pairings.end()));
}

template <class G>
class Baselines : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(Baselines, Groups);

TYPED_TEST(Baselines, FindWhatIsPlanted) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const Problem<TypeParam> p = planted<TypeParam>(seed, 12, 0, little);
    for (const auto& method : methods<TypeParam>()) {
      const SearchResult found = method.run(p);
      EXPECT_EQ(found.pairings, p.truth) << method.name << " " << seed;
      EXPECT_FALSE(found.cut_off) << method.name << " " << seed;
      EXPECT_GT(found.nodes, 0U) << method.name << " " << seed;
    }
  }
}

TYPED_TEST(Baselines, OfConfigurationsNeedNoPrior) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Problem<TypeParam> p = planted<TypeParam>(seed, 15, 0, little);
    p.prior.reset();
    for (const auto& method : methods<TypeParam>()) {
      const SearchResult found = method.run(p);
      const bool needs_one = method.name == "jcbb";
      EXPECT_EQ(found.pairings, needs_one ? std::vector<IndexPairing>{} : p.truth) << method.name << " " << seed;
    }
  }
}

std::set<Pairing> by_key(const auto& p, const SearchResult& result) {
  std::set<Pairing> pairings;
  for (const auto& [i, j] : result.pairings)
    pairings.emplace(p.a.landmarks[static_cast<std::size_t>(i)].key, p.b.landmarks[static_cast<std::size_t>(j)].key);
  return pairings;
}

TYPED_TEST(Baselines, DoNotDependOnTheOrderOfLandmarks) {
  // Noise and landmarks that are not common make ties; budgets cut some off.
  std::size_t found = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Problem<TypeParam> p = planted<TypeParam>(seed, 12, 4, {0.2, 0.0}), shuffled = p;
    test::Random random(100 + seed);
    std::shuffle(shuffled.a.landmarks.begin(), shuffled.a.landmarks.end(), random.engine());
    std::shuffle(shuffled.b.landmarks.begin(), shuffled.b.landmarks.end(), random.engine());
    for (const auto& method : methods<TypeParam>({0.99, 10}, 100)) {
      const SearchResult result = method.run(p), again = method.run(p), other = method.run(shuffled);
      expect_valid(p, result);
      expect_valid(shuffled, other);
      EXPECT_EQ(result.pairings, again.pairings) << method.name << " " << seed;
      EXPECT_EQ(by_key(p, result), by_key(shuffled, other)) << method.name << " " << seed;
      EXPECT_EQ(result.nodes, other.nodes) << method.name << " " << seed;
      found += result.pairings.size();
    }
  }
  EXPECT_GT(found, 100U);
}

TYPED_TEST(Baselines, SurviveInputThatFixesNothing) {
  using G = TypeParam;
  using Points = test::PointsOf<G>;
  const typename G::Point here = G::Point::Ones(), along = G::Point::UnitX();
  Points row, regular_row;
  for (int k = 0; k < 8; ++k) row.push_back(here + k * (1.0 + 0.2 * k) * along);
  for (int k = 0; k < 8; ++k) regular_row.push_back(here + k * along);
  const std::vector<Points> inputs = {{}, {here}, {here, here + along}, Points(6, here), row, regular_row};
  test::Random random(1);
  for (const double scale : {0.0, 1.0})
    for (const Points& in_a : inputs)
      for (const Points& in_b : inputs)
        for (const bool known : {true, false}) {
          Problem<G> p;
          p.a = test::frozen_batch(random, anchor_a, G(), in_a, {0.02, 0.0, scale});
          p.b = test::frozen_batch(random, anchor_b, G(), in_b, {0.02, 0.0, scale});
          if (known) p.prior = RelativePrior<G>{G(), 0.01 * G::Covariance::Identity()};
          for (const auto& method : methods<G>({}, 10'000)) {
            const SearchResult result = method.run(p);
            expect_valid(p, result);
            if (method.name == "delaunay" && scale == 0.0) {
              EXPECT_TRUE(result.pairings.empty());
            }
            if (in_a.empty() || in_b.empty()) {
              EXPECT_TRUE(result.pairings.empty()) << method.name;
            }
          }
        }
}

TYPED_TEST(Baselines, OfConfigurationsTakeNoMirrorImage) {
  using G = TypeParam;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    Problem<G> p = planted<G>(seed, 15, 0, little);
    p.prior.reset();
    for (auto& l : p.b.landmarks) {
      l.position.y() *= -1.0;
      l.covariance.row(1) *= -1.0;
      l.covariance.col(1) *= -1.0;
    }
    for (const auto& method : methods<G>()) EXPECT_TRUE(method.run(p).pairings.empty()) << method.name << " " << seed;
  }
}

TYPED_TEST(Baselines, SayWhenTheBudgetCutThemOff) {
  const Problem<TypeParam> p = planted<TypeParam>(1, 12, 0, little);
  for (const auto& method : methods<TypeParam>({0.99, 3}, 3)) {
    const SearchResult result = method.run(p);
    EXPECT_TRUE(result.cut_off) << method.name;
    EXPECT_EQ(result.nodes, 3U) << method.name;
    EXPECT_FALSE(result.pairings.empty()) << method.name;
    expect_valid(p, result);
  }
}

TYPED_TEST(Baselines, AllowForTheDriftThatIsStated) {
  // The way of b is stretched by 2 cm a metre.
  Problem<TypeParam> p = planted<TypeParam>(2, 15, 0, little);
  for (std::size_t k = 0; k < p.b.landmarks.size(); ++k) {
    p.b.abscissa_m.push_back(2.0 * static_cast<double>(k));
    p.b.landmarks[k].position.x() += 0.02 * p.b.abscissa_m.back();
  }
  for (const auto& method : methods<TypeParam>()) {
    p.b.drift_m2_per_m = 0.0;
    EXPECT_LT(method.run(p).pairings.size(), p.truth.size()) << method.name;
    p.b.drift_m2_per_m = 0.05;
    EXPECT_GT(method.run(p).pairings.size(), p.truth.size() / 2) << method.name;
    expect_valid(p, method.run(p));
  }
}

// The joint chi-square of pairings as one stacked vector of residuals.
template <class G>
double stacked_chi2(const Problem<G>& p, const std::vector<IndexPairing>& pairings) {
  const auto n = static_cast<Eigen::Index>(pairings.size());
  Eigen::VectorXd r(G::Dim * n);               // residuals, pair after pair, frame a
  Eigen::MatrixXd H(G::Dim * n, int{G::Dof});  // by the perturbation of the prior
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(G::Dim * n, G::Dim * n);
  const auto R = p.prior->mean.rotation();
  for (Eigen::Index k = 0; k < n; ++k) {
    const auto& [i, j] = pairings[static_cast<std::size_t>(k)];
    const auto& a = p.a.landmarks[static_cast<std::size_t>(i)];
    const auto& b = p.b.landmarks[static_cast<std::size_t>(j)];
    r.segment<G::Dim>(G::Dim * k) = a.position - p.prior->mean * b.position;
    H.middleRows<G::Dim>(G::Dim * k) = p.prior->mean.act_jacobian(b.position);
    S.block<G::Dim, G::Dim>(G::Dim * k, G::Dim * k) = a.covariance + R * b.covariance * R.transpose();
  }
  S += H * p.prior->covariance * H.transpose();
  return r.dot(S.ldlt().solve(r));
}

// Every hypothesis in the order of b, each step of it jointly compatible.
template <class G>
class BruteForce {
 public:
  explicit BruteForce(const Problem<G>& p) : p_(p), unary_(p.prior, confidence) { extend(0); }
  std::vector<IndexPairing> best;

 private:
  void extend(std::size_t j) {
    if (j == p_.b.landmarks.size()) {
      const double chi2 = H_.empty() ? 0.0 : stacked_chi2(p_, H_);
      if (H_.size() < best.size() || (H_.size() == best.size() && chi2 >= best_chi2_)) return;
      best = H_;
      best_chi2_ = chi2;
      return;
    }
    extend(j + 1);
    for (std::size_t i = 0; i < p_.a.landmarks.size(); ++i) {
      const IndexPairing next(static_cast<int>(i), static_cast<int>(j));
      const auto taken = [&](const IndexPairing& q) { return q.first == next.first; };
      if (std::any_of(H_.begin(), H_.end(), taken) || !unary_(p_.a.landmarks[i], p_.b.landmarks[j])) continue;
      H_.push_back(next);
      if (stacked_chi2(p_, H_) < chi2_quantile(confidence, static_cast<double>(G::Dim * H_.size()))) extend(j + 1);
      H_.pop_back();
    }
  }

  const Problem<G>& p_;
  IndividualCompatibility<G> unary_;
  std::vector<IndexPairing> H_;
  double best_chi2_ = std::numeric_limits<double>::infinity();
};

TYPED_TEST(Baselines, JcbbIsBruteForceOnSmallCases) {
  using G = TypeParam;
  std::set<std::size_t> sizes;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    test::Random random(seed);
    Problem<G> p;
    const auto some = [&](int most) {
      return test::scattered<G>(random, static_cast<std::size_t>(random.integer(1, most)), 4.0, 0.1);
    };
    p.a = test::frozen_batch(random, anchor_a, G(), some(5), {0.7, 0.2});
    p.b = test::frozen_batch(random, anchor_b, G(), some(4), {0.7, 0.2});
    p.prior = RelativePrior<G>{G(), random.uniform(0.01, 2.0) * G::Covariance::Identity()};
    p.prior->covariance.diagonal().template tail<G::Dof - G::Dim>() *= 0.05;
    BruteForce<G> forced(p);
    std::sort(forced.best.begin(), forced.best.end());
    const SearchResult found = jcbb(p.a, p.b, p.prior, confidence, plenty);
    ASSERT_EQ(found.pairings, forced.best) << seed;
    sizes.insert(found.pairings.size());
  }
  EXPECT_GE(sizes.size(), 4U);
}

TEST(Jcbb, RefusesPairsThatAreCompatibleOneByOneAlone) {
  // Two landmarks, shifted against each other by what a common error of the prior cannot be.
  test::Random random(1);
  Problem<SE2> p;
  p.a = test::frozen_batch(random, anchor_a, SE2(), {{-5.0, 0.0}, {5.0, 0.0}}, {0.05, 0.0, 0.0});
  p.b = test::frozen_batch(random, anchor_b, SE2(), {{-6.0, 0.0}, {6.0, 0.0}}, {0.05, 0.0, 0.0});
  p.prior = RelativePrior<SE2>{SE2(), Eigen::Vector3d(1.0, 1.0, 1e-4).asDiagonal()};
  const IndividualCompatibility<SE2> alone(p.prior, confidence);
  for (std::size_t k = 0; k < 2; ++k) EXPECT_TRUE(alone(p.a.landmarks[k], p.b.landmarks[k]));
  EXPECT_EQ(jcbb(p.a, p.b, p.prior, confidence, plenty).pairings.size(), 1U);
}

double cross(const Eigen::Vector2d& u, const Eigen::Vector2d& v) { return u.x() * v.y() - u.y() * v.x(); }

double area(const test::Points& p, const std::array<int, 3>& t) {
  const auto at = [&](std::size_t v) { return p[static_cast<std::size_t>(t[v])]; };
  return 0.5 * cross(at(1) - at(0), at(2) - at(0));
}

// By how much the circle around a triangle misses the nearest point [m^2]; negative if one is inside.
double clearance(const test::Points& p, const std::array<int, 3>& t) {
  const auto at = [&](std::size_t v) { return p[static_cast<std::size_t>(t[v])]; };
  Eigen::Matrix2d sides;
  sides << (at(1) - at(0)).transpose(), (at(2) - at(0)).transpose();
  const Eigen::Vector2d to_centre =
      sides.inverse() * (0.5 * Eigen::Vector2d((at(1) - at(0)).squaredNorm(), (at(2) - at(0)).squaredNorm()));
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k < p.size(); ++k)
    if (std::find(t.begin(), t.end(), static_cast<int>(k)) == t.end())
      least = std::min(least, (p[k] - at(0) - to_centre).squaredNorm() - to_centre.squaredNorm());
  return least;
}

TEST(DelaunayTriangulation, HasNoPointInTheCircleOfATriangle) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    test::Random random(seed);
    const test::Points points = test::scattered(random, 100, 50.0, 0.5);
    const auto triangles = delaunay_triangulation(points);
    ASSERT_GT(triangles.size(), 150U);  // 2 n - 2 - hull
    for (const auto& t : triangles) {
      ASSERT_GT(area(points, t), 0.0);
      ASSERT_GT(clearance(points, t), -1e-3);
    }
  }
}

TEST(DelaunayTriangulation, CoversAGridOnce) {
  test::Points points;
  for (int x = 0; x < 12; ++x)
    for (int y = 0; y < 12; ++y) points.emplace_back(1000.0 + 2.0 * x, 2.0 * y);
  points.insert(points.end(), points.begin(), points.begin() + 50);  // twice
  double covered = 0.0;
  int thick = 0;
  for (const auto& t : delaunay_triangulation(points)) {
    EXPECT_GT(area(points, t), -1e-3);
    EXPECT_GT(clearance(points, t), -1e-3);
    covered += area(points, t);
    if (area(points, t) > 1.0) ++thick;
  }
  EXPECT_NEAR(covered, 22.0 * 22.0, 1e-2);
  EXPECT_EQ(thick, 2 * 11 * 11);
}

TEST(DelaunayTriangulation, CoversARingOnceAndARowNotAtAll) {
  test::Points ring, row, column;
  for (int k = 0; k < 500; ++k) {
    const double angle = 2.0 * M_PI * k / 500;
    ring.emplace_back(100.0 * std::cos(angle), 100.0 * std::sin(angle));
    row.emplace_back(0.5 * k, 7.0);
    column.emplace_back(7.0, 0.5 * k);
  }
  const auto covered = [](const test::Points& points) {
    const auto triangles = delaunay_triangulation(points);
    EXPECT_LE(triangles.size(), 2 * points.size() - 5);
    double sum = 0.0;
    for (const auto& t : triangles) sum += std::abs(area(points, t));
    return sum;
  };
  EXPECT_NEAR(covered(ring), 0.5 * 500 * 1e4 * std::sin(2.0 * M_PI / 500), 1.0);
  EXPECT_LT(covered(row), 1e-6);
  EXPECT_LT(covered(column), 1e-6);
}

TEST(DelaunayTriangulation, OfTooFewPointsIsEmpty) {
  EXPECT_TRUE(delaunay_triangulation({}).empty());
  EXPECT_TRUE(delaunay_triangulation({{1.0, 1.0}, {2.0, 1.0}}).empty());
  EXPECT_TRUE(delaunay_triangulation(test::Points(9, {3.0, 4.0})).empty());
  EXPECT_EQ(delaunay_triangulation({{0.0, 0.0}, {0.0, 1.0}, {1.0, 0.0}}), (std::vector<std::array<int, 3>>{{0, 2, 1}}));
}

}  // namespace
}  // namespace convoy
