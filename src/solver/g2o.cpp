#include <convoy/geometry/covariance.hpp>
#include <convoy/solver/g2o.hpp>
#include <convoy/text_fields.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <unordered_map>

namespace convoy {
namespace {

class Parser {
 public:
  Parser(std::string_view text, const std::string& name) : fields_(text, name, "a g2o file") {}

  G2oFile parse() {
    while (fields_.next_line()) {
      if (fields_.empty() || fields_[0].front() == '#') continue;
      const std::string_view tag = fields_[0];
      if (tag == "VERTEX_SE2") vertex(2);
      else if (tag == "VERTEX_SE3:QUAT") vertex(3);
      else if (tag == "EDGE_SE2") edge(2);
      else if (tag == "EDGE_SE3:QUAT") edge(3);
      else if (tag == "FIX") fix();
      else
        fields_.refuse(
            "the tag " + TextFields::quoted(tag) +
            " is not known; VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT and FIX are: remove or convert the "
            "line");
    }
    if (edges_.empty()) throw ConfigError(fields_.name() + ": holds no edge; a pose graph has at least one EDGE_ line");
    link();
    return std::move(file_);
  }

 private:
  struct RawEdge {
    std::uint64_t from, to;
    std::size_t line;
  };

  void use_dimension(int dim) {
    if (dimension_known_ && file_.dim != dim) fields_.refuse("2-D and 3-D lines are mixed; a file holds one of them");
    file_.dim = dim;
    dimension_known_ = true;
  }

  std::vector<double> pose(std::size_t field, int dim) const {
    std::vector<double> result;
    const std::size_t count = dim == 2 ? 3 : 7;
    for (std::size_t k = 0; k < count; ++k) result.push_back(fields_.number(field + k));
    if (dim == 2) return result;
    Eigen::Map<Eigen::Vector4d> q(result.data() + 3);
    const double norm = q.norm();
    if (!(std::abs(norm - 1.0) < 1e-3))
      fields_.refuse("the quaternion (qx qy qz qw) has norm " + std::to_string(norm) + "; it must be 1: normalise it");
    q /= norm;
    return result;
  }

  void vertex(int dim) {
    use_dimension(dim);
    fields_.expect_fields(dim == 2 ? 5 : 9);
    const std::uint64_t key = fields_.id(1);
    if (!vertex_of_.emplace(key, 0).second)
      fields_.refuse("vertex " + std::to_string(key) + " is given twice; remove one");
    file_.vertices.push_back({key, pose(2, dim)});
  }

  void edge(int dim) {
    use_dimension(dim);
    const int n = dim == 2 ? 3 : 6;
    const std::size_t numbers = dim == 2 ? 3 : 7;
    fields_.expect_fields(3 + numbers + static_cast<std::size_t>(n * (n + 1) / 2));
    edges_.push_back({fields_.id(1), fields_.id(2), fields_.line()});
    if (edges_.back().from == edges_.back().to)
      fields_.refuse("the edge leads from vertex " + std::to_string(edges_.back().from) + " to itself; remove it");
    G2oFile::Edge parsed;
    parsed.measured = pose(3, dim);
    parsed.information.resize(n, n);
    std::size_t field = 3 + numbers;
    for (int r = 0; r < n; ++r)
      for (int c = r; c < n; ++c) parsed.information(r, c) = parsed.information(c, r) = fields_.number(field++);
    check_information(parsed.information);
    file_.edges.push_back(std::move(parsed));
  }

  // Positive definite, whatever the units of its rows: judged by what is left after scaling the diagonal to 1.
  void check_information(const Eigen::MatrixXd& W) const {
    constexpr double kSmallest = 1e-12;
    const std::string which = "the information matrix (upper triangle, row by row) is not positive definite: ";
    if (!(W.diagonal().array() > 0.0).all())
      fields_.refuse(which + "each entry of its diagonal must be above 0; correct or remove the line");
    const Eigen::VectorXd scale = W.diagonal().cwiseSqrt().cwiseInverse();
    const Eigen::MatrixXd scaled = scale.asDiagonal() * W * scale.asDiagonal();
    const double smallest = eigenvalues(scaled)[0];
    if (!(smallest > kSmallest))
      fields_.refuse(which + (std::abs(smallest) <= kSmallest ? "it is singular" : "an eigenvalue is negative") +
                     "; correct or remove the line");
  }

  void fix() {
    fields_.expect_fields(2);
    fixes_.push_back({fields_.id(1), 0, fields_.line()});
  }

  // Ids to indices, in the order of ids.
  void link() {
    if (file_.vertices.empty())
      for (const RawEdge& e : edges_)
        for (const std::uint64_t key : {e.from, e.to})
          if (vertex_of_.emplace(key, 0).second) file_.vertices.push_back({key, {}});
    std::sort(file_.vertices.begin(), file_.vertices.end(), [](const auto& a, const auto& b) { return a.id < b.id; });
    for (std::size_t k = 0; k < file_.vertices.size(); ++k) vertex_of_[file_.vertices[k].id] = static_cast<int>(k);
    for (const RawEdge& fix : fixes_)
      if (fix.from != file_.vertices.front().id)
        fields_.refuse_at(
            fix.line, "FIX of vertex " + std::to_string(fix.from) + "; only the vertex with the smallest id, " +
                          std::to_string(file_.vertices.front().id) + ", can be fixed, and always is: remove the line");
    for (std::size_t k = 0; k < edges_.size(); ++k) {
      file_.edges[k].from = index_of(edges_[k].from, edges_[k].line);
      file_.edges[k].to = index_of(edges_[k].to, edges_[k].line);
    }
  }

  int index_of(std::uint64_t key, std::size_t line) const {
    const auto found = vertex_of_.find(key);
    if (found == vertex_of_.end())
      fields_.refuse_at(line, "the edge names vertex " + std::to_string(key) +
                                  ", which has no VERTEX line; add it, or remove all of them");
    return found->second;
  }

  TextFields fields_;
  G2oFile file_;
  bool dimension_known_ = false;
  std::vector<RawEdge> edges_, fixes_;
  std::unordered_map<std::uint64_t, int> vertex_of_;
};

void append(std::string& text, double value) {
  char buffer[32];
  const auto [end, error] = std::to_chars(buffer, buffer + sizeof buffer, value);
  text += ' ';
  text.append(buffer, end);
}

SE2 from_numbers(const std::vector<double>& v, const SE2&) { return {v[0], v[1], v[2]}; }
SE3 from_numbers(const std::vector<double>& v, const SE3&) {
  return {SE3::Quaternion(v[6], v[3], v[4], v[5]), {v[0], v[1], v[2]}};
}
std::vector<double> numbers(const SE2& T) { return {T.translation().x(), T.translation().y(), T.theta()}; }
std::vector<double> numbers(const SE3& T) {
  const SE3::Point& t = T.translation();
  const SE3::Quaternion& q = T.quaternion();  // w first
  return {t.x(), t.y(), t.z(), q[1], q[2], q[3], q[0]};
}

template <class G>
PoseGraph<G> graph_of(const G2oFile& file) {
  PoseGraph<G> graph;
  for (const auto& v : file.vertices) graph.poses.push_back(v.pose.empty() ? G() : from_numbers(v.pose, G()));
  for (const auto& e : file.edges)
    graph.factors.push_back({e.from, e.to, from_numbers(e.measured, G()), e.information});
  return graph;
}

template <class G>
std::string text_of(const G2oFile& file, const std::vector<G>& poses, const std::string& tag) {
  std::string text;
  for (std::size_t k = 0; k < poses.size(); ++k) {
    text += "VERTEX_" + tag + ' ' + std::to_string(file.vertices[k].id);
    for (const double v : numbers(poses[k])) append(text, v);
    text += '\n';
  }
  for (const auto& e : file.edges) {
    text += "EDGE_" + tag + ' ' + std::to_string(file.vertices[static_cast<std::size_t>(e.from)].id) + ' ' +
            std::to_string(file.vertices[static_cast<std::size_t>(e.to)].id);
    for (const double v : e.measured) append(text, v);
    for (Eigen::Index r = 0; r < e.information.rows(); ++r)
      for (Eigen::Index c = r; c < e.information.cols(); ++c) append(text, e.information(r, c));
    text += '\n';
  }
  return text;
}

}  // namespace

G2oFile parse_g2o(std::string_view text, const std::string& name) { return Parser(text, name).parse(); }

G2oFile read_g2o(const std::filesystem::path& path) { return parse_g2o(read_text(path, "a g2o file"), path.string()); }

PoseGraph<SE2> pose_graph_se2(const G2oFile& file) { return graph_of<SE2>(file); }
PoseGraph<SE3> pose_graph_se3(const G2oFile& file) { return graph_of<SE3>(file); }
std::string g2o_text(const G2oFile& file, const std::vector<SE2>& poses) { return text_of(file, poses, "SE2"); }
std::string g2o_text(const G2oFile& file, const std::vector<SE3>& poses) { return text_of(file, poses, "SE3:QUAT"); }

}  // namespace convoy
