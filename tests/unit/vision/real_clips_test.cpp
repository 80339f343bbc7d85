// Recordings, where they are on the machine: KITTI's street with true poses, and a desk seen by a hand-held camera.
#include <convoy/association/appearance.hpp>
#include <convoy/vision/active_search.hpp>
#include <convoy/vision/corner_detector.hpp>
#include <convoy/vision/kitti_sequence.hpp>
#include <convoy/vision/patch_descriptor.hpp>
#include <convoy/vision/patch_warp.hpp>

#include "../../support/data_folder.hpp"

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include <algorithm>
#include <fstream>
#include <numeric>

namespace convoy {
namespace {

std::vector<Corner> corners_of(const ImagePyramid& image) {
  CornerDetector detector(image.width(), image.height());
  std::vector<int> cells(static_cast<std::size_t>(detector.cells()));
  std::iota(cells.begin(), cells.end(), 0);
  return detector.detect(image, cells, {});
}

std::vector<ImagePyramid> pyramids_of(ImageSource& images, std::size_t count) {
  std::vector<ImagePyramid> pyramids;
  while (pyramids.size() < count) {
    const SourceImage image = images.next();
    if (image.status != SourceImage::Status::image) break;
    pyramids.emplace_back(images.width(), images.height());
    EXPECT_EQ(pyramids.back().set(image.grey), ImagePyramid::Status::ok);
  }
  EXPECT_EQ(pyramids.size(), count);
  return pyramids;
}

/// Between which two values 1 / distance lies. [1/m]
struct Inverse {
  double low = 0.01, high = 0.12;
};

class KittiStreet : public testing::Test {
 protected:
  void SetUp() override {
    const auto folder = test::data_folder() / "kitti_mini/seq1";
    if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder << " is not there (CONVOY_DATA_DIR)";
    KittiSequence sequence = open_kitti(folder);
    camera_.emplace(sequence.calibration);
    images_ = pyramids_of(*sequence.images, 51);
    std::ifstream in(folder / "poses.txt");
    for (std::size_t k = 0; k < images_.size(); ++k) {
      Eigen::Matrix<double, 3, 4, Eigen::RowMajor> T;
      for (int i = 0; i < 12; ++i) ASSERT_TRUE(in >> T.data()[i]);
      poses_.push_back(SE3::from_rotation(T.leftCols<3>(), T.col(3)));
    }
  }
  SE3 between(std::size_t now, std::size_t ref) const { return poses_[now].inverse() * poses_[ref]; }

  /// A corner whose distance is known to lie between two: the ellipse covers what both would look like.
  PatchSearchResult follow(const ReferencePatch& patch, std::size_t ref, std::size_t now, const Inverse& distance,
                           ActiveSearch& search) const {
    const SE3 T = between(now, ref);
    const auto far = warp_of_plane(*camera_, patch.pixel(), distance.low, T);
    const auto likely = warp_of_plane(*camera_, patch.pixel(), 0.5 * (distance.low + distance.high), T);
    const auto near = warp_of_plane(*camera_, patch.pixel(), distance.high, T);
    if (!near || !far || !likely) return {PatchSearchResult::Status::out_of_image};
    const Eigen::Vector2d half = 0.5 * (near->pixel - far->pixel);
    const Eigen::Matrix2d covariance = half * half.transpose() / 9.0 + Eigen::Matrix2d::Identity();
    return search.find(images_[now], patch, {far->pixel + half, covariance, likely->now_from_ref});
  }
  /// How far a pixel is from the epipolar line of another one. [px]
  double off_epipolar_line(const Eigen::Vector2d& pixel_ref, std::size_t ref, const Eigen::Vector2d& pixel_now,
                           std::size_t now) const {
    const SE3 T = between(now, ref);
    const auto a = camera_->project(T.rotation() * camera_->ray(pixel_ref));
    const auto b = camera_->project(T * (10.0 * camera_->ray(pixel_ref)));
    const Eigen::Vector2d along = (b->pixel - a->pixel).normalized(), off = pixel_now - a->pixel;
    return std::abs(along.x() * off.y() - along.y() * off.x());
  }
  /// In frame ref, from where it is seen in frame now; nothing if the parallax is below half a degree.
  std::optional<Eigen::Vector3d> triangulate(const Eigen::Vector2d& pixel_ref, std::size_t ref,
                                             const Eigen::Vector2d& pixel_now, std::size_t now) const {
    const SE3 T = between(ref, now);
    const Eigen::Vector3d a = camera_->ray(pixel_ref), b = T.rotation() * camera_->ray(pixel_now);
    if (a.cross(b).norm() < 0.009) return std::nullopt;
    Eigen::Matrix<double, 3, 2> rays;
    rays << a, -b;
    const Eigen::Vector2d lengths = rays.colPivHouseholderQr().solve(T.translation());
    if (lengths.minCoeff() <= 0.0) return std::nullopt;
    return lengths.x() * a;
  }

  /// A corner of frame k in frame k, by following it over four more; nothing if it is lost or what was seen does not
  /// agree.
  std::optional<Eigen::Vector3d> located(const ReferencePatch& patch, std::size_t k, ActiveSearch& search) const {
    Inverse distance;
    std::optional<Eigen::Vector3d> point;
    for (std::size_t now = k + 1; now <= k + 4; ++now) {
      const PatchSearchResult seen = follow(patch, k, now, distance, search);
      if (seen.status != PatchSearchResult::Status::found || off_epipolar_line(patch.pixel(), k, seen.pixel, now) > 1.0)
        return std::nullopt;
      point = triangulate(patch.pixel(), k, seen.pixel, now);
      if (!point) continue;
      const double middle = 1.0 / point->norm();
      distance = {std::max(0.005, 0.8 * middle), 1.25 * middle};
    }
    return point;
  }

  std::optional<CameraModel> camera_;
  std::vector<ImagePyramid> images_;
  std::vector<SE3> poses_;
};

TEST_F(KittiStreet, MatchesLieOnTheEpipolarLines) {
  ActiveSearch search;
  std::vector<double> off_px;
  int tried = 0;
  for (std::size_t k = 0; k + 1 < images_.size(); k += 5)
    for (const Corner& corner : corners_of(images_[k])) {
      const auto patch = ReferencePatch::take(images_[k], corner.pixel);
      if (!patch || search.judge(*patch) != PatchSearchResult::Status::found) continue;
      const PatchSearchResult result = follow(*patch, k, k + 1, {}, search);
      tried += result.status != PatchSearchResult::Status::out_of_image;
      if (result.status == PatchSearchResult::Status::found)
        off_px.push_back(off_epipolar_line(corner.pixel, k, result.pixel, k + 1));
    }
  ASSERT_GT(off_px.size(), 100U);
  std::sort(off_px.begin(), off_px.end());
  const double median = off_px[off_px.size() / 2];
  const auto within =
      static_cast<double>(std::count_if(off_px.begin(), off_px.end(), [](double d) { return d < 1.0; }));
  const double share = within / static_cast<double>(off_px.size());
  std::printf("%zu of %d corners found a frame later; off the epipolar line: median %.2f px, %.0f %% within 1 px\n",
              off_px.size(), tried, median, 100.0 * share);
  EXPECT_GE(static_cast<double>(off_px.size()),
            0.6 * tried);  // the road, seen along it, is no plane that faces the camera
  EXPECT_LT(median, 0.4);
  EXPECT_GT(share, 0.85);
}

struct DescribedPair {
  Descriptor before, later;
  double scale;
  Eigen::Vector3d place;
};

/// Points that were followed over four frames, as they look at first and `gap` frames later.
TEST_F(KittiStreet, DescriptorsTellTruePairsEightFramesApart) {
  constexpr std::size_t gap = 8;
  const double focal_px = camera_->calibration().fx;
  std::vector<DescribedPair> pairs;
  ActiveSearch search;
  for (std::size_t k = 0; k + gap < images_.size(); k += 3)
    for (const Corner& corner : corners_of(images_[k])) {
      const auto patch = ReferencePatch::take(images_[k], corner.pixel);
      if (!patch) continue;
      const auto point = located(*patch, k, search);
      if (!point) continue;
      const Eigen::Vector3d later = between(k + gap, k) * *point;
      const auto seen = camera_->project(later);
      if (!seen) continue;
      const auto a = describe(images_[k], corner.pixel, point->z(), focal_px);
      const auto b = describe(images_[k + gap], seen->pixel, later.z(), focal_px);
      if (a.status == DescriptorResult::Status::made && b.status == DescriptorResult::Status::made)
        pairs.push_back({a.descriptor, b.descriptor, point->z() / later.z(), poses_[k] * *point});
    }
  ASSERT_GT(pairs.size(), 50U);
  std::vector<double> right, wrong, scales;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    scales.push_back(pairs[i].scale);
    for (std::size_t j = 0; j < pairs.size(); ++j)
      if (i == j || (pairs[i].place - pairs[j].place).norm() > 1.0)  // one thing may be there twice
        (i == j ? right : wrong).push_back(similarity(pairs[i].before, pairs[j].later).value_or(-1.0));
  }
  std::sort(wrong.rbegin(), wrong.rend());
  std::sort(scales.begin(), scales.end());
  const auto above = [&](double share) {
    const double threshold = wrong[static_cast<std::size_t>(share * static_cast<double>(wrong.size()))];
    const auto count = std::count_if(right.begin(), right.end(), [&](double s) { return s > threshold; });
    return static_cast<double>(count) / static_cast<double>(right.size());
  };
  std::printf(
      "%zu pairs, scale %.2f (median): true ones above 10 %% / 1 %% of the false: %.2f / %.2f; thresholds %.2f / "
      "%.2f\n",
      pairs.size(), scales[scales.size() / 2], above(0.1), above(0.01), wrong[wrong.size() / 10],
      wrong[wrong.size() / 100]);
  EXPECT_GE(above(0.1), 0.85);
  EXPECT_GE(above(0.01), 0.55);
}

TEST(Desk, WhatIsFoundInTheNextFrameIsFoundBack) {
  const auto folder = test::data_folder() / "monoslam_seq/png";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder << " is not there (CONVOY_DATA_DIR)";
  const auto images = open_image_folder(folder, {30.0, {}});
  const std::vector<ImagePyramid> frames = pyramids_of(*images, 101);
  const Eigen::Matrix2d covariance = 36.0 * Eigen::Matrix2d::Identity(), same = Eigen::Matrix2d::Identity();
  ActiveSearch search;
  int tried = 0, found = 0, back = 0;
  for (std::size_t k = 0; k + 1 < frames.size(); k += 10)
    for (const Corner& corner : corners_of(frames[k])) {
      const auto patch = ReferencePatch::take(frames[k], corner.pixel);
      if (!patch || search.judge(*patch) != PatchSearchResult::Status::found) continue;
      ++tried;
      const PatchSearchResult there = search.find(frames[k + 1], *patch, {corner.pixel, covariance, same});
      if (there.status != PatchSearchResult::Status::found) continue;
      ++found;
      const auto again = ReferencePatch::take(frames[k + 1], there.pixel);
      if (!again) continue;
      const PatchSearchResult here = search.find(frames[k], *again, {there.pixel, covariance, same});
      back += here.status == PatchSearchResult::Status::found && (here.pixel - corner.pixel).norm() < 0.5;
    }
  std::printf("desk: %d corners, %d found in the next frame, %d of them found back within 0.5 px\n", tried, found,
              back);
  ASSERT_GT(tried, 100);
  EXPECT_GE(found, 0.8 * tried);
  EXPECT_GE(back, 0.85 * found);
}

}  // namespace
}  // namespace convoy
