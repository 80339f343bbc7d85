// Where a pose's camera sees a landmark of the state, and how that moves with the state.
#pragma once

#include <convoy/monocular/camera_model.hpp>
#include <convoy/monocular/monocular_state.hpp>

#include <optional>
#include <vector>

namespace convoy {

/// Two rows of H and what they are about.
struct LandmarkView {
  Eigen::Vector2d pixel;           ///< predicted
  PixelJacobian6 by_pose;          ///< by the error of the viewing pose
  PixelJacobian6 by_clone;         ///< of the clone the landmark is anchored in
  PixelJacobian3 by_landmark;      ///< of the landmark
  Eigen::Index clone_column = -1;  ///< -1: it is a point
  Eigen::Index landmark_column = 0;
};

/// Nothing if it is behind the camera or outside of its field. T_anchor_body: the viewing pose.
std::optional<LandmarkView> view_of(const MonocularState& state, std::size_t landmark, const CameraModel& camera,
                                    const SE3& T_anchor_body);

/// The joint innovation of landmarks that the current pose sees.
struct JointInnovation {
  Eigen::MatrixXd PHt;  ///< n x 2m
  Eigen::MatrixXd S;    ///< H P H^T + R, 2m x 2m
};

/// R = sigma_px^2 I.
JointInnovation joint_innovation(const MonocularState& state, const std::vector<LandmarkView>& views, double sigma_px);

/// H N for H of these views and any N with n rows.
Eigen::MatrixXd times(const std::vector<LandmarkView>& views, const Eigen::MatrixXd& N);

}  // namespace convoy
