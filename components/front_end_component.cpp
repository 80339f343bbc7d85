#include <convoy/components/front_end_component.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>
#include <unordered_set>
#include <utility>

namespace convoy {
namespace {

template <class G>
ChainState<G> advance(DriftAccumulator<G>& drift, const FrontEndState<G>& s) {
  return drift.advance(s.stamp_s, s.abscissa_m, s.pose, s.slam_drift);
}

constexpr double trail_spacing_m = 1.0;
constexpr double memory_s = 120.0;  // for how long others may take to say that they saw this vehicle
constexpr double max_gap_s = 2.0;   // between two states, so that the way in between is known

// One position per track, each track once, and a joint covariance of that size; all finite.
template <class G>
bool is_whole(const RelativeLandmarks<G>& landmarks) {
  const auto n = static_cast<Eigen::Index>(landmarks.tracks.size());
  const std::unordered_set<std::uint64_t> tracks(landmarks.tracks.begin(), landmarks.tracks.end());
  const Eigen::MatrixXd& P = landmarks.covariance;
  return static_cast<Eigen::Index>(tracks.size()) == n && static_cast<Eigen::Index>(landmarks.positions.size()) == n &&
         P.rows() == G::Dim * n && P.cols() == P.rows() && P.allFinite() &&
         std::all_of(landmarks.positions.begin(), landmarks.positions.end(),
                     [](const auto& p) { return p.allFinite(); });
}

}  // namespace

template <class G>
FrontEndComponent<G>::FrontEndComponent(FrontEnd<G>& front_end, SubmapManager<G>& manager, const DriftParams<G>& drift,
                                        double live_period_s)
    : front_end_(front_end),
      manager_(manager),
      start_(front_end.state()),
      params_(drift),
      live_period_s_(live_period_s),
      drift_(drift),
      drift_at_anchor_(drift) {
  if constexpr (G::Dim == 3) {  // a SLAM that keeps a tilt bounded knows what is up: the z axis of its frame
    if (params_.persistent.bounded()) params_.persistent.up = start_.pose.rotation().row(2).transpose();
  }
  params_.persistent.scales_landmarks = params_.persistent.scale > 0.0 && front_end_.scales_landmarks();
  state_.stamp_s = start_.stamp_s;
  front_end_.take_segments();  // what converged before this chain began belongs to no anchor of it
}

// The chain begins at the identity with no drift, whatever the SLAM did before.
template <class G>
FrontEndState<G> FrontEndComponent<G>::since_start(const FrontEndState<G>& s) const {
  const typename G::Adjoint Ad = start_.pose.inverse().adjoint();
  return {s.stamp_s, s.abscissa_m - start_.abscissa_m, start_.pose.inverse() * s.pose,
          positive_part(typename G::Covariance(Ad * (s.slam_drift - start_.slam_drift) * Ad.transpose()))};
}

template <class G>
void FrontEndComponent<G>::poll() {
  for (const Segment<G>& segment : front_end_.take_segments()) close(segment);
  state_ = advance(drift_, since_start(front_end_.state()));
  if (trail_.empty() || state_.abscissa_m >= trail_.back().abscissa_m + trail_spacing_m) trail_.push_back(state_);
  remember_state();
  answer_encounters();
  if (!live_s_ || state_.stamp_s >= *live_s_ + live_period_s_) {
    live_s_ = state_.stamp_s;
    manager_.publish_live(live());
  }
}

template <class G>
void FrontEndComponent<G>::remember_state() {
  constexpr double spacing_s = 0.1;
  if (!recent_.empty() && state_.stamp_s < recent_.back().stamp_s + spacing_s) return;
  recent_.push_back(exportable_state());
  while (recent_.front().stamp_s < state_.stamp_s - memory_s) recent_.pop_front();
}

// Between two states that are remembered, on the motion of constant speed from one to the other.
template <class G>
std::optional<ChainState<G>> FrontEndComponent<G>::state_at(double stamp_s) const {
  const auto after = std::lower_bound(recent_.begin(), recent_.end(), stamp_s,
                                      [](const ChainState<G>& s, double t) { return s.stamp_s < t; });
  if (after == recent_.end() || (after == recent_.begin() && after->stamp_s != stamp_s)) return std::nullopt;
  if (after->stamp_s == stamp_s) return *after;
  const ChainState<G>&a = *std::prev(after), &b = *after;
  if (b.stamp_s - a.stamp_s > max_gap_s) return std::nullopt;
  const double share = (stamp_s - a.stamp_s) / (b.stamp_s - a.stamp_s);
  const auto between = [&](const auto& x, const auto& y) { return (x + share * (y - x)).eval(); };
  ChainState<G> s;
  s.stamp_s = stamp_s;
  s.abscissa_m = a.abscissa_m + share * (b.abscissa_m - a.abscissa_m);
  s.pose = a.pose * G::Exp(share * (a.pose.inverse() * b.pose).Log());
  s.drift = between(a.drift, b.drift);
  s.heading_lever = between(a.heading_lever, b.heading_lever);
  return s;
}

template <class G>
void FrontEndComponent<G>::answer_encounters() {
  for (const auto& encounter : manager_.take_unanswered()) seen_.push_back(encounter);
  std::erase_if(seen_, [&](const std::pair<Key, double>& encounter) {
    const auto& [key, stamp_s] = encounter;
    if (stamp_s > state_.stamp_s && stamp_s < state_.stamp_s + memory_s) return false;  // not there yet
    const auto state = state_at(stamp_s);
    const bool next_will_tell = !recent_.empty() && stamp_s > recent_.back().stamp_s && stamp_s <= state_.stamp_s;
    if (!state && next_will_tell) return false;
    if (!state || !manager_.publish_waypoint(*state, key, mark_)) ++encounters_unanswered_;
    return true;
  });
}

template <class G>
LivePose<G> FrontEndComponent<G>::live() {
  LivePose<G> live;
  live.state = state_;
  RelativeLandmarks<G> known = front_end_.remembered();
  if (!is_whole(known)) {
    ++remembered_unfit_;
    return live;
  }
  std::vector<std::size_t> best;  // those that the map has joined to others: the rest say no more than their anchors
  for (std::size_t i = 0; i < known.tracks.size(); ++i) {
    const auto exported = exported_.find(known.tracks[i]);
    if (exported != exported_.end() && manager_.map().class_of.find({manager_.self(), exported->second}))
      best.push_back(i);
  }
  const auto variance = [&](std::size_t i) {
    return known.covariance.diagonal().segment(G::Dim * static_cast<Eigen::Index>(i), G::Dim).sum();
  };
  std::stable_sort(best.begin(), best.end(), [&](std::size_t a, std::size_t b) { return variance(a) < variance(b); });
  best.resize(std::min(best.size(), LivePose<G>::max_remembered));
  RelativeLandmarks<G> chosen = subset(known, best);
  chosen.covariance *=
      std::max(params_.landmark_inflation, params_.gamma);  // what the SLAM is too sure of, it is here, too
  const auto part = rigid_part(chosen);
  if (!part) return live;
  // The drift that the SLAM knows nothing of, since the last anchor: how long ago each landmark was seen it does not
  // say.
  live.shared = part->shared;
  live.shared.diagonal() += params_.rate * std::max(0.0, state_.abscissa_m - anchor_abscissa_m_);
  for (std::size_t i = 0; i < best.size(); ++i)
    live.remembered.push_back({exported_.at(chosen.tracks[i]), chosen.positions[i], part->own[i]});
  return live;
}

template <class G>
void FrontEndComponent<G>::remember_export(std::uint64_t track, std::uint32_t index) {
  constexpr std::size_t max_exported = 4096;  // far more than a live pose is held by
  if (exported_.insert_or_assign(track, index).second) exported_order_.push_back(track);
  if (exported_order_.size() <= max_exported) return;
  exported_.erase(exported_order_.front());
  exported_order_.pop_front();
}

template <class G>
ChainState<G> FrontEndComponent<G>::exportable_state() const {
  DriftAccumulator<G> here = drift_;
  return advance(here, since_start(front_end_.exportable_state()));
}

template <class G>
void FrontEndComponent<G>::close(const Segment<G>& segment) {
  const ChainState<G> closing = advance(drift_, since_start(segment.closing));
  if (!segment.trail.empty()) {  // the segment again, as it is known now
    trail_.resize(trail_at_anchor_);
    for (const FrontEndState<G>& state : segment.trail) trail_.push_back(advance(drift_at_anchor_, since_start(state)));
  }
  trail_.push_back(closing);
  trail_at_anchor_ = trail_.size();
  drift_at_anchor_ = drift_;
  anchor_abscissa_m_ = closing.abscissa_m;

  std::vector<LandmarkFact<G>> batch;
  for (const FrozenLandmark<G>& frozen : segment.landmarks) {
    LandmarkFact<G> fact;
    fact.position = frozen.position;
    fact.covariance = symmetrised(typename G::PointCovariance(params_.landmark_inflation * frozen.covariance));
    fact.loading = std::sqrt(params_.landmark_inflation) * frozen.loading;
    fact.descriptor = frozen.descriptor;
    fact.kind = frozen.kind;
    batch.push_back(fact);
  }
  const auto indices = manager_.publish_segment(closing, std::move(batch));
  for (std::size_t i = 0; i < indices.size(); ++i) {
    if (!indices[i]) continue;
    ++landmarks_exported_;
    remember_export(segment.landmarks[i].track, *indices[i]);
    if (on_export_) on_export_(*indices[i], segment.landmarks[i].track);
  }
}

#define CONVOY_INSTANTIATE(G) template class FrontEndComponent<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
