// Association problems with their truth; those that were recorded, where they are on this machine.
#pragma once

#include <convoy/association/alignment.hpp>
#include <convoy/association/problem_file.hpp>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <sstream>
#include <string>
#include <variant>
#include <vector>

#include "../support/data_folder.hpp"

namespace convoy::bench {

struct KnownProblem {
  AnyAssociationProblem problem;
  std::string kind;                                         ///< match, nomatch, alias
  std::variant<SE2, SE3> T_map_fresh;                       ///< of the group of the problem
  std::set<std::pair<std::uint64_t, std::uint64_t>> pairs;  ///< (fresh, map), by ID
};

/// x y yaw, or x y z roll pitch yaw, as in the problem file.
inline std::variant<SE2, SE3> motion_of(const std::vector<double>& b) {
  if (b.size() == 3) return SE2(b[0], b[1], b[2]);
  const Eigen::Matrix3d R =
      (Eigen::AngleAxisd(b.at(5), Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(b[4], Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(b[3], Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  return SE3::from_rotation(R, {b[0], b[1], b[2]});
}

inline KnownProblem recorded_problem(const std::filesystem::path& path) {
  KnownProblem recorded{read_association_problem(path), {}, {}, {}};
  std::ifstream truth(std::filesystem::path(path).replace_extension(".truth"));
  for (std::string line, word; std::getline(truth, line);) {
    std::istringstream fields(line);
    fields >> word;
    if (word == "kind") fields >> recorded.kind;
    if (word == "bias")
      recorded.T_map_fresh = motion_of({std::istream_iterator<double>(fields), std::istream_iterator<double>()});
    if (std::uint64_t a, b; word == "pair" && fields >> a >> b) recorded.pairs.emplace(a, b);
  }
  return recorded;
}

/// All of `association/dev`, by name; none if they are not there.
inline const std::vector<KnownProblem>& recorded_problems() {
  static const std::vector<KnownProblem> all = [] {
    std::vector<std::filesystem::path> paths;
    const std::filesystem::path folder = test::data_folder() / "association" / "dev";
    if (std::filesystem::is_directory(folder))
      for (const auto& entry : std::filesystem::directory_iterator(folder))
        if (entry.path().extension() == ".assoc") paths.push_back(entry.path());
    std::sort(paths.begin(), paths.end());
    std::vector<KnownProblem> problems;
    for (const auto& path : paths) problems.push_back(recorded_problem(path));
    return problems;
  }();
  return all;
}

/// As the published scorer has it: at least 0.7 of the pairs are true, and the motion that fits them best is within
/// 1 m (at the middle of the fresh landmarks) and 3 degrees of the truth.
struct Score {
  bool right = false;
  bool placed = false;  ///< the latter alone
  double distance_m = 0.0;
};
template <class G>
Score score(const KnownProblem& known, const AssociationProblem<G>& p, const std::vector<Pairing>& pairings) {
  if (static_cast<int>(pairings.size()) < G::Dim || known.pairs.empty()) return {};
  std::vector<IndexPairing> found;
  int hits = 0;
  for (const auto& [of_map, of_fresh] : pairings) {
    found.emplace_back(of_map.index, of_fresh.index);
    hits += static_cast<int>(known.pairs.count({p.fresh_id[of_fresh.index], p.map_id[of_map.index]}));
  }
  typename G::Point middle = G::Point::Zero();
  for (const auto& l : p.fresh.landmarks) middle += l.position / static_cast<double>(p.fresh.landmarks.size());
  const G fitted = closed_form_alignment(p.map, p.fresh, found), truth = std::get<G>(known.T_map_fresh);
  const double turn = (truth.inverse() * fitted).Log().template tail<G::Dof - G::Dim>().norm();
  Score s;
  s.distance_m = (fitted * middle - truth * middle).norm();
  s.placed = s.distance_m < 1.0 && turn < 3.0 * M_PI / 180.0;
  s.right = s.placed && hits >= 0.7 * static_cast<double>(pairings.size());
  return s;
}

}  // namespace convoy::bench
