#include "vehicle_output.hpp"

#include <convoy/config_error.hpp>
#include <convoy/geometry/covariance.hpp>

#include <spdlog/spdlog.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <fstream>
#include <map>
#include <set>

#include "evaluate/run_folder.hpp"
#include "scenario/pose_columns.hpp"
#include "scenario/table_file.hpp"
#include "vehicle_status.hpp"

namespace convoy::cli {
namespace {

using nlohmann::json;

// "t_s,...": the part that live.csv and trajectory.csv share. The SLAM's own covariance is its drift as a right
// perturbation of its own pose.
template <class G>
void append_state(std::string& row, const ChainState<G>& slam, const std::optional<Estimate<G>>& estimate) {
  append_number(row, slam.abscissa_m);
  append_pose(row, slam.pose);
  const typename G::Adjoint Ad = slam.pose.inverse().adjoint();
  append_covariance(row, symmetrised(typename G::Covariance(Ad * slam.drift * Ad.transpose())));
  if (estimate) {
    append_pose(row, estimate->mean);
    append_covariance(row, estimate->covariance);
  } else {
    row.append(coordinate_count<G> + covariance_count<G>, ',');
  }
}

// Absolute fixes held: which are used, and where the common frame is by them.
template <class G>
json absolute_json(const FactStore<G>& store, const GlobalMap<G>& global) {
  json out = {{"datum", nullptr}, {"fixes", json::array()}};  // datum: T_enu_common
  if (const auto datum = global.map->datum())
    out["datum"] = {{"pose", pose_list(datum->mean)}, {"cov", upper_of(datum->covariance)}};
  std::set<Key> used;
  for (const auto& f : global.map->problem().fixes) used.insert(f.fix);
  for (const auto& [id, chain] : store.chains())
    for (const auto& [index, fix] : chain.absolute_fixes)
      out["fixes"].push_back(
          {{"vehicle", id.vehicle}, {"epoch", id.epoch}, {"index", index}, {"used", used.count(fix.key) > 0}});
  return out;
}

// Encounters held: whether the other vehicle has answered, and which are used.
template <class G>
json encounters_json(const FactStore<G>& store, const GlobalMap<G>& global) {
  std::set<Key> answered, used;
  for (const auto& f : global.map->problem().encounters) used.insert(f.encounter);
  for (const auto& [id, chain] : store.chains())
    for (const auto& [index, waypoint] : chain.waypoints) answered.insert(waypoint.encounter);
  json out = json::array();
  for (const auto& [id, chain] : store.chains())
    for (const auto& [index, e] : chain.encounters)
      out.push_back({{"vehicle", id.vehicle},
                     {"epoch", id.epoch},
                     {"index", index},
                     {"stamp_s", e.state.stamp_s},
                     {"other", e.other},
                     {"answered", answered.count(e.key) > 0},
                     {"used", used.count(e.key) > 0}});
  return out;
}

template <class G>
json map_json(const SubmapManager<G>& manager) {
  const FactStore<G>& store = manager.store();
  const GlobalMap<G>& global = manager.map();
  json out;
  out["facts_digest"] = hex(store.digest());
  out["selection_digest"] = hex(global.selection.digest());
  out["map_digest"] = hex(global.map->digest());
  const SolveReport& report = global.map->report();
  out["solve"] = {{"iterations", report.iterations},
                  {"converged", report.converged},
                  {"chi2", report.chi2},
                  {"dof", report.dof},
                  {"nodes", global.map->problem().nodes.size()},
                  {"classes", global.selection.classes.size()}};
  out["absolute"] = absolute_json(store, global);
  out["encounters"] = encounters_json(store, global);
  std::map<Key, int> class_of;
  for (std::size_t c = 0; c < global.selection.classes.size(); ++c)
    for (const Key& key : global.selection.classes[c]) class_of[key] = static_cast<int>(c);
  out["chains"] = out["anchors"] = out["landmarks"] = out["associations"] = json::array();
  for (const auto& [id, chain] : store.chains()) {
    out["chains"].push_back({{"vehicle", id.vehicle}, {"epoch", id.epoch}, {"aligned", global.map->aligned(id)}});
    if (const auto learnt = global.map->constants(id))
      out["chains"].back()["constants"] = {{"scale", learnt->mean[0]},
                                           {"scale_sigma", learnt->sigma[0]},
                                           {"heading_rad_per_m", learnt->mean[1]},
                                           {"heading_sigma_rad_per_m", learnt->sigma[1]}};
    for (const auto& [index, anchor] : chain.anchors) {
      json entry = {{"vehicle", id.vehicle},
                    {"epoch", id.epoch},
                    {"index", index},
                    {"stamp_s", anchor.state.stamp_s},
                    {"abscissa_m", anchor.state.abscissa_m},
                    {"slam", pose_list(anchor.state.pose)},
                    {"drift", upper_of(anchor.state.drift)}};
      if (const auto estimate = global.map->aligned(id) ? global.map->pose(id, anchor.state) : std::nullopt) {
        entry["pose"] = pose_list(estimate->mean);
        entry["cov"] = upper_of(estimate->covariance);
      } else {
        entry["pose"] = entry["cov"] = nullptr;
      }
      out["anchors"].push_back(entry);
    }
    for (const auto& [index, landmark] : chain.landmarks) {
      const auto known = class_of.find(landmark.key);
      json entry = {{"vehicle", id.vehicle},
                    {"epoch", id.epoch},
                    {"index", index},
                    {"anchor", landmark.anchor},
                    {"class", known == class_of.end() ? -1 : known->second}};
      if (const auto estimate = global.map->aligned(id) ? global.map->landmark(store, landmark) : std::nullopt) {
        for (int c = 0; c < G::Dim; ++c) entry[std::string(1, "xyz"[c])] = estimate->mean[c];
        entry["cov"] = upper_of(estimate->covariance);
      } else {
        for (int c = 0; c < G::Dim; ++c) entry[std::string(1, "xyz"[c])] = nullptr;
        entry["cov"] = nullptr;
      }
      out["landmarks"].push_back(entry);
    }
  }
  for (const Hypothesis<G>& h : global.selection.hypotheses) {
    json pairings = json::array();
    double stamp_s = 0.0;
    for (const auto& [a, b] : *h.pairings) {
      // A pairing that the map has found not to fit is no longer one.
      const auto ca = class_of.find(a), cb = class_of.find(b);
      const bool fused = ca != class_of.end() && cb != class_of.end() && ca->second == cb->second;
      if (h.state == HypothesisState::accepted && !fused) continue;
      pairings.push_back({a.chain.vehicle, a.chain.epoch, a.index, b.chain.vehicle, b.chain.epoch, b.index});
      for (const Key& key : {a, b})  // it became known when the later of its batches closed
        if (const LandmarkFact<G>* landmark = store.landmark(key))
          if (const AnchorFact<G>* anchor = store.anchor(landmark->anchor_key()))
            stamp_s = std::max(stamp_s, anchor->state.stamp_s);
    }
    out["associations"].push_back({{"id", hex(h.id)},
                                   {"author", h.author.vehicle},
                                   {"t_s", stamp_s},
                                   {"accepted", h.state == HypothesisState::accepted},
                                   {"reason", to_string(h.state)},
                                   {"pairings", pairings}});
  }
  return out;
}

template <class G>
std::string facts_lines(const FactStore<G>& store) {
  std::string text;
  const auto line = [&](const char* kind, const Key& key, json fact) {
    fact["kind"] = kind;
    fact["key"] = {key.chain.vehicle, key.chain.epoch, key.index};
    text += fact.dump() + "\n";
  };
  const auto key_of = [](const Key& key) { return json{key.chain.vehicle, key.chain.epoch, key.index}; };
  for (const auto& [id, chain] : store.chains()) {
    for (const auto& [i, f] : chain.priors)
      line("prior", f.key,
           {{"known", f.known},
            {"mean", pose_list(f.mean)},
            {"covariance", upper_of(f.covariance)},
            {"scale_sigma", f.persistent.scale},
            {"heading_sigma_rad_per_m", f.persistent.heading_rad_per_m},
            {"scales_landmarks", f.persistent.scales_landmarks}});
    for (const auto& [i, f] : chain.anchors)
      line("anchor", f.key,
           {{"stamp_s", f.state.stamp_s},
            {"abscissa_m", f.state.abscissa_m},
            {"slam", pose_list(f.state.pose)},
            {"drift", upper_of(f.state.drift)},
            {"heading_lever", list_of(f.state.heading_lever)},
            {"first_landmark", f.first_landmark},
            {"landmark_count", f.landmark_count}});
    for (const auto& [i, f] : chain.landmarks)
      line("landmark", f.key,
           {{"anchor", f.anchor},
            {"landmark_kind", f.kind},
            {"position", list_of(f.position)},
            {"covariance", upper_of(f.covariance)},
            {"loading", std::vector<double>(f.loading.data(), f.loading.data() + f.loading.size())}});
    for (const auto& [i, f] : chain.associations) {
      json pairings = json::array();
      for (const auto& [a, b] : f.pairings) pairings.push_back({key_of(a), key_of(b)});
      line("association", f.key, {{"hypothesis", hex(hypothesis_id(f.pairings))}, {"pairings", pairings}});
    }
    for (const auto& [i, f] : chain.absolute_fixes)
      line("absolute_fix", f.key,
           {{"anchor", f.anchor},
            {"stamp_s", f.state.stamp_s},
            {"slam", pose_list(f.state.pose)},
            {"abscissa_m", f.state.abscissa_m},
            {"drift", upper_of(f.state.drift)},
            {"heading_lever", list_of(f.state.heading_lever)},
            {"lever", list_of(f.lever)},
            {"position", list_of(f.position)},
            {"covariance", upper_of(f.covariance)}});
    for (const auto& [i, f] : chain.encounters)
      line("encounter", f.key,
           {{"anchor", f.anchor},
            {"stamp_s", f.state.stamp_s},
            {"slam", pose_list(f.state.pose)},
            {"abscissa_m", f.state.abscissa_m},
            {"drift", upper_of(f.state.drift)},
            {"heading_lever", list_of(f.state.heading_lever)},
            {"other", f.other},
            {"position", list_of(f.position)},
            {"covariance", upper_of(f.covariance)}});
    for (const auto& [i, f] : chain.waypoints)
      line("waypoint", f.key,
           {{"anchor", f.anchor},
            {"stamp_s", f.state.stamp_s},
            {"slam", pose_list(f.state.pose)},
            {"abscissa_m", f.state.abscissa_m},
            {"drift", upper_of(f.state.drift)},
            {"heading_lever", list_of(f.state.heading_lever)},
            {"encounter", key_of(f.encounter)},
            {"mark", list_of(f.mark)}});
    for (const auto& [i, f] : chain.verdicts)
      line("verdict", f.key, {{"hypothesis", hex(f.hypothesis)}, {"veto", f.veto}});
  }
  return text;
}

template <class G>
json counters_json(const VehicleSnapshot<G>& s) {
  json c;
  c["facts_published"] = s.submaps.facts_published;
  c["facts_received"] = s.submaps.facts_received;
  c["facts_unfit"] = s.submaps.facts_unfit;
  c["fixes_thinned"] = s.submaps.fixes_thinned;
  c["encounters_thinned"] = s.submaps.encounters_thinned;
  c["encounters_unanswered"] = s.encounters_unanswered;
  c["live_unfit"] = s.submaps.live_unfit;
  c["unknown_senders"] = s.submaps.unknown_senders;
  c["last_unknown_sender"] = s.submaps.last_unknown_sender;
  c["facts_impersonated"] = s.submaps.facts_impersonated;
  c["senders_impersonated"] = s.submaps.senders_impersonated;
  c["sends_rejected"] = s.submaps.sends_rejected;
  c["sends_unfit"] = s.network.outbox.unfit;
  c["sends_in_debt"] = s.network.outbox.in_debt;
  c["failures"] = s.failures.count;
  c["disagreements"] = s.submaps.disagreements;
  c["contradictions"] = s.submaps.contradictions;
  c["maps_built"] = s.submaps.maps_built;
  for (int i = 0; i < insertion_count; ++i)
    c["insertions"][to_string(static_cast<Insertion>(i))] = s.insertions[static_cast<std::size_t>(i)];
  c["requests_heard"] = s.repair.requests_heard;
  c["facts_served"] = s.repair.facts_served;
  c["facts_relayed"] = s.repair.facts_relayed;
  c["answers_suppressed"] = s.repair.answers_suppressed;
  c["searches"] = s.association.searches;
  c["search_nodes"] = s.association.search_nodes;
  c["searches_waiting"] = s.association.waiting;
  c["associations_accepted"] = s.association.accepted;
  c["associations_already_stated"] = s.association.already_stated;
  for (int i = 1; i < rejection_count; ++i)
    c["associations_rejected"][to_string(static_cast<Rejection>(i))] =
        s.association.rejected[static_cast<std::size_t>(i)];
  c["messages_taken"] = s.exchange.messages_taken;
  c["undecodable"] = s.exchange.undecodable;
  c["hostile"] = s.exchange.hostile;
  c["dropped"] = s.exchange.dropped;
  c["incompatible_peers"] = s.exchange.incompatible_peers;
  c["unauthorised"] = s.exchange.unauthorised;
  c["last_unauthorised"] = s.exchange.last_unauthorised;
  const JournalCounters& j = s.journal;
  c["journal"] = {{"restored", j.restored},   {"refused", j.refused}, {"damaged_bytes", j.damaged_bytes},
                  {"cut_bytes", j.cut_bytes}, {"written", j.written}, {"failed_writes", j.failed_writes},
                  {"waiting", j.waiting}};
  return c;
}

// Of this program alone: getrusage() also counts what the parent held when it forked.
double peak_rss_mb() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.rfind("VmHWM:", 0) == 0) return std::stod(line.substr(6)) / 1024.0;
  return 0.0;
}

// A minute after somebody has spoken in a vehicle's name it is no reason for doubt any more. Of the run as a whole it
// is.
template <class G>
void tell_of_impersonation(const VehicleSnapshot<G>& s, json& summary) {
  if (s.submaps.facts_impersonated + s.submaps.senders_impersonated == 0) return;
  const std::string reason = names_of_reasons(reason_impersonated).front();
  json& reasons = summary["reasons"];
  if (std::find(reasons.begin(), reasons.end(), reason) == reasons.end()) reasons.push_back(reason);
  if (summary.value("integrity", "") == to_string(Integrity::ok)) summary["integrity"] = to_string(Integrity::suspect);
}

}  // namespace

template <class G>
VehicleOutput<G>::VehicleOutput(const std::filesystem::path& folder) : folder_(folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  live_ = appending("live.csv", live_header<G>);
  traffic_ = appending("traffic.csv", traffic_header);
  labels_ = appending("labels.csv", labels_header);
}

template <class G>
std::ofstream VehicleOutput<G>::appending(const std::string& name, std::string_view header) {
  const std::filesystem::path file = folder_ / name;
  std::error_code none;
  const auto size = std::filesystem::file_size(file, none);
  const bool fresh = none || size == 0;
  std::ofstream out(file, std::ios::app);
  if (fresh) out << header << '\n' << std::flush;
  if (!out) throw ConfigError(file.string() + ": cannot write; is the output folder writable?");
  return out;
}

template <class G>
void VehicleOutput<G>::write_label(Epoch epoch, std::uint32_t index, std::uint64_t track) {
  std::string row;
  append_csv_row(row, index, epoch, track);
  labels_ << row << std::flush;
}

template <class G>
void VehicleOutput<G>::write_live(double t_s, const VehicleSnapshot<G>& snapshot, const SubmapManager<G>& manager) {
  std::string rows;
  for (const VehicleState<G>& v : snapshot.vehicles) {
    // Of a vehicle that was restarted only its latest epoch is where it is now.
    const auto next = manager.store().chains().upper_bound(v.chain);
    if (next != manager.store().chains().end() && next->first.vehicle == v.chain.vehicle) continue;
    append_number(rows, v.slam.stamp_s);
    rows += ',';
    append_number(rows, std::uint64_t{v.chain.vehicle});
    rows += ',';
    append_state(rows, v.slam, v.estimate);
    rows += std::string(",") + to_string(v.integrity) + ",";
    append_number(rows, std::uint64_t{v.reasons});
    rows += '\n';
  }
  live_ << rows << std::flush;
  std::string traffic;
  append_csv_row(traffic, t_s, snapshot.exchange.bytes_sent, snapshot.exchange.messages_sent);
  traffic_ << traffic << std::flush;
  if (complete_ && (!live_ || !traffic_ || !labels_)) {  // the vehicle drives on: its map matters more than its log
    complete_ = false;
    spdlog::error("{}: what happens is no longer written; is the disk full?", folder_.string());
  }
}

template <class G>
void VehicleOutput<G>::keep_trail(const SubmapManager<G>& manager, const FrontEndComponent<G>& front_end) {
  trails_.emplace_back(manager.self(), front_end.trail());
}

template <class G>
void VehicleOutput<G>::write_end(double t_s, const VehicleSnapshot<G>& snapshot, SubmapManager<G>& manager,
                                 const FrontEndComponent<G>& front_end) {
  keep_trail(manager, front_end);
  std::string rows(trajectory_header<G>);
  rows += '\n';
  for (const auto& [chain, trail] : trails_) {
    const bool aligned = manager.map().map->aligned(chain);
    for (const ChainState<G>& state : trail) {
      append_number(rows, state.stamp_s);
      rows += ',';
      append_state(rows, state, aligned ? manager.map().map->pose(chain, state) : std::nullopt);
      rows += '\n';
    }
  }
  write_text_file(folder_ / "trajectory.csv", rows);
  write_text_file(folder_ / "map.json", map_json(manager).dump(1) + "\n");
  write_text_file(folder_ / "facts.jsonl", facts_lines(manager.store()));

  json summary = vehicle_status(t_s, snapshot);
  tell_of_impersonation(snapshot, summary);
  summary["peak_rss_mb"] = peak_rss_mb();
  summary["counters"] = counters_json(snapshot);
  write_text_file(folder_ / "summary.json", summary.dump(1) + "\n");
}

#define CONVOY_INSTANTIATE(G) template class VehicleOutput<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
