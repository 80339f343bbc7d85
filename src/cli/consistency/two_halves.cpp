#include "consistency/two_halves.hpp"

#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <convoy/map/global_map.hpp>
#include <convoy/map/sparse_map.hpp>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>

#include "consistency/draw.hpp"

namespace convoy::cli::consistency {
namespace {

constexpr double anchor_every_m = 25.0;
constexpr int points_per_loop = 6;
constexpr double point_radius_m = 8.0;
constexpr double point_sigma_m = 0.002;  // a landmark's own error: the edge is what is uncertain
constexpr double known_sigma_m = 0.01, known_sigma_rad = 0.001;  // the first start
constexpr double start_sigma_m = 9.0, start_sigma_rad = 0.3;     // the second: 95 % within 22 m
constexpr std::uint64_t start_seed = 1;

SE2 measured(const G2oFile::Edge& edge) { return {edge.measured[0], edge.measured[1], edge.measured[2]}; }
bool is_loop(const G2oFile::Edge& edge) { return edge.to != edge.from + 1; }

// One vehicle: frames [begin, end) of the drive.
struct Half {
  ChainId chain;
  std::size_t begin = 0, end = 0;
  Recording<SE2> recording;  // in its own start frame
};

std::array<Half, 2> cut(const Recording<SE2>& whole) {
  const std::size_t end = whole.truth.size(), middle = end / 2;
  return {Half{{1, 1}, 0, middle, chain_of(whole, 0, middle)}, Half{{2, 1}, middle, end, chain_of(whole, middle, end)}};
}

// The facts of both vehicles under one drift model.
class Facts {
 public:
  Facts(const RealGraph& graph, const std::array<Half, 2>& halves, const DriftParams<SE2>& drift, bool start_known)
      : graph_(graph), halves_(halves) {
    const SE2 to_common = graph.odometry.truth.front().inverse();
    for (const Half& half : halves_) tracks.push_back(drive(half, drift, to_common, start_known));
    for (const G2oFile::Edge& edge : graph_.graph.edges)
      if (is_loop(edge)) see(edge);
    insert_batches();
  }

  FactStore<SE2> store;
  std::vector<TrueTrack<SE2>> tracks;  // at the regular anchors
  int stated = 0;

 private:
  const Half& half_of(int frame) const { return halves_[static_cast<std::size_t>(frame) < halves_[1].begin ? 0 : 1]; }

  void insert(const auto& fact) {
    if (store.insert(fact) != Insertion::inserted)
      throw std::logic_error("consistency: a fact of " + graph_.name + " was refused");
  }

  // Anchors every 25 m and where loop edges end. Landmarks follow when all edges have been read.
  TrueTrack<SE2> drive(const Half& half, const DriftParams<SE2>& drift, const SE2& to_common, bool start_known) {
    const Key origin{half.chain, 0};
    PriorFact<SE2> prior{origin, half.begin == 0 || start_known, SE2()};
    if (prior.known) {
      const bool first = half.begin == 0;
      const Eigen::Vector3d sigma = first ? Eigen::Vector3d(known_sigma_m, known_sigma_m, known_sigma_rad)
                                          : Eigen::Vector3d(start_sigma_m, start_sigma_m, start_sigma_rad);
      prior.covariance = sigma.cwiseAbs2().asDiagonal();
      prior.mean = to_common * half.recording.truth.front();
      Draw draw(start_seed, 0, 2);
      if (!first) prior.mean = prior.mean * SE2::Exp(-sigma.cwiseProduct(draw.unit_normal<3>()));
    }
    prior.persistent = drift.persistent;
    insert(prior);
    std::set<std::size_t> at_loops;
    for (const G2oFile::Edge& edge : graph_.graph.edges)
      if (is_loop(edge)) at_loops.insert({static_cast<std::size_t>(edge.from), static_cast<std::size_t>(edge.to)});
    TrueTrack<SE2> track{half.chain, prior, {}};
    DriftAccumulator<SE2> accumulator(drift);
    double next_anchor_m = 0.0;
    for (std::size_t k = 0; k < half.recording.truth.size(); ++k) {
      const ChainState<SE2>& s = half.recording.slam.states[k];
      const ChainState<SE2> state = accumulator.advance(s.stamp_s, s.abscissa_m, s.pose, SE2::Covariance::Zero());
      const bool regular = state.abscissa_m >= next_anchor_m;
      if (!regular && !at_loops.count(half.begin + k)) continue;
      auto& anchors = anchors_[half.chain];
      anchors.push_back({{half.chain, static_cast<std::uint32_t>(anchors.size())}, k == 0 ? ChainState<SE2>{} : state});
      anchor_of_[static_cast<int>(half.begin + k)] = anchors.back().key;
      if (!regular) continue;
      next_anchor_m += anchor_every_m;
      if (k > 0) track.steps.push_back({state, to_common * half.recording.truth[k]});
    }
    return track;
  }

  // Points around the pose that the edge leads to: exact there, and where the edge begins as uncertain as the edge is.
  void see(const G2oFile::Edge& edge) {
    const SE2 z = measured(edge);
    const SE2::Covariance covariance = edge.information.inverse();
    const Eigen::Matrix3d root = Eigen::LLT<Eigen::Matrix3d>(covariance).matrixL();
    std::vector<Pairing> pairs;
    for (int i = 0; i < points_per_loop; ++i) {
      const double angle = 2.0 * M_PI * i / points_per_loop;
      const SE2::Point p = point_radius_m * SE2::Point(std::cos(angle), std::sin(angle));
      LandmarkFact<SE2> there = landmark(p), here = landmark(z * p);
      here.loading.leftCols<3>() = z.act_jacobian(p) * root;
      here.covariance = symmetrised(SE2::PointCovariance(here.covariance + here.loading * here.loading.transpose()));
      pairs.push_back({batch(edge.from, here), batch(edge.to, there)});
    }
    loops_.push_back(std::move(pairs));
  }

  static LandmarkFact<SE2> landmark(const SE2::Point& p) {
    LandmarkFact<SE2> l;
    l.position = p;
    l.covariance = point_sigma_m * point_sigma_m * SE2::PointCovariance::Identity();
    return l;
  }

  // A landmark of the batch at `frame`; its key is settled once all batches are full: until then (anchor, place in
  // batch).
  Key batch(int frame, const LandmarkFact<SE2>& l) {
    const Key anchor = anchor_of_.at(frame);
    auto& landmarks = batches_[anchor];
    landmarks.push_back(l);
    return {anchor.chain, anchor.index * batch_limit + static_cast<std::uint32_t>(landmarks.size() - 1)};
  }

  void insert_batches() {
    std::map<Key, Key> settled;
    for (auto& [chain, anchors] : anchors_) {
      std::uint32_t next = 0;
      for (AnchorFact<SE2>& anchor : anchors) {
        auto& landmarks = batches_[anchor.key];
        anchor.first_landmark = next;
        anchor.landmark_count = static_cast<std::uint32_t>(landmarks.size());
        insert(anchor);
        for (std::size_t i = 0; i < landmarks.size(); ++i) {
          landmarks[i].key = {chain, next++};
          landmarks[i].anchor = anchor.key.index;
          settled[{chain, anchor.key.index * batch_limit + static_cast<std::uint32_t>(i)}] = landmarks[i].key;
          insert(landmarks[i]);
        }
      }
    }
    for (std::vector<Pairing>& pairs : loops_) {
      for (auto& [a, b] : pairs) a = settled.at(a), b = settled.at(b);
      insert(AssociationFact{{halves_[0].chain, static_cast<std::uint32_t>(stated++)}, canonical(std::move(pairs))});
    }
  }

  static constexpr std::uint32_t batch_limit = 1000;
  const RealGraph& graph_;
  const std::array<Half, 2>& halves_;
  std::map<ChainId, std::vector<AnchorFact<SE2>>> anchors_;
  std::map<int, Key> anchor_of_;  // by frame
  std::map<Key, std::vector<LandmarkFact<SE2>>> batches_;
  std::vector<std::vector<Pairing>> loops_;
};

double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

LoopQuality quality_of(const RealGraph& graph, std::size_t middle) {
  LoopQuality q;
  std::vector<double> metres, radians, stated;
  for (const G2oFile::Edge& edge : graph.graph.edges) {
    if (!is_loop(edge)) continue;
    const auto from = static_cast<std::size_t>(edge.from), to = static_cast<std::size_t>(edge.to);
    const SE2& T_from = graph.odometry.truth[from];
    const SE2& T_to = graph.odometry.truth[to];
    const SE2::Tangent r = (measured(edge).inverse() * T_from.inverse() * T_to).Log();
    metres.push_back(r.head<2>().norm());
    radians.push_back(std::abs(r[2]));
    stated.push_back(std::sqrt(0.5 * edge.information.inverse().topLeftCorner(2, 2).trace()));
    q.anees += r.dot(edge.information * r) / 3.0;
    ++q.edges;
    q.crossing += (from < middle) != (to < middle) ? 1 : 0;
  }
  q.anees /= std::max(1, q.edges);
  q.worst_error_m = metres.empty() ? 0.0 : *std::max_element(metres.begin(), metres.end());
  q.median_error_m = median(metres);
  q.median_error_rad = median(radians);
  q.stated_sigma_m = median(stated);
  return q;
}

void judge_into(HalvesRow& row, const RunSample& sample) {
  const double limit = chi2_quantile(0.95, SE2::Dof);
  std::array<double, 2> nees{}, count{};
  double squared = 0.0, inside = 0.0;
  row.nees.resize(2);
  for (const PoseSample& p : sample.poses) {
    const auto v = static_cast<std::size_t>(p.vehicle);
    nees[v] += p.squared_distance / SE2::Dof;
    count[v] += 1.0;
    squared += p.position_error_m * p.position_error_m;
    inside += p.squared_distance <= limit ? 1.0 : 0.0;
    row.nees[v].emplace_back(p.abscissa_m, p.squared_distance / SE2::Dof);
  }
  const double n = std::max(1.0, count[0] + count[1]);
  row.ate_m = std::sqrt(squared / n);
  row.coverage95 = inside / n;
  row.anees = (nees[0] + nees[1]) / n;
  row.first_anees = nees[0] / std::max(1.0, count[0]);
  row.second_anees = nees[1] / std::max(1.0, count[1]);
  double distance = 0.0;
  for (const double e : sample.distance_errors_m) distance += e * e;
  row.distance_rmse_m =
      std::sqrt(distance / std::max<double>(1.0, static_cast<double>(sample.distance_errors_m.size())));
}

HalvesRow dead_reckoned(const std::string& model, const Facts& facts) {
  HalvesRow row;
  row.model = model;
  row.start = "22 m, 0.3 rad";
  judge_into(row, judge_raw(facts.tracks));
  for (const TrueTrack<SE2>& track : facts.tracks) {
    row.paths.emplace_back();
    for (const TrueStep<SE2>& step : track.steps)
      row.paths.back().push_back((track.start.mean * step.state.pose).translation());
  }
  return row;
}

HalvesRow fused(const std::string& model, const Facts& facts, bool start_known) {
  HalvesRow row;
  row.model = model;
  row.start = start_known ? "22 m, 0.3 rad" : "unknown";
  row.fused = true;
  const SparseMap<SE2> backend;
  const GlobalMap<SE2> built = build_global_map(facts.store, SelectionParams{}, backend);
  row.linked = true;
  for (const TrueTrack<SE2>& track : facts.tracks) row.linked = row.linked && built.map->aligned(track.chain);
  std::map<std::string, int> left_out;
  bool crosses = false;
  for (const Hypothesis<SE2>& h : built.selection.hypotheses) {
    const bool accepted = h.state == HypothesisState::accepted;
    row.accepted += accepted ? 1 : 0;
    crosses = crosses || (accepted && h.batch_a.chain != h.batch_b.chain);
    if (!accepted) ++left_out[to_string(h.state)];
  }
  row.linked = row.linked && crosses;
  row.stated = facts.stated;
  for (const auto& [why, count] : left_out)
    row.left_out += (row.left_out.empty() ? "" : ", ") + std::to_string(count) + " " + why;
  judge_into(row, judge(*built.map, facts.tracks));
  for (const TrueTrack<SE2>& track : facts.tracks) {
    row.paths.emplace_back();
    for (const TrueStep<SE2>& step : track.steps)
      row.paths.back().push_back(built.map->pose(track.chain, step.state).value().mean.translation());
  }
  return row;
}

}  // namespace

HalvesStudy study_halves(const RealGraph& graph, const std::vector<RealGraph>& others) {
  HalvesStudy study;
  study.name = graph.name;
  std::vector<Recording<SE2>> calibration;
  for (const RealGraph& other : others)
    for (Half& half : cut(other.odometry)) {
      half.recording.name += half.begin == 0 ? " (1st half)" : " (2nd half)";
      calibration.push_back(std::move(half.recording));
    }
  const FittedModels<SE2> fitted = fit_models(calibration);
  study.fit = figures_of(fitted);
  study.length_m = graph.odometry.slam.states.back().abscissa_m;
  study.loops = quality_of(graph, graph.odometry.truth.size() / 2);
  const std::array<Half, 2> halves = cut(graph.odometry);
  for (const SpanModel<SE2>& model : fitted.models) {
    DriftParams<SE2> drift = model.drift;
    drift.persistent.scale = std::sqrt(model.constants[0]);
    drift.persistent.heading_rad_per_m = std::sqrt(model.constants[1]);
    const Facts facts(graph, halves, drift, true);
    if (!drift.persistent.constant())  // a covariance of its own states no constants
      study.rows.push_back(dead_reckoned("dead reckoning, " + model.name, facts));
    study.rows.push_back(fused(model.name, facts, true));
    study.rows.push_back(fused(model.name, Facts(graph, halves, drift, false), false));
    if (!study.truth.empty()) continue;
    for (const TrueTrack<SE2>& track : facts.tracks) {
      study.truth.emplace_back();
      for (const TrueStep<SE2>& step : track.steps) study.truth.back().push_back(step.T_common_body.translation());
      study.anchors += static_cast<int>(track.steps.size());
    }
  }
  return study;
}

}  // namespace convoy::cli::consistency
