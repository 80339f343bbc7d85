#include "evaluate/evaluate.hpp"

#include <algorithm>
#include <cmath>
#include <convoy/geometry/chi2.hpp>
#include <convoy/geometry/covariance.hpp>
#include <cstdio>
#include <set>

#include "evaluate/judge_associations.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {
using nlohmann::json;
namespace {

constexpr double stamp_tolerance_s = 1.5;  // a peer's pose belongs to an own pose if their stamps are this near
constexpr double settling_s = 10.0;        // distance_rmse_settled_m begins this long after the first association

json or_null(const std::optional<double>& value) { return value && std::isfinite(*value) ? json(*value) : json(); }

template <class G>
json from_summary(const VehicleRecord<G>& vehicle, const char* key) {
  if (!vehicle.summary.is_object() || !vehicle.summary.contains(key)) return nullptr;
  return vehicle.summary.at(key);
}

/// Collects squares, gives their root mean.
class RootMeanSquare {
 public:
  void add_square(double square) {
    sum_ += square;
    ++count_;
  }
  void add(double error) { add_square(error * error); }
  std::optional<double> value() const {
    if (count_ == 0) return std::nullopt;
    return std::sqrt(sum_ / static_cast<double>(count_));
  }
  std::size_t count() const { return count_; }

 private:
  double sum_ = 0.0;
  std::size_t count_ = 0;
};

/// NEES of a set of poses. Poses without a usable covariance are counted apart.
template <class G>
struct Consistency {
  double sum = 0.0;
  std::size_t count = 0, covered = 0, without_covariance = 0;
  std::vector<TimedValue> series;

  void add(double t_s, const PoseEstimate<G>& estimate, const G& T_common_true) {
    static const double bound = chi2_quantile(0.95, G::Dof);
    const typename G::Tangent r = (estimate.T.inverse() * T_common_true).Log();
    const double nees = squared_mahalanobis(r, estimate.P);
    if (!std::isfinite(nees)) {
      ++without_covariance;
      return;
    }
    sum += nees;
    ++count;
    covered += nees <= bound;
    series.push_back({t_s, nees});
  }
  void add(const Consistency& other) {
    sum += other.sum;
    count += other.count;
    covered += other.covered;
    without_covariance += other.without_covariance;
  }
  json anees() const { return count == 0 ? json() : json(sum / (G::Dof * static_cast<double>(count))); }
  json coverage95() const {
    return count == 0 ? json() : json(static_cast<double>(covered) / static_cast<double>(count));
  }
};

/// A way to express the truth in the common frame.
template <class G>
struct Gauge {
  const char* name;
  std::optional<G> T_world_common;
  const std::map<VehicleId, TruthMount>* mounts = nullptr;  ///< if set, taken off the truth
};

/// Judges what a vehicle said of itself in a gauge; what it said of its peers is skipped.
template <class G>
Consistency<G> judge(const RunRecord<G>& run, const VehicleRecord<G>& vehicle, const std::vector<PoseRow<G>>& rows,
                     const Gauge<G>& gauge) {
  Consistency<G> result;
  if (!gauge.T_world_common || run.pose_tolerance) return result;  // a coarse truth says nothing of covariances
  G T_truth_body;
  if (gauge.mounts) {
    const auto mount = gauge.mounts->find(vehicle.id);
    if (mount == gauge.mounts->end()) return result;
    if constexpr (G::Dim == 2) T_truth_body = mount->second.T_body_truth().inverse();
  }
  const G T_common_world = gauge.T_world_common->inverse();
  for (const PoseRow<G>& row : rows) {
    if (row.vehicle != vehicle.id || !row.common) continue;
    if (const auto T_world_truth = truth_at(vehicle.truth, row.t_s))
      result.add(row.t_s, *row.common, T_common_world * *T_world_truth * T_truth_body);
  }
  return result;
}

template <class G>
std::optional<G> gauge_at_start(const RunRecord<G>& run) {
  const VehicleRecord<G>* vehicle = run.find(run.common_frame_vehicle);
  const auto first = run.first_event_s.find(run.common_frame_vehicle);
  if (!vehicle || first == run.first_event_s.end()) return std::nullopt;
  return truth_at(vehicle->truth, first->second);
}

template <class G>
struct FleetFit {
  std::optional<RigidFit<G>> fit;
  std::map<VehicleId, double> ate_m;
};

/// One rigid motion for the corrected trajectories of the whole fleet, and what is left of the position error.
template <class G>
FleetFit<G> fit_fleet(const RunRecord<G>& run) {
  std::vector<typename G::Point> estimated, truth;
  std::vector<VehicleId> owner;
  for (const VehicleRecord<G>& vehicle : run.vehicles)
    for (const PoseRow<G>& row : vehicle.trajectory) {
      if (!row.common) continue;
      const auto T_world_body = truth_at(vehicle.truth, row.t_s);
      if (!T_world_body) continue;
      estimated.push_back(row.common->T.translation());
      truth.push_back(T_world_body->translation());
      owner.push_back(vehicle.id);
    }
  FleetFit<G> result{fit_rigid<G>(estimated, truth), {}};
  if (!result.fit) return result;
  std::map<VehicleId, RootMeanSquare> errors;
  for (std::size_t i = 0; i < owner.size(); ++i)
    errors[owner[i]].add_square((result.fit->T_to_from * estimated[i] - truth[i]).squaredNorm());
  for (const auto& [id, error] : errors) result.ate_m[id] = *error.value();
  return result;
}

/// The landmarks of the map, by the labels of their authors, fitted rigidly to the true ones.
template <class G>
std::optional<RigidFit<G>> fit_landmarks(const RunRecord<G>& run) {
  const VehicleRecord<G>* judge_of = run.first_survivor();
  if (!judge_of) return std::nullopt;
  std::map<std::uint32_t, typename G::Point> truth_of;
  for (const TruthLandmark<G>& landmark : run.landmarks) truth_of[landmark.id] = landmark.p_world_m;
  std::set<ChainId> aligned;
  for (const MapChain& chain : judge_of->map->chains)
    if (chain.aligned) aligned.insert(chain.chain);
  std::vector<typename G::Point> estimated, truth;
  for (const MapLandmark<G>& landmark : judge_of->map->landmarks) {
    const VehicleRecord<G>* author = run.find(landmark.key.chain.vehicle);
    if (!author || !landmark.p_common_m || !aligned.contains(landmark.key.chain)) continue;
    const auto track = author->track_of_landmark.find({landmark.key.chain.epoch, landmark.key.index});
    if (track == author->track_of_landmark.end() || !truth_of.contains(track->second)) continue;
    estimated.push_back(*landmark.p_common_m);
    truth.push_back(truth_of.at(track->second));
  }
  return fit_rigid<G>(estimated, truth);
}

/// The cumulative counter at whole seconds, by linear interpolation; a process that started again counts on.
std::vector<TimedValue> bytes_by_second(const std::vector<TrafficRow>& traffic) {
  if (traffic.empty()) return {};
  std::vector<TimedValue> total{{std::min(0.0, traffic.front().t_s), 0.0}};
  double before_restart = 0.0, last = 0.0;
  for (const TrafficRow& row : traffic) {
    if (row.bytes_sent < last) before_restart += last;
    last = row.bytes_sent;
    total.push_back({row.t_s, before_restart + last});
  }
  std::vector<TimedValue> result;
  std::size_t i = 0;
  double previous = 0.0;
  for (double t = std::floor(total.front().t_s) + 1.0; t < total.back().t_s + 1.0; t += 1.0) {
    while (i + 1 < total.size() && total[i + 1].t_s < t) ++i;
    double value = total.back().value;
    if (i + 1 < total.size()) {
      const double span = total[i + 1].t_s - total[i].t_s;
      const double share = span > 0.0 ? (t - total[i].t_s) / span : 1.0;
      value = total[i].value + share * (total[i + 1].value - total[i].value);
    }
    result.push_back({t, value - previous});
    previous = value;
  }
  return result;
}

// ---- pairs ----

template <class G>
const PoseRow<G>* nearest(const std::vector<const PoseRow<G>*>& rows, double t_s) {
  auto after =
      std::lower_bound(rows.begin(), rows.end(), t_s, [](const PoseRow<G>* row, double t) { return row->t_s < t; });
  const PoseRow<G>* best = nullptr;
  if (after != rows.end()) best = *after;
  if (after != rows.begin() && (!best || t_s - (*std::prev(after))->t_s <= best->t_s - t_s)) best = *std::prev(after);
  return best && std::abs(best->t_s - t_s) <= stamp_tolerance_s ? best : nullptr;
}

template <class G>
std::vector<const PoseRow<G>*> rows_of(const VehicleRecord<G>& viewer, VehicleId id) {
  std::vector<const PoseRow<G>*> rows;
  for (const PoseRow<G>& row : viewer.live)
    if (row.vehicle == id) rows.push_back(&row);
  std::stable_sort(rows.begin(), rows.end(), [](const auto* a, const auto* b) { return a->t_s < b->t_s; });
  return rows;
}

template <class G>
double between(const G& a, const G& b) {
  return (a.translation() - b.translation()).norm();
}

/// The distance between `viewer` and `other`, second by second, as the viewer saw it; what it did not see is counted.
template <class G>
PairSeries distances(const VehicleRecord<G>& viewer, const VehicleRecord<G>& other) {
  const auto own_rows = rows_of(viewer, viewer.id), other_rows = rows_of(viewer, other.id);
  PairSeries series;
  for (const PoseRow<G>* own : own_rows) {
    const PoseRow<G>* peer = nearest(other_rows, own->t_s);
    if (!peer || !own->slam || !peer->slam) {
      ++series.without_peer;
      continue;
    }
    const auto own_truth = truth_at(viewer.truth, own->t_s), peer_truth = truth_at(other.truth, peer->t_s);
    if (!own_truth || !peer_truth) {
      ++series.without_truth;
      continue;
    }
    DistanceSample sample{own->t_s, between(*own_truth, *peer_truth), between(own->slam->T, peer->slam->T), {}};
    if (own->common && peer->common) sample.convoy_m = between(own->common->T, peer->common->T);
    series.distances.push_back(sample);
  }
  return series;
}

/// The corrected pose at t, between the two neighbouring rows. Empty outside of the trajectory, and where a neighbour
/// is not aligned.
template <class G>
std::optional<G> corrected_at(const std::vector<PoseRow<G>>& trajectory, double t_s) {
  const auto after = std::lower_bound(trajectory.begin(), trajectory.end(), t_s,
                                      [](const PoseRow<G>& row, double t) { return row.t_s < t; });
  if (after == trajectory.end() || !after->common) return std::nullopt;
  if (after->t_s == t_s) return after->common->T;
  if (after == trajectory.begin() || !std::prev(after)->common) return std::nullopt;
  const PoseRow<G>& before = *std::prev(after);
  return interpolated(before.common->T, after->common->T, (t_s - before.t_s) / (after->t_s - before.t_s));
}

/// What the distance is off by at each row of `own`, the other vehicle's pose taken at the same moment.
template <class G>
void add_corrected_errors(const VehicleRecord<G>& own, const VehicleRecord<G>& other, RootMeanSquare& errors) {
  for (const PoseRow<G>& row : own.trajectory) {
    if (!row.common) continue;
    const auto peer = corrected_at(other.trajectory, row.t_s);
    const auto own_truth = truth_at(own.truth, row.t_s), peer_truth = truth_at(other.truth, row.t_s);
    if (peer && own_truth && peer_truth) errors.add(between(row.common->T, *peer) - between(*own_truth, *peer_truth));
  }
}

bool links(const MapAssociation& association, VehicleId a, VehicleId b) {
  return std::any_of(association.pairings.begin(), association.pairings.end(), [&](const Pairing& p) {
    const VehicleId first = p.first.chain.vehicle, second = p.second.chain.vehicle;
    return (first == a && second == b) || (first == b && second == a);
  });
}

template <class G>
std::optional<double> first_direct_association(const MapRecord<G>& map, VehicleId a, VehicleId b) {
  for (const MapAssociation* association : accepted_by_time(map))
    if (links(*association, a, b)) return association->t_s;
  return std::nullopt;
}

/// When a and b are first linked, be it through other vehicles. `confirmed`: accepted hypotheses that it takes between
/// two vehicles.
template <class G>
std::optional<double> linked_s(const MapRecord<G>& map, VehicleId a, VehicleId b, int confirmed) {
  std::map<VehicleId, VehicleId> group;  // vehicle -> name of its group
  std::map<std::pair<VehicleId, VehicleId>, int> count;
  const auto group_of = [&group](VehicleId id) { return group.emplace(id, id).first->second; };
  for (const MapAssociation* association : accepted_by_time(map)) {
    if (association->pairings.empty()) continue;
    const Pairing& p = association->pairings.front();
    const VehicleId first = p.first.chain.vehicle, second = p.second.chain.vehicle;
    if (++count[std::minmax(first, second)] < confirmed) continue;
    const VehicleId keep = group_of(first), gone = group_of(second);
    for (auto& [id, name] : group)
      if (name == gone) name = keep;
    if (group_of(a) == group_of(b)) return association->t_s;
  }
  return std::nullopt;
}

/// A first hypothesis waits for a second one, unless the starts are known well (SelectionParams::min_confirmed).
template <class G>
std::optional<double> first_association(const MapRecord<G>& map, VehicleId a, VehicleId b) {
  const auto confirmed = linked_s(map, a, b, 2);
  return confirmed ? confirmed : linked_s(map, a, b, 1);
}

/// What one pair's live distances are off by, over three spans of time.
struct DistanceErrors {
  RootMeanSquare raw, raw_after,
      raw_settled;                // each vehicle's SLAM alone: all, and at the very samples of the next two
  RootMeanSquare after, settled;  // in the common frame, from the first association on, and 10 s later on
  std::optional<double> final, final_s;

  void add(const DistanceSample& sample, const std::optional<double>& first_association_s) {
    const double raw_error = sample.raw_m - sample.true_m;
    raw.add(raw_error);
    if (!sample.convoy_m || !first_association_s || sample.t_s < *first_association_s) return;
    const double error = *sample.convoy_m - sample.true_m;
    raw_after.add(raw_error);
    after.add(error);
    if (!final_s || sample.t_s > *final_s) {
      final = std::abs(error);
      final_s = sample.t_s;
    }
    if (sample.t_s < *first_association_s + settling_s) return;
    raw_settled.add(raw_error);
    settled.add(error);
  }
};

template <class G>
json judge_pair(const RunRecord<G>& run, const VehicleRecord<G>& a, const VehicleRecord<G>& b, PairSeries& series) {
  const VehicleRecord<G>* survivor = run.first_survivor();
  if (survivor) series.first_association_s = first_association(*survivor->map, a.id, b.id);
  RootMeanSquare corrected;
  DistanceErrors live;
  for (const auto& [viewer, other] : {std::pair(&a, &b), std::pair(&b, &a)}) {
    add_corrected_errors(*viewer, *other, corrected);
    const PairSeries seen = distances(*viewer, *other);
    for (const DistanceSample& sample : seen.distances) live.add(sample, series.first_association_s);
    if (series.distances.empty()) {
      series.distances = seen.distances;
      series.without_peer = seen.without_peer;
      series.without_truth = seen.without_truth;
    }
  }
  return {
      {"a", a.id},
      {"b", b.id},
      {"first_association_s", or_null(series.first_association_s)},
      {"first_direct_association_s", survivor ? or_null(first_direct_association(*survivor->map, a.id, b.id)) : json()},
      {"distance_rmse_raw_m", or_null(live.raw.value())},
      {"distance_samples_raw", live.raw.count()},
      {"distance_rmse_m", or_null(live.after.value())},
      {"distance_rmse_raw_after_m", or_null(live.raw_after.value())},
      {"distance_samples", live.after.count()},
      {"distance_rmse_settled_m", or_null(live.settled.value())},
      {"distance_rmse_raw_settled_m", or_null(live.raw_settled.value())},
      {"distance_samples_settled", live.settled.count()},
      {"distance_rmse_corrected_m", or_null(corrected.value())},
      {"distance_samples_corrected", corrected.count()},
      {"distance_error_final_m", or_null(live.final)},
      {"distance_error_final_s", or_null(live.final_s)}};
}

// ---- the fleet as a whole ----

template <class G>
json map_digests_equal(const RunRecord<G>& run) {
  std::set<std::string> digests;
  for (const VehicleRecord<G>& vehicle : run.vehicles) {
    if (vehicle.lost) continue;
    const json digest = from_summary(vehicle, "map_digest");
    if (!digest.is_string()) return nullptr;
    digests.insert(digest.get<std::string>());
  }
  return digests.empty() ? json() : json(digests.size() == 1);
}

/// Not there when the run ended: declared missing by then, or not yet.
template <class G>
json facts_lost(const RunRecord<G>& run) {
  json sum;
  for (const VehicleRecord<G>& vehicle : run.vehicles) {
    if (vehicle.lost) continue;
    const json missing = from_summary(vehicle, "facts_missing"), declared = from_summary(vehicle, "facts_lost");
    if (!missing.is_number()) return nullptr;
    sum = (sum.is_null() ? 0 : sum.get<std::int64_t>()) + missing.get<std::int64_t>() +
          (declared.is_number() ? declared.get<std::int64_t>() : 0);
  }
  return sum;
}

/// True if accepted pairings between vehicles link every vehicle with every other, be it through a third.
template <class G>
json all_linked(const RunRecord<G>& run) {
  const VehicleRecord<G>* survivor = run.first_survivor();
  if (!survivor) return nullptr;
  std::map<VehicleId, VehicleId> group;  // vehicle -> name of its group
  const auto group_of = [&group](VehicleId id) { return group.emplace(id, id).first->second; };
  for (const MapAssociation* association : accepted_by_time(*survivor->map))
    for (const Pairing& p : association->pairings) {
      const VehicleId keep = group_of(p.first.chain.vehicle), gone = group_of(p.second.chain.vehicle);
      for (auto& [id, name] : group)
        if (name == gone) name = keep;
    }
  return std::all_of(run.vehicles.begin(), run.vehicles.end(),
                     [&](const auto& v) { return group_of(v.id) == group_of(run.vehicles.front().id); });
}

/// True if the final map has every vehicle's chains in the common frame, be it by their static biases alone.
template <class G>
json all_in_common_frame(const RunRecord<G>& run) {
  const VehicleRecord<G>* survivor = run.first_survivor();
  if (!survivor) return nullptr;
  std::set<VehicleId> aligned;
  for (const MapChain& chain : survivor->map->chains) {
    if (!chain.aligned) return false;
    aligned.insert(chain.chain.vehicle);
  }
  return std::all_of(run.vehicles.begin(), run.vehicles.end(), [&](const auto& v) { return aligned.contains(v.id); });
}

/// One map, shared: equal on every vehicle, all in its frame, and linked by landmarks that were found to be the same.
template <class G>
json all_aligned(const RunRecord<G>& run) {
  const json parts[] = {all_in_common_frame(run), all_linked(run), map_digests_equal(run)};
  for (const json& part : parts)
    if (part == json(false)) return false;
  for (const json& part : parts)
    if (part.is_null()) return nullptr;
  return true;
}

template <class G>
json info_or_null(const RunRecord<G>& run, const char* key) {
  return run.info.contains(key) ? run.info.at(key) : json();
}

template <class G>
json real_time_factor(const RunRecord<G>& run) {
  const json wall = info_or_null(run, "wall_s"), vehicle = info_or_null(run, "vehicle_s");
  if (!wall.is_number() || !vehicle.is_number() || wall.get<double>() <= 0.0) return nullptr;
  return vehicle.get<double>() / wall.get<double>();
}

template <class G>
json front_end(const RunRecord<G>& run) {
  std::vector<FrontEndDrive> drives;
  for (const VehicleRecord<G>& vehicle : run.vehicles) drives.push_back({vehicle.front_end, in_space(vehicle.truth)});
  return judge_front_ends(drives);
}

json rates(const std::vector<TimedValue>& by_second, double last_t_s) {
  if (by_second.empty() || last_t_s <= 0.0) return {{"mean", nullptr}, {"max", nullptr}};
  double sum = 0.0, worst = 0.0;
  for (const TimedValue& second : by_second) {
    sum += second.value;
    worst = std::max(worst, second.value);
  }
  return {{"mean", sum / last_t_s}, {"max", worst}};
}

}  // namespace

template <class G>
Evaluation<G> evaluate(const RunRecord<G>& run) {
  Evaluation<G> result;
  const FleetFit<G> fleet = fit_fleet(run);
  const std::optional<RigidFit<G>> landmark_fit = fit_landmarks(run);
  std::map<VehicleId, TruthMount> mounts;
  if constexpr (G::Dim == 2)
    for (const VehicleRecord<G>& vehicle : run.vehicles)
      if (const auto mount = run.pose_tolerance ? std::nullopt : find_truth_mount(vehicle.truth))
        mounts[vehicle.id] = *mount;

  const std::optional<G> fitted = fleet.fit ? std::optional(fleet.fit->T_to_from) : std::nullopt;
  const Gauge<G> gauges[] = {{"start", gauge_at_start(run)}, {"fit", fitted}, {"mounted", fitted, &mounts}};
  const Gauge<G>& chosen = run.scenario == "mrclam" || run.pose_tolerance ? gauges[1] : gauges[0];
  result.T_world_common = chosen.T_world_common;
  if (!result.T_world_common && landmark_fit) result.T_world_common = landmark_fit->T_to_from;

  std::optional<G> gauge_step;  // from gauge "start" to gauge "fit"
  if (gauges[0].T_world_common && fitted) gauge_step = gauges[0].T_world_common->inverse() * *fitted;

  json vehicles = json::array();
  std::map<std::string, Consistency<G>> fleet_live;
  Consistency<G> fleet_chosen, fleet_corrected;
  for (const VehicleRecord<G>& vehicle : run.vehicles) {
    const auto ate = fleet.ate_m.find(vehicle.id);
    const auto mount = mounts.find(vehicle.id);
    auto& by_second = result.bytes_per_s[vehicle.id] = bytes_by_second(vehicle.traffic);
    const json rate = rates(by_second, vehicle.traffic.empty() ? 0.0 : vehicle.traffic.back().t_s);
    const Consistency<G> live = judge(run, vehicle, vehicle.live, chosen);
    const Consistency<G> corrected = judge(run, vehicle, vehicle.trajectory, chosen);
    json entry = {{"id", vehicle.id},
                  {"lost", vehicle.lost},
                  {"bytes_per_s_mean", rate.at("mean")},
                  {"bytes_per_s_max", rate.at("max")},
                  {"ate_m", ate == fleet.ate_m.end() ? json() : json(ate->second)},
                  {"pose_anees", live.anees()},
                  {"pose_coverage95", live.coverage95()},
                  {"poses_judged", live.count},
                  {"poses_without_covariance", live.without_covariance},
                  {"trajectory_anees", corrected.anees()},
                  {"trajectory_coverage95", corrected.coverage95()},
                  {"front_end", judge_front_end(vehicle.front_end, in_space(vehicle.truth))},
                  {"truth_mount_heading_rad", mount == mounts.end() ? json() : json(mount->second.heading_rad)},
                  {"truth_mount_forward_m", mount == mounts.end() ? json() : json(mount->second.forward_m)}};
    for (const char* key : {"landmarks_exported", "landmarks_known", "facts_missing", "bytes_sent", "requests_sent",
                            "integrity", "reasons", "map_digest", "peak_rss_mb"})
      entry[key] = from_summary(vehicle, key);
    for (const Gauge<G>& gauge : gauges) {
      const Consistency<G> in_gauge = judge(run, vehicle, vehicle.live, gauge);
      entry[std::string("pose_anees_") + gauge.name] = in_gauge.anees();
      entry[std::string("pose_coverage95_") + gauge.name] = in_gauge.coverage95();
      fleet_live[gauge.name].add(in_gauge);
    }
    fleet_chosen.add(live);
    fleet_corrected.add(corrected);
    result.live_nees[vehicle.id] = live.series;
    vehicles.push_back(std::move(entry));
  }

  json pairs = json::array();
  for (std::size_t a = 0; a < run.vehicles.size(); ++a)
    for (std::size_t b = a + 1; b < run.vehicles.size(); ++b) {
      result.pairs.emplace_back();
      result.pairs.back().a = run.vehicles[a].id;
      result.pairs.back().b = run.vehicles[b].id;
      pairs.push_back(judge_pair(run, run.vehicles[a], run.vehicles[b], result.pairs.back()));
    }

  json& metrics = result.metrics;
  metrics = {{"scenario", run.scenario},
             {"source", info_or_null(run, "source")},
             {"seed", info_or_null(run, "seed")},
             {"dimension", G::Dim},
             {"gauge", chosen.name},
             {"pose_tolerance", run.pose_tolerance ? tolerance_to_json(*run.pose_tolerance) : json()},
             {"gauge_shift_m", gauge_step ? json(gauge_step->translation().norm()) : json()},
             {"gauge_turn_rad", gauge_step ? json(gauge_step->Log().template tail<G::Dof - G::Dim>().norm()) : json()},
             {"vehicles", std::move(vehicles)},
             {"pairs", std::move(pairs)},
             {"associations", judge_associations(run)},
             {"front_end", front_end(run)},
             {"fleet_ate_m", fleet.fit ? json(fleet.fit->rmse_m) : json()},
             {"fleet_anees", fleet_chosen.anees()},
             {"fleet_coverage95", fleet_chosen.coverage95()},
             {"fleet_trajectory_anees", fleet_corrected.anees()},
             {"fleet_trajectory_coverage95", fleet_corrected.coverage95()},
             {"landmark_rmse_m", landmark_fit ? json(landmark_fit->rmse_m) : json()},
             {"map_digests_equal", map_digests_equal(run)},
             {"facts_lost", facts_lost(run)},
             {"all_aligned", all_aligned(run)},
             {"all_in_common_frame", all_in_common_frame(run)},
             {"all_linked", all_linked(run)},
             {"lost_vehicles", run.info.value("lost_vehicles", json::array())},
             {"wall_s", info_or_null(run, "wall_s")},
             {"vehicle_s", info_or_null(run, "vehicle_s")},
             {"real_time_factor", real_time_factor(run)}};
  for (const auto& [name, consistency] : fleet_live) {
    metrics["fleet_anees_" + name] = consistency.anees();
    metrics["fleet_coverage95_" + name] = consistency.coverage95();
  }
  return result;
}

namespace {

/// "x y z qx qy qz qw"
std::string tum_pose(const SE2& T) {
  char text[160];
  std::snprintf(text, sizeof text, "%.6f %.6f 0 0 0 %.9f %.9f", T.translation().x(), T.translation().y(),
                std::sin(0.5 * T.theta()), std::cos(0.5 * T.theta()));
  return text;
}
std::string tum_pose(const SE3& T) {
  char text[160];
  const SE3::Quaternion& q = T.quaternion();
  std::snprintf(text, sizeof text, "%.6f %.6f %.6f %.9f %.9f %.9f %.9f", T.translation().x(), T.translation().y(),
                T.translation().z(), q[1], q[2], q[3], q[0]);
  return text;
}

}  // namespace

template <class G>
std::string tum_trajectory(const std::vector<PoseRow<G>>& trajectory) {
  std::string text;
  char stamp[40];
  for (const PoseRow<G>& row : trajectory) {
    if (!row.common) continue;
    std::snprintf(stamp, sizeof stamp, "%.6f ", row.t_s);
    text += stamp + tum_pose(row.common->T) + '\n';
  }
  return text;
}

template <class G>
void write_evaluation(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  for (const VehicleRecord<G>& vehicle : run.vehicles)
    if (!vehicle.trajectory.empty())
      write_text_file(run.folder / ("vehicle_" + std::to_string(vehicle.id) + ".tum"),
                      tum_trajectory(vehicle.trajectory));
  write_text_file(run.folder / "metrics.json", evaluation.metrics.dump(2) + "\n");
}

#define CONVOY_INSTANTIATE(G)                                                \
  template Evaluation<G> evaluate(const RunRecord<G>&);                      \
  template void write_evaluation(const RunRecord<G>&, const Evaluation<G>&); \
  template std::string tum_trajectory(const std::vector<PoseRow<G>>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
