// Pose graphs in files: the text format of g2o, read strictly.
#pragma once

#include <convoy/geometry/groups.hpp>
#include <convoy/solver/pose_graph.hpp>

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace convoy {

/// What a file holds, before a group is chosen. Vertices are sorted by id.
struct G2oFile {
  struct Vertex {
    std::uint64_t id = 0;
    std::vector<double> pose;  ///< x y theta, or x y z qx qy qz qw (a unit quaternion); empty: no VERTEX line
  };
  struct Edge {
    int from = 0, to = 0;          ///< indices into vertices
    std::vector<double> measured;  ///< like Vertex::pose
    Eigen::MatrixXd information;   ///< 3 x 3 or 6 x 6, positive definite, order of the residual
  };
  int dim = 2;  ///< 2: SE2, 3: SE3:QUAT
  std::vector<Vertex> vertices;
  std::vector<Edge> edges;
};

/// Reads VERTEX_SE2 and EDGE_SE2, or VERTEX_SE3:QUAT and EDGE_SE3:QUAT; '#' begins a comment line. A file may leave out
/// all vertices; they are then those that edges name. Throws ConfigError, "file:line: what, and how to mend it", for
/// anything else: other tags, both dimensions, a missing or extra field, numbers that are none or not finite, an id
/// given twice, an edge that names a vertex that is not there or the same one twice, an information matrix that is not
/// positive definite, no edges at all.
G2oFile read_g2o(const std::filesystem::path& path);
/// The same from text; `name` stands for the file in errors.
G2oFile parse_g2o(std::string_view text, const std::string& name);

/// Only of a file of that dimension.
PoseGraph<SE2> pose_graph_se2(const G2oFile& file);
PoseGraph<SE3> pose_graph_se3(const G2oFile& file);
template <class G>
PoseGraph<G> pose_graph(const G2oFile& file) {
  if constexpr (G::Dim == 2) return pose_graph_se2(file);
  else return pose_graph_se3(file);
}

/// VERTEX_ and EDGE_ lines of the poses' dimension; numbers read back as the same doubles.
std::string g2o_text(const G2oFile& file, const std::vector<SE2>& poses);
std::string g2o_text(const G2oFile& file, const std::vector<SE3>& poses);

}  // namespace convoy
