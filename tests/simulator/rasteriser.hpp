// A scene as light on a lens's pixels, and for each of them where in the world it came from.
#pragma once

#include "image.hpp"
#include "lens.hpp"
#include "mip_texture.hpp"
#include "scene.hpp"
#include "visibility.hpp"

#include <Eigen/Geometry>

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace convoy::simulator {

struct RasteriserParams {
  Filter filter;
  double near_m = 0.1;        ///< nothing is nearer than that, > 0
  double far_m = 400.0;       ///< meshes beyond are passed over, > near_m
  double oversampling = 1.5;  ///< pixels in which visibility is found per frame pixel, each way; 0.5 to 3
  std::optional<std::uint32_t> hidden_object;  ///< is not drawn: what the camera is in

  /// Throws std::invalid_argument that says what is wrong and how to mend it.
  void validate() const;
};

/// What is seen at a place of the frame.
struct Hit {
  Eigen::Vector3d p_world;
  std::uint32_t mesh = 0;               ///< index in Scene::meshes or Object::meshes
  std::uint32_t triangle = 0;           ///< index in Mesh::triangles
  std::optional<std::uint32_t> object;  ///< index in Scene::objects; none: it stands still
};

/// Each polygon is first marked in a visibility buffer, somewhat finer than the frame and without the lens's
/// distortion; each pixel of the frame is then lit once, along its own ray, by the texture of what is seen there. A
/// decal (Mesh::bias) is drawn as if its plane were so much nearer to the camera; where it is seen, it lies where it
/// is. The sky's u is atan2(north, east) / 2 pi. One rasteriser per thread.
class Rasteriser {
 public:
  /// The scene must outlive it; meshes and textures must not change, T_world_object may. Throws std::invalid_argument
  /// on meshes that name textures or vertices that are not there, or coordinates that are not finite.
  /// `textures`: the scene's, if others have them already.
  Rasteriser(const Scene& scene, const Lens& lens, const RasteriserParams& params = {},
             std::shared_ptr<const std::vector<MipTexture>> textures = nullptr);

  /// What follows is of the last pose rendered.
  const LightImage& render(const Eigen::Isometry3d& T_world_camera);

  const LightImage& light() const { return light_; }
  const Lens& lens() const { return lens_; }
  /// What is at a place of the frame [px], from the plane of the triangle seen there; none: sky, or not in the frame.
  std::optional<Hit> hit(double u, double v) const;
  std::optional<Eigen::Vector3d> world_point(double u, double v) const;
  /// How far away along the camera's z is what a pixel shows [m]; 0: the sky. The same as by world_point(), but sooner.
  float depth(int x, int y) const;
  /// Where a world point is in the frame [px], be it hidden or not; none: outside the frame.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& p_world) const;
  /// In the frame with nothing more than tolerance_m in front of it.
  bool visible(const Eigen::Vector3d& p_world, double tolerance_m = 0.05) const;
  /// Triangles of which a pixel was drawn, before others hid it.
  std::size_t drawn_triangles() const { return drawn_.size(); }

 private:
  struct Piece {  ///< a mesh and what encloses it, in the mesh's frame
    const Mesh* mesh;
    std::uint32_t mesh_index;
    std::optional<std::uint32_t> object;
    Eigen::Vector3d centre;
    double radius;
  };
  struct Seen {  ///< a triangle: linear forms of the ray, 1/z and texture coordinates / z
    Eigen::Vector3d inverse_depth;
    Eigen::Vector3f w, u, v;
    const MipTexture* texture;
    float shade;
    std::uint32_t piece, triangle;
  };

  void add_piece(const Mesh& mesh, std::uint32_t index, std::optional<std::uint32_t> object);
  void lay_out_pixels();
  bool in_view(const Eigen::Vector3d& centre, double radius) const;
  void draw(std::uint32_t piece, const Eigen::Isometry3d& T_camera_mesh);
  void draw_triangle(std::uint32_t piece, std::uint32_t triangle, float bias);
  int clip(std::vector<Eigen::Vector3d>& polygon) const;
  void light_row(int y);
  float light_edge(int x, int y, std::uint32_t first_corner) const;
  bool continuous(std::uint32_t a, std::uint32_t b, int x, int y) const;
  void light(std::uint32_t id, int x, int y, int count, float* out) const;
  float sky(float ray_x, float ray_y) const;
  std::uint32_t id_at(const Eigen::Vector2d& ray) const;

  const Scene& scene_;
  Lens lens_;
  RasteriserParams params_;
  std::shared_ptr<const std::vector<MipTexture>> shared_textures_;
  const std::vector<MipTexture>& textures_;
  std::vector<Piece> pieces_;
  VisibilityBuffer buffer_;
  Image<float> ray_x_, ray_y_;         ///< where a frame pixel's ray meets the plane z = 1; a row more, for fours
  Image<std::uint32_t> corner_;        ///< the upper left one of four visibility pixels around it
  Image<std::uint8_t> right_, below_;  ///< weights of the right and lower ones, of 255
  LightImage light_;
  int sky_level_ = 0;

  Eigen::Isometry3d T_world_camera_ = Eigen::Isometry3d::Identity();
  Eigen::Matrix3f R_world_camera_ = Eigen::Matrix3f::Identity();
  std::vector<Seen> drawn_;
  std::vector<Eigen::Vector3d> corners_;           ///< of the mesh being drawn, camera frame
  std::vector<std::uint8_t> outside_;              ///< sides of the window a corner is beyond
  std::vector<VisibilityBuffer::Corner> rounded_;  ///< corners in the window
  std::vector<Eigen::Vector3d> polygon_, clipped_;
};

}  // namespace convoy::simulator
