// Poses and covariances as the files of a run hold them, of either group: columns of a table, lists in JSON.
//   pose         x, y, th [m, m, rad] in the plane; x, y, z, qw, qx, qy, qz [m, m, m, unit quaternion] in space
//   covariance   of a right perturbation, order (rho, theta): the upper triangle, row by row
#pragma once

#include <convoy/geometry/groups.hpp>

#include <cmath>
#include <optional>
#include <string>

#include <nlohmann/json.hpp>

#include "scenario/table_file.hpp"

namespace convoy::cli {

template <class G>
inline constexpr int coordinate_count = G::Dim == 2 ? 3 : 7;
template <class G>
inline constexpr int covariance_count = G::Dof*(G::Dof + 1) / 2;
template <class G>
using Coordinates = Eigen::Matrix<double, coordinate_count<G>, 1>;

inline Coordinates<SE2> coordinates_of(const SE2& T) { return {T.translation().x(), T.translation().y(), T.theta()}; }
inline Coordinates<SE3> coordinates_of(const SE3& T) {
  Coordinates<SE3> c;
  c << T.translation(), T.quaternion();
  return c;
}

/// Empty if the quaternion is not of length 1 (to 1e-6).
template <class G>
std::optional<G> pose_from(const Coordinates<G>& c) {
  if constexpr (G::Dim == 2) {
    return G(c[0], c[1], c[2]);
  } else {
    if (!(std::abs(c.template tail<4>().norm() - 1.0) < 1e-6)) return std::nullopt;
    return G(typename G::Quaternion(c.template tail<4>()), typename G::Point(c.template head<3>()));
  }
}

/// "slam_x,slam_y,slam_th" for the prefix "slam_".
template <class G>
std::string pose_header(const std::string& prefix) {
  if constexpr (G::Dim == 2) return prefix + "x," + prefix + "y," + prefix + "th";
  std::string header;
  for (const char* name : {"x", "y", "z", "qw", "qx", "qy", "qz"})
    header += (header.empty() ? "" : ",") + prefix + name;
  return header;
}

/// "P00,P01,..." for the prefix "P".
template <class G>
std::string covariance_header(const std::string& prefix) {
  std::string header;
  for (int i = 0; i < G::Dof; ++i)
    for (int j = i; j < G::Dof; ++j)
      header += (header.empty() ? "" : ",") + prefix + std::to_string(i) + std::to_string(j);
  return header;
}

/// A symmetric matrix from its upper triangle: get(n), n = 0, 1, ..., row by row.
template <class Matrix, class Get>
Matrix symmetric_from(const Get& get) {
  Matrix P;
  std::size_t n = 0;
  for (Eigen::Index i = 0; i < P.rows(); ++i)
    for (Eigen::Index j = i; j < P.cols(); ++j) P(i, j) = P(j, i) = get(n++);
  return P;
}

/// ",x,y,th"
template <class G>
void append_pose(std::string& row, const G& T) {
  for (const double x : coordinates_of(T)) {
    row += ',';
    append_number(row, x);
  }
}

/// ",P00,P01,..."
template <class Matrix>
void append_covariance(std::string& row, const Matrix& P) {
  for (Eigen::Index i = 0; i < P.rows(); ++i)
    for (Eigen::Index j = i; j < P.cols(); ++j) {
      row += ',';
      append_number(row, P(i, j));
    }
}

/// The pose in `coordinate_count` columns from `first`. Throws ConfigError with file:line.
template <class G>
G read_pose(const TableFile& table, std::size_t first) {
  Coordinates<G> c;
  for (Eigen::Index i = 0; i < c.size(); ++i) c[i] = table.number(first + static_cast<std::size_t>(i));
  const auto T = pose_from<G>(c);
  if (!T) table.refuse("(qw, qx, qy, qz) is no rotation: its length must be 1");
  return *T;
}

template <class Vector>
nlohmann::json list_of(const Vector& x) {
  nlohmann::json list = nlohmann::json::array();
  for (Eigen::Index i = 0; i < x.size(); ++i) list.push_back(x[i]);
  return list;
}

template <class G>
nlohmann::json pose_list(const G& T) {
  return list_of(coordinates_of(T));
}

template <class Matrix>
nlohmann::json upper_of(const Matrix& P) {
  nlohmann::json list = nlohmann::json::array();
  for (Eigen::Index i = 0; i < P.rows(); ++i)
    for (Eigen::Index j = i; j < P.cols(); ++j) list.push_back(P(i, j));
  return list;
}

/// A list of as many numbers as the vector has. Throws nlohmann::json::exception.
template <class Vector>
Vector vector_from(const nlohmann::json& list) {
  Vector x;
  for (Eigen::Index i = 0; i < x.size(); ++i) x[i] = list.at(static_cast<std::size_t>(i));
  return x;
}

template <class Matrix>
Matrix upper_from(const nlohmann::json& list) {
  return symmetric_from<Matrix>([&](std::size_t n) { return list.at(n).template get<double>(); });
}

/// Throws nlohmann::json::exception, also if the quaternion is not of length 1.
template <class G>
G pose_from_list(const nlohmann::json& list) {
  const auto T = pose_from<G>(vector_from<Coordinates<G>>(list));
  if (!T) throw nlohmann::json::other_error::create(501, "a pose whose quaternion is not of length 1", &list);
  return *T;
}

}  // namespace convoy::cli
