// What goes over time: the paper's Fig. 13 and 14, and consistency.
#include "report/figure_parts.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <limits>
#include <set>

namespace convoy::cli::figures {
namespace {

using nlohmann::json;

// ---- Fig. 13 ----

/// Means over blocks of `block` seconds: many vehicles over a long time would only make a carpet.
std::vector<Point> block_means(const std::vector<TimedValue>& seconds, std::size_t block) {
  std::vector<Point> points;
  for (std::size_t i = 0; i < seconds.size(); i += block) {
    const std::size_t end = std::min(seconds.size(), i + block);
    double sum = 0.0;
    for (std::size_t k = i; k < end; ++k) sum += seconds[k].value;
    points.emplace_back(0.5 * (seconds[i].t_s + seconds[end - 1].t_s), sum / static_cast<double>(end - i));
  }
  return points;
}

/// The most in any one second: in the first one, which holds all that came before it as well, and later.
template <class G>
std::string traffic_findings(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  double first = 0.0, later = 0.0;
  for (const auto& [id, seconds] : evaluation.bytes_per_s)
    for (std::size_t i = 0; i < seconds.size(); ++i)
      (i == 0 ? first : later) = std::max(i == 0 ? first : later, seconds[i].value);
  if (first == 0.0 && later == 0.0) return " No vehicle left its counters.";
  const json rate = run.info.value("rate", json());
  const bool pressed = rate.is_number() && rate.get<double>() != 1.0;
  return " The first second holds up to " + fixed(first / 1000.0, 1) +
         " KB: all that was sent up to then, when vehicles and endpoints discover each other" +
         (pressed ? ". That takes wall time, and one second of this replay lasted " +
                        fixed(1.0 / rate.get<double>(), rate.get<double>() > 10.0 ? 3 : 2) + " s"
                  : "") +
         ". Later it is at most " + fixed(later / 1000.0, 1) + " KB in a second; the paper stays below 10.";
}

}  // namespace

template <class G>
Figure bytes_sent(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  SvgPlot plot(page_width, 320.0);
  plot.x_label("time [s]");
  const std::size_t block = crowded(run) ? 10 : 1;
  plot.y_label(block == 1 ? "sent in each second [byte]" : "sent per second, mean of 10 s [byte]");
  plot.include({0.0, 0.0});
  for (const VehicleRecord<G>& vehicle : run.vehicles) {
    std::vector<Point> points;
    if (const auto it = evaluation.bytes_per_s.find(vehicle.id); it != evaluation.bytes_per_s.end())
      points = block_means(it->second, block);
    plot.line(points, {vehicle_color(run, vehicle.id), 1.3, "", 0.9}, vehicle_name(run, vehicle.id));
  }
  return {"Amount of data sent (paper, Fig. 13)", plot.svg(),
          "Bytes that each vehicle put on the network per second of vehicle time, as counted by its own process." +
              traffic_findings(run, evaluation)};
}

namespace {

// ---- Fig. 14 ----

constexpr double longest_step_s = 3.0;  // live poses come every second

void draw_distances(SvgPlot& plot, const PairSeries& pair, double width) {
  std::vector<Point> truth, raw, convoy;
  for (const DistanceSample& sample : pair.distances) {
    if (!truth.empty() && sample.t_s - truth.back().x() > longest_step_s)  // nothing known between: no line
      for (auto* line : {&truth, &raw, &convoy}) line->emplace_back(NAN, NAN);
    truth.emplace_back(sample.t_s, sample.true_m);
    raw.emplace_back(sample.t_s, sample.raw_m);
    convoy.emplace_back(sample.t_s, sample.convoy_m.value_or(NAN));
  }
  plot.x_label("time [s]");
  plot.y_label("distance [m]");
  plot.include({0.0, 0.0});
  plot.line(raw, {raw_color, width}, "SLAM alone, started in one place");
  plot.line(truth, {truth_color, width + 1.8}, "truth");
  plot.line(convoy, {convoy_color, width}, "convoy");
  if (pair.first_association_s) plot.vertical(*pair.first_association_s, {"#7b8794", 1.2, "4 3"}, "first association");
}

/// How well blue lies on black once vehicles are associated, and why lines have gaps.
template <class G>
std::string distance_findings(const Evaluation<G>& evaluation, const std::vector<const PairSeries*>& pairs) {
  std::string text;
  const auto range = [&evaluation](const char* key, int decimals) {
    json best, worst;
    for (const json& pair : evaluation.metrics.at("pairs"))
      if (const json& value = pair.at(key); value.is_number()) {
        if (best.is_null() || value < best) best = value;
        if (worst.is_null() || value > worst) worst = value;
      }
    if (!best.is_number()) return std::string();
    return fixed(best.get<double>(), decimals) + (worst == best ? "" : " to " + fixed(worst.get<double>(), decimals));
  };
  if (const std::string settled = range("distance_rmse_settled_m", 2); !settled.empty())
    text += " From ten seconds after the first association on, blue is off by " + settled + " m RMSE (" +
            range("distance_samples_settled", 0) +
            " samples of a pair); with the seconds in which the association is found and the map is built, by " +
            range("distance_rmse_m", 2) + " m RMSE (" + range("distance_samples", 0) + ").";
  const json& judged = evaluation.metrics.at("pairs");
  const auto few = std::count_if(judged.begin(), judged.end(), [](const json& pair) {
    return pair.at("first_association_s").is_number() && pair.at("distance_samples_settled") < enough_distance_samples;
  });
  if (few > 0)
    text += " Of " + std::to_string(few) + (few == 1 ? " pair" : " pairs") + " there are fewer than " +
            std::to_string(enough_distance_samples) +
            " samples from ten seconds after the first association on, too few to mean anything: the run ended soon "
            "after it, or the machine did not keep up with --rate.";
  std::size_t after = 0, not_aligned = 0, without_peer = 0, without_truth = 0;
  for (const PairSeries* pair : pairs) {
    for (const DistanceSample& sample : pair->distances) {
      if (!pair->first_association_s || sample.t_s < *pair->first_association_s) continue;
      ++after;
      not_aligned += !sample.convoy_m;
    }
    without_peer += pair->without_peer;
    without_truth += pair->without_truth;
  }
  const auto count = [](std::size_t n, const std::string& what) { return std::to_string(n) + " " + what; };
  if (not_aligned > 0)
    text += " Blue has a gap where the vehicle did not hold both poses in the common frame: " +
            count(not_aligned, "of the ") + count(after, "poses after the first association.");
  if (without_truth > 0 || without_peer > 0)
    text += " No line is drawn over " + std::to_string(static_cast<int>(longest_step_s)) +
            " s and more without a comparison: the truth has a gap at " + count(without_truth, "poses") +
            ", and nothing was heard of the other one within 1.5 s of " + count(without_peer, "poses.");
  return text;
}

}  // namespace

template <class G>
Figure distances(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  Figure figure;
  figure.title = "Distance between vehicles (paper, Fig. 14)";
  std::vector<const PairSeries*> drawable;
  for (const PairSeries& pair : evaluation.pairs)
    if (!pair.distances.empty()) drawable.push_back(&pair);
  if (drawable.empty()) {
    figure.caption =
        "No pair of vehicles with a true distance: the data set has no pose truth, or nothing was exchanged.";
    return figure;
  }
  const auto name_of = [&run](const PairSeries& pair) {
    return vehicle_name(run, pair.a) + " and " + vehicle_name(run, pair.b);
  };
  SvgPlot first(page_width, 360.0);
  first.title(name_of(*drawable.front()));
  draw_distances(first, *drawable.front(), 1.5);
  figure.body = first.svg();
  std::string cells;
  for (std::size_t i = 1; i < drawable.size(); ++i) {
    SvgPlot plot(small_width, 220.0);
    plot.title(name_of(*drawable[i]));
    plot.no_legend();
    draw_distances(plot, *drawable[i], 1.0);
    cells += cell(plot.svg(), "third");
  }
  if (!cells.empty()) figure.body += row_of(cells);
  figure.caption =
      "What the first of the two says live about its distance to the other one (blue) against the truth (black); red "
      "is "
      "what the two SLAMs give without any exchange. The two poses are those that the vehicle has at the time, up to "
      "1.5 s "
      "apart, and the truth is taken at the same two moments." +
      distance_findings(evaluation, drawable);
  return figure;
}

namespace {

// ---- consistency ----

}  // namespace

template <class G>
Figure consistency(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  SvgPlot plot(page_width, 340.0);
  plot.x_label("time [s]");
  plot.y_label("NEES of the live pose");
  plot.log_y(0.01);
  const double low = chi2_quantile(0.025, G::Dof), high = chi2_quantile(0.975, G::Dof);
  plot.band(low, high, {"#2f9e63", 1.0, "", 0.13}, "95 % of a consistent estimate");
  plot.include({0.0, 0.05});
  plot.include({0.0, 20.0});
  bool any = false;
  for (const VehicleRecord<G>& vehicle : run.vehicles) {
    std::vector<Point> points;
    if (const auto it = evaluation.live_nees.find(vehicle.id); it != evaluation.live_nees.end())
      for (const TimedValue& sample : it->second) {
        if (!points.empty() && sample.t_s - points.back().x() > longest_step_s) points.emplace_back(NAN, NAN);
        points.emplace_back(sample.t_s, sample.value);
      }
    any = any || !points.empty();
    plot.line(points, {vehicle_color(run, vehicle.id), 1.3, "", 0.9}, vehicle_name(run, vehicle.id));
  }
  Figure figure{
      "Consistency over time", plot.svg(),
      "Normalised squared error of each vehicle's own live pose in the common frame (" + std::to_string(G::Dof) +
          " degrees of freedom, "
          "logarithmic); above the band the vehicle is surer of itself than it may be, below it is more cautious "
          "than needed." +
          (evaluation.metrics.at("gauge") != json("fit")
               ? ""
               : " Judged in gauge fit, which counts against the first poses of " +
                     the_vehicle(run, run.common_frame_vehicle) + ": see below the table of vehicles.")};
  if (!any) figure = {figure.title, "", without_judgement(run, "the live poses").substr(1)};
  return figure;
}

#define CONVOY_INSTANTIATE(G)                                            \
  template Figure bytes_sent(const RunRecord<G>&, const Evaluation<G>&); \
  template Figure distances(const RunRecord<G>&, const Evaluation<G>&);  \
  template Figure consistency(const RunRecord<G>&, const Evaluation<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli::figures
