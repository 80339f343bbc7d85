#include <convoy/geometry/covariance.hpp>
#include <convoy/monocular/landmark_view.hpp>
#include <convoy/monocular/monocular_state.hpp>

#include "monocular_world.hpp"

#include <gtest/gtest.h>
#include <Eigen/LU>

namespace convoy {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/// The state with its error coordinate `i` moved by `step`.
MonocularState perturbed(const MonocularState& state, Index i, double step) {
  MonocularState moved = state;
  MatrixXd PHt = VectorXd::Unit(state.covariance().rows(), i);
  moved.correct(PHt, Eigen::LLT<MatrixXd>(MatrixXd::Identity(1, 1)), VectorXd::Constant(1, step));
  return moved;
}

/// In the middle of a street: points, landmarks in clones, clones.
MonocularState on_the_way(std::uint64_t seed) {
  MonocularParams params;
  params.sigma_scale = 0.01;
  test::MonocularWorldParams world;
  world.length_m = 15.0;
  test::MonocularWorld street(params, world, seed);
  street.run();
  return street.ekf().filter().state();
}

/// What a common motion d of everything is in the error coordinates of this state.
VectorXd common_motion(const MonocularState& state, const SE3::Tangent& d) {
  VectorXd n = VectorXd::Zero(state.covariance().rows());
  n.head<6>() = d;
  for (std::size_t i = 0; i < state.landmarks().size(); ++i)
    if (state.landmarks()[i].clone == 0) n.segment<3>(MonocularState::landmark_column(i)) = d.head<3>();
  for (std::size_t i = 0; i < state.clones().size(); ++i) n.segment<6>(state.clone_column(i)) = d;
  return n;
}

TEST(MonocularState, HasPointsAndLandmarksInClonesOnTheWay) {
  const MonocularState state = on_the_way(1);
  std::size_t points = 0;
  for (const auto& l : state.landmarks()) points += l.clone == 0 ? 1 : 0;
  EXPECT_GT(points, 3U);
  EXPECT_GT(state.landmarks().size() - points, 3U);
  EXPECT_GT(state.clones().size(), 5U);
  EXPECT_TRUE(is_covariance(state.covariance()));
}

TEST(MonocularState, TheJacobiansOfAViewAreThoseOfItsPixel) {
  const CameraModel camera(test::street_camera());
  const MonocularState state = on_the_way(2);
  int checked = 0;
  for (std::size_t k = 0; k < state.landmarks().size(); ++k) {
    const auto view = view_of(state, k, camera, state.pose());
    if (!view) continue;
    ++checked;
    const MatrixXd H = times({*view}, MatrixXd::Identity(state.covariance().rows(), state.covariance().rows()));
    for (Index i = 0; i < H.cols(); ++i) {
      if (i == MonocularState::scale_column) continue;
      const double step = 1e-6;
      const MonocularState plus = perturbed(state, i, step), minus = perturbed(state, i, -step);
      const Eigen::Vector2d numeric =
          (view_of(plus, k, camera, plus.pose())->pixel - view_of(minus, k, camera, minus.pose())->pixel) /
          (2.0 * step);
      ASSERT_LT((H.col(i) - numeric).norm(), 1e-4 * (1.0 + H.norm())) << "landmark " << k << ", column " << i;
    }
  }
  EXPECT_GT(checked, 10);
}

// Gauge: no view sees a common motion of everything, whatever the estimates are, and no step of the odometer does.
TEST(MonocularState, NothingSeesACommonMotion) {
  const CameraModel camera(test::street_camera());
  const MonocularState state = on_the_way(3);
  for (int axis = 0; axis < 6; ++axis) {
    const VectorXd n = common_motion(state, SE3::Tangent::Unit(axis));
    for (std::size_t k = 0; k < state.landmarks().size(); ++k) {
      const auto view = view_of(state, k, camera, state.pose());
      if (!view) continue;
      ASSERT_LT(times({*view}, n).norm(), 1e-9 * (1.0 + view->by_clone.norm())) << axis;
    }
  }
  MonocularState moved = state;
  OdometryStep step;
  step.append(0.4, 0.05, 0.1, SE3::Tangent::Zero());
  moved.move(step, 0.0);
  for (int axis = 0; axis < 6; ++axis)
    EXPECT_EQ(common_motion(state, SE3::Tangent::Unit(axis)), common_motion(moved, SE3::Tangent::Unit(axis)));
}

// What the odometer does not know moves the state as step_jacobian() says.
TEST(MonocularState, AStepMovesTheErrorsAsItsJacobianSays) {
  const MonocularState state = on_the_way(4);
  OdometryStep step;
  step.append(0.4, 0.05, 0.1, SE3::Tangent::Zero());
  step.append(0.3, -0.02, 0.1, SE3::Tangent::Zero());
  const double turn = 1e-3;
  OdometryStep other;
  other.append(0.4, 0.05 - turn * 0.1, 0.1, SE3::Tangent::Zero());
  other.append(0.3, -0.02 - turn * 0.1, 0.1, SE3::Tangent::Zero());
  EXPECT_LT(((step.motion.inverse() * other.motion).Log() / turn - step.by_bias).norm(), 1e-3);
  OdometryStep longer;
  longer.append(0.4 * (1.0 + 1e-3), 0.05, 0.1, SE3::Tangent::Zero());
  longer.append(0.3 * (1.0 + 1e-3), -0.02, 0.1, SE3::Tangent::Zero());
  EXPECT_LT(((step.motion.inverse() * longer.motion).Log() / 1e-3 - step.by_scale).norm(), 1e-3);

  MonocularState moved = state;
  moved.move(step, 0.0);
  const MatrixXd N = moved.step_jacobian();
  MatrixXd F = MatrixXd::Identity(N.rows(), N.rows());
  F.col(MonocularState::bias_column) += N * step.by_bias;
  F.col(MonocularState::scale_column) += N * step.by_scale;
  const MatrixXd P = F * state.covariance() * F.transpose();
  EXPECT_LT((moved.covariance() - P).norm(), 1e-10 * P.norm());
}

TEST(MonocularState, TwoStepsAreOne) {
  OdometryStep one, a, b;
  const SE3::Tangent variance = SE3::Tangent::Constant(1e-3);
  for (int k = 0; k < 6; ++k) {
    one.append(0.1 * k, 0.03, 0.1, variance);
    (k < 3 ? a : b).append(0.1 * k, 0.03, 0.1, variance);
  }
  a.append(b);
  EXPECT_LT((a.motion.inverse() * one.motion).Log().norm(), 1e-12);
  EXPECT_LT((a.noise - one.noise).norm(), 1e-12);
  EXPECT_LT((a.by_bias - one.by_bias).norm() + (a.by_scale - one.by_scale).norm(), 1e-12);
  EXPECT_DOUBLE_EQ(a.length_m, one.length_m);
}

TEST(MonocularState, BecomingAPointKeepsWhatIsKnown) {
  MonocularState state = on_the_way(5);
  std::vector<std::size_t> all;
  for (std::size_t i = 0; i < state.landmarks().size(); ++i) all.push_back(i);
  const MatrixXd before = state.relative_covariance(all);
  std::vector<Eigen::Vector3d> positions;
  for (const std::size_t i : all) positions.push_back(state.position(i));
  for (const std::size_t i : all)
    if (state.landmarks()[i].clone != 0) state.make_point(i);
  EXPECT_LT((state.relative_covariance(all) - before).norm(), 1e-9 * before.norm());
  for (const std::size_t i : all) EXPECT_LT((state.position(i) - positions[i]).norm(), 1e-12);
  EXPECT_TRUE(is_covariance(state.covariance()));
}

TEST(MonocularState, ANewAnchorKeepsWhatIsKnownRelativeToThePose) {
  MonocularState state = on_the_way(6);
  std::vector<std::size_t> all;
  for (std::size_t i = 0; i < state.landmarks().size(); ++i) all.push_back(i);
  const MatrixXd before = state.relative_covariance(all);
  const SE3 T = state.pose();
  const SE3 clone = state.clones()[2].pose;
  state.rebase();
  EXPECT_LT((state.relative_covariance(all) - before).norm(), 1e-9 * before.norm());
  EXPECT_TRUE(state.pose_covariance().isZero(0.0));
  EXPECT_TRUE(state.pose().Log().isZero(0.0));
  EXPECT_LT((state.clones()[2].pose.inverse() * (T.inverse() * clone)).Log().norm(), 1e-12);
  EXPECT_TRUE(is_covariance(state.covariance()));
}

// Against K = P H^T S^-1 with the scale's gain set to zero, (I - K H) P (I - K H)^T + K R K^T.
TEST(MonocularState, CorrectsLikeASchmidtFilter) {
  const CameraModel camera(test::street_camera());
  MonocularState state = on_the_way(7);
  std::vector<LandmarkView> views;
  for (std::size_t k = 0; k < state.landmarks().size() && views.size() < 12; ++k)
    if (const auto view = view_of(state, k, camera, state.pose())) views.push_back(*view);
  const MatrixXd P = state.covariance();
  JointInnovation joint = joint_innovation(state, views, 1.0);
  const MatrixXd H = times(views, MatrixXd::Identity(P.rows(), P.rows()));
  ASSERT_LT((joint.PHt - P * H.transpose()).norm(), 1e-10);
  MatrixXd K = joint.PHt * joint.S.inverse();
  K.row(MonocularState::scale_column).setZero();
  const MatrixXd rest = MatrixXd::Identity(P.rows(), P.rows()) - K * H;
  const MatrixXd expected = rest * P * rest.transpose() + K * K.transpose();
  state.correct(joint.PHt, Eigen::LLT<MatrixXd>(joint.S), VectorXd::Zero(joint.S.rows()));
  EXPECT_LT((state.covariance() - expected).norm(), 1e-9 * P.norm());
  EXPECT_EQ(state.covariance()(MonocularState::scale_column, MonocularState::scale_column), 1e-4);
}

TEST(MonocularState, DropsRowsAndColumnsOfWhatLeaves) {
  MonocularState state = on_the_way(8);
  const MatrixXd last = state.relative_covariance({state.landmarks().size() - 1});
  const std::uint64_t id = state.landmarks().back().id;
  std::vector<std::size_t> clones;
  for (std::size_t i = 0; i < state.clones().size(); ++i) {
    bool needed = false;
    for (const auto& l : state.landmarks()) needed |= l.clone == state.clones()[i].id;
    if (!needed) clones.push_back(i);
  }
  const std::size_t landmarks = state.landmarks().size(), left = state.clones().size() - clones.size();
  state.drop({0, 2}, clones);
  ASSERT_EQ(state.landmarks().size(), landmarks - 2);
  ASSERT_EQ(state.clones().size(), left);
  ASSERT_EQ(state.covariance().rows(), static_cast<Index>(8 + 3 * (landmarks - 2) + 6 * left));
  ASSERT_EQ(state.landmarks().back().id, id);
  EXPECT_LT((state.relative_covariance({landmarks - 3}) - last).norm(), 1e-12);
}

}  // namespace
}  // namespace convoy
