// Which of a frame's matches belong together: 1-point RANSAC with the filter's own prior (Civera, Grasa, Davison,
// Montiel: 1-Point RANSAC for EKF filtering, JFR 2010), on the linearised innovations.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace convoy {

struct InlierSearchParams {
  double gate_chi2 = 13.8;    ///< of a match by itself, 2 dof
  double inlier_chi2 = 5.99;  ///< of a match given one other
  double rescue_chi2 = 9.21;  ///< of a match given all (other) inliers
};

/// Innovations of m matches (2m) and their joint covariance S (2m x 2m). What one match says about the others is
/// S_jk S_kk^-1: the hypotheses, one per match, need no update of the filter, and all of them are tried. Returns the
/// matches of the largest consensus that stand the test against each other, and those rescued, ascending.
std::vector<std::size_t> find_inliers(const Eigen::VectorXd& innovation, const Eigen::MatrixXd& S,
                                      const InlierSearchParams& params);

/// Rows and columns 2 i, 2 i + 1 for each i.
std::vector<Eigen::Index> pixel_rows(const std::vector<std::size_t>& matches);

}  // namespace convoy
