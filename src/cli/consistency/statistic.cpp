#include "consistency/statistic.hpp"

#include <convoy/drift/drift_model.hpp>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "consistency/draw.hpp"

namespace convoy::cli::consistency {
namespace {

constexpr int bootstrap_draws = 1000;

template <class G>
PoseSample pose_sample(int vehicle, int step, const TrueStep<G>& truth, const Estimate<G>& estimate) {
  const typename G::Tangent r = (estimate.mean.inverse() * truth.T_common_body).Log();
  return {vehicle, step, truth.state.abscissa_m, squared_mahalanobis(r, estimate.covariance),
          (estimate.mean.translation() - truth.T_common_body.translation()).norm()};
}

// `estimates` of each vehicle, step by step.
template <class G>
RunSample sample_of(const std::vector<TrueTrack<G>>& tracks, const std::vector<std::vector<Estimate<G>>>& estimates) {
  RunSample sample;
  for (std::size_t v = 0; v < tracks.size(); ++v) {
    for (std::size_t k = 0; k < tracks[v].steps.size(); ++k)
      sample.poses.push_back(
          pose_sample(static_cast<int>(v), static_cast<int>(k), tracks[v].steps[k], estimates[v][k]));
    for (std::size_t w = 0; w < v; ++w)
      for (std::size_t k = 0; k < std::min(tracks[v].steps.size(), tracks[w].steps.size()); ++k) {
        const auto& a = tracks[v].steps[k].T_common_body;
        const auto& b = tracks[w].steps[k].T_common_body;
        sample.distance_errors_m.push_back(
            (estimates[v][k].mean.translation() - estimates[w][k].mean.translation()).norm() -
            (a.translation() - b.translation()).norm());
      }
  }
  return sample;
}

// Sums over runs of what happened at one step.
struct StepSum {
  double abscissa_m = 0.0, nees = 0.0, squared_error = 0.0;
  int inside = 0, count = 0;
  void add(const PoseSample& p, double scale, double limit) {
    abscissa_m += p.abscissa_m;
    nees += p.squared_distance / scale;
    squared_error += p.position_error_m * p.position_error_m;
    inside += p.squared_distance / scale <= limit ? 1 : 0;
    ++count;
  }
};

double mean_of(const std::vector<std::pair<double, int>>& sums, const std::vector<std::size_t>& which) {
  double sum = 0.0;
  int count = 0;
  for (const std::size_t i : which) {
    sum += sums[i].first;
    count += sums[i].second;
  }
  return sum / std::max(1, count);
}

}  // namespace

template <class G>
RunSample judge(Map<G>& map, const std::vector<TrueTrack<G>>& tracks) {
  std::vector<std::vector<Estimate<G>>> estimates;
  for (const TrueTrack<G>& track : tracks) {
    estimates.emplace_back();
    for (const TrueStep<G>& step : track.steps) estimates.back().push_back(map.pose(track.chain, step.state).value());
  }
  return sample_of(tracks, estimates);
}

template <class G>
RunSample judge_raw(const std::vector<TrueTrack<G>>& tracks) {
  std::vector<std::vector<Estimate<G>>> estimates;
  for (const TrueTrack<G>& track : tracks) {
    estimates.emplace_back();
    for (const TrueStep<G>& step : track.steps) {
      const Increment<G> since_start = increment(ChainState<G>{}, step.state);
      const typename G::Adjoint Ad = since_start.motion.inverse().adjoint();
      estimates.back().push_back(
          {track.start.mean * since_start.motion,
           symmetrised(typename G::Covariance(Ad * track.start.covariance * Ad.transpose() + since_start.covariance))});
    }
  }
  return sample_of(tracks, estimates);
}

Summary summarise(const std::vector<RunSample>& runs, int dof, double covariance_scale, std::uint64_t bootstrap_seed) {
  const double limit = chi2_quantile(0.95, dof);
  Summary s;
  s.runs = static_cast<int>(runs.size());
  std::map<std::pair<int, int>, StepSum> by_step;  // vehicle, step
  std::map<int, StepSum> curve;
  std::vector<std::pair<double, int>> by_run;
  StepSum all;
  double squared_distance_error = 0.0;
  std::size_t distances = 0;
  for (const RunSample& run : runs) {
    by_run.emplace_back(0.0, 0);
    for (const PoseSample& p : run.poses) {
      by_step[{p.vehicle, p.step}].add(p, covariance_scale, limit);
      curve[p.step].add(p, covariance_scale, limit);
      all.add(p, covariance_scale, limit);
      by_run.back().first += p.squared_distance / covariance_scale;
      ++by_run.back().second;
    }
    for (const double e : run.distance_errors_m) squared_distance_error += e * e;
    distances += run.distance_errors_m.size();
    s.false_fusions += run.false_fusions;
    s.true_stated += run.true_stated;
    s.true_dropped += run.true_dropped;
    s.false_stated += run.false_stated;
    s.unlinked_runs += run.unlinked ? 1 : 0;
  }
  const double n = std::max(1, all.count);
  s.anees = all.nees / n / dof;
  s.coverage95 = all.inside / n;
  s.pos_rmse_m = std::sqrt(all.squared_error / n);
  s.distance_rmse_m = distances == 0 ? std::numeric_limits<double>::quiet_NaN()
                                     : std::sqrt(squared_distance_error / static_cast<double>(distances));
  int in_band = 0;
  for (const auto& [key, step] :
       by_step) {  // segments may differ from run to run: each step has its own number of runs
    const double freedom = static_cast<double>(step.count) * dof;
    const bool inside = step.nees >= chi2_quantile(0.025, freedom) && step.nees <= chi2_quantile(0.975, freedom);
    in_band += inside ? 1 : 0;
  }
  s.steps = static_cast<int>(by_step.size());
  s.steps_in_band = in_band / std::max(1.0, static_cast<double>(s.steps));
  const double freedom = std::max(1.0, static_cast<double>(s.runs) * dof);
  s.band_low = chi2_quantile(0.025, freedom) / freedom;
  s.band_high = chi2_quantile(0.975, freedom) / freedom;
  for (const auto& [step, sum] : curve)
    if (2 * sum.count >= s.runs)  // steps that only some runs reached say nothing over distance
      s.curve.push_back({sum.abscissa_m / sum.count, sum.nees / sum.count / dof,
                         sum.inside / static_cast<double>(sum.count), std::sqrt(sum.squared_error / sum.count)});

  Draw draw(bootstrap_seed, 0, 99);
  std::vector<double> means;
  std::vector<std::size_t> which(by_run.size());
  for (int b = 0; b < bootstrap_draws && !which.empty(); ++b) {
    for (std::size_t& i : which)
      i = std::min(which.size() - 1, static_cast<std::size_t>(draw.uniform() * static_cast<double>(which.size())));
    means.push_back(mean_of(by_run, which) / dof);
  }
  std::sort(means.begin(), means.end());
  if (!means.empty()) {
    s.anees_low = means[bootstrap_draws * 25 / 1000];
    s.anees_high = means[bootstrap_draws * 975 / 1000 - 1];
  }
  return s;
}

#define CONVOY_INSTANTIATE(G)                                          \
  template RunSample judge(Map<G>&, const std::vector<TrueTrack<G>>&); \
  template RunSample judge_raw(const std::vector<TrueTrack<G>>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::consistency
