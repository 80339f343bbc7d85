#include <convoy/monocular/inlier_search.hpp>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include <algorithm>
#include <iterator>
#include <utility>

namespace convoy {

using Eigen::Index;
using Eigen::Matrix2d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::VectorXd;

namespace {

double chi2_of(const Vector2d& r, const Matrix2d& S) { return r.dot(S.inverse() * r); }

// Matches that lie within the gate given match k, k among them.
std::vector<std::size_t> consensus(const VectorXd& r, const MatrixXd& S, std::size_t k,
                                   const std::vector<std::size_t>& matches, double gate) {
  const Index at_k = 2 * static_cast<Index>(k);
  const Matrix2d inverse = S.block<2, 2>(at_k, at_k).inverse();
  const Vector2d weighted = inverse * r.segment<2>(at_k);
  std::vector<std::size_t> agreeing;
  for (const std::size_t j : matches) {
    const Index at_j = 2 * static_cast<Index>(j);
    const Matrix2d S_jk = S.block<2, 2>(at_j, at_k);
    const Matrix2d left = S.block<2, 2>(at_j, at_j) - S_jk * inverse * S_jk.transpose();
    if (j == k || chi2_of(r.segment<2>(at_j) - S_jk * weighted, left) < gate) agreeing.push_back(j);
  }
  return agreeing;
}

// Without those that, one by one, do not lie within the gate given all the others: one match fixes little of a step
// that is known badly. Of S^-1 r, divided by the diagonal block of S^-1, it is the error left out of a match.
std::vector<std::size_t> pruned(const VectorXd& r, const MatrixXd& S, std::vector<std::size_t> inliers, double gate) {
  while (inliers.size() > 2) {
    const std::vector<Index> rows = pixel_rows(inliers);
    const MatrixXd inverse =
        Eigen::LLT<MatrixXd>(MatrixXd(S(rows, rows))).solve(MatrixXd::Identity(r(rows).size(), r(rows).size()));
    const VectorXd g = inverse * r(rows);
    std::size_t worst = 0;
    double largest = 0.0;
    for (std::size_t k = 0; k < inliers.size(); ++k) {
      const Index at = 2 * static_cast<Index>(k);
      const double chi2 = chi2_of(g.segment<2>(at), inverse.block<2, 2>(at, at));
      if (chi2 > largest) {
        largest = chi2;
        worst = k;
      }
    }
    if (largest < gate) break;
    inliers.erase(inliers.begin() + static_cast<std::ptrdiff_t>(worst));
  }
  return inliers;
}

// Those of `others` that lie within the gate given all inliers.
std::vector<std::size_t> rescued(const VectorXd& r, const MatrixXd& S, const std::vector<std::size_t>& inliers,
                                 const std::vector<std::size_t>& others, double gate) {
  const std::vector<Index> in = pixel_rows(inliers), out = pixel_rows(others);
  const Eigen::LLT<MatrixXd> llt(MatrixXd(S(in, in)));
  const MatrixXd W = llt.matrixL().solve(MatrixXd(S(in, out)));
  const VectorXd left = VectorXd(r(out)) - W.transpose() * llt.matrixL().solve(VectorXd(r(in)));
  std::vector<std::size_t> found;
  for (std::size_t k = 0; k < others.size(); ++k) {
    const Index at = 2 * static_cast<Index>(k), at_S = 2 * static_cast<Index>(others[k]);
    const auto column = W.middleCols<2>(at);
    const Matrix2d C = S.block<2, 2>(at_S, at_S) - column.transpose() * column;
    if (chi2_of(left.segment<2>(at), C) < gate) found.push_back(others[k]);
  }
  return found;
}

}  // namespace

std::vector<Index> pixel_rows(const std::vector<std::size_t>& matches) {
  std::vector<Index> rows;
  for (const std::size_t i : matches)
    rows.insert(rows.end(), {2 * static_cast<Index>(i), 2 * static_cast<Index>(i) + 1});
  return rows;
}

std::vector<std::size_t> find_inliers(const VectorXd& r, const MatrixXd& S, const InlierSearchParams& params) {
  std::vector<std::size_t> plausible, best;
  for (std::size_t i = 0; 2 * static_cast<Index>(i) < r.size(); ++i) {
    const Index at = 2 * static_cast<Index>(i);
    if (chi2_of(r.segment<2>(at), S.block<2, 2>(at, at)) < params.gate_chi2) plausible.push_back(i);
  }
  for (const std::size_t k : plausible) {
    std::vector<std::size_t> agreeing = consensus(r, S, k, plausible, params.inlier_chi2);
    if (agreeing.size() > best.size()) best = std::move(agreeing);
  }
  best = pruned(r, S, std::move(best), params.rescue_chi2);
  std::vector<std::size_t> others;
  std::set_difference(plausible.begin(), plausible.end(), best.begin(), best.end(), std::back_inserter(others));
  if (best.size() < 2 || others.empty()) return best;
  for (const std::size_t i : rescued(r, S, best, others, params.rescue_chi2)) best.push_back(i);
  std::sort(best.begin(), best.end());
  return best;
}

}  // namespace convoy
