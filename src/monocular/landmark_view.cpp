#include <convoy/monocular/bearing.hpp>
#include <convoy/monocular/landmark_view.hpp>

namespace convoy {

using Eigen::Index;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;

namespace {

// q = R_camera_anchor (l - t) for a point: by (xi_l - xi_rho), no rotation.
std::optional<LandmarkView> view_of_point(const MonocularState& state, std::size_t i, const CameraModel& camera,
                                          const SE3& T_camera_anchor) {
  const auto at = camera.project(T_camera_anchor * state.landmarks()[i].position);
  if (!at) return std::nullopt;
  LandmarkView view;
  view.pixel = at->pixel;
  view.by_landmark = at->jacobian * T_camera_anchor.rotation();
  view.by_pose.leftCols<3>() = -view.by_landmark;
  view.by_pose.rightCols<3>().setZero();
  view.by_clone.setZero();
  view.landmark_column = MonocularState::landmark_column(i);
  return view;
}

}  // namespace

// Of a landmark in a clone: q = R m + rho t, rho times the point in the viewing camera's frame.
std::optional<LandmarkView> view_of(const MonocularState& state, std::size_t i, const CameraModel& camera,
                                    const SE3& T_anchor_body) {
  const SE3 T_camera_anchor = (T_anchor_body * state.T_body_camera()).inverse();
  const MonocularLandmark& l = state.landmarks()[i];
  if (l.clone == 0) return view_of_point(state, i, camera, T_camera_anchor);
  const std::size_t clone = state.clone_index(l.clone);
  const SE3 T_camera_first = T_camera_anchor * state.clones()[clone].pose * state.T_body_camera();
  const Matrix3d R = T_camera_first.rotation();
  const auto at = camera.project(R * l.bearing + l.inverse_depth * T_camera_first.translation());
  if (!at) return std::nullopt;
  LandmarkView view;
  view.pixel = at->pixel;
  view.by_landmark.leftCols<2>() = at->jacobian * R * across(l.bearing);
  view.by_landmark.col(2) = at->jacobian * T_camera_first.translation();
  view.by_clone.leftCols<3>() = l.inverse_depth * at->jacobian * T_camera_anchor.rotation();
  view.by_clone.rightCols<3>() = -view.by_clone.leftCols<3>() * skew(state.position(i));
  view.by_pose = -view.by_clone;
  view.clone_column = state.clone_column(clone);
  view.landmark_column = MonocularState::landmark_column(i);
  return view;
}

MatrixXd times(const std::vector<LandmarkView>& views, const MatrixXd& N) {
  MatrixXd HN(2 * static_cast<Index>(views.size()), N.cols());
  for (std::size_t k = 0; k < views.size(); ++k) {
    const LandmarkView& v = views[k];
    auto rows = HN.middleRows<2>(2 * static_cast<Index>(k));
    rows.noalias() = v.by_pose * N.topRows<6>();
    rows.noalias() += v.by_landmark * N.middleRows<3>(v.landmark_column);
    if (v.clone_column >= 0) rows.noalias() += v.by_clone * N.middleRows<6>(v.clone_column);
  }
  return HN;
}

JointInnovation joint_innovation(const MonocularState& state, const std::vector<LandmarkView>& views, double sigma_px) {
  const MatrixXd& P = state.covariance();
  JointInnovation joint;
  joint.PHt.resize(P.rows(), 2 * static_cast<Index>(views.size()));
  for (std::size_t k = 0; k < views.size(); ++k) {
    const LandmarkView& v = views[k];
    auto columns = joint.PHt.middleCols<2>(2 * static_cast<Index>(k));
    columns.noalias() = P.leftCols<6>() * v.by_pose.transpose();
    columns.noalias() += P.middleCols<3>(v.landmark_column) * v.by_landmark.transpose();
    if (v.clone_column >= 0) columns.noalias() += P.middleCols<6>(v.clone_column) * v.by_clone.transpose();
  }
  joint.S = times(views, joint.PHt);
  joint.S.diagonal().array() += sigma_px * sigma_px;
  return joint;
}

}  // namespace convoy
