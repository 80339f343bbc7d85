#include <convoy/association/problem_file.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/text_fields.hpp>

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <charconv>
#include <cstring>

namespace convoy {
namespace {

constexpr const char* kind = "an association problem";

// What a file holds, before a group is chosen.
struct RawLandmark {
  std::uint64_t id = 0, signature = 0;
  bool has_signature = false;
  std::vector<double> position, covariance;  // upper triangle
  double abscissa_m = 0.0;
  std::size_t line = 0;
};

class Parser {
 public:
  Parser(std::string_view text, const std::string& name) : fields_(text, name, kind) {}

  AnyAssociationProblem parse() {
    if (!fields_.next_line() || fields_.size() != 2 || fields_[0] != "convoy-assoc" || fields_[1] != "1")
      throw ConfigError(fields_.name() + ":1: the first line must be 'convoy-assoc 1'; give an association problem");
    bool ended = false;
    while (!ended && fields_.next_line()) {
      if (fields_.empty()) continue;
      ended = fields_[0] == "end";
      if (!ended) keyword(fields_[0]);
    }
    while (ended && fields_.next_line())
      if (!fields_.empty()) fields_.refuse("stands after the line 'end'; move that to the bottom");
    if (!ended) throw ConfigError(fields_.name() + ": has no line 'end'; it was cut off: write or fetch it again");
    check_whole();
    if (dim_ == 2) return problem<SE2>();
    return problem<SE3>();
  }

 private:
  std::size_t dof() const { return dim_ == 2 ? 3 : 6; }

  void keyword(std::string_view word) {
    if (word == "name") {
      fields_.expect_fields(2);
      name_ = fields_[1];
    } else if (word == "dim") {
      fields_.expect_fields(2);
      dim_ = static_cast<int>(fields_.number(1));
      if (dim_ != 2 && dim_ != 3) fields_.refuse("dim must be 2 or 3");
    } else if (word == "alpha") {
      fields_.expect_fields(2);
      alpha_ = fields_.number(1);
      if (!(alpha_ > 0.0 && alpha_ < 1.0)) fields_.refuse("alpha must lie in (0, 1)");
    } else if (word == "bias_mean") {
      mean_ = numbers(dof());
    } else if (word == "bias_cov_diag") {
      variances_ = numbers(dof());
      if (std::ranges::any_of(variances_, [](double v) { return !(v >= 0.0); }))
        fields_.refuse("a variance is below 0; each must be >= 0");
    } else if (word == "drift_a" || word == "drift_b") {
      const double drift = numbers(2)[0];
      if (!(drift >= 0.0)) fields_.refuse("the variance per metre must be >= 0");
      (word == "drift_a" ? drift_fresh_ : drift_map_) = drift;
    } else if (word == "desc_max_hamming") {
      fields_.expect_fields(2);
      max_hamming_ = static_cast<int>(std::min<std::uint64_t>(fields_.id(1), 64));
    } else if (word == "desc_bits") {
      fields_.expect_fields(2);
      if (fields_.id(1) != 64) fields_.refuse("signatures have 64 bits here");
    } else if (word == "na" || word == "nb") {
      fields_.expect_fields(2);
      (word == "na" ? count_fresh_ : count_map_) = fields_.id(1);
    } else if (word == "a" || word == "b") {
      (word == "a" ? fresh_ : map_).push_back(landmark());
    } else if (word != "gate" && word != "sigma") {  // of what made the problem
      fields_.refuse(
          "there is no line " + TextFields::quoted(word) +
          "; there are name, dim, alpha, gate, sigma, bias_mean, bias_cov_diag, drift_a, drift_b, desc_bits, "
          "desc_max_hamming, na, nb, a, b and end");
    }
  }

  std::vector<double> numbers(std::size_t count) {
    needs_dim();
    fields_.expect_fields(1 + count);
    std::vector<double> values;
    for (std::size_t k = 1; k <= count; ++k) values.push_back(fields_.number(k));
    return values;
  }

  void needs_dim() const {
    if (dim_ == 0) fields_.refuse("comes before the line 'dim'; move that to the top");
  }

  RawLandmark landmark() {
    needs_dim();
    const auto n = static_cast<std::size_t>(dim_);
    const std::size_t least = 3 + n + n * (n + 1) / 2;
    if (fields_.size() != least && fields_.size() != least + 1)
      fields_.refuse("the line has " + std::to_string(fields_.size()) + " fields; a landmark has " +
                     std::to_string(least) + ", and a signature if there are any");
    RawLandmark l;
    l.line = fields_.line();
    l.id = fields_.id(1);
    for (std::size_t k = 0; k < n; ++k) l.position.push_back(fields_.number(2 + k));
    for (std::size_t k = 0; k < n * (n + 1) / 2; ++k) l.covariance.push_back(fields_.number(2 + n + k));
    l.abscissa_m = fields_.number(least - 1);
    if (fields_.size() == least + 1) {
      const std::string_view hex = fields_[least];
      const auto [end, error] = std::from_chars(hex.data(), hex.data() + hex.size(), l.signature, 16);
      if (error != std::errc() || end != hex.data() + hex.size())
        fields_.refuse("the signature is " + TextFields::quoted(hex) + "; it must be 16 hexadecimal digits");
      l.has_signature = true;
    }
    return l;
  }

  void check_whole() {
    const auto missing = [&](const std::string& word) {
      throw ConfigError(fields_.name() + ": has no line '" + word + "'; add it");
    };
    if (dim_ == 0) missing("dim");
    if (mean_.empty()) missing("bias_mean");
    if (variances_.empty()) missing("bias_cov_diag");
    check_count("na", count_fresh_, fresh_);
    check_count("nb", count_map_, map_);
    check_signatures();
    for (std::vector<RawLandmark>* side : {&fresh_, &map_}) {
      std::ranges::sort(*side, {}, &RawLandmark::id);
      const auto twice = std::ranges::adjacent_find(*side, {}, &RawLandmark::id);
      if (twice != side->end())
        fields_.refuse_at(std::next(twice)->line,
                          "landmark " + std::to_string(twice->id) + " is given twice; remove one");
    }
  }

  // All of them, or none.
  void check_signatures() const {
    for (const std::vector<RawLandmark>* side : {&fresh_, &map_})
      for (const RawLandmark& l : *side)
        if (l.has_signature != (max_hamming_ >= 0))
          fields_.refuse_at(l.line, max_hamming_ >= 0 ? "the signature is missing, and there is a line desc_max_hamming"
                                                      : "has a signature, and there is no line desc_max_hamming");
  }

  void check_count(const char* word, std::uint64_t count, const std::vector<RawLandmark>& side) const {
    if (count != side.size())
      throw ConfigError(fields_.name() + ": " + word + " says " + std::to_string(count) + ", and there are " +
                        std::to_string(side.size()) + "; lines are missing, or it is wrong");
  }

  template <class G>
  AssociationProblem<G> problem() const {
    AssociationProblem<G> p;
    p.name = name_;
    p.confidence = alpha_;
    p.prior = prior<G>();
    p.map.anchor = {{1, 1}, 0};
    p.fresh.anchor = {{2, 1}, 0};
    fill(map_, drift_map_, p.map, p.map_id);
    fill(fresh_, drift_fresh_, p.fresh, p.fresh_id);
    if (max_hamming_ >= 0)
      p.looks_alike = [max = max_hamming_](const LandmarkFact<G>& i, const LandmarkFact<G>& j) {
        return std::popcount(signature_of(i.descriptor) ^ signature_of(j.descriptor)) <= max;
      };
    return p;
  }

  static std::uint64_t signature_of(const Descriptor& d) {
    std::uint64_t value;
    std::memcpy(&value, d.bytes.data(), sizeof value);
    return value;
  }

  template <class G>
  void fill(const std::vector<RawLandmark>& raw, double drift_m2_per_m, Batch<G>& batch,
            std::vector<std::uint64_t>& ids) const {
    batch.drift_m2_per_m = drift_m2_per_m;
    for (const RawLandmark& r : raw) {
      LandmarkFact<G> l;
      l.key = {batch.anchor.chain, static_cast<std::uint32_t>(batch.landmarks.size())};
      l.position = Eigen::Map<const typename G::Point>(r.position.data());
      std::size_t k = 0;
      for (int row = 0; row < G::Dim; ++row)
        for (int column = row; column < G::Dim; ++column)
          l.covariance(row, column) = l.covariance(column, row) = r.covariance[k++];
      if (!is_covariance(l.covariance) || !(l.covariance.diagonal().minCoeff() > 0.0))
        fields_.refuse_at(r.line, "the covariance (upper triangle, row by row) is not positive definite; correct it");
      std::memcpy(l.descriptor.bytes.data(), &r.signature, sizeof r.signature);
      batch.landmarks.push_back(l);
      batch.abscissa_m.push_back(r.abscissa_m);
      ids.push_back(r.id);
    }
  }

  // The file's variances are those of the bias added on the side of the map; a right perturbation is on the other.
  template <class G>
  RelativePrior<G> prior() const {
    const Eigen::Map<const Eigen::VectorXd> mean(mean_.data(), static_cast<Eigen::Index>(mean_.size()));
    const Eigen::Map<const Eigen::VectorXd> variances(variances_.data(), static_cast<Eigen::Index>(variances_.size()));
    RelativePrior<G> prior;
    if constexpr (G::Dim == 2) {
      prior.mean = SE2(mean[0], mean[1], mean[2]);
    } else {
      const auto about = [&](int k, const Eigen::Vector3d& axis) { return Eigen::AngleAxisd(mean[k], axis); };
      prior.mean = SE3::from_rotation(
          (about(5, Eigen::Vector3d::UnitZ()) * about(4, Eigen::Vector3d::UnitY()) * about(3, Eigen::Vector3d::UnitX()))
              .toRotationMatrix(),
          mean.head<3>());
    }
    const typename G::PointCovariance R = prior.mean.rotation();
    const typename G::Point of_position = variances.head<G::Dim>();
    prior.covariance.template topLeftCorner<G::Dim, G::Dim>() = R.transpose() * of_position.asDiagonal() * R;
    prior.covariance.diagonal().template tail<G::Dof - G::Dim>() = variances.tail<G::Dof - G::Dim>();
    return prior;
  }

  TextFields fields_;
  std::string name_;
  int dim_ = 0, max_hamming_ = -1;
  double alpha_ = 0.95, drift_fresh_ = 0.0, drift_map_ = 0.0;
  std::vector<double> mean_, variances_;
  std::uint64_t count_fresh_ = 0, count_map_ = 0;
  std::vector<RawLandmark> fresh_, map_;
};

}  // namespace

AnyAssociationProblem parse_association_problem(std::string_view text, const std::string& name) {
  return Parser(text, name).parse();
}

AnyAssociationProblem read_association_problem(const std::filesystem::path& path) {
  return parse_association_problem(read_text(path, kind), path.string());
}

}  // namespace convoy
