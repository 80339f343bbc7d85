#include "feature_statistics.hpp"

#include "random.hpp"

#include <opencv2/imgproc.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace convoy::simulator {
namespace {

constexpr int kHalf = 5, kSurroundings = 32;  // [px]
constexpr std::uint32_t kPredictionStream = 0x40000;
using Patch = std::array<float, (2 * kHalf + 1) * (2 * kHalf + 1)>;

bool has_patch(const GreyImage& image, int x, int y) {
  return x >= kHalf && y >= kHalf && x < image.width - kHalf && y < image.height - kHalf;
}

/// Mean 0 and norm 1; zero where all is of one grey.
Patch normalised(Patch patch) {
  float sum = 0.0F, squares = 0.0F;
  for (const float value : patch) sum += value;
  for (float& value : patch) value -= sum / static_cast<float>(patch.size()), squares += value * value;
  for (float& value : patch) value *= squares > 1.0F ? 1.0F / std::sqrt(squares) : 0.0F;
  return patch;
}

Patch patch_at(const GreyImage& image, int x, int y) {
  Patch patch;
  std::size_t i = 0;
  for (int dy = -kHalf; dy <= kHalf; ++dy)
    for (int dx = -kHalf; dx <= kHalf; ++dx) patch[i++] = image.at(x + dx, y + dy);
  return normalised(patch);
}

/// What is kept of a frame about a patch's middle, to warp it; beyond the frame: its border.
GreyImage surroundings(const GreyImage& image, const Eigen::Vector2i& pixel) {
  GreyImage part(2 * kSurroundings + 1, 2 * kSurroundings + 1);
  for (int y = 0; y < part.height; ++y)
    for (int x = 0; x < part.width; ++x)
      part.at(x, y) = image.at(std::clamp(pixel.x() + x - kSurroundings, 0, image.width - 1),
                               std::clamp(pixel.y() + y - kSurroundings, 0, image.height - 1));
  return part;
}

/// The patch whose pixel (dx, dy) is the mean about `to_part` (dx, dy) from the middle; none: it is larger than that.
std::optional<Patch> warped(const GreyImage& part, const Eigen::Matrix2d& to_part) {
  const Eigen::Vector2d reach = to_part.cwiseAbs() * Eigen::Vector2d::Constant(kHalf + 0.5);
  if (!(reach.maxCoeff() < kSurroundings - 1)) return std::nullopt;
  Patch patch{};
  std::size_t i = 0;
  for (int dy = -kHalf; dy <= kHalf; ++dy)
    for (int dx = -kHalf; dx <= kHalf; ++dx, ++i)
      for (const double below : {-0.25, 0.25})
        for (const double beside : {-0.25, 0.25}) {
          const Eigen::Vector2d at =
              to_part * Eigen::Vector2d(dx + beside, dy + below) + Eigen::Vector2d::Constant(kSurroundings);
          const int x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
          const double r = at.x() - x, b = at.y() - y;
          patch[i] += static_cast<float>((part.at(x, y) * (1 - r) + part.at(x + 1, y) * r) * (1 - b) +
                                         (part.at(x, y + 1) * (1 - r) + part.at(x + 1, y + 1) * r) * b);
        }
  return normalised(patch);
}

double zncc(const Patch& a, const Patch& b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += static_cast<double>(a[i] * b[i]);
  return sum;
}

struct Match {
  int x = 0, y = 0;
  double score = -1.0;
};

Match search(const GreyImage& image, const Patch& patch, const Eigen::Vector2d& about, int reach) {
  Match best;
  const int cx = static_cast<int>(std::lround(about.x())), cy = static_cast<int>(std::lround(about.y()));
  for (int y = cy - reach; y <= cy + reach; ++y)
    for (int x = cx - reach; x <= cx + reach; ++x) {
      if (!has_patch(image, x, y)) continue;
      const double score = zncc(patch, patch_at(image, x, y));
      if (score > best.score) best = {x, y, score};
    }
  return best;
}

struct Mapped {
  Patch patch;
  Eigen::Vector3d p_world;
  std::size_t frame;
  GreyImage part;                    // of the frame, about it
  Eigen::Isometry3d T_world_camera;  // of that frame
  Eigen::Vector3d normal;            // of its surface
  bool seen = false;
  std::array<bool, kWarps> found{};
};

struct Track {
  Patch patch;
  Eigen::Vector3d p_world;
  Eigen::Vector2d pixel;
  std::size_t length = 1, missed = 0;
};

class Measurement {
 public:
  Measurement(const Scene& scene, const CameraParams& camera, const FeatureParams& params)
      : scene_(scene), camera_params_(camera), params_(params), stream_({camera.seed, 0, kPredictionStream, 0}) {}

  FeatureStatistics run(const std::vector<Eigen::Isometry3d>& poses) {
    first_drive(poses);
    second_drive(poses);
    FeatureStatistics& s = statistics_;
    s.frames = poses.size(), s.tracks = lengths_.size();
    std::sort(lengths_.begin(), lengths_.end());
    const auto quantile = [this](double share) {
      return lengths_.empty()
                 ? 0.0
                 : static_cast<double>(
                       lengths_[static_cast<std::size_t>(share * static_cast<double>(lengths_.size() - 1))]);
    };
    s.median_track = quantile(0.5), s.p95_track = quantile(0.95);
    const auto share = [](std::size_t part, std::size_t of) {
      return of == 0 ? 0.0 : static_cast<double>(part) / static_cast<double>(of);
    };
    s.good_matches = share(good_, s.matches), s.wrong_pairs = share(wrong_, s.pairs);
    std::array<std::size_t, kWarps> found{};
    for (const Mapped& patch : mapped_) {
      s.mapped += patch.seen;
      for (std::size_t warp = 0; warp < kWarps; ++warp) found[warp] += patch.found[warp];
    }
    for (std::size_t warp = 0; warp < kWarps; ++warp) s.found_by_second[warp] = share(found[warp], s.mapped);
    return s;
  }

 private:
  void first_drive(const std::vector<Eigen::Isometry3d>& poses) {
    Camera camera(scene_, camera_params_);
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const auto frame = camera.take(poses[i], static_cast<std::uint32_t>(i));
      if (!frame) continue;
      std::erase_if(tracks_, [&](Track& track) {
        const std::size_t before = track.length;
        const bool lost = !follow(track, frame->image, camera.truth());
        if (track.length > before && track.length == params_.mapped_after) map(track, *frame, camera.truth(), i);
        if (lost) lengths_.push_back(track.length);
        return lost;
      });
      add_corners(frame->image, camera.truth());
      compare_pairs();
    }
    for (const Track& track : tracks_) lengths_.push_back(track.length);
  }

  bool follow(Track& track, const GreyImage& image, const Rasteriser& truth) {
    const auto exact = truth.project(track.p_world);
    if (!exact || !has_patch(image, static_cast<int>(exact->x()), static_cast<int>(exact->y()))) return false;
    const Match match = search(image, track.patch, predicted(*exact), params_.search_px);
    track.pixel = *exact;
    if (match.score < params_.accept) return ++track.missed <= params_.misses;
    ++statistics_.matches;
    if ((Eigen::Vector2d(match.x, match.y) - *exact).norm() > params_.good_px) return ++track.missed <= params_.misses;
    ++good_, ++track.length, track.missed = 0;
    // Each new patch is up to half a pixel beside the corner: the old one stays while it is good.
    if (match.score < params_.renew) track.patch = patch_at(image, match.x, match.y);
    track.pixel = {match.x, match.y};
    return true;
  }

  void map(const Track& track, const Frame& frame, const Rasteriser& truth, std::size_t index) {
    const Eigen::Vector2i pixel = track.pixel.cast<int>();
    const auto hit = truth.hit(pixel.x(), pixel.y());
    if (!hit) return;
    mapped_.push_back({patch_at(frame.image, pixel.x(), pixel.y()), hit->p_world, index,
                       surroundings(frame.image, pixel), frame.T_world_camera, normal(*hit)});
  }

  Eigen::Vector3d normal(const Hit& hit) const {
    const Mesh& mesh = hit.object ? scene_.objects[*hit.object].meshes[hit.mesh] : scene_.meshes[hit.mesh];
    const auto corner = [&](std::size_t i) -> Eigen::Vector3d {
      return mesh.vertices[mesh.triangles[hit.triangle][i]].position.cast<double>();
    };
    const Eigen::Vector3d n = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
    return hit.object ? scene_.objects[*hit.object].T_world_object.linear() * n : n;
  }

  void add_corners(const GreyImage& image, const Rasteriser& truth) {
    if (tracks_.size() >= params_.tracks) return;
    const cv::Mat grey(image.height, image.width, CV_8U, const_cast<std::uint8_t*>(image.row(0)));
    cv::Mat free(grey.size(), CV_8U, cv::Scalar(255));
    for (const Track& track : tracks_)
      cv::circle(free, {static_cast<int>(track.pixel.x()), static_cast<int>(track.pixel.y())}, 15, cv::Scalar(0),
                 cv::FILLED);
    std::vector<cv::Point2f> corners;
    cv::goodFeaturesToTrack(grey, corners, static_cast<int>(params_.tracks - tracks_.size()), 0.01, 15.0, free);
    for (const cv::Point2f& corner : corners) {
      const int x = static_cast<int>(std::lround(corner.x)), y = static_cast<int>(std::lround(corner.y));
      const auto p_world = truth.world_point(x, y);
      if (!p_world || !has_patch(image, x, y)) continue;
      tracks_.push_back({patch_at(image, x, y), *p_world, {x, y}});
    }
  }

  /// Each patch against a random other one of the frame.
  void compare_pairs() {
    const auto n = static_cast<std::uint32_t>(tracks_.size());
    for (std::uint32_t i = 0; i < n && n > 1; ++i) {
      const std::uint32_t other = (i + 1 + stream_.below(n - 1)) % n;
      ++statistics_.pairs;
      wrong_ += zncc(tracks_[i].patch, tracks_[other].patch) > params_.accept;
    }
  }

  void second_drive(const std::vector<Eigen::Isometry3d>& poses) {
    CameraParams params = camera_params_;
    params.vehicle += 1;
    Camera camera(scene_, params);
    for (std::size_t i = 0; i < poses.size(); ++i) {
      const Eigen::Isometry3d beside = poses[i] * Eigen::Translation3d(0.0, params_.second_left_m, 0.0);
      const auto frame = camera.take(beside, static_cast<std::uint32_t>(i));
      if (!frame) continue;
      for (Mapped& patch : mapped_) {
        if (patch.found == std::array{true, true, true} || patch.frame > i + params_.second_reach ||
            i > patch.frame + params_.second_reach)
          continue;
        const auto exact = camera.truth().project(patch.p_world);
        if (!exact || !has_patch(frame->image, static_cast<int>(exact->x()), static_cast<int>(exact->y())) ||
            !camera.truth().visible(patch.p_world, 0.3))
          continue;
        patch.seen = true;
        look_for(patch, *frame, *exact, camera.truth().lens());
      }
    }
  }

  void look_for(Mapped& patch, const Frame& frame, const Eigen::Vector2d& exact, const Lens& lens) {
    const Eigen::Vector2d about = predicted(exact);
    const Eigen::Vector3d facing = (patch.p_world - patch.T_world_camera.translation()).normalized();
    const std::array<std::optional<Patch>, kWarps> expected{patch.patch, warped_for(patch, facing, frame, exact, lens),
                                                            warped_for(patch, patch.normal, frame, exact, lens)};
    for (std::size_t warp = 0; warp < kWarps; ++warp) {
      if (patch.found[warp] || !expected[warp]) continue;
      const Match match = search(frame.image, *expected[warp], about, params_.search_px);
      patch.found[warp] =
          match.score >= params_.accept && (Eigen::Vector2d(match.x, match.y) - exact).norm() <= params_.good_px;
    }
  }

  /// By how pixels beside `exact`, seen on the patch's plane, move in the frame it was mapped in.
  static std::optional<Patch> warped_for(const Mapped& patch, const Eigen::Vector3d& normal, const Frame& frame,
                                         const Eigen::Vector2d& exact, const Lens& lens) {
    const Eigen::Vector3d from = frame.T_world_camera.translation();
    Eigen::Matrix2d to_part;
    for (int axis = 0; axis < 2; ++axis) {
      std::array<Eigen::Vector2d, 2> ends;
      for (const int end : {0, 1}) {
        const Eigen::Vector2d ray = lens.ray_of(exact + (end - 0.5) * Eigen::Vector2d::Unit(axis));
        const Eigen::Vector3d along = frame.T_world_camera.linear() * ray.homogeneous();
        const double depth = normal.dot(patch.p_world - from) / normal.dot(along);
        if (!(depth > 0.0)) return std::nullopt;
        const auto pixel = lens.pixel_of(patch.T_world_camera.inverse() * (from + depth * along));
        if (!pixel) return std::nullopt;
        ends[static_cast<std::size_t>(end)] = *pixel;
      }
      to_part.col(axis) = ends[1] - ends[0];
    }
    return warped(patch.part, to_part);
  }

  Eigen::Vector2d predicted(const Eigen::Vector2d& exact) {
    const double x = stream_.gaussian(), y = stream_.gaussian();
    return exact + params_.prediction_px * Eigen::Vector2d(x, y);
  }

  const Scene& scene_;
  CameraParams camera_params_;
  FeatureParams params_;
  Stream stream_;
  std::vector<Track> tracks_;
  std::vector<Mapped> mapped_;
  std::vector<std::size_t> lengths_;
  std::size_t good_ = 0, wrong_ = 0;
  FeatureStatistics statistics_;
};

}  // namespace

FeatureStatistics feature_statistics(const Scene& scene, const CameraParams& camera,
                                     const std::vector<Eigen::Isometry3d>& T_world_body, const FeatureParams& params) {
  return Measurement(scene, camera, params).run(T_world_body);
}

}  // namespace convoy::simulator
