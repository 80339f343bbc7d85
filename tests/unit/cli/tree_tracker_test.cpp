#include "scenario/tree_tracker.hpp"

#include <gtest/gtest.h>

#include <numeric>
#include <set>

namespace convoy::cli {
namespace {

using Points = std::vector<Eigen::Vector2d>;  // local frame

/// A vehicle that drives along x at 2 m/s, five scans per second.
class Drive {
 public:
  void see(const Points& local, double wait_s = 0.2) {
    const double t_s = scans_.empty() ? 0.0 : scans_.back().t_s + wait_s;
    const SE2 T_local_body(2.0 * t_s, 0.0, 0.1 * t_s);
    TreeScan scan{t_s, T_local_body, 2.0 * t_s, {}};
    for (const Eigen::Vector2d& p : local) scan.points_m.push_back(T_local_body.inverse() * p);
    scans_.push_back(scan);
  }
  TreeTracks tracks() const { return follow_trees(scans_); }
  std::set<std::uint32_t> names(const TreeTracks& tracks) const {
    std::set<std::uint32_t> names;
    for (const auto& scan : tracks.track_of) names.insert(scan.begin(), scan.end());
    return names;
  }

 private:
  std::vector<TreeScan> scans_;
};

TEST(TreeTracker, FollowsWhatStaysInPlace) {
  Drive drive;
  for (int i = 0; i < 20; ++i)
    drive.see(i % 2 == 0 ? Points{{20.0, 5.0}, {15.0, -6.0}} : Points{{15.1, -6.1}, {20.0, 5.1}});
  const TreeTracks tracks = drive.tracks();
  EXPECT_EQ(tracks.tracks, 2U);
  for (std::size_t i = 0; i < 20; ++i)
    EXPECT_EQ(tracks.track_of[i], (i % 2 == 0 ? std::vector<std::uint32_t>{1, 2} : std::vector<std::uint32_t>{2, 1}));
  EXPECT_EQ(tracks.unsure + tracks.seldom + tracks.moving, 0U);
}

TEST(TreeTracker, ATreeThatWasOutOfSightGetsANewName) {
  Drive drive;
  for (int i = 0; i < 10; ++i) drive.see({{20.0, 5.0}});
  drive.see({{20.0, 5.0}}, 2.5);
  for (int i = 0; i < 10; ++i) drive.see({{20.0, 5.0}});
  const TreeTracks tracks = drive.tracks();
  EXPECT_EQ(tracks.tracks, 2U);
  EXPECT_EQ(tracks.track_of.front().front(), 1U);
  EXPECT_EQ(tracks.track_of.back().front(), 2U);
}

TEST(TreeTracker, ShortSightIsNoNewName) {
  Drive drive;
  for (int i = 0; i < 10; ++i) drive.see({{20.0, 5.0}});
  for (int i = 0; i < 3; ++i) drive.see({});
  for (int i = 0; i < 10; ++i) drive.see({{20.0, 5.0}});
  EXPECT_EQ(drive.tracks().tracks, 1U);
}

TEST(TreeTracker, SaysNothingOfTreesThatStandTooClose) {
  Drive drive;
  for (int i = 0; i < 10; ++i) drive.see({{20.0, 5.0}});
  for (int i = 0; i < 10; ++i) drive.see({{20.0, 5.0}, {21.0, 5.0}});
  const TreeTracks tracks = drive.tracks();
  EXPECT_EQ(tracks.tracks, 1U);
  EXPECT_EQ(tracks.unsure, 20U);
  for (std::size_t i = 10; i < 20; ++i) EXPECT_EQ(tracks.track_of[i], std::vector<std::uint32_t>(2, TreeTracks::none));
}

TEST(TreeTracker, DropsClutterAndCars) {
  Drive drive;
  for (int i = 0; i < 30; ++i) {
    Points points{{40.0, 8.0}, {30.0 - 0.15 * i, -4.0}, {50.0 - 2.5 * i, -15.0}};  // tree, cars
    if (i < 5) points.emplace_back(25.0, 12.0);
    drive.see(points);
  }
  const TreeTracks tracks = drive.tracks();
  EXPECT_EQ(tracks.tracks, 1U);
  EXPECT_EQ(tracks.seldom, 5U + 30U);  // the fast car is lost again and again
  EXPECT_EQ(tracks.moving_tracks, 1U);
  EXPECT_EQ(tracks.moving, 30U);
  EXPECT_EQ(drive.names(tracks), (std::set<std::uint32_t>{TreeTracks::none, 1}));
}

}  // namespace
}  // namespace convoy::cli
