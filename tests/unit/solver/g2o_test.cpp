#include <convoy/solver/g2o.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <convoy/config_error.hpp>

namespace convoy {
namespace {

using testing::HasSubstr;

constexpr const char* kGood =
    "# a triangle\n"
    "VERTEX_SE2 7 0 0 0\n"
    "VERTEX_SE2 3 1 0 0.5\n"
    "\n"
    "VERTEX_SE2 10 1 1 -3e-1\n"
    "FIX 3\n"
    "EDGE_SE2 3 7 1 0 0.25 10 1 2 20 3 30\r\n"
    "EDGE_SE2 10 7 0 1 0 1 0 0 1 0 1\n";

TEST(G2o, ReadsIdsInOrderAndUpperTriangles) {
  const G2oFile file = parse_g2o(kGood, "good.g2o");
  EXPECT_EQ(file.dim, 2);
  ASSERT_EQ(file.vertices.size(), 3U);
  EXPECT_EQ(file.vertices[0].id, 3U);
  EXPECT_EQ(file.vertices[2].id, 10U);
  ASSERT_EQ(file.edges.size(), 2U);
  EXPECT_EQ(file.edges[0].from, 0);
  EXPECT_EQ(file.edges[0].to, 1);
  EXPECT_EQ(file.edges[1].from, 2);
  EXPECT_EQ(file.edges[0].information, (Eigen::Matrix3d() << 10, 1, 2, 1, 20, 3, 2, 3, 30).finished());
  const PoseGraph<SE2> graph = pose_graph_se2(file);
  EXPECT_EQ(graph.poses[2].theta(), -0.3);
  EXPECT_EQ(graph.factors[0].measured.theta(), 0.25);
}

TEST(G2o, WritesWhatItReads) {
  const G2oFile file = parse_g2o(kGood, "good.g2o");
  const std::string text = g2o_text(file, pose_graph_se2(file).poses);
  const G2oFile again = parse_g2o(text, "again.g2o");
  EXPECT_EQ(g2o_text(again, pose_graph_se2(again).poses), text);
  EXPECT_EQ(again.edges[0].information, file.edges[0].information);
}

TEST(G2o, VerticesMayBeLeftOut) {
  const G2oFile file = parse_g2o("EDGE_SE2 4 2 1 0 0 1 0 0 1 0 1\nEDGE_SE2 4 9 1 0 0 1 0 0 1 0 1\n", "x");
  ASSERT_EQ(file.vertices.size(), 3U);
  EXPECT_EQ(file.vertices[0].id, 2U);
  EXPECT_EQ(file.edges[0].from, 1);
  EXPECT_TRUE(file.vertices[0].pose.empty());
}

TEST(G2o, ReadsThreeDimensions) {
  std::string edge = "EDGE_SE3:QUAT 0 1 1 2 3 0 0 0 1";
  for (int r = 0; r < 6; ++r)
    for (int c = r; c < 6; ++c) edge += r == c ? " 2" : " 0.5";
  const G2oFile file =
      parse_g2o("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 2 3 0.5 0.5 0.5 0.5\n" + edge, "x");
  EXPECT_EQ(file.dim, 3);
  EXPECT_EQ(file.edges[0].information.rows(), 6);
  EXPECT_EQ(file.edges[0].information(5, 0), 0.5);
  EXPECT_EQ(file.edges[0].measured.size(), 7U);
}

struct Damage {
  const char* text;
  const char* message;
};

class DamagedG2o : public testing::TestWithParam<Damage> {};

TEST_P(DamagedG2o, IsRefusedWithFileAndLine) {
  try {
    parse_g2o(GetParam().text, "bad.g2o");
    FAIL() << "was accepted";
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(), HasSubstr(std::string("bad.g2o:") + GetParam().message));
  }
}

#define VERTICES "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
#define UNIT " 1 0 0 1 0 1\n"
#define NOT_DEFINITE "3: the information matrix (upper triangle, row by row) is not positive definite"
INSTANTIATE_TEST_SUITE_P(
    G2o, DamagedG2o,
    testing::Values(Damage{"", " holds no edge"}, Damage{VERTICES, " holds no edge"},
                    Damage{"VERTEX_XY 0 0 0\n", "1: the tag 'VERTEX_XY' is not known"},
                    Damage{"\x7f\x1b[31m\xc3\xa4z 0\n", "1: the tag '??[31m??z' is not known"},
                    Damage{"VERTEX_VERTEX_VERTEX_VERTEX_VERTEX_VERTEX_VERTEX\n",
                           "1: the tag 'VERTEX_VERTEX_VERTEX_VERTEX_VERTEX_VERTE...' is"},
                    Damage{"VERTEX_SE2 0 0 0\n", "1: the line has 4 fields, VERTEX_SE2 has 5"},
                    Damage{"VERTEX_SE2 0 0 0 0 0\n", "1: the line has 6 fields"},
                    Damage{"VERTEX_SE2 -1 0 0 0\n", "1: field 2 is '-1'; it must be an id"},
                    Damage{"VERTEX_SE2 1.5 0 0 0\n", "1: field 2 is '1.5'"},
                    Damage{"VERTEX_SE2 0 0 nan 0\n", "1: field 4 is 'nan'; it must be a finite number"},
                    Damage{"VERTEX_SE2 0 0 inf 0\n", "1: field 4 is 'inf'"},
                    Damage{"VERTEX_SE2 0 0 1e999 0\n", "1: field 4 is '1e999'"},
                    Damage{"VERTEX_SE2 0 0 1x 0\n", "1: field 4 is '1x'"},
                    Damage{VERTICES "VERTEX_SE2 1 0 0 0\n", "3: vertex 1 is given twice"},
                    Damage{VERTICES "EDGE_SE2 0 2 1 0 0" UNIT, "3: the edge names vertex 2, which has no VERTEX line"},
                    Damage{VERTICES "EDGE_SE2 1 1 1 0 0" UNIT, "3: the edge leads from vertex 1 to itself"},
                    Damage{VERTICES "EDGE_SE2 0 1 1 0 0 1 0 0 1 0\n", "3: the line has 11 fields, EDGE_SE2 has 12"},
                    Damage{VERTICES "EDGE_SE2 0 1 nan 0 0" UNIT, "3: field 4 is 'nan'"},
                    Damage{VERTICES "EDGE_SE2 0 1 1 0 0 1 0 0 nan 0 1\n", "3: field 10 is 'nan'"},
                    Damage{VERTICES "EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n", "3: the information matrix"},
                    Damage{VERTICES "EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1\n", "3: the information matrix"},
                    Damage{VERTICES "EDGE_SE2 0 1 1 0 0 0 0 0 0 0 0\n", "3: the information matrix"},
                    Damage{VERTICES "EDGE_SE2 0 1 1 0 0 1 1 0 1 0 1\n", NOT_DEFINITE ": it is singular"},
                    Damage{VERTICES "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 0\n", NOT_DEFINITE ": each entry of its"},
                    Damage{VERTICES "EDGE_SE2 0 1 1 0 0 4e9 2e-3 0 1e-15 0 1\n", NOT_DEFINITE},
                    Damage{VERTICES "VERTEX_SE3:QUAT 3 0 0 0 0 0 0 1\n", "3: 2-D and 3-D lines are mixed"},
                    Damage{"VERTEX_SE3:QUAT 3 0 0 0 0 0 0 2\n", "1: the quaternion (qx qy qz qw) has norm"},
                    Damage{VERTICES "FIX 1\nEDGE_SE2 0 1 1 0 0" UNIT,
                           "3: FIX of vertex 1; only the vertex with the smallest id, 0,"},
                    Damage{VERTICES "FIX 8\nEDGE_SE2 0 1 1 0 0" UNIT, "3: FIX of vertex 8"}));

TEST(G2o, UnitsOfTheInformationDoNotMatter) {
  const G2oFile file = parse_g2o(VERTICES "EDGE_SE2 0 1 1 0 0 1e12 0 1 1e-9 0 1e-3\n", "scaled.g2o");
  EXPECT_EQ(file.edges[0].information(1, 1), 1e-9);
}

TEST(G2o, RefusesABinaryFile) {
  try {
    parse_g2o({"\x7f"
               "ELF\x02\0\0",
               7},
              "program");
    FAIL() << "accepted";
  } catch (const ConfigError& error) {
    EXPECT_STREQ(error.what(), "program: a binary file; give a g2o file, which is text");
  }
}

TEST(G2o, RefusesAFileThatIsNotThere) {
  EXPECT_THROW(read_g2o("/nowhere/graph.g2o"), ConfigError);
  EXPECT_THROW(read_g2o("/tmp"), ConfigError);
}

}  // namespace
}  // namespace convoy
