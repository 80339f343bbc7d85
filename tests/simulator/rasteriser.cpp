#include "rasteriser.hpp"

#include "four.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

namespace convoy::simulator {
namespace {

constexpr int kRun = 8;                  // a multiple of four
constexpr std::size_t kMostCorners = 9;  // of a triangle cut by five planes, and one to spare

Window window_of(const Lens& lens, double oversampling) {
  const LensParams& params = lens.params();
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e9), high = -low;
  const auto add = [&](double x, double y) {
    const Eigen::Vector2d ray = lens.ray_of({x, y});
    low = low.cwiseMin(ray), high = high.cwiseMax(ray);
  };
  for (int x = -1; x <= params.width; ++x) add(x, -1), add(x, params.height);
  for (int y = -1; y <= params.height; ++y) add(-1, y), add(params.width, y);
  Window window;
  window.pixels_per_unit = oversampling * std::max(params.fx, params.fy);
  const Eigen::Vector2d margin = Eigen::Vector2d::Constant(2.0 / window.pixels_per_unit);
  low -= margin, high += margin;
  window.left = low.x(), window.top = low.y();
  window.width = static_cast<int>(std::ceil((high.x() - low.x()) * window.pixels_per_unit));
  window.height = static_cast<int>(std::ceil((high.y() - low.y()) * window.pixels_per_unit));
  return window;
}

/// atan2(y, x) / 2 pi in [-0.5, 0.5] from operations that are rounded alike everywhere; to 1e-5 turns.
float turns(float y, float x) {
  const float ax = std::abs(x), ay = std::abs(y), larger = std::max(ax, ay);
  if (!(larger > 0.0F)) return 0.0F;
  const float t = std::min(ax, ay) / larger, t2 = t * t;
  float angle =
      t * (0.99997726F +
           t2 * (-0.33262347F + t2 * (0.19354346F + t2 * (-0.11643287F + t2 * (0.05265332F - 0.01172120F * t2)))));
  angle *= 0.15915494F;
  if (ay > ax) angle = 0.25F - angle;
  if (x < 0.0F) angle = 0.5F - angle;
  return y < 0.0F ? -angle : angle;
}

constexpr Four kLeast = {1e-4F, 1e-4F, 1e-4F, 1e-4F};  // of an inverse depth [1/m]

std::string name_of(std::uint32_t index, std::optional<std::uint32_t> object) {
  return (object ? "object " + std::to_string(*object) + ", mesh " : "mesh ") + std::to_string(index);
}

}  // namespace

void RasteriserParams::validate() const {
  const auto require = [](bool good, const char* what) {
    if (!good) throw std::invalid_argument(std::string("RasteriserParams: ") + what);
  };
  require(filter.most_taps >= 1 && filter.most_taps <= 16, "filter.most_taps must be 1 to 16");
  require(near_m > 0.0 && std::isfinite(near_m), "near_m must be above 0 m");
  require(far_m > near_m, "far_m must be above near_m");
  require(oversampling >= 0.5 && oversampling <= 3.0, "oversampling must be 0.5 to 3");
}

Rasteriser::Rasteriser(const Scene& scene, const Lens& lens, const RasteriserParams& params,
                       std::shared_ptr<const std::vector<MipTexture>> textures)
    : scene_(scene),
      lens_(lens),
      params_((params.validate(), params)),
      shared_textures_(textures ? std::move(textures) : mip_textures(scene)),
      textures_(*shared_textures_),
      buffer_(window_of(lens, params.oversampling)),
      ray_x_(lens.params().width, lens.params().height + 1),
      ray_y_(ray_x_),
      corner_(lens.params().width, lens.params().height),
      right_(corner_.width, corner_.height),
      below_(right_),
      light_(corner_.width, corner_.height) {
  if (scene.sky >= textures_.size())
    throw std::invalid_argument("Scene: the sky is texture " + std::to_string(scene.sky) + " of " +
                                std::to_string(textures_.size()) + "; add it to textures");
  for (std::uint32_t i = 0; i < scene.meshes.size(); ++i) add_piece(scene.meshes[i], i, std::nullopt);
  for (std::uint32_t j = 0; j < scene.objects.size(); ++j)
    for (std::uint32_t i = 0; params.hidden_object != j && i < scene.objects[j].meshes.size(); ++i)
      add_piece(scene.objects[j].meshes[i], i, j);
  lay_out_pixels();
}

void Rasteriser::add_piece(const Mesh& mesh, std::uint32_t index, std::optional<std::uint32_t> object) {
  const auto require = [&](bool good, const char* what) {
    if (!good) throw std::invalid_argument("Scene: " + name_of(index, object) + ": " + what);
  };
  require(mesh.texture < textures_.size(), "its texture is not in Scene::textures; add it");
  require(std::isfinite(mesh.shade) && mesh.shade >= 0.0F, "shade must be finite and not below 0");
  require(std::isfinite(mesh.bias), "bias must be finite");
  Eigen::Vector3d low = Eigen::Vector3d::Constant(1e30), high = -low;
  for (const Vertex& vertex : mesh.vertices) {
    require(vertex.position.allFinite() && vertex.uv.allFinite(), "a vertex is not finite; repair or leave it out");
    low = low.cwiseMin(vertex.position.cast<double>()), high = high.cwiseMax(vertex.position.cast<double>());
  }
  for (const auto& triangle : mesh.triangles)
    for (const std::uint32_t corner : triangle)
      require(corner < mesh.vertices.size(), "a triangle names a vertex that is not there; mend its indices");
  if (mesh.triangles.empty()) return;
  pieces_.push_back({&mesh, index, object, (low + high) / 2.0, (high - low).norm() / 2.0});
}

void Rasteriser::lay_out_pixels() {
  for (int y = 0; y < light_.height; ++y)
    for (int x = 0; x < light_.width; ++x) {
      const Eigen::Vector2d ray = lens_.ray_of({x, y});
      const Eigen::Vector2d place = buffer_.window().pixel_of(ray) - Eigen::Vector2d::Constant(0.5);
      const Eigen::Vector2i corner = place.array().floor().cast<int>();
      const Eigen::Vector2d weight = (place - corner.cast<double>()) * 255.0;
      ray_x_.at(x, y) = static_cast<float>(ray.x()), ray_y_.at(x, y) = static_cast<float>(ray.y());
      corner_.at(x, y) = static_cast<std::uint32_t>(buffer_.index(corner.x(), corner.y()));
      right_.at(x, y) = static_cast<std::uint8_t>(weight.x()), below_.at(x, y) = static_cast<std::uint8_t>(weight.y());
    }
  const double texels_per_pixel = textures_[scene_.sky].width() / (2.0 * M_PI) / lens_.params().fx;
  sky_level_ = std::max(0, static_cast<int>(std::lround(std::log2(std::max(texels_per_pixel, 1.0)))));
}

const LightImage& Rasteriser::render(const Eigen::Isometry3d& T_world_camera) {
  T_world_camera_ = T_world_camera;
  R_world_camera_ = T_world_camera.linear().cast<float>();
  const Eigen::Isometry3d T_camera_world = T_world_camera.inverse();
  buffer_.clear();
  drawn_.clear();

  struct Turn {
    double distance;
    std::uint32_t piece;
  };
  std::vector<Turn> turns_to_draw;
  const auto to_camera = [&](const Piece& piece) {
    return piece.object ? T_camera_world * scene_.objects[*piece.object].T_world_object : T_camera_world;
  };
  for (std::uint32_t i = 0; i < pieces_.size(); ++i) {
    const Eigen::Vector3d centre = to_camera(pieces_[i]) * pieces_[i].centre;
    if (in_view(centre, pieces_[i].radius)) turns_to_draw.push_back({centre.norm() - pieces_[i].radius, i});
  }
  std::sort(turns_to_draw.begin(), turns_to_draw.end(), [](const Turn& a, const Turn& b) {
    return a.distance != b.distance ? a.distance < b.distance : a.piece < b.piece;
  });
  for (const Turn& turn : turns_to_draw) draw(turn.piece, to_camera(pieces_[turn.piece]));
  for (int y = 0; y < light_.height; ++y) light_row(y);
  return light_;
}

bool Rasteriser::in_view(const Eigen::Vector3d& centre, double radius) const {
  if (centre.z() + radius < params_.near_m || centre.norm() - radius > params_.far_m) return false;
  const Window& w = buffer_.window();
  const double right = w.left + w.width / w.pixels_per_unit, bottom = w.top + w.height / w.pixels_per_unit;
  const auto beyond = [&](double along, double slope, double sign) {
    return sign * (along - slope * centre.z()) > radius * std::sqrt(1.0 + slope * slope);
  };
  return !beyond(centre.x(), right, 1.0) && !beyond(centre.x(), w.left, -1.0) && !beyond(centre.y(), bottom, 1.0) &&
         !beyond(centre.y(), w.top, -1.0);
}

void Rasteriser::draw(std::uint32_t piece, const Eigen::Isometry3d& T_camera_mesh) {
  const Mesh& mesh = *pieces_[piece].mesh;
  const Window& w = buffer_.window();
  const std::size_t n = mesh.vertices.size();
  corners_.resize(n), outside_.resize(n), rounded_.resize(n);
  const double wide = w.width, high = w.height;
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Vector3d p = T_camera_mesh * mesh.vertices[i].position.cast<double>();
    corners_[i] = p;
    const double x = (p.x() - w.left * p.z()) * w.pixels_per_unit, y = (p.y() - w.top * p.z()) * w.pixels_per_unit;
    const auto side = [](bool beyond, int bit) { return beyond ? 1 << bit : 0; };
    outside_[i] = static_cast<std::uint8_t>(side(p.z() < params_.near_m, 0) | side(x < 0.0, 1) |
                                            side(x > wide * p.z(), 2) | side(y < 0.0, 3) | side(y > high * p.z(), 4));
    if (outside_[i] != 0) continue;
    const double scale = VisibilityBuffer::kSubpixels / p.z();
    rounded_[i] = {static_cast<std::int32_t>(x * scale + 0.5), static_cast<std::int32_t>(y * scale + 0.5)};
  }
  for (std::uint32_t i = 0; i < mesh.triangles.size(); ++i) draw_triangle(piece, i, mesh.bias);
}

void Rasteriser::draw_triangle(std::uint32_t piece, std::uint32_t triangle, float bias) {
  const Mesh& mesh = *pieces_[piece].mesh;
  const auto& [ia, ib, ic] = mesh.triangles[triangle];
  if ((outside_[ia] & outside_[ib] & outside_[ic]) != 0) return;
  const Eigen::Vector3d &a = corners_[ia], &b = corners_[ib], &c = corners_[ic];
  const Eigen::Vector3d normal = (b - a).cross(c - a);
  const double volume = normal.dot(a);
  if (!(volume < 0.0)) return;  // seen from behind, or edge-on

  std::array<VisibilityBuffer::Corner, kMostCorners> outline;
  int count = 3;
  if ((outside_[ia] | outside_[ib] | outside_[ic]) == 0) {
    outline[0] = rounded_[ia], outline[1] = rounded_[ib], outline[2] = rounded_[ic];
  } else {
    polygon_.assign({a, b, c});
    count = clip(polygon_);
    const Window& w = buffer_.window();
    for (std::size_t i = 0; i < static_cast<std::size_t>(count); ++i) {
      const Eigen::Vector2d pixel = w.pixel_of(polygon_[i].head<2>() / polygon_[i].z());
      const Eigen::Array2d in = pixel.array().max(0.0).min(Eigen::Array2d(w.width, w.height));
      outline[i] = (in * VisibilityBuffer::kSubpixels + 0.5).cast<std::int32_t>();
    }
  }
  // The depth of a decal is that of its plane moved towards the camera, but never to more than half the distance.
  const Eigen::Vector3d inverse_depth = normal / volume;
  const double length = normal.norm(), distance = -volume / length;
  const double nearer = std::max(distance - static_cast<double>(bias), 0.5 * distance);
  if (!buffer_.draw(outline.data(), count, inverse_depth * (distance / nearer),
                    static_cast<std::uint32_t>(drawn_.size())))
    return;

  const Vertex &va = mesh.vertices[ia], &vb = mesh.vertices[ib], &vc = mesh.vertices[ic];
  const Eigen::Vector2f whole = va.uv.array().floor();  // repeats that do not matter, but cost digits
  const Eigen::Vector2d ta = (va.uv - whole).cast<double>(), tb = (vb.uv - whole).cast<double>(),
                        tc = (vc.uv - whole).cast<double>();
  const Eigen::Vector3d fa = b.cross(c) / volume, fb = c.cross(a) / volume, fc = a.cross(b) / volume;
  drawn_.push_back({inverse_depth, inverse_depth.cast<float>(), (fa * ta.x() + fb * tb.x() + fc * tc.x()).cast<float>(),
                    (fa * ta.y() + fb * tb.y() + fc * tc.y()).cast<float>(), &textures_[mesh.texture], mesh.shade,
                    piece, triangle});
}

/// Sutherland and Hodgman. Edges are cut from the inner corner to the outer one: neighbours cut theirs alike.
int Rasteriser::clip(std::vector<Eigen::Vector3d>& polygon) const {
  const Window& w = buffer_.window();
  const double right = w.left + w.width / w.pixels_per_unit, bottom = w.top + w.height / w.pixels_per_unit;
  const std::array<Eigen::Vector4d, 5> planes{Eigen::Vector4d(0, 0, 1, -params_.near_m),
                                              {1, 0, -w.left, 0},
                                              {-1, 0, right, 0},
                                              {0, 1, -w.top, 0},
                                              {0, -1, bottom, 0}};
  std::array<Eigen::Vector3d, kMostCorners> kept;
  for (const Eigen::Vector4d& plane : planes) {
    std::size_t count = 0;
    const auto inside = [&plane](const Eigen::Vector3d& p) { return plane.head<3>().dot(p) + plane.w(); };
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Eigen::Vector3d &p = polygon[i], &q = polygon[i + 1 < polygon.size() ? i + 1 : 0];
      const double dp = inside(p), dq = inside(q);
      if (dp >= 0.0) kept[count++] = p;
      if (dp >= 0.0 && dq < 0.0) kept[count++] = p + (q - p) * (dp / (dp - dq));
      if (dp < 0.0 && dq >= 0.0) kept[count++] = q + (p - q) * (dq / (dq - dp));
    }
    polygon.assign(kept.begin(), kept.begin() + static_cast<std::ptrdiff_t>(count));
    if (count < 3) return 0;
  }
  return static_cast<int>(polygon.size());
}

/// Runs of up to four pixels that see one triangle are lit together.
void Rasteriser::light_row(int y) {
  const std::uint32_t* corners = corner_.row(y);
  const std::uint32_t* ids = buffer_.ids();
  const std::size_t down = buffer_.stride();
  const auto sees_only = [&](int x, std::uint32_t id) {
    const std::uint32_t* at = ids + corners[x];
    return ((at[0] ^ id) | (at[1] ^ id) | (at[down] ^ id) | (at[down + 1] ^ id)) == 0;
  };
  float* out = light_.row(y);
  for (int x = 0; x < light_.width;) {
    const std::uint32_t id = ids[corners[x]];
    int count = 0;
    while (count < kRun && x + count < light_.width && sees_only(x + count, id)) ++count;
    if (count == 0) {
      out[x] = light_edge(x, y, corners[x]), ++x;
    } else {
      light(id, x, y, count, out + x), x += count;
    }
  }
}

/// A pixel that sees several triangles: each one's light by the share that it has of the pixel.
float Rasteriser::light_edge(int x, int y, std::uint32_t first_corner) const {
  const std::uint32_t* at = buffer_.ids() + first_corner;
  const std::array<std::uint32_t, 4> ids{at[0], at[1], at[buffer_.stride()], at[buffer_.stride() + 1]};
  const float r = static_cast<float>(right_.at(x, y)) / 255.0F, b = static_cast<float>(below_.at(x, y)) / 255.0F;
  std::array<float, 4> weights{(1 - r) * (1 - b), r * (1 - b), (1 - r) * b, r * b};
  float sum = 0.0F, one = 0.0F;
  for (std::size_t i = 0; i < 4; ++i) {
    if (weights[i] <= 0.0F) continue;
    for (std::size_t j = i + 1; j < 4; ++j)
      if (weights[j] > 0.0F && continuous(ids[i], ids[j], x, y)) weights[i] += weights[j], weights[j] = 0.0F;
    light(ids[i], x, y, 1, &one);
    sum += weights[i] * one;
  }
  return sum;
}

/// One triangle, or two of a mesh that meet here with one depth and one place on the texture.
bool Rasteriser::continuous(std::uint32_t a, std::uint32_t b, int x, int y) const {
  if (a == b) return true;
  if (a == VisibilityBuffer::kNothing || b == VisibilityBuffer::kNothing) return false;
  const Seen &one = drawn_[a], &other = drawn_[b];
  if (one.piece != other.piece) return false;
  const Eigen::Vector3f ray(ray_x_.at(x, y), ray_y_.at(x, y), 1.0F);
  const float w = one.w.dot(ray), v = other.w.dot(ray);
  if (!(std::abs(w - v) <= 0.005F * w)) return false;
  const auto apart = [&](const Eigen::Vector3f& f, const Eigen::Vector3f& g) {
    const float difference = f.dot(ray) / w - g.dot(ray) / v;
    return std::abs(difference - static_cast<float>(static_cast<int>(difference + (difference < 0 ? -0.5F : 0.5F))));
  };
  return apart(one.u, other.u) * static_cast<float>(one.texture->width()) < 2.0F &&
         apart(one.v, other.v) * static_cast<float>(one.texture->height()) < 2.0F;
}

void Rasteriser::light(std::uint32_t id, int x, int y, int count, float* out) const {
  const float *ray_x = ray_x_.row(y) + x, *ray_y = ray_y_.row(y) + x;
  if (id == VisibilityBuffer::kNothing) {
    for (int i = 0; i < count; ++i) out[i] = sky(ray_x[i], ray_y[i]);
    return;
  }
  const Seen& seen = drawn_[id];
  std::array<float, kRun> z, u, v;
  for (std::size_t i = 0; i < static_cast<std::size_t>(count); i += 4) {
    const Four px = load(ray_x + i), py = load(ray_y + i);
    const auto form = [&](const Eigen::Vector3f& f) { return f[0] * px + f[1] * py + f[2]; };
    const Four inverse_depth = form(seen.w), depth = 1.0F / (inverse_depth > kLeast ? inverse_depth : kLeast);
    store(z.data() + i, depth);
    store(u.data() + i, form(seen.u) * depth), store(v.data() + i, form(seen.v) * depth);
  }
  // The footprint of the run's middle pixel serves all of it.
  const auto m = static_cast<std::size_t>(count / 2);
  const int mx = x + count / 2, left = mx + 1 < light_.width ? mx : mx - 1, above = y + 1 < light_.height ? y : y - 1;
  const float x_x = ray_x_.at(left + 1, y) - ray_x_.at(left, y), y_x = ray_y_.at(left + 1, y) - ray_y_.at(left, y);
  const float x_y = ray_x_.at(mx, above + 1) - ray_x_.at(mx, above),
              y_y = ray_y_.at(mx, above + 1) - ray_y_.at(mx, above);
  const float ux = (seen.u[0] - u[m] * seen.w[0]) * z[m], uy = (seen.u[1] - u[m] * seen.w[1]) * z[m];
  const float vx = (seen.v[0] - v[m] * seen.w[0]) * z[m], vy = (seen.v[1] - v[m] * seen.w[1]) * z[m];
  const MipTexture::Taps taps = seen.texture->taps(
      {ux * x_x + uy * y_x, vx * x_x + vy * y_x, ux * x_y + uy * y_y, vx * x_y + vy * y_y}, params_.filter);
  MipTexture::sample(u.data(), v.data(), static_cast<std::size_t>(count), taps, out);
  for (int i = 0; i < count; ++i) out[i] *= seen.shade;
}

float Rasteriser::sky(float ray_x, float ray_y) const {
  const MipTexture& panorama = textures_[scene_.sky];
  const Eigen::Vector3f ray = R_world_camera_ * Eigen::Vector3f(ray_x, ray_y, 1.0F);
  const float level = std::sqrt(ray.x() * ray.x() + ray.y() * ray.y());
  const float from_zenith = 1.0F - 4.0F * turns(ray.z(), level);
  const float half = 0.5F / static_cast<float>(panorama.height() >> std::min(sky_level_, panorama.levels() - 1));
  return panorama.at_level(turns(ray.y(), ray.x()), std::clamp(from_zenith, half, 1.0F - half), sky_level_);
}

std::uint32_t Rasteriser::id_at(const Eigen::Vector2d& ray) const {
  const Window& w = buffer_.window();
  const Eigen::Vector2i pixel = w.pixel_of(ray).array().floor().cast<int>();
  const int x = std::clamp(pixel.x(), 0, w.width - 1), y = std::clamp(pixel.y(), 0, w.height - 1);
  return buffer_.ids()[buffer_.index(x, y)];
}

std::optional<Hit> Rasteriser::hit(double u, double v) const {
  if (!lens_.in_frame({u, v})) return std::nullopt;
  const Eigen::Vector2d ray = lens_.ray_of({u, v});
  const std::uint32_t id = id_at(ray);
  if (id == VisibilityBuffer::kNothing) return std::nullopt;
  const Seen& seen = drawn_[id];
  const Eigen::Vector3d along(ray.x(), ray.y(), 1.0);
  const Piece& piece = pieces_[seen.piece];
  return Hit{T_world_camera_ * (along / std::max(seen.inverse_depth.dot(along), 1e-4)), piece.mesh_index, seen.triangle,
             piece.object};
}

std::optional<Eigen::Vector3d> Rasteriser::world_point(double u, double v) const {
  const std::optional<Hit> there = hit(u, v);
  if (!there) return std::nullopt;
  return there->p_world;
}

float Rasteriser::depth(int x, int y) const {
  const Eigen::Vector3d along(ray_x_.at(x, y), ray_y_.at(x, y), 1.0);
  const std::uint32_t id = id_at(along.head<2>());
  if (id == VisibilityBuffer::kNothing) return 0.0F;
  return static_cast<float>(1.0 / std::max(drawn_[id].inverse_depth.dot(along), 1e-4));
}

std::optional<Eigen::Vector2d> Rasteriser::project(const Eigen::Vector3d& p_world) const {
  const auto pixel = lens_.pixel_of(T_world_camera_.inverse() * p_world);
  return pixel && lens_.in_frame(*pixel) ? pixel : std::nullopt;
}

bool Rasteriser::visible(const Eigen::Vector3d& p_world, double tolerance_m) const {
  if (!project(p_world)) return false;
  const Eigen::Vector3d p = T_world_camera_.inverse() * p_world, along = p / p.z();
  const std::uint32_t id = id_at(along.head<2>());
  return id == VisibilityBuffer::kNothing ||
         p.z() <= 1.0 / std::max(drawn_[id].inverse_depth.dot(along), 1e-4) + tolerance_m;
}

}  // namespace convoy::simulator
