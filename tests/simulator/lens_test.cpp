#include "lens.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>
#include <string>

namespace convoy::simulator {
namespace {

LensParams equidistant() {
  LensParams params;
  params.distortion = Distortion::kEquidistant;
  params.fx = params.fy = 420.0;
  params.coefficients = {-0.02, 0.003, 0.0, 0.0};
  return params;
}

TEST(Lens, RaysAndPixelsAreOneToOne) {
  for (const LensParams& params :
       {LensParams{}, LensParams::small(), equidistant(), LensParams::pinhole(640, 480, 400.0)}) {
    const Lens lens(params);
    for (double v = -0.5; v < params.height; v += 17.3)
      for (double u = -0.5; u < params.width; u += 13.7) {
        const Eigen::Vector2d ray = lens.ray_of({u, v});
        const auto pixel = lens.pixel_of(Eigen::Vector3d(ray.x(), ray.y(), 1.0) * 12.0);
        ASSERT_TRUE(pixel);
        EXPECT_LT((*pixel - Eigen::Vector2d(u, v)).norm(), 1e-8);
      }
  }
}

// cv::projectPoints and cv::fisheye::projectPoints of the point (0.4, -0.3, 1), worked by hand from their formulas.
TEST(Lens, DistortsAsItsModelSays) {
  LensParams params = LensParams::pinhole(640, 480, 400.0);
  params.coefficients = {-0.1, 0.02, 0.001, -0.002};
  const Eigen::Vector2d radial = *Lens(params).pixel_of({0.4, -0.3, 1.0});
  const double r2 = 0.25, factor = 1.0 - 0.1 * r2 + 0.02 * r2 * r2;
  EXPECT_NEAR(radial.x(), 319.5 + 400.0 * (0.4 * factor + 0.002 * 0.4 * -0.3 - 0.002 * (r2 + 0.32)), 1e-9);
  EXPECT_NEAR(radial.y(), 239.5 + 400.0 * (-0.3 * factor + 0.001 * (r2 + 0.18) - 0.004 * 0.4 * -0.3), 1e-9);
  const Eigen::Vector2d fisheye = *Lens(equidistant()).pixel_of({0.4, -0.3, 1.0});
  const double angle = 0.46364760900080609, a2 = angle * angle;
  EXPECT_NEAR(fisheye.x(), 319.5 + 420.0 * 0.8 * angle * (1.0 + a2 * (-0.02 + a2 * 0.003)), 1e-9);
}

TEST(Lens, DoesNotSeeWhatIsBehindOrFarOffTheAxis) {
  const Lens lens((LensParams()));
  EXPECT_FALSE(lens.pixel_of({0.0, 0.0, -1.0}));
  EXPECT_FALSE(lens.pixel_of({0.0, 0.0, 0.0}));
  EXPECT_FALSE(lens.pixel_of({10.0, 0.0, 1.0}));
}

TEST(Lens, SaysWhatIsWrongWithItsParameters) {
  const auto message = [](auto change) {
    LensParams params;
    change(params);
    try {
      params.validate();
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_NE(message([](LensParams& p) { p.width = 0; }).find("width is 0"), std::string::npos);
  EXPECT_NE(message([](LensParams& p) { p.fx = -1.0; }).find("fx"), std::string::npos);
  EXPECT_NE(message([](LensParams& p) { p.cy = 480.0; }).find("cy"), std::string::npos);
  EXPECT_NE(message([](LensParams& p) { p.fx = p.fy = 50.0, p.coefficients = {}; }).find("degrees off"),
            std::string::npos);
  EXPECT_NE(message([](LensParams& p) { p.coefficients = {-0.6, 0.0, 0.0, 0.0}; }).find("lessen"), std::string::npos);
  EXPECT_NE(message([](LensParams& p) { p.coefficients[1] = NAN; }).find("finite"), std::string::npos);
  EXPECT_EQ(message([](LensParams&) {}), "");
}

}  // namespace
}  // namespace convoy::simulator
