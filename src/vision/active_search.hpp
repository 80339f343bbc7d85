// Active search: a feature is looked for where the filter says it can be, by the patch it was first seen with, warped
// to what it should look like now (A. J. Davison, Real-time simultaneous localisation and mapping with a single camera,
// ICCV 2003; J. Civera et al., 1-point RANSAC for EKF filtering, 2010).
#pragma once

#include <convoy/vision/correlation.hpp>

#include <cstdint>
#include <vector>

namespace convoy {

struct ActiveSearchParams {
  double min_score = 0.8;           ///< zero-mean normalised cross-correlation of a match, (0, 1)
  double gate_probability = 0.99;   ///< share of true places within the ellipse, (0, 1)
  double coarse_above_px = 10.0;    ///< longest semi-axis from which the search begins on a smaller image, >= 1
  double max_radius_px = 80.0;      ///< longest semi-axis that is searched, >= 1
  double min_contrast = 4.0;        ///< standard deviation of the template's grey values (of 0..255), > 0
  double min_contrast_there = 1.5;  ///< of what it is compared with, > 0
  double max_saturated = 0.4;       ///< share of the template that is black or white, [0, 1]
};

/// Throws RangeError.
void validate(const ActiveSearchParams& params);

struct PatchPrediction {
  Eigen::Vector2d pixel;         ///< where the feature should be
  Eigen::Matrix2d covariance;    ///< of the innovation, measurement noise included [px^2]
  Eigen::Matrix2d now_from_ref;  ///< see PatchWarp
};

struct PatchSearchResult {
  enum class Status : std::uint8_t {
    found,
    no_match,         ///< nothing in the ellipse is similar enough
    at_edge,          ///< what is most similar lies at the rim of the ellipse and grows outwards
    bad_prediction,   ///< a number is not finite, or the covariance is not positive definite
    out_of_image,     ///< the ellipse lies beyond it
    too_uncertain,    ///< the ellipse is larger than max_radius_px
    warp_too_strong,  ///< larger or smaller by more than 3, squeezed by more than 4, or mirrored
    blank,            ///< the template has too little contrast
    saturated,        ///< too much of it is black or white
    beyond_patch,     ///< the template needs more than was kept of the surroundings
    bad_image,        ///< ImagePyramid::valid() is false
  };
  Status status = Status::no_match;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();  ///< if found
  double score = 0.0;      ///< if found or no_match: zero-mean normalised cross-correlation there, [-1, 1]
  double runner_up = 0.0;  ///< score of the next best place, > 2 px away, that was looked into; 0: there is none
};
inline constexpr int search_statuses = 11;
const char* to_string(PatchSearchResult::Status status);

/// Not for several threads at once; makes no memory once it has seen the largest ellipse. The same input gives the same
/// result, to the bit.
class ActiveSearch {
 public:
  explicit ActiveSearch(const ActiveSearchParams& params = {});

  PatchSearchResult find(const ImagePyramid& image, const ReferencePatch& patch, const PatchPrediction& prediction);

  /// Whether a patch just taken is worth following: found, blank, saturated or beyond_patch. Not counted.
  PatchSearchResult::Status judge(const ReferencePatch& patch) const;

  /// Results of find() so far.
  std::uint64_t count(PatchSearchResult::Status status) const { return counts_[static_cast<std::size_t>(status)]; }
  const ActiveSearchParams& params() const { return params_; }

 private:
  struct Candidate {
    Eigen::Vector2d pixel;  // on the level it was found
    double score;
  };
  struct Ellipse;

  PatchSearchResult search(const ImagePyramid& image, const ReferencePatch& patch, const PatchPrediction& prediction);
  PatchSearchResult::Status make(const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now,
                                 PatchTemplate& made) const;
  PatchSearchResult::Status find_peaks(const cv::Mat& image, const PatchTemplate& wanted, const Ellipse& ellipse);
  void add_candidate(const Candidate& candidate);
  void descend(const cv::Mat& image, const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now, int level);
  bool climb(const cv::Mat& image, const PatchTemplate& wanted, Candidate& candidate);
  void refine_all(const cv::Mat& image, const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now);
  bool refine(const cv::Mat& image, const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now,
              Candidate& candidate);
  PatchSearchResult best_of_candidates() const;

  ActiveSearchParams params_;
  double gate_;  // chi-square, two degrees of freedom
  std::array<std::uint64_t, search_statuses> counts_{};
  CorrelationWindow window_;
  std::vector<Candidate> candidates_;  // best first
};

}  // namespace convoy
