#include "replay/image_tracker.hpp"

#include <algorithm>
#include <chrono>

namespace convoy::cli {

namespace {

constexpr double sigma_px = 6.0;  // of where a feature goes from one image to the next, beside going on as before
constexpr int most_misses = 2;

}  // namespace

ImageTracker::ImageTracker(const MonocularSlamParams& params, int width, int height)
    : params_(params), pyramid_(width, height), search_(params.search), corners_(width, height, params.corners) {
  validate(params, width, height);
}

ImageReport ImageTracker::follow(double stamp_s, const cv::Mat& grey) {
  const auto began = std::chrono::steady_clock::now();
  ImageReport report;
  report.stamp_s = stamp_s;
  if (pyramid_.set(grey) != ImagePyramid::Status::ok) return report;
  seek(report);
  start(report);
  report.took_ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - began).count();
  return report;
}

void ImageTracker::seek(ImageReport& report) {
  for (auto it = tracks_.begin(); it != tracks_.end();) {
    Track& track = it->second;
    const PatchPrediction expected{track.pixel + track.velocity_px, sigma_px * sigma_px * Eigen::Matrix2d::Identity(),
                                   Eigen::Matrix2d::Identity()};
    ++report.sought;
    const PatchMatch result = search_.find(pyramid_, track.patch, expected);
    if (result.status == PatchMatch::Status::found) {
      track.velocity_px = result.pixel - track.pixel;
      track.pixel = result.pixel;
      track.misses = 0;
      report.features.push_back({it->first, result.pixel, result.score});
    } else if (++track.misses > most_misses) {
      it = tracks_.erase(it);
      continue;
    }
    ++it;
  }
}

void ImageTracker::start(ImageReport& report) {
  const int room = std::min(params_.features - static_cast<int>(tracks_.size()), params_.new_features);
  if (room <= 0) return;
  const auto most = static_cast<std::size_t>(room);
  for (const NewTrack& found : find_new_tracks(pyramid_, report.features, most, corners_, search_)) {
    tracks_.emplace(++last_track_, Track{found.patch, found.pixel});
    report.features.push_back({last_track_, found.pixel});
  }
}

}  // namespace convoy::cli
