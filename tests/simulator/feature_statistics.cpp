#include "feature_statistics.hpp"

#include "random.hpp"

#include <opencv2/imgproc.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace convoy::simulator {
namespace {

constexpr int kHalf = 5;
constexpr std::uint32_t kPredictionStream = 0x40000;
using Patch = std::array<float, (2 * kHalf + 1) * (2 * kHalf + 1)>;

bool has_patch(const GreyImage& image, int x, int y) {
  return x >= kHalf && y >= kHalf && x < image.width - kHalf && y < image.height - kHalf;
}

/// Mean 0 and norm 1; zero where all is of one grey.
Patch patch_at(const GreyImage& image, int x, int y) {
  Patch patch;
  std::size_t i = 0;
  float sum = 0.0F, squares = 0.0F;
  for (int dy = -kHalf; dy <= kHalf; ++dy)
    for (int dx = -kHalf; dx <= kHalf; ++dx) sum += patch[i++] = image.at(x + dx, y + dy);
  for (float& value : patch) value -= sum / static_cast<float>(patch.size()), squares += value * value;
  for (float& value : patch) value *= squares > 1.0F ? 1.0F / std::sqrt(squares) : 0.0F;
  return patch;
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
  bool seen = false, found = false;
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
    std::size_t found = 0;
    for (const Mapped& patch : mapped_) s.mapped += patch.seen, found += patch.found;
    s.found_by_second = share(found, s.mapped);
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
        if (track.length > before && track.length == params_.mapped_after) map(track, frame->image, camera.truth(), i);
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

  void map(const Track& track, const GreyImage& image, const Rasteriser& truth, std::size_t frame) {
    const Eigen::Vector2i pixel = track.pixel.cast<int>();
    if (const auto p_world = truth.world_point(pixel.x(), pixel.y()))
      mapped_.push_back({patch_at(image, pixel.x(), pixel.y()), *p_world, frame});
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
        if (patch.found || patch.frame > i + params_.second_reach || i > patch.frame + params_.second_reach) continue;
        const auto exact = camera.truth().project(patch.p_world);
        if (!exact || !has_patch(frame->image, static_cast<int>(exact->x()), static_cast<int>(exact->y())) ||
            !camera.truth().visible(patch.p_world, 0.3))
          continue;
        patch.seen = true;
        const Match match = search(frame->image, patch.patch, predicted(*exact), params_.search_px);
        patch.found =
            match.score >= params_.accept && (Eigen::Vector2d(match.x, match.y) - *exact).norm() <= params_.good_px;
      }
    }
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
