#include "facade.hpp"

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

int offset_of(Stream& random) { return static_cast<int>(random.below(1024)); }

void paint_courses(Canvas& canvas, const FacadeStyle& style, Stream& random) {
  if (style.wall == FacadeStyle::Wall::kBrick) {
    constexpr double high = 0.08, wide = 0.24;
    int row = 0;
    for (double y = 0.0; y < canvas.height_m(); y += high, ++row)
      for (double x = row % 2 == 0 ? 0.0 : -wide / 2; x < canvas.width_m(); x += wide) {
        canvas.fill(x, y, x + wide - 0.02, y + high - 0.02, style.grey + 13.0 * random.gaussian());
      }
  } else if (style.wall == FacadeStyle::Wall::kStone) {
    constexpr double high = 0.44, wide = 0.96;
    int row = 0;
    for (double y = 0.0; y < canvas.height_m(); y += high, ++row)
      for (double x = row % 2 == 0 ? 0.0 : -wide / 2; x < canvas.width_m(); x += wide) {
        canvas.fill(x, y, x + wide, y + high, style.grey + 8.0 * random.gaussian());
        canvas.frame(x, y, x + wide, y + high, 0.012, style.grey - 48.0);
      }
  } else if (style.wall == FacadeStyle::Wall::kConcrete) {
    for (double x = 0.0; x < canvas.width_m(); x += style.pitch_m)
      canvas.line(x, 0.0, x, canvas.height_m(), 0.03, style.grey - 60.0, 0.8);
    for (double y = 0.3; y < canvas.height_m(); y += style.storey_m)
      canvas.line(0.0, y, canvas.width_m(), y, 0.03, style.grey - 60.0, 0.8);
  }
}

/// What is behind the pane differs from window to window: curtains, blinds let down so far, a room, the sky's image.
void paint_panes(Canvas& canvas, const FacadeStyle& style, double x0, double y0, double x1, double y1, Stream& random) {
  const double dark = random.uniform(24.0, 62.0);
  canvas.shade(x0, y0, x1, y1, dark + 30.0, dark);
  const double look = random.uniform(0.0, 1.0);
  if (look < 0.3) {  // curtains
    const double wide = random.uniform(0.12, 0.4) * (x1 - x0), grey = random.uniform(130.0, 205.0);
    for (double x = x0; x < x0 + wide; x += 0.08) {
      canvas.fill(x, y0, x + 0.05, y1, grey);
      canvas.fill(x1 - (x - x0) - 0.05, y0, x1 - (x - x0), y1, grey - 12.0);
    }
  } else if (look < 0.6) {  // a blind
    static constexpr double levels[] = {0.25, 0.5, 0.75, 1.0};
    const double low = y0 + (y1 - y0) * levels[random.below(4)], grey = random.uniform(140.0, 215.0);
    canvas.fill(x0, y0, x1, low, grey);
    for (double y = y0 + 0.08; y < low; y += 0.08) canvas.fill(x0, y, x1, y + 0.02, grey - 45.0);
    canvas.fill(x0, low - 0.04, x1, low, grey - 70.0);
  } else if (look < 0.72) {  // somebody's plants or things
    for (int i = 0; i < 4; ++i) {
      const double x = random.uniform(x0, x1), r = random.uniform(0.05, 0.14);
      canvas.disc(x, y1 - r, r, random.uniform(70.0, 190.0));
    }
  }
  if (random.chance(0.35)) {  // the sky and the houses opposite
    const double x = random.uniform(x0, x1), slant = random.uniform(-0.3, 0.3);
    canvas.line(x, y0, x + slant, y1, random.uniform(0.1, 0.35), 190.0, 0.25);
  }
  canvas.frame(x0, y0, x1, y1, 0.07, style.frame_grey);
  for (int pane = 1; pane < style.panes; ++pane) {
    const double x = x0 + (x1 - x0) * pane / style.panes;
    canvas.fill(x - 0.035, y0, x + 0.035, y1, style.frame_grey);
  }
  canvas.fill(x0, y0 + 0.3 * (y1 - y0), x1, y0 + 0.3 * (y1 - y0) + 0.05, style.frame_grey);
  canvas.shade(x0, y0, x1, y0 + 0.16, 20.0, 60.0, 0.5);  // in the shadow of the lintel
}

void paint_window(Canvas& canvas, const FacadeStyle& style, double x0, double y0, double x1, double y1,
                  Stream& random) {
  if (style.surrounds) {
    canvas.fill(x0 - 0.16, y0 - 0.2, x1 + 0.16, y1 + 0.04, style.grey + 34.0);
    canvas.fill(x0 - 0.2, y0 - 0.26, x1 + 0.2, y0 - 0.18, style.grey + 48.0);
    canvas.fill(x0 - 0.2, y0 - 0.18, x1 + 0.2, y0 - 0.15, style.grey - 50.0);
  } else if (style.wall == FacadeStyle::Wall::kBrick) {
    for (double x = x0 - 0.1; x < x1 + 0.1; x += 0.09) canvas.fill(x, y0 - 0.24, x + 0.07, y0, style.grey + 22.0);
  }
  canvas.fill(x0 - 0.1, y1, x1 + 0.1, y1 + 0.07, style.grey + 45.0);
  canvas.fill(x0 - 0.1, y1 + 0.07, x1 + 0.1, y1 + 0.11, style.grey - 65.0);
  paint_panes(canvas, style, x0, y0, x1, y1, random);
  if (style.balconies) {
    for (double x = x0 - 0.1; x <= x1 + 0.1; x += 0.12) canvas.fill(x, y1 - 0.6, x + 0.025, y1 + 0.05, 48.0);
    canvas.fill(x0 - 0.12, y1 - 0.62, x1 + 0.12, y1 - 0.57, 40.0);
  }
  if (random.chance(0.3)) {  // rain has run down from the sill
    const double x = random.uniform(x0, x1 - 0.2);
    canvas.darken(x, y1 + 0.1, x + random.uniform(0.1, 0.4), y1 + random.uniform(0.5, 1.1), 0.84, 0.12);
  }
}

void paint_shop(Canvas& canvas, double x0, double y0, double x1, double y1, Stream& random) {
  const double dark = random.uniform(28.0, 70.0);
  canvas.shade(x0, y0, x1, y1, dark, dark + 40.0);
  for (int thing = 0; thing < 7; ++thing) {  // goods behind the glass
    const double wide = random.uniform(0.08, 0.35), high = random.uniform(0.1, 0.6), x = random.uniform(x0, x1 - wide);
    const double grey = random.uniform(40.0, 220.0);
    canvas.fill(x, y1 - high, x + wide, y1, grey);
    if (random.chance(0.4)) canvas.letters(random, x + 0.03, y1 - high + 0.05, 0.09, 3, 255.0 - grey);
  }
  if (random.chance(0.5)) {
    const double x = random.uniform(x0, x0 + 0.4 * (x1 - x0)), y = random.uniform(y0 + 0.3, y0 + 0.8);
    canvas.letters(random, x, y, random.uniform(0.12, 0.28), 4 + static_cast<int>(random.below(4)), 225.0);
  }
  canvas.frame(x0, y0, x1, y1, 0.08, random.uniform(40.0, 200.0));
  // The name over it.
  const double back = random.uniform(25.0, 235.0), high = random.uniform(0.42, 0.6);
  canvas.fill(x0 - 0.15, y0 - high - 0.06, x1 + 0.15, y0 - 0.06, back);
  canvas.frame(x0 - 0.15, y0 - high - 0.06, x1 + 0.15, y0 - 0.06, 0.03, back > 128 ? back - 60 : back + 60);
  const double letter = 0.6 * high;
  const int count = std::max(2, static_cast<int>((x1 - x0 - 0.1) / (0.8 * letter)) - static_cast<int>(random.below(4)));
  canvas.letters(random, x0 + 0.05, y0 - 0.8 * high - 0.06, letter, count, back > 128 ? 30.0 : 230.0);
}

void paint_door(Canvas& canvas, double x0, double y0, double x1, double y1, Stream& random) {
  const double grey = random.uniform(40.0, 120.0);
  canvas.fill(x0 - 0.12, y0 - 0.12, x1 + 0.12, y1, random.uniform(150.0, 205.0));
  canvas.fill(x0, y0, x1, y1, grey);
  const double middle = (x0 + x1) / 2;
  for (int half = 0; half < 2; ++half) {
    const double left = (half == 0 ? x0 : middle) + 0.09, right = (half == 0 ? middle : x1) - 0.09;
    canvas.fill(left, y0 + 0.5, right, y0 + 1.3, grey > 80 ? 35.0 : 150.0);
    canvas.frame(left, y0 + 1.45, right, y1 - 0.15, 0.04, grey + 40.0);
  }
  canvas.fill(x0, y0 + 0.38, x1, y0 + 0.44, grey - 30.0);
  canvas.fill(middle - 0.012, y0 + 0.4, middle + 0.012, y1, 15.0);
  canvas.disc(middle + 0.1, y1 - 1.0, 0.04, 220.0);
  canvas.fill(x1 + 0.2, y1 - 1.7, x1 + 0.45, y1 - 1.5, 230.0);  // the number of the house, and the bells
  canvas.letters(random, x1 + 0.23, y1 - 1.67, 0.14, 2, 30.0);
  canvas.fill(x1 + 0.22, y1 - 1.4, x1 + 0.38, y1 - 1.1, 90.0);
  for (double y = y1 - 1.37; y < y1 - 1.12; y += 0.07) canvas.fill(x1 + 0.25, y, x1 + 0.35, y + 0.03, 210.0);
}

void paint_garage(Canvas& canvas, double x0, double y0, double x1, double y1, Stream& random) {
  const double grey = random.uniform(80.0, 190.0);
  canvas.fill(x0, y0, x1, y1, grey);
  for (double y = y0; y < y1; y += 0.16) canvas.fill(x0, y, x1, y + 0.03, grey - 40.0);
  canvas.frame(x0, y0, x1, y1, 0.07, grey - 55.0);
}

void paint_graffiti(Canvas& canvas, double x, double base, Stream& random) {
  const double grey = random.chance(0.5) ? random.uniform(15.0, 60.0) : random.uniform(200.0, 250.0);
  double px = x, py = base - random.uniform(0.6, 1.3), angle = random.uniform(-1.0, 1.0);
  const double wide = random.uniform(0.03, 0.09);
  for (int i = 0; i < 60; ++i) {
    angle += random.uniform(-0.9, 0.9);
    const double nx = px + 0.07 * std::cos(angle) + 0.02,
                 ny = std::clamp(py + 0.09 * std::sin(angle), base - 1.7, base - 0.3);
    canvas.line(px, py, nx, ny, wide, grey, 0.85);
    px = nx, py = ny;
  }
}

/// What makes one front another than the next of its style.
void paint_marks(Canvas& canvas, const FacadePlan& plan, const FacadeStyle& style, Stream& random) {
  const double base = plan.height_m, wide = plan.width_m;
  const int cracks = 1 + static_cast<int>(random.below(4));
  for (int i = 0; i < cracks; ++i) {
    const double x = random.uniform(0.0, wide), y = random.uniform(0.2 * base, base);
    const double angle = random.uniform(0.6, 2.5);
    canvas.crack(random, x, y, angle, random.uniform(0.6, 3.0), 0.03, style.grey - 80.0);
  }
  const int stains = 3 + static_cast<int>(random.below(5));
  for (int i = 0; i < stains; ++i) {
    const double x = random.uniform(0.0, wide), y = random.uniform(0.0, base), w = random.uniform(0.3, 1.4);
    const double h = random.uniform(0.4, 2.2);
    canvas.darken(x, y, x + w, y + h, random.uniform(0.8, 1.12), 0.35);
  }
  const int patches = static_cast<int>(random.below(3));
  for (int i = 0; i < patches; ++i) {
    const double x = random.uniform(0.0, wide), y = random.uniform(0.3 * base, base), w = random.uniform(0.2, 0.8);
    const double h = random.uniform(0.2, 0.8);
    canvas.fill(x, y, x + w, y + h, style.grey + random.uniform(-35.0, 40.0), 0.7);
  }
  if (random.chance(0.8)) {  // a pipe from the gutter down
    const double x = random.chance(0.5) ? 0.25 : wide - 0.3, grey = random.uniform(70.0, 170.0);
    canvas.fill(x, 0.0, x + 0.1, base, grey);
    canvas.fill(x + 0.07, 0.0, x + 0.14, base, grey - 50.0, 0.7);
    for (double y = random.uniform(0.3, 1.5); y < base; y += 1.9)
      canvas.fill(x - 0.03, y, x + 0.13, y + 0.06, grey - 30.0);
  }
  const auto at_eye_level = [&](double w, double h, double& x, double& y) {
    x = random.uniform(0.1, std::max(0.2, wide - w - 0.1)), y = base - random.uniform(h + 0.7, h + 1.7);
  };
  const int posters = static_cast<int>(random.below(4));
  for (int i = 0; i < posters; ++i) {
    const double w = random.uniform(0.3, 0.8), h = 1.4 * w, grey = random.uniform(120.0, 245.0);
    double x = 0, y = 0;
    at_eye_level(w, h, x, y);
    canvas.fill(x, y, x + w, y + h, grey);
    canvas.fill(x + 0.1 * w, y + 0.1 * h, x + 0.9 * w, y + random.uniform(0.3, 0.55) * h, random.uniform(20.0, 230.0));
    for (double line = 0.62; line < 0.9; line += 0.13)
      canvas.letters(random, x + 0.1 * w, y + line * h, 0.08 * h, 6 + static_cast<int>(random.below(3)), grey - 110.0);
  }
  const int plates = 1 + static_cast<int>(random.below(4));
  for (int i = 0; i < plates; ++i) {
    const double w = random.uniform(0.15, 0.5), h = random.uniform(0.12, 0.35), grey = random.uniform(30.0, 240.0);
    double x = 0, y = 0;
    at_eye_level(w, h, x, y);
    canvas.fill(x, y, x + w, y + h, grey);
    canvas.letters(random, x + 0.04, y + 0.25 * h, 0.45 * h, std::max(1, static_cast<int>(w / (0.4 * h))),
                   grey > 128 ? 20.0 : 235.0);
  }
  if (random.chance(0.3)) paint_graffiti(canvas, random.uniform(0.0, std::max(0.1, wide - 3.0)), base, random);
  const int boxes = static_cast<int>(random.below(4));
  for (int i = 0; i < boxes; ++i) {  // air conditioners and vents
    const double x = random.uniform(0.0, wide), y = random.uniform(0.0, 0.8 * base);
    canvas.fill(x, y, x + 0.7, y + 0.5, 205.0);
    canvas.disc(x + 0.25, y + 0.25, 0.2, 90.0);
    canvas.fill(x, y + 0.5, x + 0.7, y + 0.58, style.grey - 60.0);
  }
}

}  // namespace

FacadePainter::FacadePainter(std::uint32_t seed)
    : fine_(seed + 1, 1024, 1, 64, 0.35, 1.0), coarse_(seed + 2, 1024, 16, 512, 0.6, 1.0) {}

void FacadePainter::paint_wall(Canvas& canvas, const FacadeStyle& style, Stream& random) const {
  const double joints = style.wall == FacadeStyle::Wall::kBrick ? style.grey + 32.0 : style.grey;
  canvas.fill(0.0, 0.0, canvas.width_m(), canvas.height_m(), joints);
  paint_courses(canvas, style, random);
}

Texture FacadePainter::paint(const FacadeStyle& base_style, const FacadePlan& plan, double texel_m,
                             Stream& random) const {
  FacadeStyle style = base_style;
  style.grey += random.uniform(-9.0, 9.0);
  Canvas canvas(plan.width_m, plan.height_m + foot_m, texel_m);
  paint_wall(canvas, style, random);
  const double base = plan.height_m, wide = plan.width_m;
  if (style.bands) {
    for (double up = style.ground_storey_m - 0.1; up < base - 1.0; up += style.storey_m) {
      canvas.fill(0.0, base - up - 0.22, wide, base - up, style.grey + 30.0);
      canvas.fill(0.0, base - up, wide, base - up + 0.05, style.grey - 55.0);
    }
  }
  canvas.fill(0.0, base - 0.55, wide, base + foot_m, style.grey - 42.0);
  canvas.fill(0.0, base - 0.6, wide, base - 0.55, style.grey + 15.0);
  canvas.fill(0.0, 0.0, wide, 0.25, style.grey + 30.0);
  canvas.shade(0.0, 0.25, wide, 0.7, style.grey - 70.0, style.grey - 10.0, 0.7);
  paint_marks(canvas, plan, style, random);
  for (const Opening& o : plan.openings) {
    const double y0 = base - o.z1, y1 = base - o.z0;
    if (o.kind == Opening::Kind::kWindow) paint_window(canvas, style, o.x0, y0, o.x1, y1, random);
    if (o.kind == Opening::Kind::kShop) paint_shop(canvas, o.x0, y0, o.x1, y1, random);
    if (o.kind == Opening::Kind::kDoor) paint_door(canvas, o.x0, y0, o.x1, y1, random);
    if (o.kind == Opening::Kind::kGarage) paint_garage(canvas, o.x0, y0, o.x1, y1, random);
  }
  canvas.darken(0.0, base - 0.5, wide, base + foot_m, 0.85, 0.3);
  const int x = offset_of(random), y = offset_of(random);
  canvas.roughen(fine_, style.wall == FacadeStyle::Wall::kConcrete ? 6.5 : 5.0, x, y);
  canvas.roughen(coarse_, 5.5, offset_of(random), y);
  return canvas.take();
}

Texture FacadePainter::paint_blank(const FacadeStyle& style, Stream& random) const {
  Canvas canvas(blank_tile_m, blank_tile_m, 0.01, true);
  paint_wall(canvas, style, random);
  for (int i = 0; i < 6; ++i) {
    const double x = random.uniform(0.0, blank_tile_m), y = random.uniform(0.0, blank_tile_m);
    const double w = random.uniform(0.5, 2.0);
    canvas.darken(x, y, x + w, y + random.uniform(0.5, 3.0), random.uniform(0.78, 1.12), 0.3);
    canvas.crack(random, y, x, 1.6, 2.0, 0.03, style.grey - 80.0);
  }
  canvas.roughen(fine_, 5.0, 0, 0);
  canvas.roughen(coarse_, 7.0, 0, 0, 1);
  return canvas.take();
}

}  // namespace convoy::simulator
