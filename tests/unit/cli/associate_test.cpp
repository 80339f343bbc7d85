// `convoy associate`: results as its scorers read them.
#include <convoy/config_error.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "associate.hpp"

namespace convoy::cli {
namespace {

using testing::HasSubstr;

class AssociateCommand : public testing::Test {
 protected:
  AssociateCommand() { std::filesystem::create_directories(folder); }
  ~AssociateCommand() override { std::filesystem::remove_all(folder); }

  /// Seven posts, seen again by a vehicle that has started at the map's origin, within a metre and 0.05 rad.
  std::filesystem::path problem(const std::string& file, const std::string& name) const {
    std::ofstream out(folder / file);
    out << "convoy-assoc 1\nname " << name << "\ndim 2\nalpha 0.95\nbias_mean 0 0 0\nbias_cov_diag 1 1 0.0025\n"
        << "na 7\nnb 7\n";
    const double x[] = {0.0, 11.0, 17.5, 21.0, 30.0, 33.5, 41.0}, y[] = {0.0, 7.0, -4.0, 9.0, 1.0, -8.0, 5.0};
    for (int k = 0; k < 7; ++k) {
      out << "a " << k << " " << x[k] << " " << y[k] << " 0.0025 0 0.0025 0\n";
      out << "b " << 100 + k << " " << x[k] + 0.5 << " " << y[k] - 0.3 << " 0.0025 0 0.0025 0\n";
    }
    out << "end\n";
    return folder / file;
  }
  static std::string content(const std::filesystem::path& file) {
    std::ifstream in(file);
    return {std::istreambuf_iterator<char>(in), {}};
  }

  std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("convoy_associate_" + std::to_string(::getpid()));
};

TEST_F(AssociateCommand, WritesPairsByTheIdsOfTheFileAndAVerdict) {
  for (const std::string& method : association_methods()) {
    AssociateOptions options{{problem("p.assoc", "posts")}, method, folder / method};
    EXPECT_EQ(run_associate(options), 0);
    const std::string result = content(folder / method / "posts.result");
    EXPECT_THAT(result, HasSubstr("name posts\n")) << method;
    EXPECT_THAT(result, HasSubstr("time_ms ")) << method;
    for (int k = 0; k < 7; ++k)
      EXPECT_THAT(result, HasSubstr("pair " + std::to_string(k) + " " + std::to_string(100 + k) + "\n")) << method;
    if (method == "alignment") {
      EXPECT_THAT(result, HasSubstr("verdict accept\n"));
      double x = 0.0, y = 0.0, yaw = 1.0;
      const auto at = result.find("\ntransform ");
      ASSERT_NE(at, std::string::npos);
      ASSERT_EQ(std::sscanf(result.c_str() + at, " transform %lf %lf %lf", &x, &y, &yaw), 3);
      EXPECT_NEAR(x, 0.5, 1e-6);
      EXPECT_NEAR(y, -0.3, 1e-6);
      EXPECT_NEAR(yaw, 0.0, 1e-6);
      EXPECT_THAT(result, HasSubstr("\ntransform_covariance "));
    }
  }
}

TEST_F(AssociateCommand, ReadsEverythingBeforeItWritesAnything) {
  std::ofstream(folder / "bad.assoc") << "convoy-assoc 1\nend\n";
  const AssociateOptions options{{problem("p.assoc", "posts"), folder / "bad.assoc"}, "alignment", folder / "out"};
  EXPECT_THROW(run_associate(options), ConfigError);
  EXPECT_FALSE(std::filesystem::exists(folder / "out" / "posts.result"));
}

TEST_F(AssociateCommand, RefusesNamesThatCannotNameAFile) {
  for (const std::string name : {"../up", ".hidden"}) {
    const AssociateOptions options{{problem("p.assoc", name)}, "alignment", folder / "out"};
    EXPECT_THROW(run_associate(options), ConfigError) << name;
  }
  const AssociateOptions twice{{problem("p.assoc", "same"), problem("q.assoc", "same")}, "alignment", folder / "out"};
  EXPECT_THROW(run_associate(twice), ConfigError);
}

}  // namespace
}  // namespace convoy::cli
