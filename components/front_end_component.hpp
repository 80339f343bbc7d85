// FrontEndComponent: hosts a vehicle's own SLAM and exports its converged landmarks once and for all (paper, Fig. 4,
// the arrow from the low level to the submap). Here the drift, which the SLAM knows nothing of, is added.
#pragma once

#include <convoy/components/submap_manager.hpp>
#include <convoy/drift/drift_model.hpp>
#include <convoy/frontend/front_end.hpp>

#include <deque>
#include <functional>
#include <optional>
#include <unordered_map>
#include <vector>

namespace convoy {

template <class G>
class FrontEndComponent {
 public:
  /// Called for each exported landmark with its index and the front end's own name for it; never leaves the vehicle.
  using ExportListener = std::function<void(std::uint32_t index, std::uint64_t track)>;

  /// Both references must outlive it. Throws ConfigError.
  FrontEndComponent(FrontEnd<G>& front_end, SubmapManager<G>& manager, const DriftParams<G>& drift,
                    double live_period_s = 1.0);

  void on_export(ExportListener listener) { on_export_ = std::move(listener); }

  /// Call after every sensor input given to the front end: the drift is accumulated step by step.
  void poll();

  /// Says where this vehicle was when others saw it. poll() does; call it, too, while no sensor input comes.
  void answer_encounters();

  /// The states passed so far: smoothed up to the last anchor, filtered after it. Feed them to Map::pose for the
  /// corrected trajectory. One per metre or so.
  const std::vector<ChainState<G>>& trail() const { return trail_; }
  const ChainState<G>& state() const { return state_; }
  /// The same for facts: without what the SLAM knows by landmarks it has exported (FrontEnd::exportable_state).
  ChainState<G> exportable_state() const;
  /// DriftParams::persistent with what is up in this chain: for SubmapManager::open_chain.
  const PersistentDrift& persistent() const { return params_.persistent; }
  /// What others see of this vehicle, body frame [m]. The origin by default.
  void set_mark(const typename G::Point& mark) { mark_ = mark; }
  /// Encounters in which others saw this vehicle and that it could not answer: of moments that it has
  /// forgotten (two minutes), or that its time is far from reaching.
  std::uint64_t encounters_unanswered() const { return encounters_unanswered_; }
  /// Where the vehicle is now, with what the front end remembers of landmarks that the map has joined to others.
  LivePose<G> live();
  std::uint64_t landmarks_exported() const { return landmarks_exported_; }
  /// How often FrontEnd::remembered() was not usable: sizes that do not match, a track named twice, or not finite.
  std::uint64_t remembered_unfit() const { return remembered_unfit_; }

 private:
  void close(const Segment<G>& segment);
  void remember_export(std::uint64_t track, std::uint32_t index);
  void remember_state();
  std::optional<ChainState<G>> state_at(double stamp_s) const;
  FrontEndState<G> since_start(const FrontEndState<G>& state) const;

  FrontEnd<G>& front_end_;
  SubmapManager<G>& manager_;
  FrontEndState<G> start_;  // of the front end when this chain began: its epoch may be younger than the SLAM
  DriftParams<G> params_;
  double live_period_s_;
  ExportListener on_export_;
  DriftAccumulator<G> drift_, drift_at_anchor_;
  ChainState<G> state_;
  std::vector<ChainState<G>> trail_;
  std::size_t trail_at_anchor_ = 0;
  std::optional<double> live_s_;
  std::uint64_t landmarks_exported_ = 0;
  std::unordered_map<std::uint64_t, std::uint32_t> exported_;  // the latest index of each track ...
  std::deque<std::uint64_t> exported_order_;                   // ... of the latest tracks, in order
  double anchor_abscissa_m_ = 0.0;
  std::uint64_t remembered_unfit_ = 0;
  std::deque<ChainState<G>> recent_;          // exportable states of the last two minutes
  std::vector<std::pair<Key, double>> seen_;  // encounters to answer: [key, stamp_s]
  typename G::Point mark_ = G::Point::Zero();
  std::uint64_t encounters_unanswered_ = 0;
};

}  // namespace convoy
