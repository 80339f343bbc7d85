#include "facade.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

TEST(Facade, OpeningsAreInTheWallAndApart) {
  for (std::size_t style = 0; style < n_facade_styles; ++style) {
    for (const double width : {2.2, 5.0, 8.0, 13.7, 25.0, 60.0}) {
      Stream random({1, 0, 0, static_cast<std::uint32_t>(width * 10)});
      const FacadePlan plan = plan_facade(facade_style(style), width, 14.0, random);
      for (std::size_t i = 0; i < plan.openings.size(); ++i) {
        const Opening& a = plan.openings[i];
        EXPECT_GT(a.x0, 0.0);
        EXPECT_LT(a.x1, width);
        EXPECT_GE(a.z0, 0.0);
        EXPECT_LT(a.z1, 14.0);
        EXPECT_GT(a.x1 - a.x0, 0.3);
        EXPECT_GT(a.z1 - a.z0, 0.3);
        for (std::size_t k = 0; k < i; ++k) {
          const Opening& b = plan.openings[k];
          EXPECT_TRUE(a.x1 <= b.x0 || b.x1 <= a.x0 || a.z1 <= b.z0 || b.z1 <= a.z0) << style << " " << width;
        }
      }
    }
  }
  Stream random({1, 0, 0, 0});
  EXPECT_TRUE(plan_facade(facade_style(0), 20.0, 2.5, random).openings.empty());
  EXPECT_TRUE(plan_facade(facade_style(0), 0.5, 14.0, random).openings.empty());
}

TEST(Facade, WallWithRecessesHasNoHoles) {
  Stream random({1, 0, 0, 0});
  const FacadePlan plan = plan_facade(facade_style(0), 16.0, 14.0, random);
  ASSERT_GT(plan.openings.size(), 10U);
  SceneBuilder scene;
  add_facade(scene, 0, plan, {0, 0}, {16, 0}, 3.0, 1.0F);
  // Seen from ahead, wall and panes cover the whole front; reveals are seen edge-on.
  double area = 0.0;
  float deepest = 0.0F;
  for (const Mesh& mesh : scene.scene.meshes) {
    for (const auto& t : mesh.triangles) {
      const Eigen::Vector3f a = mesh.vertices[t[0]].position, b = mesh.vertices[t[1]].position;
      const Eigen::Vector3f c = mesh.vertices[t[2]].position;
      const float towards = -(b - a).cross(c - a).y();  // the viewer stands at y < 0
      EXPECT_GE(towards, -1e-4F);
      area += 0.5 * static_cast<double>(towards);
      deepest = std::max({deepest, a.y(), b.y(), c.y()});
    }
  }
  EXPECT_NEAR(area, 16.0 * (14.0 + FacadePainter::foot_m), 0.01);
  EXPECT_NEAR(deepest, 0.18, 0.07);
}

TEST(Facade, FrontsOfAStyleShareWindowsButNotMarks) {
  const FacadePainter painter(1);
  const FacadeStyle& style = facade_style(1);
  const auto front = [&](std::uint32_t id) {
    Stream random({1, 0, 0, id});
    return painter.paint(style, plan_facade(style, 12.0, 14.0, random), 0.04, random);
  };
  const Texture a = front(1), b = front(2);
  EXPECT_EQ(a.grey, front(1).grey);
  ASSERT_EQ(a.grey.size(), b.grey.size());
  EXPECT_EQ(a.width, 300);
  std::size_t differing = 0;
  double sum = 0.0, squares = 0.0;
  for (std::size_t i = 0; i < a.grey.size(); ++i) {
    const double grey = a.grey[i];
    differing += std::abs(grey - b.grey[i]) > 40.0;
    sum += grey, squares += grey * grey;
  }
  const auto n = static_cast<double>(a.grey.size());
  EXPECT_GT(static_cast<double>(differing), 0.02 * n);
  EXPECT_LT(static_cast<double>(differing), 0.5 * n);
  EXPECT_GT(std::sqrt(squares / n - sum * sum / (n * n)), 15.0);  // contrast
}

}  // namespace
}  // namespace convoy::simulator
