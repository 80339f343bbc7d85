#include "street_textures.hpp"

#include "noise.hpp"

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

constexpr double ground_tile_m = 8.0;  // as ground_mesh.cpp lays it

struct Grain {
  explicit Grain(std::uint32_t seed)
      : fine(seed + 21, 1024, 1, 16, 0.1, 1.0),
        middle(seed + 22, 1024, 8, 128, 0.5, 1.0),
        coarse(seed + 23, 1024, 64, 512, 0.5, 1.0) {}
  NoiseTile fine, middle, coarse;
};

Texture asphalt(const Grain& grain, Stream& random) {
  Canvas canvas(ground_tile_m, ground_tile_m, ground_tile_m / 1024, true);
  canvas.fill(0, 0, ground_tile_m, ground_tile_m, 98.0);
  for (int i = 0; i < 500; ++i) {  // stones that shine through
    const double x = random.uniform(0, ground_tile_m), y = random.uniform(0, ground_tile_m);
    canvas.disc(x, y, random.uniform(0.008, 0.02), random.uniform(60.0, 170.0), 0.7);
  }
  for (int i = 0; i < 14; ++i) {
    const double x = random.uniform(0, ground_tile_m), y = random.uniform(0, ground_tile_m);
    canvas.crack(random, x, y, random.uniform(0, 6.28), random.uniform(0.5, 2.5), 0.02, 58.0);
  }
  for (int i = 0; i < 10; ++i) {
    const double x = random.uniform(0, ground_tile_m), y = random.uniform(0, ground_tile_m);
    canvas.disc(x, y, random.uniform(0.05, 0.3), 70.0, 0.35);
  }
  canvas.roughen(grain.fine, 6.0, 0, 0);
  canvas.roughen(grain.middle, 4.0, 0, 0);
  canvas.roughen(grain.coarse, 6.0, 0, 0);
  return canvas.take();
}

Texture slabs(const Grain& grain, Stream& random) {
  Canvas canvas(ground_tile_m, ground_tile_m, ground_tile_m / 1024, true);
  constexpr double slab = 0.5;
  for (double y = 0; y < ground_tile_m - 0.01; y += slab)
    for (double x = 0; x < ground_tile_m - 0.01; x += slab) {
      canvas.fill(x, y, x + slab, y + slab, 138.0 + 7.0 * random.gaussian());
      canvas.frame(x, y, x + slab, y + slab, 0.01, 92.0);
    }
  for (int i = 0; i < 60; ++i) {  // chewing gum and worse
    const double x = random.uniform(0, ground_tile_m), y = random.uniform(0, ground_tile_m);
    canvas.disc(x, y, random.uniform(0.015, 0.05), random.uniform(60.0, 175.0), 0.8);
  }
  for (int i = 0; i < 8; ++i) {
    const double x = random.uniform(0, ground_tile_m), y = random.uniform(0, ground_tile_m),
                 w = random.uniform(0.3, 1.5);
    canvas.darken(x, y, x + w, y + w, random.uniform(0.75, 0.92), 0.3);
  }
  canvas.roughen(grain.fine, 5.0, 0, 0);
  canvas.roughen(grain.coarse, 5.0, 0, 0);
  return canvas.take();
}

Texture yard(const Grain& grain, Stream& random) {
  Canvas canvas(ground_tile_m, ground_tile_m, ground_tile_m / 1024, true);
  canvas.fill(0, 0, ground_tile_m, ground_tile_m, 112.0);
  for (int i = 0; i < 4000; ++i) {
    const double x = random.uniform(0, ground_tile_m), y = random.uniform(0, ground_tile_m);
    canvas.disc(x, y, random.uniform(0.01, 0.05), random.uniform(70.0, 150.0), 0.6);
  }
  canvas.roughen(grain.middle, 9.0, 0, 0);
  canvas.roughen(grain.coarse, 9.0, 0, 0);
  return canvas.take();
}

Texture kerb_stone(const Grain& grain, Stream& random) {
  Canvas canvas(2.0, 2.0, 2.0 / 256, true);
  canvas.fill(0, 0, 2, 2, 158.0);
  for (double x = 0; x < 1.9; x += 1.0) canvas.fill(x, 0, x + 0.02, 2, 95.0);
  for (double y = 0; y < 1.9; y += 1.0) canvas.fill(0, y, 2, y + 0.02, 110.0);
  for (int i = 0; i < 12; ++i) {
    const double x = random.uniform(0, 2), y = random.uniform(0, 2);
    canvas.disc(x, y, random.uniform(0.01, 0.06), random.uniform(90.0, 190.0), 0.7);
  }
  canvas.roughen(grain.fine, 7.0, 0, 0);
  return canvas.take();
}

/// One colour with grain, worn.
Texture worn(const Grain& grain, Stream& random, double grey, double strength, int flaws, double flaw_grey) {
  Canvas canvas(2.0, 2.0, 2.0 / 256, true);
  canvas.fill(0, 0, 2, 2, grey);
  for (int i = 0; i < flaws; ++i) {
    const double x = random.uniform(0, 2), y = random.uniform(0, 2), turn = random.uniform(0, 6.28);
    canvas.crack(random, x, y, turn, random.uniform(0.1, 0.5), 0.03, flaw_grey);
  }
  canvas.roughen(grain.fine, strength, static_cast<int>(random.below(1024)), 0);
  canvas.roughen(grain.middle, strength, static_cast<int>(random.below(1024)), 0);
  return canvas.take();
}

Texture patch(const Grain& grain, Stream& random, bool tar) {
  Canvas canvas(2.0, 2.0, 2.0 / 256);
  const double grey = tar ? 88.0 : random.uniform(72.0, 125.0);
  canvas.fill(0, 0, 2, 2, tar ? 98.0 : grey);
  if (tar) {
    for (int i = 0; i < 3; ++i) {
      const double y = random.uniform(0.4, 1.6);
      canvas.crack(random, 0.1, y, random.uniform(-0.4, 0.4), 2.2, 0.07, 44.0);
    }
  } else {
    canvas.frame(0, 0, 2, 2, 0.05, 52.0);
  }
  canvas.roughen(grain.fine, 6.0, static_cast<int>(random.below(1024)), 0);
  canvas.roughen(grain.middle, 5.0, static_cast<int>(random.below(1024)), 0);
  return canvas.take();
}

Texture lid(const Grain& grain, int kind) {
  Canvas canvas(0.8, 0.8, 0.8 / 96);
  canvas.fill(0, 0, 0.8, 0.8, 96.0);
  if (kind == 2) {  // a drain
    canvas.fill(0.05, 0.05, 0.75, 0.75, 62.0);
    for (double y = 0.12; y < 0.7; y += 0.1) canvas.fill(0.12, y, 0.68, y + 0.05, 16.0);
  } else {
    canvas.disc(0.4, 0.4, 0.38, 48.0);
    canvas.disc(0.4, 0.4, 0.33, 84.0);
    for (double y = 0.14; y < 0.66; y += 0.09)
      for (double x = 0.14; x < 0.66; x += 0.09)
        if (std::hypot(x - 0.38, y - 0.38) < 0.27) canvas.fill(x, y, x + 0.05, y + 0.05, kind == 0 ? 46.0 : 120.0);
  }
  canvas.roughen(grain.fine, 5.0, 0, 0);
  return canvas.take();
}

Texture sign(const Grain& grain, Stream& random, int kind) {
  Canvas canvas(0.64, 0.64, 0.64 / 64);
  const bool dark = kind % 2 == 0;
  canvas.fill(0, 0, 0.64, 0.64, dark ? 60.0 : 225.0);
  canvas.frame(0.02, 0.02, 0.62, 0.62, 0.05, dark ? 230.0 : 70.0);
  switch (kind / 2) {
    case 0:
      canvas.line(0.32, 0.14, 0.32, 0.5, 0.08, dark ? 240.0 : 40.0),
          canvas.line(0.32, 0.14, 0.2, 0.28, 0.07, dark ? 240.0 : 40.0),
          canvas.line(0.32, 0.14, 0.44, 0.28, 0.07, dark ? 240.0 : 40.0);
      break;
    case 1: canvas.letters(random, 0.14, 0.18, 0.3, 2, dark ? 240.0 : 20.0); break;
    case 2:
      canvas.disc(0.32, 0.32, 0.22, dark ? 220.0 : 80.0), canvas.fill(0.16, 0.28, 0.48, 0.36, dark ? 50.0 : 240.0);
      break;
    default:
      canvas.letters(random, 0.08, 0.12, 0.12, 4, dark ? 240.0 : 20.0),
          canvas.letters(random, 0.08, 0.36, 0.12, 4, dark ? 240.0 : 20.0);
      break;
  }
  canvas.roughen(grain.middle, 4.0, 64 * kind, 0);
  return canvas.take();
}

/// Side view: 4.4 m long, 1.5 m high, the nose at u = 0.
Texture car_side(const Grain& grain, Stream& random, double grey) {
  Canvas canvas(4.4, 1.5, 4.4 / 352);
  canvas.fill(0, 0, 4.4, 1.5, grey);
  canvas.shade(0, 0.6, 4.4, 1.5, grey + 12.0, 0.6 * grey);
  canvas.fill(0, 1.2, 4.4, 1.5, 34.0);
  canvas.shade(1.15, 0.08, 3.75, 0.56, 70.0, 38.0);  // windows
  for (const double x : {1.15, 2.2, 3.15, 3.7}) canvas.fill(x - 0.05, 0.06, x + 0.05, 0.6, 0.75 * grey);
  canvas.fill(1.1, 0.0, 3.8, 0.08, 0.9 * grey);
  for (const double x : {1.25, 2.22, 3.2}) canvas.fill(x, 0.5, x + 0.015, 1.2, 0.45 * grey);
  for (const double x : {1.95, 2.95}) canvas.fill(x, 0.66, x + 0.16, 0.7, 0.4 * grey);
  canvas.line(0.3, 0.75, 4.2, 0.72, 0.02, 0.7 * grey);
  for (const double x : {0.85, 3.5}) {
    canvas.disc(x, 1.18, 0.4, 22.0);
    canvas.disc(x, 1.18, 0.2, 150.0);
  }
  canvas.fill(0.02, 0.62, 0.3, 0.78, 220.0);
  canvas.fill(4.2, 0.6, 4.38, 0.8, 80.0);
  canvas.fill(1.15, 0.5, 1.4, 0.62, 0.8 * grey);  // mirror
  canvas.roughen(grain.middle, 2.5, static_cast<int>(random.below(1024)), 0);
  return canvas.take();
}

/// From the nose (v = 0) over screen and roof to the tail (v = 1), by the stations of car_model.cpp.
Texture car_top(const Grain& grain, Stream& random, double grey) {
  Canvas canvas(1.7, 4.4, 4.4 / 176);
  canvas.fill(0, 0, 1.7, 4.4, std::min(grey + 25.0, 240.0));
  canvas.fill(0, 0, 1.7, 0.28, 0.6 * grey);
  canvas.fill(0.1, 0.02, 0.45, 0.2, 215.0);
  canvas.fill(1.25, 0.02, 1.6, 0.2, 215.0);
  canvas.fill(0.55, 0.1, 1.15, 0.24, 35.0);
  canvas.shade(0.1, 1.05, 1.6, 1.72, 50.0, 90.0);
  canvas.shade(0.15, 3.2, 1.55, 3.7, 80.0, 45.0);
  canvas.fill(0, 4.1, 1.7, 4.4, 0.7 * grey);
  canvas.fill(0.05, 4.05, 0.35, 4.25, 75.0);
  canvas.fill(1.35, 4.05, 1.65, 4.25, 75.0);
  canvas.fill(0.6, 4.15, 1.1, 4.28, 230.0);
  canvas.letters(random, 0.63, 4.18, 0.07, 7, 20.0);
  canvas.roughen(grain.middle, 2.5, static_cast<int>(random.below(1024)), 0);
  return canvas.take();
}

void add_car_textures(SceneBuilder& scene, const Grain& grain, Stream& random, StreetTextures& t) {
  static constexpr std::array<double, 8> paints{228, 60, 150, 36, 186, 96, 120, 205};
  for (std::size_t i = 0; i < paints.size(); ++i) {
    t.car_sides[i] = scene.add(car_side(grain, random, paints[i]));
    t.car_tops[i] = scene.add(car_top(grain, random, paints[i]));
  }
  t.tyre = scene.add(plain(26));
}

}  // namespace

StreetTextures paint_car_textures(SceneBuilder& scene, std::uint32_t seed) {
  const Grain grain(seed);
  Stream random({seed, 0, 21, 0});
  StreetTextures t;
  add_car_textures(scene, grain, random, t);
  return t;
}

StreetTextures paint_street_textures(SceneBuilder& scene, std::uint32_t seed) {
  const Grain grain(seed);
  Stream random({seed, 0, 20, 0});
  StreetTextures t;
  t.ground.road = scene.add(asphalt(grain, random));
  t.ground.pavement = scene.add(slabs(grain, random));
  t.ground.yard = scene.add(yard(grain, random));
  t.ground.kerb = scene.add(kerb_stone(grain, random));
  t.paint = scene.add(worn(grain, random, 208.0, 9.0, 30, 130.0));
  for (auto& id : t.patches) id = scene.add(patch(grain, random, false));
  for (auto& id : t.cracks) id = scene.add(patch(grain, random, true));
  for (std::size_t i = 0; i < t.lids.size(); ++i) t.lids[i] = scene.add(lid(grain, static_cast<int>(i)));
  t.metal = scene.add(worn(grain, random, 122.0, 5.0, 10, 80.0));
  t.bark = scene.add(worn(grain, random, 84.0, 14.0, 60, 40.0));
  t.leaves = scene.add(worn(grain, random, 78.0, 24.0, 90, 25.0));
  t.stone = scene.add(worn(grain, random, 178.0, 7.0, 6, 120.0));
  t.bin = scene.add(worn(grain, random, 66.0, 6.0, 20, 150.0));
  for (std::size_t i = 0; i < t.signs.size(); ++i) t.signs[i] = scene.add(sign(grain, random, static_cast<int>(i)));
  t.sign_back = scene.add(plain(96));
  add_car_textures(scene, grain, random, t);
  return t;
}

Texture paint_sky(std::uint32_t seed) {
  Texture sky{2048, 512, {}};
  sky.grey.resize(2048 * 512);
  const auto skyline = [&](int x) {  // houses far away, so many rows high
    const int block = x / 24;
    return 7 + static_cast<int>(6.0 * lattice_noise(seed + 31, block, 0)) + (x % 24 < 3 ? -2 : 0);
  };
  for (int y = 0; y < sky.height; ++y) {
    const double down = (y + 0.5) / sky.height;
    for (int x = 0; x < sky.width; ++x) {
      // Clouds on a level above, so that they are denser towards the horizon.
      const double away = std::tan(std::min(down, 0.97) * M_PI / 2), bearing = 2 * M_PI * x / sky.width;
      const double cx = away * std::cos(bearing), cy = away * std::sin(bearing);
      double cloud = 0.0, strength = 0.5;
      for (std::uint32_t octave = 0; octave < 5; ++octave, strength *= 0.55)
        cloud += strength * value_noise(seed + 32 + octave, cx * (1 << octave) * 0.9, cy * (1 << octave) * 0.9);
      double grey = 205.0 + 25.0 * down + 60.0 * std::max(cloud, 0.0) * (1.0 - down * down);
      if (sky.height - y <= skyline(x)) grey = 165.0 + 14.0 * lattice_noise(seed + 33, x / 24, 1);
      sky.grey[static_cast<std::size_t>(y * sky.width + x)] = static_cast<std::uint8_t>(std::clamp(grey, 0.0, 255.0));
    }
  }
  return sky;
}

}  // namespace convoy::simulator
