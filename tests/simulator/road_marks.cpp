#include "road_marks.hpp"

#include "polyline.hpp"

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>

namespace convoy::simulator {
namespace {

constexpr float paint_bias_m = 0.03F, patch_bias_m = 0.015F;

class Marker {
 public:
  Marker(SceneBuilder& scene, const GroundMesh& ground, const Street& street, const StreetTextures& textures)
      : scene_(scene), ground_(ground), street_(street), textures_(textures) {}

  Eigen::Vector2d at(double s, double right) const {
    const PointOnLine point = point_at(street_.line, s);
    return point.at + right * Eigen::Vector2d(point.ahead.y(), -point.ahead.x());
  }

  /// A band along the street from s0 to s1, `right` of its middle.
  void band(double s0, double s1, double right, double width) {
    constexpr double step = 2.0;
    const int pieces = std::max(1, static_cast<int>(std::ceil((s1 - s0) / step)));
    for (int i = 0; i < pieces; ++i)
      paint(s0 + (s1 - s0) * i / pieces, s0 + (s1 - s0) * (i + 1) / pieces, right - width / 2, right + width / 2);
  }

  /// A rectangle of the street's own coordinates.
  void paint(double s0, double s1, double right0, double right1) {
    const Eigen::Vector2d a = at(s0, right1), b = at(s1, right1), c = at(s1, right0), d = at(s0, right0);
    // The paint's wear is of the place.
    const auto uv = [](const Eigen::Vector2d& p) { return Eigen::Vector2f((0.5 * p).cast<float>()); };
    polygon(textures_.paint, paint_bias_m, {a, b, c, d}, {uv(a), uv(b), uv(c), uv(d)});
  }

  void polygon(TextureId texture, float bias, const std::vector<Eigen::Vector2d>& points,
               const std::vector<Eigen::Vector2f>& uv) {
    std::vector<Corner> corners;
    for (std::size_t i = 0; i < points.size(); ++i)
      corners.push_back({Eigen::Vector3d(points[i].x(), points[i].y(), ground_.bed_m(points[i])).cast<float>(), uv[i]});
    add_polygon(scene_.piece(texture, points[0].x(), points[0].y(), bias), corners);
  }

  /// A turned rectangle that shows a whole texture.
  void plate(TextureId texture, double s, double right, double length, double width, double yaw) {
    const PointOnLine point = point_at(street_.line, s);
    const Eigen::Vector2d middle = at(s, right);
    const Eigen::Vector2d ahead = Eigen::Rotation2Dd(yaw) * point.ahead * (length / 2);
    const Eigen::Vector2d left =
        Eigen::Rotation2Dd(yaw) * Eigen::Vector2d(-point.ahead.y(), point.ahead.x()) * (width / 2);
    polygon(texture, patch_bias_m,
            {middle - ahead - left, middle + ahead - left, middle + ahead + left, middle - ahead + left},
            {{0.005F, 0.995F}, {0.995F, 0.995F}, {0.995F, 0.005F}, {0.005F, 0.005F}});
  }

  void arrow(double s, double right, double direction) {
    const double width = 0.16;
    paint(std::min(s, s + 2.0 * direction), std::max(s, s + 2.0 * direction), right - width / 2, right + width / 2);
    std::vector<Eigen::Vector2d> head{at(s + 2.0 * direction, right + 0.35 * direction), at(s + 3.0 * direction, right),
                                      at(s + 2.0 * direction, right - 0.35 * direction)};
    const auto uv = [](const Eigen::Vector2d& p) { return Eigen::Vector2f((0.5 * p).cast<float>()); };
    polygon(textures_.paint, paint_bias_m, head, {uv(head[0]), uv(head[1]), uv(head[2])});
  }

 private:
  SceneBuilder& scene_;
  const GroundMesh& ground_;
  const Street& street_;
  const StreetTextures& textures_;
};

/// Stripes to walk on and, before them, the line to stop at. `direction`: +1 where the junction lies at higher s.
void add_crossing(Marker& mark, const Street& street, double s, double direction) {
  const double width = street.half_width_m;
  const double near = s - 1.0 * direction, far = s - 3.6 * direction;
  for (double right = -width + 0.4; right + 0.5 < width - 0.1; right += 1.0)
    mark.paint(std::min(near, far), std::max(near, far), right, right + 0.5);
  const double stop = far - 1.2 * direction;
  const double inner = street.two_way ? 0.15 * direction : -(width - 0.3) * direction;
  const double outer = (width - 0.3) * direction;
  if (street.two_way || direction > 0.0)
    mark.paint(std::min(stop, stop - 0.4 * direction), std::max(stop, stop - 0.4 * direction), std::min(inner, outer),
               std::max(inner, outer));
}

void add_lanes(Marker& mark, const Street& street, const Stretch& stretch, double from, double to) {
  if (street.lanes < 2) return;
  const double lane = 2.0 * (street.half_width_m - 2.1) / street.lanes;
  for (int line = 1; line < street.lanes; ++line) {
    const double right = -(street.half_width_m - 2.1) + line * lane;
    if (street.two_way && 2 * line == street.lanes && street.lanes > 2) {
      mark.band(from, to, right, 0.12);
      continue;
    }
    for (double s = from; s + 1.5 < to; s += 4.5) mark.paint(s, s + 1.5, right - 0.06, right + 0.06);
  }
  const double middle = street.two_way ? street.half_width_m - 2.1 - lane / 2 : 0.0;
  if (to - from < 25.0) return;
  if (stretch.ends_at_junction_to) mark.arrow(to - 6.0, middle, 1.0);
  if (stretch.ends_at_junction_from && street.two_way) mark.arrow(from + 6.0, -middle, -1.0);
}

void add_wear(Marker& mark, const Street& street, double from, double to, const StreetTextures& textures,
              Stream& random) {
  const double length = to - from, reach = street.half_width_m - 1.0;
  const int wear = static_cast<int>(length / 7.0);
  for (int i = 0; i < wear; ++i) {
    const double s = random.uniform(from, to), right = random.uniform(-reach, reach);
    const double kind = random.uniform(0.0, 1.0);
    const std::uint32_t which = random.below(4);
    const double turn = random.uniform(-3.1, 3.1);
    if (kind < 0.35) {
      const double long_m = random.uniform(0.8, 2.6), wide_m = random.uniform(0.6, 1.6);
      mark.plate(textures.patches[which], s, right, long_m, wide_m, random.chance(0.7) ? 0.0 : turn);
    } else if (kind < 0.7) {
      mark.plate(textures.cracks[which], s, right, 2.0, 2.0, turn);
    } else {
      mark.plate(textures.lids[which % 2], s, right, 0.76, 0.76, turn);
    }
  }
  for (double s = from + random.uniform(2.0, 18.0); s < to; s += random.uniform(18.0, 28.0))
    for (const double side : {-1.0, 1.0})
      mark.plate(textures.lids[2], s, side * (street.half_width_m - 0.3), 0.5, 0.5, 0.0);
}

}  // namespace

std::vector<Stretch> stretches_between_junctions(const StreetNetwork& network, const Street& street,
                                                 std::size_t index) {
  constexpr double step = 0.5, clear_m = 1.5;
  std::vector<Stretch> stretches;
  const double length = length_m(street.line);
  bool open = false;
  for (double s = 0.0; s <= length; s += step) {
    const Eigen::Vector2d point = point_at(street.line, s).at;
    const bool free = network.beyond_others_m(point, index) > clear_m;
    if (free && !open) stretches.push_back({s, length, s > step, false});
    if (free) stretches.back().to = s;
    if (!free && open) stretches.back().ends_at_junction_to = true;
    open = free;
  }
  return stretches;
}

void add_road_marks(SceneBuilder& scene, const GroundMesh& ground, const StreetNetwork& network, const Street& street,
                    std::size_t index, const StreetTextures& textures, std::uint32_t seed) {
  Marker mark(scene, ground, street, textures);
  Stream random({seed, 0, 30, street.id});
  for (const Stretch& stretch : stretches_between_junctions(network, street, index)) {
    double from = stretch.from, to = stretch.to;
    if (to - from > 16.0 && street.lanes >= 2) {
      if (stretch.ends_at_junction_from) add_crossing(mark, street, from, -1.0), from += 6.0;
      if (stretch.ends_at_junction_to) add_crossing(mark, street, to, 1.0), to -= 6.0;
    }
    if (to - from < 6.0) continue;
    add_lanes(mark, street, stretch, from, to);
    add_wear(mark, street, stretch.from, stretch.to, textures, random);
  }
}

}  // namespace convoy::simulator
