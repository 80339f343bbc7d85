// Fronts of houses: where the openings are, how they are painted, and walls in which windows are set back.
#pragma once

#include "paint.hpp"
#include "scene_builder.hpp"

#include <vector>

namespace convoy::simulator {

/// What houses of one builder have in common: the same windows at the same pitch.
struct FacadeStyle {
  enum class Wall { kPlaster, kBrick, kConcrete, kStone } wall = Wall::kPlaster;
  double grey = 160.0;
  double pitch_m = 3.0;  ///< window to window
  double window_width_m = 1.2, window_height_m = 1.7, sill_m = 0.9;
  double storey_m = 3.2, ground_storey_m = 4.0;
  double frame_grey = 210.0;
  int panes = 2;           ///< side by side
  bool surrounds = false;  ///< window surrounds of another grey
  bool balconies = false;
  bool bands = false;       ///< a band between storeys
  double shop_share = 0.4;  ///< of the ground floor's openings
};
inline constexpr std::size_t n_facade_styles = 8;
const FacadeStyle& facade_style(std::size_t index);

/// An opening, from the left end of the wall and up from its base [m].
struct Opening {
  enum class Kind { kWindow, kDoor, kShop, kGarage } kind = Kind::kWindow;
  double x0 = 0, x1 = 0, z0 = 0, z1 = 0;
};

struct FacadePlan {
  double width_m = 0, height_m = 0;
  std::vector<Opening> openings;
};

/// Opening by opening for a wall of this size.
FacadePlan plan_facade(const FacadeStyle& style, double width_m, double height_m, Stream& random);

/// Materials and their grain, made once for all.
class FacadePainter {
 public:
  explicit FacadePainter(std::uint32_t seed);
  /// The front as a texture from `foot_m` under its base to its top. Same random numbers, same front.
  Texture paint(const FacadeStyle& style, const FacadePlan& plan, double texel_m, Stream& random) const;
  /// A wall without openings, that repeats: `blank_tile_m` wide and high.
  Texture paint_blank(const FacadeStyle& style, Stream& random) const;

  static constexpr double foot_m = 1.2, blank_tile_m = 10.24;

 private:
  void paint_wall(Canvas& canvas, const FacadeStyle& style, Stream& random) const;
  NoiseTile fine_, coarse_;
};

/// The wall from left (a) to right (b) as seen, base at height z, openings set back into it.
void add_facade(SceneBuilder& scene, TextureId texture, const FacadePlan& plan, const Eigen::Vector2d& a,
                const Eigen::Vector2d& b, double z, float shade);
/// The same as one flat polygon.
void add_flat_facade(SceneBuilder& scene, TextureId texture, const FacadePlan& plan, const Eigen::Vector2d& a,
                     const Eigen::Vector2d& b, double z, float shade);

}  // namespace convoy::simulator
