#include "report/svg_plot.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <tinyxml2.h>

namespace convoy::cli {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

TEST(RoundTicks, AreOneTwoOrFiveApart) {
  EXPECT_THAT(round_ticks(0.0, 1.0, 5), testing::Pointwise(testing::DoubleNear(1e-12), {0.0, 0.2, 0.4, 0.6, 0.8, 1.0}));
  EXPECT_THAT(round_ticks(-3.0, 12.0, 4), ElementsAre(0.0, 5.0, 10.0));
  EXPECT_THAT(round_ticks(980.0, 1720.0, 4), ElementsAre(1000.0, 1200.0, 1400.0, 1600.0));
  EXPECT_TRUE(round_ticks(1.0, 1.0, 4).empty());
}

TEST(Thinned, KeepsWhatShowsAndTheEnds) {
  std::vector<Eigen::Vector2d> line;
  for (int i = 0; i <= 1000; ++i) line.emplace_back(i, i == 500 ? 40.0 : 0.1 * (i % 2));
  const auto thin = thinned(line, 0.5);
  EXPECT_LT(thin.size(), 10U);
  EXPECT_EQ(thin.front(), line.front());
  EXPECT_EQ(thin.back(), line.back());
  EXPECT_NE(std::find(thin.begin(), thin.end(), line[500]), thin.end());
}

TEST(Thinned, DoesNotLoseALoop) {
  std::vector<Eigen::Vector2d> circle;
  for (int i = 0; i <= 360; ++i)
    circle.emplace_back(100.0 * std::cos(i * M_PI / 180), 100.0 * std::sin(i * M_PI / 180));
  EXPECT_GT(thinned(circle, 0.3).size(), 20U);
}

TEST(Text, IsEscapedAndNumbersHaveNoNegativeZero) {
  EXPECT_EQ(xml_escaped("a<b & \"c\">"), "a&lt;b &amp; &quot;c&quot;&gt;");
  EXPECT_EQ(fixed(-0.0001, 2), "0.00");
  EXPECT_EQ(fixed(-1.26, 1), "-1.3");
}

TEST(SvgPlot, IsWellFormedAndShowsAxesAndLegend) {
  SvgPlot plot(600, 300);
  plot.title("speed < 3 & rising");
  plot.x_label("time [s]");
  plot.y_label("speed [m/s]");
  plot.line({{0, 0}, {1, 2}, {NAN, NAN}, {2, 3}, {3, 1}}, {"#123456"}, "measured");
  plot.dots({{1, 1}}, 3, {"#ff0000"}, "dots");
  plot.band(0.5, 1.0, {"#00ff00", 1.0, "", 0.2}, "band");
  plot.vertical(1.5, {"#888888"}, "event");
  plot.box({1, 1}, {1.01, 1.01}, {"#000000"});
  plot.segments({{{0, 0}, {1, 1}}}, {"#0000ff"});
  plot.ellipse({1, 1}, Eigen::Vector2d(0.1, 0.2).asDiagonal(), {"#0000ff"}, "measured");
  const std::string svg = plot.svg();
  tinyxml2::XMLDocument document;
  EXPECT_EQ(document.Parse(svg.c_str()), tinyxml2::XML_SUCCESS) << document.ErrorStr();
  for (const char* text : {"time [s]", "speed [m/s]", "speed &lt; 3 &amp; rising", ">measured<", ">band<", ">event<"})
    EXPECT_THAT(svg, HasSubstr(text));
  EXPECT_EQ(svg.find(">measured<"), svg.rfind(">measured<"));  // one entry for both items
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  EXPECT_THAT(svg, Not(HasSubstr("inf")));
}

TEST(SvgPlot, WithoutDataStillHasAxes) {
  SvgPlot plot(300, 200);
  plot.equal_aspect(100, 200);
  tinyxml2::XMLDocument document;
  EXPECT_EQ(document.Parse(plot.svg().c_str()), tinyxml2::XML_SUCCESS);
  EXPECT_THAT(plot.svg(), Not(HasSubstr("nan")));
}

TEST(SvgPlot, StaysSmallForALongLine) {
  SvgPlot plot(600, 300);
  std::vector<Eigen::Vector2d> line;
  for (int i = 0; i < 200000; ++i) line.emplace_back(0.01 * i, std::sin(0.0005 * i));
  plot.line(line, {"#000000"});
  EXPECT_LT(plot.svg().size(), 20000U);
}

}  // namespace
}  // namespace convoy::cli
