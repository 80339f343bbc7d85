#include "camera_demo.hpp"

#include <convoy/config_error.hpp>
#include <convoy/geometry/chi2.hpp>

#include <chrono>
#include <cmath>

#include "free_domains.hpp"
#include "other_program.hpp"
#include "scenario/street.hpp"

namespace convoy::cli {
namespace {

constexpr double gap_m = 20.0, speed_mps = 2.0;
constexpr double loop_s = 250.0;  // about: what the route takes at that speed

/// Of no meaning but to be another one than those of others.
std::uint64_t new_run() {
  return static_cast<std::uint64_t>(std::chrono::system_clock::now().time_since_epoch().count());
}

double steady_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

std::vector<VehicleId> ids_of(const Scenario<SE3>& scenario) {
  std::vector<VehicleId> ids;
  for (const VehicleLog<SE3>& vehicle : scenario.vehicles) ids.push_back(vehicle.id);
  return ids;
}

/// Where the one behind starts.
StaticPrior<SE3> prior_of_paper() {
  const StreetParams paper;  // that of the landmark-level run
  const double circle_m = paper.prior_circle_m / std::sqrt(chi2_quantile(0.95, 2.0));
  SE3::Tangent sigma;
  sigma << circle_m, circle_m, paper.prior_height_sigma_m, paper.prior_tilt_sigma_rad, paper.prior_tilt_sigma_rad,
      paper.prior_heading_sigma_rad;
  return {SE3(), sigma};
}

}  // namespace

bool can_drive_with_cameras() {
  return std::filesystem::exists(camera_program()) && std::filesystem::exists(simulator_program());
}

Scenario<SE3> camera_scenario(std::uint64_t seed, const CameraStreets& streets) {
  Scenario<SE3> scenario;
  scenario.name = "camera";
  scenario.source = "convoy sim, " + (streets.world.empty() ? "the generated district" : streets.world) + ", " +
                    std::to_string(streets.vehicles) + " vehicles with cameras";
  scenario.seed = seed;
  scenario.common_frame_vehicle = 1;
  scenario.duration_s = streets.distance_m ? *streets.distance_m / speed_mps : loop_s;
  scenario.vehicles.resize(static_cast<std::size_t>(streets.vehicles));
  for (VehicleId id = 1; VehicleLog<SE3> & vehicle : scenario.vehicles) vehicle.id = id++;
  scenario.vehicles.front().prior = StaticPrior<SE3>{};
  if (streets.vehicles == 2 && streets.routes.size() < 2) scenario.vehicles.back().prior = prior_of_paper();
  return scenario;
}

CameraDrive::CameraDrive(const std::filesystem::path& run_folder, const Scenario<SE3>& scenario,
                         std::uint32_t fleet_domain, const CameraStreets& streets)
    : folder_(run_folder),
      seed_(scenario.seed),
      streets_(streets),
      sensor_domain_(free_domain_beside(fleet_domain, 10)),
      truth_domain_(free_domain_beside(fleet_domain, 20)),
      run_(new_run()),
      truth_(truth_domain_, run_, run_folder, ids_of(scenario)) {}

void CameraDrive::equip(VehicleConfig<SE3>& config) const {
  config.camera.domain = sensor_domain_;
  config.camera.lock_step = true;
  config.camera.wait_s = 120.0;
}

void CameraDrive::start() {
  const auto text = [](double value) { return std::to_string(value); };
  std::vector<std::string> command{simulator_program().string(),
                                   "--vehicles",
                                   std::to_string(streets_.vehicles),
                                   "--gap",
                                   text(gap_m),
                                   "--speed",
                                   text(speed_mps),
                                   "--seed",
                                   std::to_string(seed_),
                                   "--run",
                                   std::to_string(run_),
                                   "--lock-step",
                                   "--deadline",
                                   "120",
                                   "--truth-depth",
                                   "--domain-sensors",
                                   std::to_string(sensor_domain_),
                                   "--domain-truth",
                                   std::to_string(truth_domain_)};
  if (streets_.distance_m) command.insert(command.end(), {"--distance", text(*streets_.distance_m)});
  if (!streets_.world.empty()) command.insert(command.end(), {"--world", streets_.world});
  for (const std::string& route : streets_.routes) command.insert(command.end(), {"--route", route});
  simulator_ = std::make_unique<ChildProcess>(command, folder_ / "simulator.txt");
}

void CameraDrive::tend() {
  (void)simulator_->lines();
  truth_.take();
  if (truth_.time_s() <= last_s_) return;
  last_s_ = truth_.time_s();
  ended_s_ = steady_s();
  if (began_s_ == 0.0) began_s_ = ended_s_;
}

std::optional<std::string> CameraDrive::fault() {
  if (!simulator_->ended() || simulator_->succeeded()) return std::nullopt;
  return *simulator_->ended() + "; see " + (folder_ / "simulator.txt").string();
}

std::optional<std::string> CameraDrive::warning() {
  const TruthCounters& refused = truth_.counters();
  if (warned_ || refused.foreign + refused.unusable == 0) return std::nullopt;
  warned_ = true;
  return (refused.foreign > 0 ? "another simulator tells its truth on DDS domain "
                              : "somebody says what is no truth on DDS domain ") +
         std::to_string(truth_domain_) + ", too: that is not used; end who does, or take another --domain";
}

void CameraDrive::write_truth(Scenario<SE3>& scenario) const {
  for (VehicleLog<SE3>& vehicle : scenario.vehicles) vehicle.truth = truth_.path(vehicle.id);
  scenario.duration_s = std::max(truth_.time_s(), 0.1);
  scenario.write(folder_);
  truth_.write_tracks();
}

std::optional<double> CameraDrive::real_time_factor() const {
  if (ended_s_ <= began_s_) return std::nullopt;
  return last_s_ / (ended_s_ - began_s_);
}

}  // namespace convoy::cli
