// Textures of everything but fronts.
#pragma once

#include "ground_mesh.hpp"
#include "paint.hpp"

#include <array>

namespace convoy::simulator {

struct StreetTextures {
  GroundTextures ground;
  TextureId paint = 0;                 ///< of lane markings, worn; repeats, 2 m
  std::array<TextureId, 4> patches{};  ///< mended asphalt
  std::array<TextureId, 3> lids{};     ///< manholes and drains
  std::array<TextureId, 4> cracks{};   ///< tar over cracks
  TextureId metal = 0, bark = 0, leaves = 0, stone = 0, tyre = 0, bin = 0;
  std::array<TextureId, 8> signs{};  ///< traffic signs and boards
  TextureId sign_back = 0;
  std::array<TextureId, 8> car_sides{};  ///< one for each paint
  std::array<TextureId, 8> car_tops{};
};

StreetTextures paint_street_textures(SceneBuilder& scene, std::uint32_t seed);

/// The textures of cars alone; the others are not there.
StreetTextures paint_car_textures(SceneBuilder& scene, std::uint32_t seed);

/// The sky with clouds, and the outline of the town at the horizon.
Texture paint_sky(std::uint32_t seed);

}  // namespace convoy::simulator
