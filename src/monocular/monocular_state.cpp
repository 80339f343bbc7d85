#include <convoy/geometry/covariance.hpp>
#include <convoy/monocular/bearing.hpp>
#include <convoy/monocular/monocular_state.hpp>

#include <algorithm>
#include <numeric>
#include <utility>

namespace convoy {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

MonocularState::MonocularState(const SE3& T_body_camera, double sigma_yaw_bias_radps, double sigma_scale)
    : T_body_camera_(T_body_camera), P_(MatrixXd::Zero(first_landmark, first_landmark)) {
  P_(bias_column, bias_column) = sigma_yaw_bias_radps * sigma_yaw_bias_radps;
  P_(scale_column, scale_column) = sigma_scale * sigma_scale;
}

std::optional<std::size_t> MonocularState::find_landmark(std::uint64_t id) const {
  const auto it = std::find_if(landmarks_.begin(), landmarks_.end(), [&](const auto& l) { return l.id == id; });
  if (it == landmarks_.end()) return std::nullopt;
  return static_cast<std::size_t>(it - landmarks_.begin());
}

std::size_t MonocularState::clone_index(std::uint64_t id) const {
  const auto it = std::lower_bound(clones_.begin(), clones_.end(), id, [](const auto& c, auto i) { return c.id < i; });
  return static_cast<std::size_t>(it - clones_.begin());
}

bool MonocularState::has_clone(std::uint64_t id) const {
  const std::size_t i = clone_index(id);
  return i < clones_.size() && clones_[i].id == id;
}

Vector3d MonocularState::position(std::size_t i) const {
  const MonocularLandmark& l = landmarks_[i];
  if (l.clone == 0) return l.position;
  return clones_[clone_index(l.clone)].pose * (T_body_camera_ * Vector3d(l.bearing / l.inverse_depth));
}

// xi+ = xi + Ad_X w for the pose, of which theta moves a point against itself: xi_l+ = xi_l - theta x l^.
MatrixXd MonocularState::step_jacobian() const {
  const SE3::Adjoint Ad = pose_.adjoint();
  MatrixXd N = MatrixXd::Zero(P_.rows(), 6);
  N.topRows<6>() = Ad;
  for (std::size_t i = 0; i < landmarks_.size(); ++i)
    if (landmarks_[i].clone == 0)
      N.block<3, 3>(landmark_column(i), 3) = skew(landmarks_[i].position) * Ad.bottomRightCorner<3, 3>();
  return N;
}

void MonocularState::add_noise(const MatrixXd& N, const SE3::Covariance& noise) {
  const MatrixXd NQ = N * noise;
  P_.noalias() += NQ * N.transpose();
}

void MonocularState::move(const OdometryStep& step, double bias_walk_variance) {
  pose_ = pose_ * step.motion;
  const MatrixXd N = step_jacobian();
  MatrixXd by_constant(P_.rows(), 2);  // F = I + by_constant * (rows of bias and scale)
  by_constant.col(0) = N * step.by_bias;
  by_constant.col(1) = N * step.by_scale;
  const MatrixXd rows = P_.middleRows<2>(bias_column);
  P_.noalias() += by_constant * rows;
  const MatrixXd columns = P_.middleCols<2>(bias_column);
  P_.noalias() += columns * by_constant.transpose();
  add_noise(N, step.noise);
  P_(bias_column, bias_column) += bias_walk_variance;
  P_ = symmetrised(P_);
}

void MonocularState::inflate(const SE3::Tangent& variance) { add_noise(step_jacobian(), variance.asDiagonal()); }

std::uint64_t MonocularState::clone_pose(double stamp_s, double abscissa_m, bool trail) {
  clones_.push_back({++last_clone_, stamp_s, abscissa_m, pose_, trail});
  const Index n = P_.rows();
  P_.conservativeResize(n + 6, n + 6);
  P_.bottomLeftCorner(6, n) = P_.topLeftCorner(6, n);
  P_.topRightCorner(n, 6) = P_.bottomLeftCorner(6, n).transpose();
  P_.bottomRightCorner<6, 6>() = P_.topLeftCorner<6, 6>();
  return last_clone_;
}

void MonocularState::add(const MonocularLandmark& landmark, const Eigen::Matrix<double, 3, Eigen::Dynamic>& AP,
                         const Matrix3d& F) {
  const Index n = P_.rows(), at = landmark_column(landmarks_.size()), after = n - at;
  MatrixXd grown(n + 3, n + 3);
  grown.topLeftCorner(at, at) = P_.topLeftCorner(at, at);
  grown.bottomRightCorner(after, after) = P_.bottomRightCorner(after, after);
  grown.topRightCorner(at, after) = P_.topRightCorner(at, after);
  grown.bottomLeftCorner(after, at) = P_.bottomLeftCorner(after, at);
  grown.block(at, 0, 3, at) = -AP.leftCols(at);
  grown.block(at, at + 3, 3, after) = -AP.rightCols(after);
  grown.block<3, 3>(at, at) = F;
  grown.block(0, at, at, 3) = grown.block(at, 0, 3, at).transpose();
  grown.block(at + 3, at, after, 3) = grown.block(at, at + 3, 3, after).transpose();
  P_ = std::move(grown);
  landmarks_.push_back(landmark);
}

// xi_l of the point l that landmark i stands for, by the errors of pose, clone and landmark; see the class.
void MonocularState::point_rows(std::size_t i, Eigen::Matrix<double, 3, 6>& by_pose,
                                Eigen::Matrix<double, 3, 6>& by_clone, Matrix3d& by_landmark) const {
  const MonocularLandmark& l = landmarks_[i];
  const Matrix3d cross = skew(position(i));
  by_pose.setZero();
  by_pose.rightCols<3>() = cross;
  by_clone.leftCols<3>() = Matrix3d::Identity();
  by_clone.rightCols<3>() = -cross;
  const Matrix3d R = (clones_[clone_index(l.clone)].pose * T_body_camera_).rotation();
  by_landmark.leftCols<2>() = R * across(l.bearing) / l.inverse_depth;
  by_landmark.col(2) = -R * l.bearing / (l.inverse_depth * l.inverse_depth);
}

void MonocularState::make_point(std::size_t i) {
  MonocularLandmark& l = landmarks_[i];
  Eigen::Matrix<double, 3, 6> by_pose, by_clone;
  Matrix3d by_landmark;
  point_rows(i, by_pose, by_clone, by_landmark);
  const Index at = landmark_column(i), clone = clone_column(clone_index(l.clone));
  Eigen::Matrix<double, 3, Eigen::Dynamic> rows =
      by_pose * P_.topRows<6>() + by_clone * P_.middleRows<6>(clone) + by_landmark * P_.middleRows<3>(at);
  const Matrix3d own = rows.leftCols<6>() * by_pose.transpose() + rows.middleCols<6>(clone) * by_clone.transpose() +
                       rows.middleCols<3>(at) * by_landmark.transpose();
  rows.middleCols<3>(at) = symmetrised(own);
  P_.middleRows<3>(at) = rows;
  P_.middleCols<3>(at) = rows.transpose();
  l.position = position(i);
  l.clone = 0;
}

// Of l' = R^T (l - t): xi_l' = R^T (xi_l - xi_rho).
MatrixXd MonocularState::relative_covariance(const std::vector<std::size_t>& landmarks) const {
  const auto n = 3 * static_cast<Index>(landmarks.size());
  const Matrix3d Rt = pose_.rotation().transpose();
  MatrixXd A = MatrixXd::Zero(n, P_.rows());
  for (std::size_t k = 0; k < landmarks.size(); ++k) {
    const std::size_t i = landmarks[k];
    const Index row = 3 * static_cast<Index>(k), at = landmark_column(i);
    if (landmarks_[i].clone == 0) {
      A.block<3, 3>(row, at) = Rt;
    } else {
      Eigen::Matrix<double, 3, 6> by_pose, by_clone;
      Matrix3d by_landmark;
      point_rows(i, by_pose, by_clone, by_landmark);
      A.block<3, 6>(row, 0) = Rt * by_pose;
      A.block<3, 6>(row, clone_column(clone_index(landmarks_[i].clone))) = Rt * by_clone;
      A.block<3, 3>(row, at) = Rt * by_landmark;
    }
    A.block<3, 3>(row, 0) -= Rt;
  }
  return symmetrised(MatrixXd(A * P_ * A.transpose()));
}

// K = P H^T S^-1 in all rows but that of the scale, whose gain is zero: only its own variance then differs from the
// optimal update's.
void MonocularState::correct(MatrixXd& PHt, const Eigen::LLT<MatrixXd>& S, const VectorXd& innovation) {
  const double scale_variance = P_(scale_column, scale_column);
  S.matrixU().solveInPlace<Eigen::OnTheRight>(PHt);  // W = P H^T L^-T
  VectorXd d = PHt * S.matrixL().solve(innovation);
  P_.selfadjointView<Eigen::Lower>().rankUpdate(PHt, -1.0);
  P_.triangularView<Eigen::StrictlyUpper>() = P_.transpose();
  P_(scale_column, scale_column) = scale_variance;
  d[scale_column] = 0.0;
  retract(d);
}

void MonocularState::retract(const VectorXd& d) {
  pose_ = SE3::Exp(d.head<6>()) * pose_;
  yaw_bias_ += d[bias_column];
  SE3::Tangent d_point = d.head<6>();
  for (std::size_t i = 0; i < landmarks_.size(); ++i) {
    MonocularLandmark& l = landmarks_[i];
    const Index at = landmark_column(i);
    if (l.clone == 0) {
      d_point.head<3>() = d.segment<3>(at);
      l.position = SE3::Exp(d_point) * l.position;
    } else {
      l.bearing = turned(l.bearing, d.segment<2>(at));
      l.inverse_depth += d[at + 2];
    }
  }
  for (std::size_t i = 0; i < clones_.size(); ++i)
    clones_[i].pose = SE3::Exp(d.segment<6>(clone_column(i))) * clones_[i].pose;
}

void MonocularState::drop(const std::vector<std::size_t>& landmarks, const std::vector<std::size_t>& clones) {
  if (landmarks.empty() && clones.empty()) return;
  std::vector<Index> kept(first_landmark);
  std::iota(kept.begin(), kept.end(), Index{0});
  const auto keep = [&kept](auto& items, const auto& dropped, const auto& column, Index size) {
    std::decay_t<decltype(items)> left;
    for (std::size_t i = 0; i < items.size(); ++i) {
      if (std::binary_search(dropped.begin(), dropped.end(), i)) continue;
      left.push_back(items[i]);
      for (Index c = column(i); c < column(i) + size; ++c) kept.push_back(c);
    }
    return left;
  };
  auto left = keep(
      landmarks_, landmarks, [](std::size_t i) { return landmark_column(i); }, 3);
  clones_ = keep(
      clones_, clones, [this](std::size_t i) { return clone_column(i); }, 6);
  landmarks_ = std::move(left);
  P_ = MatrixXd(P_(kept, kept));
}

// What is left is expressed relative to the new anchor: l' = R^T (l - t), C' = X^-1 C.
void MonocularState::rebase() {
  const SE3 T_new_old = pose_.inverse();
  const SE3::Adjoint Ad = T_new_old.adjoint();
  const Matrix3d Rt = T_new_old.rotation();
  MatrixXd A = MatrixXd::Identity(P_.rows(), P_.rows());
  A.topLeftCorner<6, 6>().setZero();  // the pose is exact now
  for (std::size_t i = 0; i < landmarks_.size(); ++i) {
    if (landmarks_[i].clone != 0) continue;
    const Index at = landmark_column(i);
    A.block<3, 3>(at, at) = Rt;
    A.block<3, 3>(at, 0) = -Rt;
    landmarks_[i].position = T_new_old * landmarks_[i].position;
  }
  for (std::size_t i = 0; i < clones_.size(); ++i) {
    const Index at = clone_column(i);
    A.block<6, 6>(at, at) = Ad;
    A.block<6, 6>(at, 0) = -Ad;
    clones_[i].pose = T_new_old * clones_[i].pose;
    clones_[i].trail = false;
  }
  P_ = symmetrised(MatrixXd(A * P_ * A.transpose()));
  pose_ = SE3();
}

}  // namespace convoy
