// Association problems in files: what is read, and what is refused.
#include <convoy/association/associate.hpp>
#include <convoy/association/problem_file.hpp>
#include <convoy/config_error.hpp>

#include "../../support/data_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include <string>

namespace convoy {
namespace {

using testing::HasSubstr;

const std::string head =
    "convoy-assoc 1\nname two_posts\ndim 2\nalpha 0.9\ngate 4.6\nbias_mean 3 -2 1.5707963267948966\n"
    "bias_cov_diag 4 9 0.25\ndrift_a 0.01 0\ndrift_b 0 0\ndesc_bits 64\ndesc_max_hamming 3\nna 1\nnb 2\n";
const std::string body =
    "a 7 1 2 0.04 0.01 0.09 5.5 00000000000000ff\n"
    "b 40 10 0 0.01 0 0.01 1 00000000000000fe\n"
    "b 4 -5 0 0.01 0 0.01 2 ff00000000000000\n";

TEST(AssociationProblemFile, IsReadInTheUnitsAndFramesOfTheSearch) {
  const auto p = std::get<AssociationProblem<SE2>>(parse_association_problem(head + body + "end\n", "file"));
  EXPECT_EQ(p.name, "two_posts");
  EXPECT_EQ(p.confidence, 0.9);
  ASSERT_EQ(p.map.landmarks.size(), 2U);
  EXPECT_EQ(p.map_id, (std::vector<std::uint64_t>{4, 40}));  // by ID
  EXPECT_EQ(p.map.landmarks[1].position, SE2::Point(10.0, 0.0));
  ASSERT_EQ(p.fresh.landmarks.size(), 1U);
  EXPECT_EQ(p.fresh.landmarks[0].covariance, (Eigen::Matrix2d() << 0.04, 0.01, 0.01, 0.09).finished());
  EXPECT_EQ(p.fresh.abscissa_m, std::vector<double>{5.5});
  EXPECT_EQ(p.fresh.drift_m2_per_m, 0.01);
  // Variances are along the axes of the map: 4 along x of the map is along -y of what is turned by 90 degrees.
  EXPECT_TRUE(p.prior->covariance.isApprox(Eigen::Vector3d(9.0, 4.0, 0.25).asDiagonal().toDenseMatrix(), 1e-12));
  EXPECT_TRUE((p.prior->mean * SE2::Point(1.0, 0.0)).isApprox(SE2::Point(3.0, -1.0), 1e-12));
  ASSERT_TRUE(p.looks_alike);
  EXPECT_FALSE(p.looks_alike(p.map.landmarks[0], p.fresh.landmarks[0]));
  EXPECT_TRUE(p.looks_alike(p.map.landmarks[1], p.fresh.landmarks[0]));
}

TEST(AssociationProblemFile, InSpaceTheBiasTurnsByRollPitchYaw) {
  const std::string text =
      "convoy-assoc 1\nname s\ndim 3\nbias_mean 1 2 3 0.1 0.2 0.3\nbias_cov_diag 1 1 1 0.01 0.01 0.01\nna 0\nnb 1\n"
      "b 1 1 2 3 0.01 0 0 0.01 0 0.02 0\nend\n";
  const auto p = std::get<AssociationProblem<SE3>>(parse_association_problem(text, "file"));
  const Eigen::Matrix3d R =
      (Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  EXPECT_TRUE(p.prior->mean.rotation().isApprox(R, 1e-12));
  EXPECT_EQ(p.map.landmarks[0].covariance(2, 2), 0.02);
  EXPECT_FALSE(p.looks_alike);
}

struct Damage {
  std::string text, message;
};
class DamagedProblem : public testing::TestWithParam<Damage> {};

TEST_P(DamagedProblem, IsRefusedWithFileAndLine) {
  try {
    parse_association_problem(GetParam().text, "bad.assoc");
    FAIL() << "was accepted";
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(), HasSubstr("bad.assoc:"));
    EXPECT_THAT(error.what(), HasSubstr(GetParam().message));
  }
}

std::string changed(const std::string& from, const std::string& to) {
  std::string text = head + body + "end\n";
  return text.replace(text.find(from), from.size(), to);
}

INSTANTIATE_TEST_SUITE_P(
    Assoc, DamagedProblem,
    testing::Values(Damage{"", "first line"}, Damage{"convoy-assoc 2\nend\n", "first line"},
                    Damage{std::string("convoy\0", 7), "binary"}, Damage{head + body, "no line 'end'"},
                    Damage{changed("dim 2", "dim 4"), "3: dim must be 2 or 3"},
                    Damage{changed("dim 2\n", ""), "comes before the line 'dim'"},
                    Damage{changed("alpha 0.9", "alpha 1"), "4: alpha must lie in (0, 1)"},
                    Damage{changed("alpha 0.9", "alpha nan"), "finite number"},
                    Damage{changed("bias_mean 3 -2 1.5707963267948966\n", ""), "has no line 'bias_mean'"},
                    Damage{changed("bias_mean 3", "bias_mean"), "6: the line has 3 fields"},
                    Damage{changed("diag 4 9", "diag 4 -9"), "7: a variance is below 0"},
                    Damage{changed("drift_a 0.01", "drift_a -1"), "8: the variance per metre must be >= 0"},
                    Damage{changed("bits 64", "bits 64\ndrft_a 0 0"), "there is no line 'drft_a'"},
                    Damage{changed("end", "end\na 1"), "stands after the line 'end'"},
                    Damage{changed("desc_max_hamming", "sigma 1 "), "has a signature, and there is no line"},
                    Damage{changed("bits 64", "bits 256"), "10: signatures have 64 bits"},
                    Damage{changed("na 1", "na 2"), "na says 2, and there are 1"},
                    Damage{changed("a 7 1 2", "a 7 inf 2"), "14: field 3 is 'inf'"},
                    Damage{changed("a 7 1 2 0.04", "a 7 1"), "a landmark has 8"},
                    Damage{changed("0.04 0.01 0.09", "0.04 0.5 0.09"), "14: the covariance"},
                    Damage{changed("0.04 0.01 0.09", "0 0 0"), "14: the covariance"},
                    Damage{changed("00000000000000ff", "xyz"), "the signature is 'xyz'"},
                    Damage{changed("b 40", "b 4"), "landmark 4 is given twice"},
                    Damage{changed("b 40", "b -1"), "must be an id"}));

TEST(AssociationProblemFile, ThatCannotBeReadIsNamed) {
  try {
    read_association_problem("/nowhere/x.assoc");
    FAIL();
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(), HasSubstr("/nowhere/x.assoc: cannot be read"));
  }
}

// All public problems: without overlap nothing is accepted, and most of the others are.
TEST(AssociationProblemFile, RecordedProblemsAreSolvedByTheLikeliestPlace) {
  const auto folder = test::data_folder() / "association" / "dev";
  if (!std::filesystem::is_directory(folder)) GTEST_SKIP() << "needs " << folder << " (CONVOY_DATA_DIR)";
  int accepted = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() != ".assoc") continue;
    const std::string file = entry.path().stem();
    const bool overlaps = file.find("_NO_") == std::string::npos && file.find("_ALIAS_") == std::string::npos;
    std::visit(
        [&](const auto& problem) {
          AssociationParams params;
          params.method = SearchMethod::alignment;
          params.constraints.compatibility = problem.confidence;
          const auto result = associate(problem.map, problem.fresh, problem.prior, params, problem.looks_alike);
          if (overlaps) accepted += result.decision == Decision::accepted;
          else EXPECT_NE(result.decision, Decision::accepted) << file;
        },
        read_association_problem(entry.path()));
  }
  EXPECT_GE(accepted, 18);
}

}  // namespace
}  // namespace convoy
