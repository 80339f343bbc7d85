// What is painted on roads and let into them.
#pragma once

#include "ground_mesh.hpp"
#include "street_textures.hpp"

#include <vector>

namespace convoy::simulator {

/// Lane markings, stop lines, crossings, arrows, patches, cracks and lids of one street.
void add_road_marks(SceneBuilder& scene, const GroundMesh& ground, const StreetNetwork& network, const Street& street,
                    std::size_t index, const StreetTextures& textures, std::uint32_t seed);

/// Parts of a street between junctions, as arc lengths [m].
struct Stretch {
  double from, to;
  bool ends_at_junction_from, ends_at_junction_to;
};
std::vector<Stretch> stretches_between_junctions(const StreetNetwork& network, const Street& street, std::size_t index);

}  // namespace convoy::simulator
