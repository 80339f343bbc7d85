// The joint state of the monocular filter and its covariance; nothing else changes either.
//
// It lives in the frame of the last anchor, like the range-bearing filter. Error state (DESIGN B3): X = Exp(xi) X^ for
// the pose and the clones of past poses, l = R(xi_theta) l^ + xi_l for a point, with xi_theta that of the pose, and
// (tangent plane of the unit bearing, inverse depth) for a landmark that is anchored in the camera of a clone. A common
// motion of everything is xi = (d, d, ..., 0) whatever the estimates are, so that what nothing observes gains no
// information from moving linearisation points.
//
// Order: pose (rho, theta), yaw-rate bias, distance scale, landmarks (3 each), clones (6 each).
//
// The distance scale is a consider state (Schmidt): no measurement changes it or its variance; the covariances between
// it and the rest are kept.
#pragma once

#include <convoy/geometry/se3.hpp>
#include <convoy/monocular/odometry_step.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

namespace convoy {

using PixelJacobian3 = Eigen::Matrix<double, 2, 3>;
using PixelJacobian6 = Eigen::Matrix<double, 2, 6>;

/// Where a landmark is. clone == 0: `position` counts; otherwise bearing and inverse depth in that clone's camera.
struct MonocularLandmark {
  std::uint64_t id = 0;
  std::uint64_t clone = 0;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< frame of the last anchor [m]
  Eigen::Vector3d bearing = Eigen::Vector3d::Zero();   ///< unit vector
  double inverse_depth = 0.0;                          ///< of the distance along it [1/m]
};

struct MonocularClone {
  std::uint64_t id = 0;  ///< > 0, growing
  double stamp_s = 0.0, abscissa_m = 0.0;
  SE3 pose;            ///< T_anchor_body
  bool trail = false;  ///< a state of Segment::trail
};

class MonocularState {
 public:
  static constexpr Eigen::Index bias_column = 6, scale_column = 7, first_landmark = 8;

  /// T_body_camera: where the camera is fixed. sigmas: [rad/s] of the yaw rate's bias, [] of the distance scale.
  MonocularState(const SE3& T_body_camera, double sigma_yaw_bias_radps, double sigma_scale);

  const SE3& pose() const { return pose_; }  ///< T_anchor_body
  double yaw_bias_radps() const { return yaw_bias_; }
  const SE3& T_body_camera() const { return T_body_camera_; }
  const std::vector<MonocularLandmark>& landmarks() const { return landmarks_; }
  const std::vector<MonocularClone>& clones() const { return clones_; }
  const Eigen::MatrixXd& covariance() const { return P_; }
  SE3::Covariance pose_covariance() const { return P_.topLeftCorner<6, 6>(); }  ///< of a left perturbation
  static Eigen::Index landmark_column(std::size_t i) { return first_landmark + 3 * static_cast<Eigen::Index>(i); }
  Eigen::Index clone_column(std::size_t i) const {
    return landmark_column(landmarks_.size()) + 6 * static_cast<Eigen::Index>(i);
  }
  std::optional<std::size_t> find_landmark(std::uint64_t id) const;
  std::size_t clone_index(std::uint64_t id) const;  ///< which must be there
  bool has_clone(std::uint64_t id) const;
  /// In the frame of the last anchor [m].
  Eigen::Vector3d position(std::size_t landmark) const;

  void move(const OdometryStep& step, double bias_walk_variance);
  /// More uncertainty of the last step: of a right perturbation, order (rho, theta).
  void inflate(const SE3::Tangent& variance);
  /// How the state moves with a right perturbation of the pose. n x 6
  Eigen::MatrixXd step_jacobian() const;

  std::uint64_t clone_pose(double stamp_s, double abscissa_m, bool trail);
  /// Appends a landmark of which the error is f = -A x + w, with A (3 x n) given by A P = AP and A P A^T + Cov(w) = F.
  void add(const MonocularLandmark& landmark, const Eigen::Matrix<double, 3, Eigen::Dynamic>& AP,
           const Eigen::Matrix3d& F);
  /// Of a landmark anchored in a clone: it becomes a point.
  void make_point(std::size_t landmark);
  /// Covariance of what make_point() would make, relative to the current pose, in its frame. [m^2]
  Eigen::MatrixXd relative_covariance(const std::vector<std::size_t>& landmarks) const;

  /// Joint update. PHt: n x m, used up; S = H P H^T + R, factorised; innovation: m.
  void correct(Eigen::MatrixXd& PHt, const Eigen::LLT<Eigen::MatrixXd>& S, const Eigen::VectorXd& innovation);

  /// Indices, ascending.
  void drop(const std::vector<std::size_t>& landmarks, const std::vector<std::size_t>& clones);
  /// The current pose becomes the anchor; no clone is part of a trail any more.
  void rebase();

 private:
  void add_noise(const Eigen::MatrixXd& N, const SE3::Covariance& noise);
  void retract(const Eigen::VectorXd& d);
  void point_rows(std::size_t landmark, Eigen::Matrix<double, 3, 6>& by_pose, Eigen::Matrix<double, 3, 6>& by_clone,
                  Eigen::Matrix3d& by_landmark) const;

  SE3 T_body_camera_;
  SE3 pose_;
  double yaw_bias_ = 0.0;
  std::vector<MonocularLandmark> landmarks_;
  std::vector<MonocularClone> clones_;
  std::uint64_t last_clone_ = 0;
  Eigen::MatrixXd P_;
};

}  // namespace convoy
