// A run folder as vehicle processes might have left it, made from a scenario's truth, for the tests of the judge and of
// the report. The numbers are plausible, not computed by any SLAM.
#pragma once

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <string>

#include <unistd.h>

#include <nlohmann/json.hpp>

#include "evaluate/run_folder.hpp"
#include "evaluate/truth.hpp"
#include "scenario/counter_rng.hpp"
#include "scenario/scenario.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli::test {

/// A folder of its own, gone at the end of the test.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "convoy_test_XXXXXX").string();
    path_ = ::mkdtemp(name.data());
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  const std::filesystem::path& path() const { return path_; }
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

inline void write(const std::filesystem::path& file, const std::string& text) {
  std::filesystem::create_directories(file.parent_path());
  std::ofstream(file, std::ios::binary) << text;
}

/// A file of a recording that is missing or spoilt, and what a loader says of it after the file's name.
struct Damage {
  const char* file;
  const char* content;  ///< nullptr: the file is missing
  const char* message;

  void apply(const std::filesystem::path& folder) const {
    std::filesystem::remove(folder / file);
    if (content) write(folder / file, content);
  }
  std::string refusal() const { return std::string(file) + ":" + message; }
};

inline std::string read(const std::filesystem::path& file) {
  std::stringstream text;
  text << std::ifstream(file, std::ios::binary).rdbuf();
  return text.str();
}

/// What ConfigError says when `action` is done, "" if it does not throw one.
template <class Action>
std::string config_error_of(const Action& action) {
  try {
    action();
  } catch (const ConfigError& error) {
    return error.what();
  }
  return {};
}

/// An estimate in full, or as many empty columns.
template <class G>
std::string csv_pose(const std::optional<PoseEstimate<G>>& pose) {
  if (!pose) return std::string(coordinate_count<G> + covariance_count<G> - 1, ',');
  std::string text;
  append_pose(text, pose->T);
  append_covariance(text, pose->P);
  return text.substr(1);
}

template <class G>
std::string live_row(const PoseRow<G>& row, const std::string& integrity = "OK", const std::string& reasons = "") {
  return std::to_string(row.t_s) + "," + std::to_string(row.vehicle) + "," + std::to_string(row.abscissa_m) + "," +
         csv_pose(row.slam) + "," + csv_pose(row.common) + "," + integrity + "," + reasons + "\n";
}

template <class G>
std::string trajectory_row(const PoseRow<G>& row) {
  return std::to_string(row.t_s) + "," + std::to_string(row.abscissa_m) + "," + csv_pose(row.slam) + "," +
         csv_pose(row.common) + "\n";
}

template <class G>
class FakeRun {
 public:
  double association_period_s = 12.0;  ///< one hypothesis in each
  double first_association_s = 40.0;
  bool aligned_by_prior = true;  ///< false: a vehicle is nowhere before the first association

  FakeRun(const Scenario<G>& scenario, const std::filesystem::path& folder) : scenario_(scenario), folder_(folder) {}

  void write_all() {
    scenario_.write(folder_);
    const G start = *truth_at(scenario_.find(scenario_.common_frame_vehicle)->truth,
                              scenario_.find(scenario_.common_frame_vehicle)->sensors.front().t_s);
    T_common_world_ = start.inverse();
    for (const VehicleLog<G>& vehicle : scenario_.vehicles) drive(vehicle);
    const nlohmann::json map = make_map();
    nlohmann::json ids = nlohmann::json::array();
    for (const VehicleLog<G>& vehicle : scenario_.vehicles) {
      ids.push_back(vehicle.id);
      write_vehicle(vehicle, map);
    }
    const nlohmann::json info = {{"scenario", scenario_.name},
                                 {"source", scenario_.source},
                                 {"seed", scenario_.seed},
                                 {"dimension", G::Dim},
                                 {"rate", 20.0},
                                 {"vehicles", ids},
                                 {"impair", ""},
                                 {"common_frame_vehicle", scenario_.common_frame_vehicle},
                                 {"wall_s", scenario_.duration_s / 19.0},
                                 {"vehicle_s", scenario_.duration_s},
                                 {"lost_vehicles", nlohmann::json::array()}};
    test::write(folder_ / "run.json", info.dump(2));
  }

 private:
  static typename G::Tangent each(double translation, double rotation) {
    typename G::Tangent d;
    d.template head<G::Dim>().setConstant(translation);
    d.template tail<G::Dof - G::Dim>().setConstant(rotation);
    return d;
  }

  struct Drive {
    std::vector<PoseRow<G>> live;
    std::vector<PoseRow<G>> trajectory;
    nlohmann::json anchors = nlohmann::json::array();
    std::vector<std::uint32_t> tracks;  ///< of the landmarks, in the order in which they were exported
    std::vector<double> seen_s;
  };

  void drive(const VehicleLog<G>& vehicle) {
    Drive& d = drives_[vehicle.id];
    const CounterRng rng(scenario_.seed, vehicle.id, 99);
    const typename G::Tangent q = each(1e-4, 8e-6);  // drift per metre
    const G prior = vehicle.prior ? vehicle.prior->mean : G();
    typename G::Covariance prior_P = G::Covariance::Zero(), C = G::Covariance::Zero();
    if (vehicle.prior) prior_P = vehicle.prior->sigma.cwiseAbs2().asDiagonal();
    G X, before = *truth_at(vehicle.truth, vehicle.sensors.front().t_s);
    typename G::Tangent smooth = G::Tangent::Zero();
    double s = 0.0, next_anchor_m = 0.0;
    std::uint32_t step = 0, anchors = 0;
    for (double t = vehicle.sensors.front().t_s; t <= scenario_.duration_s; t += 0.2, ++step) {
      const auto truth = truth_at(vehicle.truth, t, 3.0);
      if (!truth) break;
      const G U = before.inverse() * *truth;
      const double ds = U.translation().norm();
      typename G::Tangent eta, white;
      for (std::uint32_t i = 0; i < G::Dof; ++i) {
        eta[i] = std::sqrt(q[i] * ds) * rng.normal(step, i);
        white[i] = rng.normal(step, G::Dof + i);
      }
      X = X * U * G::Exp(eta);
      s += ds;
      before = *truth;
      C += X.adjoint() * typename G::Covariance((ds * q).asDiagonal()) * X.adjoint().transpose();
      const typename G::Adjoint back = X.inverse().adjoint();
      const typename G::Covariance drift = back * C * back.transpose();
      const bool associated = t >= first_association_s;
      const typename G::Tangent sigma = each(0.06, 0.006);
      smooth = 0.995 * smooth + std::sqrt(1.0 - 0.995 * 0.995) * white;
      const PoseEstimate<G> slam{X, 0.02 * drift + 1e-6 * G::Covariance::Identity()};
      const PoseEstimate<G> fused{T_common_world_ * *truth * G::Exp(sigma.cwiseProduct(smooth)),
                                  1.3 * typename G::Covariance(sigma.cwiseAbs2().asDiagonal())};
      const PoseEstimate<G> by_prior{prior * X, drift + back * prior_P * back.transpose()};
      std::optional<PoseEstimate<G>> live = fused;
      if (!associated) live = aligned_by_prior || vehicle.id == 1 ? std::optional(by_prior) : std::nullopt;
      if (step % 5 == 0) d.live.push_back({t, vehicle.id, s, slam, live});
      d.trajectory.push_back({t, vehicle.id, s, slam, fused});
      if (s >= next_anchor_m) {
        next_anchor_m = s + 25.0;
        d.anchors.push_back({{"vehicle", vehicle.id},
                             {"epoch", 1},
                             {"index", anchors++},
                             {"stamp_s", t},
                             {"abscissa_m", s},
                             {"pose", pose_list(fused.T)},
                             {"cov", upper_of(fused.P)},
                             {"slam", pose_list(X)},
                             {"drift", upper_of(C)}});
      }
    }
    std::set<std::uint32_t> seen;
    for (const SensorEvent& event : vehicle.sensors)
      if (event.kind == SensorEvent::Kind::sighting && seen.insert(event.track).second) {
        d.tracks.push_back(event.track);
        d.seen_s.push_back(event.t_s);
      }
  }

  nlohmann::json make_map() {
    nlohmann::json map = {{"facts_digest", "f00d"},
                          {"selection_digest", "beef"},
                          {"map_digest", "c0ffee"},
                          {"chains", nlohmann::json::array()},
                          {"anchors", nlohmann::json::array()},
                          {"landmarks", nlohmann::json::array()},
                          {"associations", nlohmann::json::array()}};
    std::map<std::uint32_t, typename G::Point> truth;
    for (const TruthLandmark<G>& l : scenario_.landmarks) truth[l.id] = T_common_world_ * l.p_world_m;
    std::map<std::uint32_t, int> times;
    for (const auto& [id, d] : drives_)
      for (const std::uint32_t track : d.tracks) ++times[track];
    for (const auto& [id, d] : drives_) {
      map["chains"].push_back({{"vehicle", id}, {"epoch", 1}, {"aligned", true}});
      for (const auto& anchor : d.anchors) map["anchors"].push_back(anchor);
      const CounterRng rng(scenario_.seed, id, 98);
      for (std::uint32_t i = 0; i < d.tracks.size(); ++i) {
        typename G::Point p = truth.at(d.tracks[i]);
        for (int c = 0; c < G::Dim; ++c) p[c] += 0.08 * rng.normal(i, static_cast<std::uint32_t>(c));
        nlohmann::json landmark = {
            {"vehicle", id},
            {"epoch", 1},
            {"index", i},
            {"anchor", 0},
            {"cov", upper_of(typename G::PointCovariance(0.01 * G::PointCovariance::Identity()))},
            {"class", times[d.tracks[i]] > 1 ? int(d.tracks[i]) : -1}};
        for (int c = 0; c < G::Dim; ++c) landmark[std::string(1, "xyz"[c])] = p[c];
        map["landmarks"].push_back(landmark);
      }
    }
    for (auto a = drives_.begin(); a != drives_.end(); ++a)
      for (auto b = std::next(a); b != drives_.end(); ++b) associate(a->first, a->second, b->first, b->second, map);
    return map;
  }

  void associate(VehicleId a, const Drive& da, VehicleId b, const Drive& db, nlohmann::json& map) {
    std::map<int, nlohmann::json> batches;
    for (std::uint32_t i = 0; i < da.tracks.size(); ++i) {
      const auto it = std::find(db.tracks.begin(), db.tracks.end(), da.tracks[i]);
      if (it == db.tracks.end()) continue;
      const auto j = static_cast<std::uint32_t>(it - db.tracks.begin());
      const double t = std::max({da.seen_s[i], db.seen_s[j], first_association_s});
      batches[int(t / association_period_s)].push_back({a, 1, i, b, 1, j});
    }
    for (const auto& [batch, pairings] : batches)
      map["associations"].push_back({{"id", std::to_string(map["associations"].size())},
                                     {"author", b},
                                     {"t_s", std::max(first_association_s, batch * association_period_s)},
                                     {"accepted", true},
                                     {"reason", ""},
                                     {"pairings", pairings}});
  }

  void write_vehicle(const VehicleLog<G>& vehicle, const nlohmann::json& map) {
    const Drive& own = drives_.at(vehicle.id);
    const auto folder = vehicle_folder(folder_, vehicle.id);
    std::string live = live_header<G> + "\n", trajectory = trajectory_header<G> + "\n";
    std::string traffic = std::string(traffic_header) + "\n", labels = std::string(labels_header) + "\n";
    for (std::size_t i = 0; i < own.live.size(); ++i) {
      live += live_row(own.live[i]);
      for (const auto& [id, peer] : drives_)
        if (id != vehicle.id && i > 0 && i < peer.live.size()) live += live_row(peer.live[i]);
    }
    for (const PoseRow<G>& row : own.trajectory) trajectory += trajectory_row(row);
    const CounterRng rng(scenario_.seed, vehicle.id, 97);
    double bytes = 0.0;
    for (std::uint32_t t = 1; t <= scenario_.duration_s; ++t) {
      bytes +=
          std::round(220.0 + 60.0 * rng.uniform(t) + (t % 12 == vehicle.id % 12 ? 900.0 * rng.uniform(t, 1) : 0.0));
      append_csv_row(traffic, t, bytes, 3 * t);
    }
    for (std::uint32_t i = 0; i < own.tracks.size(); ++i) append_csv_row(labels, i, 1, own.tracks[i]);
    test::write(folder / "live.csv", live);
    test::write(folder / "trajectory.csv", trajectory);
    test::write(folder / "traffic.csv", traffic);
    test::write(folder / "labels.csv", labels);
    test::write(folder / "map.json", map.dump());
    const nlohmann::json summary = {{"landmarks_exported", own.tracks.size()},
                                    {"landmarks_known", map["landmarks"].size()},
                                    {"facts_missing", 0},
                                    {"bytes_sent", bytes},
                                    {"requests_sent", 4},
                                    {"integrity", "OK"},
                                    {"reasons", nlohmann::json::array()},
                                    {"map_digest", "c0ffee"},
                                    {"facts_digest", "f00d"},
                                    {"peak_rss_mb", 41.5},
                                    {"vehicle_s", scenario_.duration_s},
                                    {"counters", {{"gated", 3}}}};
    test::write(folder / "summary.json", summary.dump());
  }

  Scenario<G> scenario_;
  std::filesystem::path folder_;
  G T_common_world_;
  std::map<VehicleId, Drive> drives_;
};

}  // namespace convoy::cli::test
