#include <convoy/config_error.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/drift/paper_bias.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include "../random_world.hpp"

#include <gtest/gtest.h>
#include <Eigen/Eigenvalues>

#include <limits>
#include <vector>

namespace convoy {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

/// One number for every translation, another for every rotation.
template <class G>
typename G::Tangent each(double translation, double rotation) {
  typename G::Tangent d;
  d.template head<G::Dim>().setConstant(translation);
  d.template tail<G::Dof - G::Dim>().setConstant(rotation);
  return d;
}

/// A step forward with a turn; in space, a turn about every axis.
template <class G>
G step_of(double length_m, double turn_rad) {
  typename G::Tangent d = each<G>(0.0, turn_rad);
  d[0] = length_m;
  return G::Exp(d);
}

template <class G>
const typename G::Covariance floor_of = each<G>(1e-10, 1e-12).asDiagonal();
const SE2::Covariance floor_of_increment = Eigen::Vector3d(1e-10, 1e-10, 1e-12).asDiagonal();

template <class G>
class IncrementOf : public testing::Test {};
using Groups = testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(IncrementOf, Groups);

template <class G = SE2>
DriftParams<G> params_of(DriftModel model) {
  DriftParams<G> params;
  params.model = model;
  params.rate = each<G>(2e-4, 4e-6);
  return params;
}

/// A winding path of steps of 0.5 m, with a SLAM that states a covariance of its own.
template <class G>
std::vector<ChainState<G>> winding_chain(const DriftParams<G>& params, int steps, std::uint64_t seed = 1) {
  test::Random random(seed);
  DriftAccumulator<G> accumulator(params);
  std::vector<ChainState<G>> states{{}};
  G pose;
  typename G::Covariance slam_drift = G::Covariance::Zero();
  for (int k = 1; k <= steps; ++k) {
    pose = pose * step_of<G>(0.5, random.normal(0.05));
    typename G::Tangent variance;
    for (int i = 0; i < G::Dof; ++i) variance[i] = random.uniform(1e-5, 1e-3) * (i < G::Dim ? 1.0 : 1e-2);
    slam_drift += pose.adjoint() * variance.asDiagonal() * pose.adjoint().transpose();
    states.push_back(accumulator.advance(0.25 * k, 0.5 * k, pose, slam_drift));
  }
  return states;
}

double relative_difference(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B) {
  return (A - B).norm() / std::max(A.norm(), B.norm());
}

// T_c = T_a U_ab Exp(eta_ab) U_bc Exp(eta_bc): the covariances compose with the adjoint.
template <class G>
Increment<G> chained(const Increment<G>& ab, const Increment<G>& bc) {
  const typename G::Adjoint Ad = bc.motion.inverse().adjoint();
  return {ab.motion * bc.motion, Ad * (ab.covariance - floor_of<G>)*Ad.transpose() + bc.covariance};
}

template <class G>
Increment<G> of_first_order(const ChainState<G>& a, const ChainState<G>& b) {
  return {increment(a, b).motion, first_order_drift(a, b)};
}

TYPED_TEST(IncrementOf, AnyTwoAnchorsIsTheChainOfThoseBetween) {
  using G = TypeParam;
  for (const DriftModel model : {DriftModel::local, DriftModel::literal}) {
    const auto states = winding_chain(params_of<G>(model), 400);
    test::Random random(7);
    for (int round = 0; round < 200; ++round) {
      const int a = random.integer(0, 380), b = random.integer(a + 2, 400);
      Increment<G> sum = of_first_order(states[static_cast<std::size_t>(a)], states[static_cast<std::size_t>(a) + 1]);
      for (int k = a + 1; k < b;) {  // anchors between, an arbitrary half of them lost
        const int next = std::min(b, k + random.integer(1, 3));
        sum = chained(sum, of_first_order(states[static_cast<std::size_t>(k)], states[static_cast<std::size_t>(next)]));
        k = next;
      }
      const auto direct = of_first_order(states[static_cast<std::size_t>(a)], states[static_cast<std::size_t>(b)]);
      ASSERT_LT((direct.motion.inverse() * sum.motion).Log().norm(), 1e-9) << a << " to " << b;
      ASSERT_LT(relative_difference(direct.covariance, sum.covariance), 1e-9) << a << " to " << b;
    }
  }
}

TYPED_TEST(IncrementOf, TheLocalModelIsTheDriftInTheBodyFrame) {
  using G = TypeParam;
  // One step: Q is what was stated for it, seen from where the step ends.
  auto params = params_of<G>(DriftModel::local);
  DriftAccumulator<G> accumulator(params);
  const G far = step_of<G>(1100.0, 1.2), next = far * step_of<G>(0.5, 0.1);
  const auto a = accumulator.advance(0.0, 0.0, far, G::Covariance::Zero());
  const auto b = accumulator.advance(1.0, 0.5, next, G::Covariance::Zero());
  const typename G::Covariance expected = (0.5 * params.rate).asDiagonal();
  EXPECT_LT(relative_difference(increment(a, b).covariance - floor_of<G>, expected), 1e-6);
}

TYPED_TEST(IncrementOf, DoesNotDependOnWhereTheChainBegan) {
  using G = TypeParam;
  const auto params = params_of<G>(DriftModel::local);
  const auto run = [&](const G& origin) {
    DriftAccumulator<G> accumulator(params);
    std::vector<ChainState<G>> states;
    for (int k = 0; k < 100; ++k)
      states.push_back(accumulator.advance(k, k, origin * step_of<G>(1.0 * k, 0.02 * k), G::Covariance::Zero()));
    return increment(states[20], states[90]);
  };
  EXPECT_LT(relative_difference(run({}).covariance, run(step_of<G>(1000.0, 1.0)).covariance), 1e-8);
}

TYPED_TEST(IncrementOf, IsNeverLessThanTheFloor) {
  using G = TypeParam;
  ChainState<G> a, b;
  b.pose = step_of<G>(5.0, 0.0);
  EXPECT_TRUE(increment(a, b).covariance.isApprox(floor_of<G>, 1e-12));
  // A SLAM may regain information between anchors: C_b - C_a is indefinite then.
  a.drift = each<G>(0.1, 1e-4).asDiagonal();
  a.drift(0, 0) = 1.0;
  b.drift = each<G>(0.2, 1e-4).asDiagonal();
  b.drift(0, 0) = 0.5;
  const auto Q = increment(a, b).covariance;
  EXPECT_TRUE(is_covariance(Q));
  const Eigen::SelfAdjointEigenSolver<typename G::Covariance> eigen(Q);
  EXPECT_GE(eigen.eigenvalues().minCoeff(), 0.99e-12);
  EXPECT_NEAR(eigen.eigenvalues().maxCoeff(), 0.1, 1e-3);
}

// DESIGN B1.5 as written: Q + 1/8 E[ad_x Q ad_x^T], x ~ N(0, Q).
template <class G>
typename G::Covariance to_second_order(const typename G::Covariance& Q) {
  typename G::Covariance sum = Q;
  for (int i = 0; i < G::Dof; ++i)
    for (int j = 0; j < G::Dof; ++j)
      sum += 0.125 * Q(i, j) * G::ad(G::Tangent::Unit(i)) * Q * G::ad(G::Tangent::Unit(j)).transpose();
  return sum;
}

// A kilometre of drift: what is said of it covers what comes of it, which a covariance of first order does not.
TYPED_TEST(IncrementOf, CoversALongWay) {
  using G = TypeParam;
  constexpr std::uint64_t seed = 12;
  test::Random random(seed);
  typename G::Tangent rate;
  rate.template head<G::Dim>().setConstant(2e-4);
  rate.template tail<G::Dof - G::Dim>().setConstant(4e-6);
  const double step_m = 10.0;
  const G U = step_of<G>(step_m, 0.0);
  ChainState<G> end;
  typename G::Covariance first_order = floor_of<G>;
  for (int k = 0; k < 100; ++k) {
    end.pose = end.pose * U;
    const typename G::Adjoint Ad = end.pose.adjoint();
    end.drift += Ad * (step_m * rate).asDiagonal() * Ad.transpose();
  }
  const typename G::Adjoint Ad = end.pose.inverse().adjoint();
  first_order += Ad * end.drift * Ad.transpose();
  const typename G::Covariance second_order = increment(ChainState<G>{}, end).covariance;
  constexpr int runs = 4000;
  double first = 0.0, second = 0.0;
  for (int run = 0; run < runs; ++run) {
    G T;
    for (int k = 0; k < 100; ++k)
      T = T * U * G::Exp((step_m * rate).cwiseSqrt().cwiseProduct(random.unit_normal<G::Dof>()));
    const typename G::Tangent e = (end.pose.inverse() * T).Log();
    first += squared_mahalanobis(e, first_order) / G::Dof / runs;
    second += squared_mahalanobis(e, second_order) / G::Dof / runs;
  }
  std::printf("seed %d: ANEES after 1 km, of first order %.3f, of second %.3f\n", static_cast<int>(seed), first,
              second);
  EXPECT_GT(first, 1.2);
  EXPECT_NEAR(second, 1.0, 0.05);
}

// DESIGN eq. 2 to rounding: C accumulated step by step gives back the sum of the steps' own covariances, each carried
// to the end by the adjoint. Neither the path nor what was lost on the way leaves a trace.
TYPED_TEST(IncrementOf, IsExactToRounding) {
  using G = TypeParam;
  test::Random random(11);
  for (int round = 0; round < 100; ++round) {
    ChainState<G> a, b;
    a.pose = b.pose = random.template pose_of<G>(100.0);
    const auto accumulate = [&](ChainState<G>& state) {
      const typename G::Adjoint Ad = state.pose.adjoint();
      typename G::Tangent q = random.unit_normal<G::Dof>().cwiseAbs2();
      state.drift += Ad * q.asDiagonal() * Ad.transpose();
      return q;
    };
    for (int k = 0; k < 5; ++k) accumulate(a);
    b.drift = a.drift;
    std::vector<std::pair<G, typename G::Tangent>> steps;
    for (int k = 0; k < 30; ++k) {
      b.pose = b.pose * step_of<G>(0.5, random.normal(0.1));
      steps.emplace_back(b.pose, accumulate(b));
    }
    typename G::Covariance expected = floor_of<G>;
    for (const auto& [pose, q] : steps) {
      const typename G::Adjoint Ad = (b.pose.inverse() * pose).adjoint();
      expected += Ad * q.asDiagonal() * Ad.transpose();
    }
    const Increment<G> increment_ab = increment(a, b);
    EXPECT_LT(relative_difference(first_order_drift(a, b), expected), 1e-12) << round;
    EXPECT_LT(relative_difference(increment_ab.covariance, to_second_order<G>(expected)), 1e-11) << round;
    EXPECT_LT(((a.pose * increment_ab.motion).inverse() * b.pose).Log().norm(), 1e-12) << round;
  }
}

// Eq. 1 linearised at no bias: how an error of the bias moves the pose (x, y, theta).
Eigen::Matrix3d pose_covariance_of_the_paper(const Eigen::Matrix3d& P_b, const Eigen::Vector3d& v) {
  Eigen::Matrix3d J;
  constexpr double h = 1e-6;
  for (int k = 0; k < 3; ++k) {
    paper::Bias plus, minus;
    plus.b[k] = h;
    minus.b[k] = -h;
    J.col(k) = (paper::unbiased_pose(plus, v) - paper::unbiased_pose(minus, v)) / (2.0 * h);
  }
  return J * P_b * J.transpose();
}

Eigen::Matrix3d pose_covariance_of_the_model(const ChainState<SE2>& state) {
  const auto drift = increment({}, state);
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  R.topLeftCorner<2, 2>() = drift.motion.rotation();
  return R * (first_order_drift({}, state) - floor_of_increment) * R.transpose();
}

TEST(DriftModel, LiteralIsTheRandomWalkOfThePaperToFirstOrder) {
  const auto params = params_of(DriftModel::literal);
  const Eigen::Matrix3d P_eps = params.rate.asDiagonal();
  for (const auto& state : winding_chain(params, 300)) {
    if (state.abscissa_m == 0.0) continue;
    const paper::Bias bias = paper::propagated({}, state.abscissa_m, P_eps);
    const Eigen::Vector3d v(state.pose.translation().x(), state.pose.translation().y(), state.pose.theta());
    ASSERT_LT(relative_difference(pose_covariance_of_the_model(state), pose_covariance_of_the_paper(bias.P_b, v)), 1e-7)
        << state.abscissa_m;
  }
}

ChainState<SE2> after_a_loop(DriftModel model) {
  DriftAccumulator<SE2> accumulator(params_of(model));
  const double length_m = 340.0;
  ChainState<SE2> state;
  for (int k = 1; k <= 338; ++k) {  // a circle, closed but for 2 m
    const double angle = 2.0 * M_PI * k / length_m, radius = length_m / (2.0 * M_PI);
    const SE2 pose(radius * std::sin(angle), radius * (1.0 - std::cos(angle)), angle);
    state = accumulator.advance(k, k, pose, SE2::Covariance::Zero());
  }
  return state;
}

TEST(DriftModel, LiteralIsOverconfidentWhereALoopClosesAndLocalIsNot) {
  const auto sigma_m = [](const ChainState<SE2>& state) {
    return std::sqrt(pose_covariance_of_the_model(state).topLeftCorner<2, 2>().trace());
  };
  const auto literal = after_a_loop(DriftModel::literal), local = after_a_loop(DriftModel::local);
  EXPECT_NEAR(sigma_m(literal), std::sqrt(2.0 * 338.0 * 2e-4), 0.02);
  EXPECT_GT(sigma_m(local), 5.0 * sigma_m(literal));

  // The truth: runs of the drift itself.
  test::Random random(3);
  double squared = 0.0;
  constexpr int runs = 400;
  for (int run = 0; run < runs; ++run) {
    SE2 T, previous;
    const Eigen::Vector3d sigma = params_of(DriftModel::local).rate.cwiseSqrt();
    for (int k = 1; k <= 338; ++k) {
      const double angle = 2.0 * M_PI * k / 340.0, radius = 340.0 / (2.0 * M_PI);
      const SE2 pose(radius * std::sin(angle), radius * (1.0 - std::cos(angle)), angle);
      T = T * (previous.inverse() * pose) * SE2::Exp(sigma.cwiseProduct(random.unit_normal<3>()));
      previous = pose;
    }
    squared += (T.translation() - local.pose.translation()).squaredNorm() / runs;
  }
  EXPECT_NEAR(std::sqrt(squared), sigma_m(local), 0.12 * sigma_m(local));
}

/// The same path with the plane z = 0 for its world.
SE3 raised(const SE2& T) {
  const double half = 0.5 * T.theta();
  return {{std::cos(half), 0.0, 0.0, std::sin(half)}, {T.translation().x(), T.translation().y(), 0.0}};
}

// Rates in the plane and none out of it: the three rows and columns that the plane knows are those of SE(2).
TEST(DriftModel, OfAPathInThePlaneIsThatOfThePlane) {
  for (const DriftModel model : {DriftModel::local, DriftModel::literal}) {
    DriftParams<SE3> in_space;
    in_space.model = model;
    in_space.rate << 2e-4, 2e-4, 2e-4, 0.0, 0.0, 4e-6;
    DriftAccumulator<SE2> flat(params_of(model));
    DriftAccumulator<SE3> spatial(in_space);
    SE2 pose;
    for (int k = 1; k <= 200; ++k) {
      pose = pose * SE2::Exp({1.0, 0.0, 0.03 * std::sin(0.1 * k)});
      const auto a = flat.advance(k, k, pose, SE2::Covariance::Zero());
      const auto b = spatial.advance(k, k, raised(pose), SE3::Covariance::Zero());
      const Eigen::Array3i plane(0, 1, 5);
      ASSERT_LT(relative_difference(a.drift, b.drift(plane, plane)), 1e-12) << k;
      ASSERT_LT(relative_difference(increment({}, a).covariance, increment({}, b).covariance(plane, plane)), 1e-9) << k;
    }
  }
}

TEST(DriftParams, OfTheLiteralModelInSpaceHaveNoDirectionOrTurnAboutZAlone) {
  const auto accepted = [](const SE3::Tangent& rate) {
    DriftParams<SE3> params;
    params.model = DriftModel::literal;
    params.rate = rate;
    try {
      validate(params);
    } catch (const ConfigError&) {
      return false;
    }
    return true;
  };
  SE3::Tangent rate;
  EXPECT_TRUE(accepted((rate << 1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6).finished()));
  EXPECT_TRUE(accepted((rate << 1e-4, 1e-4, 1e-4, 0.0, 0.0, 1e-6).finished()));
  EXPECT_FALSE(accepted((rate << 1e-4, 1e-4, 2e-4, 0.0, 0.0, 1e-6).finished()));
  EXPECT_FALSE(accepted((rate << 1e-4, 1e-4, 1e-4, 1e-6, 0.0, 1e-6).finished()));
  EXPECT_FALSE(accepted((rate << 1e-4, 1e-4, 1e-4, 2e-6, 2e-6, 1e-6).finished()));
}

TEST(DriftModel, AddsGammaTimesWhatTheSlamStates) {
  DriftParams<SE2> params = params_of(DriftModel::local);
  params.rate.setZero();
  params.gamma = 3.0;
  const SE2::Covariance stated = Eigen::Vector3d(0.1, 0.2, 0.01).asDiagonal();
  const auto state = DriftAccumulator<SE2>(params).advance(2.0, 10.0, SE2(10.0, 1.0, 0.2), stated);
  EXPECT_TRUE(state.drift.isApprox(3.0 * stated, 1e-12));
  EXPECT_EQ(state.stamp_s, 2.0);
  EXPECT_EQ(state.abscissa_m, 10.0);
}

TEST(DriftModel, StandingStillAddsNothing) {
  DriftAccumulator<SE2> accumulator(params_of(DriftModel::local));
  const auto before = accumulator.advance(1.0, 10.0, SE2(10.0, 0.0, 0.0), SE2::Covariance::Zero());
  const auto after = accumulator.advance(100.0, 10.0, SE2(10.0, 0.0, 0.0), SE2::Covariance::Zero());
  EXPECT_EQ(before.drift, after.drift);
}

TEST(DriftParams, AreCheckedWithAWordOnHowToMendThem) {
  const auto refused = [](auto change) {
    DriftParams<SE2> params;
    change(params);
    try {
      validate(params);
    } catch (const ConfigError& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  using P = DriftParams<SE2>;
  EXPECT_EQ(refused([](P&) {}), "accepted");
  for (const double gamma : {0.0, -1.0, nan})
    EXPECT_NE(refused([&](P& p) { p.gamma = gamma; }).find("gamma"), std::string::npos) << gamma;
  for (int k = 0; k < 3; ++k)
    for (const double rate : {-1e-9, nan, std::numeric_limits<double>::infinity()})
      EXPECT_NE(refused([&](P& p) { p.rate[k] = rate; }).find("rate"), std::string::npos) << k << ": " << rate;
  for (const double inflation : {0.5, nan})
    EXPECT_NE(refused([&](P& p) { p.landmark_inflation = inflation; }).find("landmark_inflation"), std::string::npos);
  const auto unequal = [](P& p) { p.rate = {1e-4, 2e-4, 1e-6}; };
  EXPECT_EQ(refused(unequal), "accepted");
  EXPECT_NE(refused([&](P& p) {
              unequal(p);
              p.model = DriftModel::literal;
            }).find("literal"),
            std::string::npos);
  EXPECT_THROW(DriftAccumulator<SE2>(P{.gamma = -1.0}), ConfigError);
}

}  // namespace
}  // namespace convoy
