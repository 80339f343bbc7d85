// Whether the wheels slip: a windowed test of what the camera says against the odometer. A single frame proves nothing,
// since an encoder counts in ticks.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <deque>

namespace convoy {

class SlipMonitor {
 public:
  SlipMonitor(int window_frames, double threshold)
      : window_(static_cast<std::size_t>(window_frames)), threshold_(threshold) {}

  /// Score of one frame: by how many standard deviations the step was longer, and turned further to the left, than the
  /// odometer said. True if their sum over the window is beyond the threshold; then it starts anew.
  bool slips(const std::array<double, 2>& score) {
    scores_.push_back(score);
    if (scores_.size() > window_) scores_.pop_front();
    for (std::size_t axis = 0; axis < 2; ++axis) {
      double sum = 0.0;
      for (const auto& s : scores_) sum += s[axis];
      if (!(std::abs(sum) < threshold_ * std::sqrt(static_cast<double>(scores_.size())))) {
        scores_.clear();
        return true;
      }
    }
    return false;
  }

 private:
  std::size_t window_;
  double threshold_;
  std::deque<std::array<double, 2>> scores_;
};

}  // namespace convoy
