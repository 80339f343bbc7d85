// Association problems in files: text, read strictly. One line per keyword:
//   convoy-assoc 1                      first line
//   name S, dim 2|3, alpha A            A: confidence of eq. 5, in (0, 1)
//   bias_mean x y [z roll pitch] yaw    static bias of the new landmarks, to the frame of the map [m, rad]
//   bias_cov_diag ...                   its variances, the same order, on the map's side
//   drift_a P H, drift_b P H            variance per metre of way, of position [m^2/m] and heading [rad^2/m]
//   desc_bits 64, desc_max_hamming K    landmarks carry signatures; those that differ in more than K bits are different
//   na M, nb N                          how many there are
//   a ID x y [z] C.. s [HEX]            a new landmark: upper triangle of its covariance row by row, abscissa [m]
//   b ID x y [z] C.. s [HEX]            a landmark of the map
//   end
// R(bias) = Rz(yaw) Ry(pitch) Rx(roll). Other keywords are refused. Both maps should have their origin near by: beyond
// some 100 km, rounding leaves nothing of an alignment, and the answer is none.
#pragma once

#include <convoy/association/constraints.hpp>
#include <convoy/geometry/groups.hpp>

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace convoy {

template <class G>
struct AssociationProblem {
  std::string name;
  Batch<G> map, fresh;  ///< landmarks by ascending ID
  std::vector<std::uint64_t> map_id, fresh_id;
  std::optional<RelativePrior<G>> prior;  ///< T_map_fresh
  double confidence = 0.95;
  LooksAlike<G> looks_alike;  ///< by signature; empty: there are none
};
using AnyAssociationProblem = std::variant<AssociationProblem<SE2>, AssociationProblem<SE3>>;

/// Throws ConfigError, "file:line: what, and how to mend it": a missing or extra field, a number that is none or not
/// finite, a variance below zero, a covariance that is none, an ID given twice, counts that are wrong, no `end`.
AnyAssociationProblem read_association_problem(const std::filesystem::path& path);
/// The same from text; `name` stands for the file in errors.
AnyAssociationProblem parse_association_problem(std::string_view text, const std::string& name);

}  // namespace convoy
