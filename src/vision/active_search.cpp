#include <convoy/config_error.hpp>
#include <convoy/vision/active_search.hpp>

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>

namespace convoy {

using Status = PatchSearchResult::Status;

namespace {

constexpr std::size_t most_candidates = 4;
constexpr double same_place_px = 2.0;
// Between pixels, and on a smaller image, a match looks less similar than it is.
constexpr double loss_between_pixels = 0.25, loss_when_coarse = 0.35;

void check(bool holds, const char* name, double value, const char* range) {
  if (!holds) throw RangeError("active search", name, value, range);
}

/// Larger or smaller by more than 3, squeezed by more than 4, or mirrored.
bool is_too_strong(const Eigen::Matrix2d& A) {
  constexpr double most_scale = 3.0, most_squeeze = 4.0;
  const double area = A.determinant();
  if (!(area > 1.0 / (most_scale * most_scale) && area < most_scale * most_scale)) return true;
  // Of the singular values p >= q: p q = area, p^2 + q^2 = squared norm.
  return !(A.squaredNorm() < area * (most_squeeze + 1.0 / most_squeeze));
}

}  // namespace

/// The gate about a prediction, on one level of the pyramid. It is larger by half a pixel than told, so that there is a
/// place in it however small it is.
struct ActiveSearch::Ellipse {
  Ellipse(const PatchPrediction& p, double gate, int level)
      : middle(ImagePyramid::to_level(p.pixel, level)),
        covariance(p.covariance / (1 << 2 * level) + 0.5 / gate * Eigen::Matrix2d::Identity()),
        information(covariance.inverse()),
        reach((gate * covariance.diagonal()).cwiseSqrt()),
        gate_(gate) {}
  bool holds(int x, int y) const {
    const Eigen::Vector2d d = Eigen::Vector2d(x, y) - middle;
    return d.dot(information * d) <= gate_;
  }
  /// A template fits into the image wherever it is compared.
  bool is_within(const cv::Mat& image) const {
    const Eigen::Array2d margin = reach.array() + (PatchTemplate::half + 1), size(image.cols - 1, image.rows - 1);
    return (middle.array() >= margin).all() && (middle.array() <= size - margin).all();
  }
  Eigen::Vector2d middle;
  Eigen::Matrix2d covariance, information;
  Eigen::Vector2d reach;  // half the sides of the box around it

 private:
  double gate_;
};

void validate(const ActiveSearchParams& p) {
  check(p.min_score > 0.0 && p.min_score < 1.0, "min_score", p.min_score, "lie in (0, 1)");
  check(p.gate_probability > 0.0 && p.gate_probability < 1.0, "gate_probability", p.gate_probability, "lie in (0, 1)");
  check(p.coarse_above_px >= 1.0, "coarse_above_px", p.coarse_above_px, "be >= 1");
  check(p.max_radius_px >= 1.0 && p.max_radius_px <= 1000.0, "max_radius_px", p.max_radius_px, "lie in [1, 1000]");
  check(p.min_contrast > 0.0, "min_contrast", p.min_contrast, "be > 0");
  check(p.min_contrast_there > 0.0, "min_contrast_there", p.min_contrast_there, "be > 0");
  check(p.max_saturated >= 0.0 && p.max_saturated <= 1.0, "max_saturated", p.max_saturated, "lie in [0, 1]");
}

const char* to_string(Status status) {
  switch (status) {
    case Status::found: return "found";
    case Status::no_match: return "no match";
    case Status::at_edge: return "at the edge of the ellipse";
    case Status::bad_prediction: return "bad prediction";
    case Status::out_of_image: return "out of the image";
    case Status::too_uncertain: return "too uncertain";
    case Status::warp_too_strong: return "warp too strong";
    case Status::blank: return "blank";
    case Status::saturated: return "saturated";
    case Status::beyond_patch: return "beyond the patch";
    case Status::bad_image: return "bad image";
  }
  return "?";
}

ActiveSearch::ActiveSearch(const ActiveSearchParams& params)
    : params_(params), gate_(0.0), window_(params.min_contrast_there) {
  validate(params);
  gate_ = -2.0 * std::log1p(-params.gate_probability);
}

Status ActiveSearch::judge(const ReferencePatch& patch) const {
  PatchTemplate itself;
  return make(patch, Eigen::Matrix2d::Identity(), itself);
}

Status ActiveSearch::make(const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now, PatchTemplate& made) const {
  if (!made.warp(patch, ref_from_now, Eigen::Vector2d::Zero())) return Status::beyond_patch;
  if (made.saturated_share() > params_.max_saturated) return Status::saturated;
  if (made.contrast() < params_.min_contrast) return Status::blank;
  return Status::found;
}

PatchSearchResult ActiveSearch::find(const ImagePyramid& image, const ReferencePatch& patch,
                                     const PatchPrediction& prediction) {
  const PatchSearchResult result = search(image, patch, prediction);
  ++counts_[static_cast<std::size_t>(result.status)];
  return result;
}

PatchSearchResult ActiveSearch::search(const ImagePyramid& image, const ReferencePatch& patch,
                                       const PatchPrediction& prediction) {
  if (!image.valid()) return {Status::bad_image};
  const Eigen::Matrix2d& S = prediction.covariance;
  if (!prediction.pixel.allFinite() || !S.allFinite() || !prediction.now_from_ref.allFinite())
    return {Status::bad_prediction};
  const double half_trace = 0.5 * S.trace(), determinant = S.determinant();
  if (!(half_trace > 0.0 && determinant > 0.0)) return {Status::bad_prediction};
  if (is_too_strong(prediction.now_from_ref)) return {Status::warp_too_strong};
  const double largest = half_trace + std::sqrt(std::max(0.0, half_trace * half_trace - determinant));
  const double radius_px = std::sqrt(gate_ * largest);
  if (!(radius_px <= params_.max_radius_px)) return {Status::too_uncertain};
  int level = 0;
  while (level + 1 < ImagePyramid::levels && radius_px > params_.coarse_above_px * (1 << level)) ++level;

  const Eigen::Matrix2d ref_from_now = prediction.now_from_ref.inverse();
  PatchTemplate at_full_size, wanted;
  // What decides whether there is enough to see is the template at full size; on smaller ones the grey values even out.
  if (const Status status = make(patch, ref_from_now, at_full_size); status != Status::found) return {status};
  // Near an edge smaller images end too soon, here or where the patch was taken.
  while (level > 0 && !(Ellipse(prediction, gate_, level).is_within(image.level(level)) &&
                        wanted.warp(patch, ref_from_now * (1 << level), Eigen::Vector2d::Zero())))
    --level;
  if (level == 0) wanted = at_full_size;
  const Status status = find_peaks(image.level(level), wanted, Ellipse(prediction, gate_, level));
  if (status != Status::found) return {status};
  for (; level > 0; --level) descend(image.level(level - 1), patch, ref_from_now, level - 1);
  refine_all(image.level(0), patch, ref_from_now);
  return best_of_candidates();
}

Status ActiveSearch::find_peaks(const cv::Mat& image, const PatchTemplate& wanted, const Ellipse& ellipse) {
  candidates_.clear();
  const Eigen::Vector2d one(1.0, 1.0);  // neighbours at the rim
  if (!window_.load(image, ellipse.middle - ellipse.reach - one, ellipse.middle + ellipse.reach + one))
    return Status::out_of_image;
  bool any = false, at_rim = false;
  const double least = params_.min_score - loss_when_coarse;
  double best = -1.0;
  for (int y = window_.top(); y <= window_.bottom(); ++y)
    for (int x = window_.left(); x <= window_.right(); ++x) {
      if (!ellipse.holds(x, y)) continue;
      any = true;
      const double score = window_.score(wanted, x, y);
      if (score < least) continue;
      const bool peak = window_.is_peak(wanted, x, y);
      if (score > best) best = score, at_rim = !peak;
      if (peak) add_candidate({Eigen::Vector2d(x, y), score});
    }
  if (!any) return Status::out_of_image;
  if (candidates_.empty()) return at_rim ? Status::at_edge : Status::no_match;
  return Status::found;
}

/// Keeps the best of them, best first.
void ActiveSearch::add_candidate(const Candidate& candidate) {
  const auto better = [](const Candidate& a, const Candidate& b) { return a.score > b.score; };
  candidates_.insert(std::upper_bound(candidates_.begin(), candidates_.end(), candidate, better), candidate);
  if (candidates_.size() > most_candidates) candidates_.pop_back();
}

/// From one level to the next finer one.
void ActiveSearch::descend(const cv::Mat& image, const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now,
                           int level) {
  PatchTemplate wanted;
  const bool whole = wanted.warp(patch, ref_from_now * (1 << level), Eigen::Vector2d::Zero());
  std::erase_if(candidates_, [&](Candidate& candidate) {
    candidate.pixel = ImagePyramid::from_level(candidate.pixel, 1);
    return !whole || !climb(image, wanted, candidate);
  });
}

/// To the most similar place within 2 px, which must be similar enough.
bool ActiveSearch::climb(const cv::Mat& image, const PatchTemplate& wanted, Candidate& candidate) {
  const Eigen::Vector2d reach(2.0, 2.0);
  if (!window_.load(image, candidate.pixel - reach, candidate.pixel + reach)) return false;
  candidate.score = -1.0;
  for (int y = window_.top(); y <= window_.bottom(); ++y)
    for (int x = window_.left(); x <= window_.right(); ++x)
      if (const double score = window_.score(wanted, x, y); score > candidate.score)
        candidate = {Eigen::Vector2d(x, y), score};
  return candidate.score >= params_.min_score - loss_when_coarse;
}

void ActiveSearch::refine_all(const cv::Mat& image, const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now) {
  std::erase_if(candidates_, [&](Candidate& candidate) {
    return candidate.score < params_.min_score - loss_between_pixels || !refine(image, patch, ref_from_now, candidate);
  });
  std::stable_sort(candidates_.begin(), candidates_.end(),
                   [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
}

/// Between pixels: the template is made again for where the feature seems to lie, so that it is compared with what the
/// image really shows, and the rest is corrected.
bool ActiveSearch::refine(const cv::Mat& image, const ReferencePatch& patch, const Eigen::Matrix2d& ref_from_now,
                          Candidate& candidate) {
  const Eigen::Vector2d reach(2.0, 2.0);
  if (!window_.load(image, candidate.pixel - reach, candidate.pixel + reach)) return false;
  Eigen::Vector2d estimate = candidate.pixel;
  PatchTemplate wanted;
  for (int round = 0; round < 3; ++round) {
    const int x = static_cast<int>(std::lround(estimate.x())), y = static_cast<int>(std::lround(estimate.y()));
    if (!window_.holds(x, y)) return false;
    const Eigen::Vector2d phase = estimate - Eigen::Vector2d(x, y);
    if (!wanted.warp(patch, ref_from_now, phase)) return false;
    window_.forget_scores();
    candidate = {estimate, window_.score(wanted, x, y)};
    if (round < 2) estimate = window_.summit(wanted, x, y) + phase;
  }
  return true;
}

PatchSearchResult ActiveSearch::best_of_candidates() const {
  PatchSearchResult result;
  if (candidates_.empty()) return result;
  const Candidate& best = candidates_.front();
  result.pixel = best.pixel;
  result.score = best.score;
  if (best.score >= params_.min_score) result.status = Status::found;
  for (const Candidate& other : candidates_)
    if ((other.pixel - best.pixel).norm() > same_place_px) {
      result.runner_up = other.score;
      break;
    }
  return result;
}

}  // namespace convoy
