// The trivial front end: the host already has converged landmarks (another SLAM, a map provider) and passes them on.
#pragma once

#include <convoy/frontend/front_end.hpp>
#include <convoy/geometry/covariance.hpp>

#include <utility>

namespace convoy {

template <class G>
class FrozenLandmarks final : public FrontEnd<G> {
 public:
  /// The SLAM has moved. Returns false, and changes nothing, if stamp or abscissa go back, anything is not finite, or
  /// slam_drift is no covariance.
  [[nodiscard]] bool advance(const FrontEndState<G>& state) {
    const bool grows = state.stamp_s >= state_.stamp_s && state.abscissa_m >= state_.abscissa_m;
    if (!grows || !state.pose.Log().allFinite() || !is_covariance(state.slam_drift)) return false;
    state_ = state;
    return true;
  }

  /// Closes a segment here, with landmarks in the frame of the current pose.
  void close(std::vector<FrozenLandmark<G>> landmarks) { segments_.push_back({state_, {}, std::move(landmarks)}); }

  FrontEndState<G> state() const override { return state_; }
  std::vector<Segment<G>> take_segments() override { return std::exchange(segments_, {}); }

 private:
  FrontEndState<G> state_;
  std::vector<Segment<G>> segments_;
};

}  // namespace convoy
