#include "evaluate/judge_associations.hpp"

#include <algorithm>
#include <map>
#include <set>

#include "evaluate/truth.hpp"

namespace convoy::cli {
using nlohmann::json;
namespace {

enum class Verdict { right, wrong, unknown };

/// Nothing, where the truth does not know one of the two.
template <class G>
std::optional<double> distance_apart(const RunRecord<G>& run, const Pairing& pairing) {
  const auto place_of = [&run](const Key& key) -> const Eigen::Vector3d* {
    const VehicleRecord<G>* author = run.find(key.chain.vehicle);
    if (!author) return nullptr;
    const auto track = author->track_of_landmark.find({key.chain.epoch, key.index});
    if (track == author->track_of_landmark.end()) return nullptr;
    const auto place = author->place_of_track.find(track->second);
    return place == author->place_of_track.end() ? nullptr : &place->second;
  };
  const auto *first = place_of(pairing.first), *second = place_of(pairing.second);
  if (!first || !second) return std::nullopt;
  return (*first - *second).norm();
}

template <class G>
bool judged_by_places(const RunRecord<G>& run) {
  return std::any_of(run.vehicles.begin(), run.vehicles.end(), [](const auto& v) { return !v.place_of_track.empty(); });
}

template <class G>
Verdict verdict_of(const RunRecord<G>& run, const Pairing& pairing) {
  if (judged_by_places(run)) {
    const auto apart_m = distance_apart(run, pairing);
    if (!apart_m) return Verdict::unknown;
    return *apart_m <= same_place_m ? Verdict::right : Verdict::wrong;
  }
  const auto track_of = [&run](const Key& key) -> std::optional<std::uint32_t> {
    const VehicleRecord<G>* author = run.find(key.chain.vehicle);
    if (!author) return std::nullopt;
    const auto it = author->track_of_landmark.find({key.chain.epoch, key.index});
    return it == author->track_of_landmark.end() ? std::nullopt : std::optional(it->second);
  };
  const auto first = track_of(pairing.first), second = track_of(pairing.second);
  if (!first || !second) return Verdict::unknown;
  return *first == *second ? Verdict::right : Verdict::wrong;
}

/// Where the truth has a landmark: as it lies from its anchor, from the true pose there.
template <class G>
class LandmarksByPoses {
 public:
  LandmarksByPoses(const RunRecord<G>& run, const MapRecord<G>& map) {
    std::map<Key, G> T_world_common;  // of each anchor
    for (const MapAnchor<G>& anchor : map.anchors) {
      const VehicleRecord<G>* author = run.find(anchor.key.chain.vehicle);
      const auto T_world_body = author ? truth_at(author->truth, anchor.stamp_s) : std::nullopt;
      if (T_world_body && anchor.common) T_world_common[anchor.key] = *T_world_body * anchor.common->T.inverse();
    }
    for (const MapLandmark<G>& landmark : map.landmarks) {
      const auto T = T_world_common.find({landmark.key.chain, landmark.anchor});
      if (T != T_world_common.end() && landmark.p_common_m) places_[landmark.key] = T->second * *landmark.p_common_m;
    }
  }
  const typename G::Point* find(const Key& key) const {
    const auto it = places_.find(key);
    return it == places_.end() ? nullptr : &it->second;
  }

 private:
  std::map<Key, typename G::Point> places_;
};

/// Wrong if the truth has the paired landmarks in two places, or turned against each other.
template <class G>
Verdict verdict_by_poses(const LandmarksByPoses<G>& truth, const PoseTolerance& tolerance,
                         const MapAssociation& association) {
  std::vector<typename G::Point> first, second;
  typename G::Point apart = G::Point::Zero();
  for (const Pairing& pairing : association.pairings) {
    const auto *a = truth.find(pairing.first), *b = truth.find(pairing.second);
    if (!a || !b) continue;
    first.push_back(*a);
    second.push_back(*b);
    apart += *b - *a;
  }
  const auto fit = fit_rigid<G>(first, second);
  if (!fit) return Verdict::unknown;
  const double shift_m = apart.norm() / static_cast<double>(first.size());
  const double turn_rad = fit->T_to_from.Log().template tail<G::Dof - G::Dim>().norm();
  return shift_m > tolerance.position_m || turn_rad > tolerance.heading_rad ? Verdict::wrong : Verdict::right;
}

bool within_one_vehicle(const Pairing& pairing) { return pairing.first.chain.vehicle == pairing.second.chain.vehicle; }

/// Where nothing says which landmark is which: whole hypotheses, by the poses.
template <class G>
json judge_associations_by_poses(const RunRecord<G>& run, const MapRecord<G>& map) {
  const LandmarksByPoses<G> truth(run, map);
  std::set<Pairing> seen;
  int count[3] = {0, 0, 0};
  const std::vector<const MapAssociation*> accepted = accepted_by_time(map);
  for (const MapAssociation* association : accepted) {
    seen.insert(association->pairings.begin(), association->pairings.end());
    ++count[static_cast<int>(verdict_by_poses(truth, *run.pose_tolerance, *association))];
  }
  const auto within = std::count_if(seen.begin(), seen.end(), within_one_vehicle);
  return {{"judged_by", "poses"},
          {"accepted", seen.size()},
          {"true", nullptr},
          {"false", nullptr},
          {"unjudged", seen.size()},
          {"within_a_vehicle", within},
          {"within_a_vehicle_false", nullptr},
          {"between_vehicles", seen.size() - static_cast<std::size_t>(within)},
          {"between_vehicles_false", nullptr},
          {"hypotheses_accepted", accepted.size()},
          {"hypotheses_false", count[static_cast<int>(Verdict::wrong)]},
          {"hypotheses_unjudged", count[static_cast<int>(Verdict::unknown)]},
          {"hypotheses_rejected", map.associations.size() - accepted.size()}};
}

}  // namespace

template <class G>
std::vector<const MapAssociation*> accepted_by_time(const MapRecord<G>& map) {
  std::vector<const MapAssociation*> accepted;
  for (const MapAssociation& association : map.associations)
    if (association.accepted) accepted.push_back(&association);
  std::stable_sort(accepted.begin(), accepted.end(), [](const auto* a, const auto* b) { return a->t_s < b->t_s; });
  return accepted;
}

template <class G>
json judge_associations(const RunRecord<G>& run) {
  const VehicleRecord<G>* survivor = run.first_survivor();
  if (!survivor) return {{"accepted", nullptr}, {"true", nullptr}, {"false", nullptr}};
  if (run.pose_tolerance) return judge_associations_by_poses(run, *survivor->map);
  std::set<Pairing> seen;
  std::vector<double> apart_m;
  int count[3] = {0, 0, 0}, within[3] = {0, 0, 0}, hypotheses = 0, hypotheses_false = 0;
  for (const MapAssociation* association : accepted_by_time(*survivor->map)) {
    bool wrong = false;
    for (const Pairing& pairing : association->pairings) {
      const Verdict verdict = verdict_of(run, pairing);
      wrong = wrong || verdict == Verdict::wrong;
      if (!seen.insert(pairing).second) continue;  // two hypotheses may hold the same pairing
      if (const auto distance_m = distance_apart(run, pairing)) apart_m.push_back(*distance_m);
      ++count[static_cast<int>(verdict)];
      within[static_cast<int>(verdict)] += within_one_vehicle(pairing);
    }
    ++hypotheses;
    hypotheses_false += wrong;
  }
  std::sort(apart_m.begin(), apart_m.end());
  const auto quantile = [&apart_m](double share) {
    if (apart_m.empty()) return json();
    return json(apart_m[static_cast<std::size_t>(share * static_cast<double>(apart_m.size() - 1))]);
  };
  json judged = {
      {"judged_by", judged_by_places(run) ? "places" : "identities"},
      {"accepted", seen.size()},
      {"true", count[static_cast<int>(Verdict::right)]},
      {"false", count[static_cast<int>(Verdict::wrong)]},
      {"unjudged", count[static_cast<int>(Verdict::unknown)]},
      {"within_a_vehicle", within[0] + within[1] + within[2]},
      {"within_a_vehicle_false", within[static_cast<int>(Verdict::wrong)]},
      {"between_vehicles", count[0] + count[1] + count[2] - (within[0] + within[1] + within[2])},
      {"between_vehicles_false", count[static_cast<int>(Verdict::wrong)] - within[static_cast<int>(Verdict::wrong)]},
      {"hypotheses_accepted", hypotheses},
      {"hypotheses_false", hypotheses_false},
      {"hypotheses_rejected", survivor->map->associations.size() - static_cast<std::size_t>(hypotheses)}};
  if (judged_by_places(run)) {
    judged["apart_median_m"] = quantile(0.5);
    judged["apart_p95_m"] = quantile(0.95);
  }
  return judged;
}

#define CONVOY_INSTANTIATE(G)                                                            \
  template std::vector<const MapAssociation*> accepted_by_time(const MapRecord<G>& map); \
  template json judge_associations(const RunRecord<G>& run);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
