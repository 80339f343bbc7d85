#include "scenario/tree_tracker.hpp"

#include <algorithm>
#include <iterator>
#include <limits>

namespace convoy::cli {
namespace {

constexpr double following = 0.2;  // share of a new sighting in the place of an old track: dead reckoning drifts

struct Sighting {
  std::size_t scan = 0, point = 0;
  double t_s = 0.0;
  Eigen::Vector2d place_m = Eigen::Vector2d::Zero();  // local frame; in a track: that of the track from then on
};

struct Track {
  std::vector<Sighting> sightings;
  Eigen::Vector2d place_m = Eigen::Vector2d::Zero();  // local frame, lately
  double driven_m = 0.0;                              // when last seen

  void see(const Sighting& sighting, double at_driven_m) {
    sightings.push_back(sighting);
    place_m += std::max(following, 1.0 / static_cast<double>(sightings.size())) * (sighting.place_m - place_m);
    sightings.back().place_m = place_m;
    driven_m = at_driven_m;
  }
  std::size_t scans() const { return sightings.back().scan - sightings.front().scan + 1; }
};

/// The nearest of some places, and how far away it and the next one are.
struct Nearest {
  std::size_t index = 0;
  double first_m = std::numeric_limits<double>::infinity();
  double second_m = std::numeric_limits<double>::infinity();

  void offer(std::size_t candidate, double distance_m) {
    if (distance_m < first_m) {
      second_m = first_m;
      first_m = distance_m;
      index = candidate;
    } else {
      second_m = std::min(second_m, distance_m);
    }
  }
};

class Tracker {
 public:
  explicit Tracker(const TreeTrackerParams& params) : params_(params) {}

  void add(std::size_t index, const TreeScan& scan) {
    end_unseen(scan);
    std::vector<Sighting> seen;
    for (std::size_t i = 0; i < scan.points_m.size(); ++i)
      seen.push_back({index, i, scan.t_s, scan.T_local_body * scan.points_m[i]});
    const Neighbours near = neighbours(seen);
    for (std::size_t i = 0; i < seen.size(); ++i) {
      const Nearest& track = near.track[i];
      const bool alone = track.second_m >= params_.clear_m;
      if (track.first_m <= params_.gate_m && alone && near.sighting[track.index].second_m >= params_.clear_m)
        live_[track.index].see(seen[i], scan.driven_m);
      else if (track.first_m >= params_.clear_m && near.other[i].first_m >= params_.clear_m) begin(seen[i], scan);
      else ++unsure_;
    }
  }

  TreeTracks finish(const std::vector<TreeScan>& scans) {
    for (std::vector<Track>* tracks : {&live_, &started_})
      std::move(tracks->begin(), tracks->end(), std::back_inserter(ended_));
    std::stable_sort(ended_.begin(), ended_.end(), [](const Track& a, const Track& b) {
      return a.sightings.front().scan < b.sightings.front().scan;
    });
    TreeTracks result;
    result.unsure = unsure_;
    for (const TreeScan& scan : scans) result.track_of.emplace_back(scan.points_m.size(), TreeTracks::none);
    for (const Track& track : ended_) {
      if (is_seldom(track)) result.seldom += track.sightings.size();
      else if (moves(track)) {
        result.moving += track.sightings.size();
        ++result.moving_tracks;
      } else {
        ++result.tracks;
        for (const Sighting& s : track.sightings) result.track_of[s.scan][s.point] = result.tracks;
      }
    }
    return result;
  }

 private:
  struct Neighbours {
    std::vector<Nearest> track, other;  // of each sighting: among the tracks, among the other sightings
    std::vector<Nearest> sighting;      // of each track
  };

  Neighbours neighbours(const std::vector<Sighting>& seen) const {
    Neighbours near{std::vector<Nearest>(seen.size()), std::vector<Nearest>(seen.size()),
                    std::vector<Nearest>(live_.size())};
    for (std::size_t i = 0; i < seen.size(); ++i) {
      for (std::size_t k = 0; k < live_.size(); ++k) {
        const double distance_m = (live_[k].place_m - seen[i].place_m).norm();
        near.track[i].offer(k, distance_m);
        near.sighting[k].offer(i, distance_m);
      }
      for (std::size_t j = 0; j < seen.size(); ++j)
        if (j != i) near.other[i].offer(j, (seen[j].place_m - seen[i].place_m).norm());
    }
    return near;
  }

  void begin(const Sighting& sighting, const TreeScan& scan) {
    started_.emplace_back();
    started_.back().see(sighting, scan.driven_m);
  }

  void end_unseen(const TreeScan& scan) {
    std::move(started_.begin(), started_.end(), std::back_inserter(live_));
    started_.clear();
    const auto kept = std::stable_partition(live_.begin(), live_.end(), [&](const Track& track) {
      return scan.t_s - track.sightings.back().t_s <= params_.max_unseen_s &&
             scan.driven_m - track.driven_m <= params_.max_unseen_m;
    });
    std::move(kept, live_.end(), std::back_inserter(ended_));
    live_.erase(kept, live_.end());
  }

  bool is_seldom(const Track& track) const {
    const auto count = static_cast<double>(track.sightings.size());
    return count < params_.min_sightings || count < params_.min_seen_share * static_cast<double>(track.scans());
  }

  bool moves(const Track& track) const {
    std::size_t old = 0;
    for (const Sighting& s : track.sightings) {
      while (s.t_s - track.sightings[old].t_s > params_.motion_span_s) ++old;
      if ((s.place_m - track.sightings[old].place_m).norm() > params_.max_motion_m) return true;
    }
    return false;
  }

  TreeTrackerParams params_;
  std::vector<Track> live_, started_, ended_;
  std::size_t unsure_ = 0;
};

}  // namespace

TreeTracks follow_trees(const std::vector<TreeScan>& scans, const TreeTrackerParams& params) {
  Tracker tracker(params);
  for (std::size_t i = 0; i < scans.size(); ++i) tracker.add(i, scans[i]);
  return tracker.finish(scans);
}

}  // namespace convoy::cli
