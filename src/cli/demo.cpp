#include "demo.hpp"

#include <convoy/components/vehicle_config.hpp>
#include <convoy/config_error.hpp>
#include <convoy/dds/dds_exchange.hpp>

#include <nlohmann/json.hpp>

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <memory>
#include <set>
#include <thread>
#include <vector>

#include "child_process.hpp"
#include "evaluate/evaluate.hpp"
#include "evaluate/run_folder.hpp"
#include "free_domains.hpp"
#include "qos_profile.hpp"
#include "report/report.hpp"
#include "scenario/mrclam.hpp"
#include "scenario/street.hpp"
#include "scenario/table_file.hpp"
#include "scenario/victoria_park.hpp"
#include "scenario_config.hpp"

namespace convoy::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* here = "127.0.0.1";  // all that a demo speaks on
constexpr double silence_s = 5.0;          // a vehicle speaks every quarter of a second

double unix_now_s() {
  return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

template <class G>
Scenario<G> make_scenario(const DemoOptions& options) {
  if (options.dataset.empty()) return make_street<G>({}, options.seed);
  if constexpr (G::Dim == 2) {
    if (options.dataset == "mrclam") return load_mrclam(options.dataset_folder);
    if (options.dataset == "victoria-park") return load_victoria_park(options.dataset_folder, options.seed);
  } else if (options.dataset == "mrclam" || options.dataset == "victoria-park") {
    throw ConfigError("demo: " + options.dataset + " was recorded in a plane; leave out --space, or --dataset");
  }
  throw ConfigError("demo: no data set '" + options.dataset + "'; there are: mrclam, victoria-park");
}

// Why a process gave up, by its own log; empty if it does not say.
std::string last_error(const fs::path& log) {
  std::ifstream in(log);
  std::string last;
  for (std::string line; std::getline(in, line);) last = line;
  for (const char* level : {"[error] ", "[critical] "})
    if (const auto at = last.find(level); at != std::string::npos) return last.substr(at + std::string(level).size());
  return {};
}

// One vehicle of the demo, as its parent sees it.
struct Member {
  VehicleId id = 0;
  fs::path config;
  std::unique_ptr<ChildProcess> process;
  json status;                // its last status line
  double heard_unix_s = 0.0;  // when that came, or when the process was started
  bool silent = false;
  bool told_silent = false;
  bool lost = false;
  bool restarted = false;
  bool impersonated = false;
};

volatile std::sig_atomic_t interrupted = 0;

template <class G>
class Demo {
 public:
  explicit Demo(const DemoOptions& options) : options_(options) {
    if (!(options.rate > 0.0)) throw ConfigError("demo: --rate must be > 0");
    impairment_ = Impairments::parse(options.impair);
    profile_ = options.profile.empty() ? qos_profile("loopback_udp.xml") : given_profile(options.profile);
    if (fs::exists(options.out / "run.json") || fs::exists(options.out / "scenario.json")) refuse_folder();
  }

  /// With cameras, in the simulator's streets.
  int run_with_cameras() requires(G::Dim == 3) {
    cameras_ = true;
    return run();
  }

  int run() {
    std::printf("[1/4] scenario\n");
    std::fflush(stdout);
    scenario_ = plan();
    choose_domain();  // before anything is written
    claim_folder();
    scenario_.write(options_.out);
    write_text_file(options_.out / "profile.xml", read_text_file(profile_));
    std::printf("      %s, %zu vehicles, %.0f s%s\n", scenario_.name.c_str(), scenario_.vehicles.size(),
                scenario_.duration_s, cameras_ ? ", in lock-step" : (" at " + number(options_.rate) + "x").c_str());
    if constexpr (G::Dim == 3)
      if (cameras_) camera_ = std::make_unique<CameraDrive>(options_.out, scenario_, domain_, options_.streets);
    write_configs();
    std::printf("[2/4] driving: one process per vehicle, DDS domain %u on 127.0.0.1, run folder %s\n", domain_,
                options_.out.c_str());
    std::signal(SIGINT, [](int) { interrupted = 1; });
    std::signal(SIGTERM, [](int) { interrupted = 1; });
    for (Member& member : members_) start(member);
    const double began_s = unix_now_s();
    if (camera_) camera_->start();
    drive();
    std::printf("[3/4] collecting\n");
    collect(unix_now_s() - began_s);
    std::printf("[4/4] evaluating\n");
    return judge();
  }

 private:
  [[noreturn]] void refuse_folder() const {
    throw ConfigError(
        options_.out.string() +
        ": holds a run already, or another demo has begun one; name another folder with --out, or delete it");
  }

  Scenario<G> plan() const {
    if constexpr (G::Dim == 3)
      if (cameras_) return camera_scenario(options_.seed, options_.streets);
    return make_scenario<G>(options_);
  }

  // Of two demos that were given one folder, one makes scenario.json first, and the other is told.
  void claim_folder() const {
    std::error_code failed;
    fs::create_directories(options_.out, failed);
    const fs::path mark = options_.out / "scenario.json";
    const int file = open(mark.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
    if (file < 0 && errno == EEXIST) refuse_folder();
    if (file < 0) throw ConfigError(mark.string() + ": cannot be written (" + std::strerror(errno) + ")");
    close(file);
  }

  // Vehicles of another fleet that are heard on the domain, before ours speak. Both fleets would number their vehicles
  // alike and become one.
  std::size_t strangers(std::uint32_t domain) const {
    constexpr double discovery_s = 1.0;  // announcements of the profile: five, 0.2 s apart
    dds::DdsConfig listen;
    listen.domain = domain;
    listen.profile_file = profile_.string();
    listen.interface_whitelist = {here};
    const auto ear = open_ear(listen);
    if (ear->wait_for_peers(1, discovery_s)) return ear->peers();
    return ear->counters().incompatible_peers;  // those of another profile
  }

  static std::unique_ptr<dds::DdsExchange<G>> open_ear(const dds::DdsConfig& listen) {
    try {
      return std::make_unique<dds::DdsExchange<G>>(listen);
    } catch (const ConfigError& error) {
      throw ConfigError("demo: --profile does not serve here: " + std::string(error.what()) +
                        ". A demo's vehicles find each other without addresses: by loopback, loopback_udp, lan, "
                        "lossy_radio or low_bandwidth");
    }
  }

  void choose_domain() {
    const auto own = static_cast<std::uint32_t>(getpid());
    domain_ = options_.domain.value_or(free_domain(own));
    for (std::uint32_t attempt = 1; strangers(domain_) > 0; ++attempt) {
      if (options_.domain || attempt == 8)
        throw ConfigError("demo: another convoy fleet is heard on DDS domain " + std::to_string(domain_) +
                          "; wait for its end, or name a domain of its own with --domain");
      domain_ = free_domain_beside(domain_, 1 + own / free_domains % (free_domains - 1));
    }
  }

  void write_configs() {
    start_unix_s_ = unix_now_s() + 1.0 + 0.2 * static_cast<double>(scenario_.vehicles.size());
    for (const VehicleLog<G>& log : scenario_.vehicles) {
      VehicleConfig<G> c = vehicle_config_of(scenario_, log);
      c.vehicle.state_folder = "state";
      c.first_epoch = options_.first_epoch;
      c.vehicle.step_period_s = std::clamp(0.1 / options_.rate, 0.005, 0.05);
      c.dds.domain = domain_;
      c.dds.profile_file = "../profile.xml";
      c.dds.interface_whitelist = {here};
      c.impairment = impairment_;
      c.impairment.received.seed += log.id;
      c.impairment.sent.seed += log.id;
      if (!equip_with_camera(c)) {
        c.sensors.file = "sensors.csv";
        c.sensors.encounters = options_.encounters;
        c.sensors.rate = options_.rate;
        c.sensors.start_unix_s = start_unix_s_;
      }
      if (options_.literal) use_paper_method(c);
      Member member;
      member.id = log.id;
      member.config = vehicle_folder(options_.out, log.id) / "config.xml";
      save_vehicle_config(c, member.config);
      members_.push_back(std::move(member));
    }
  }

  bool equip_with_camera(VehicleConfig<G>& c) const {
    if constexpr (G::Dim == 3)
      if (camera_) camera_->equip(c);
    return camera_ != nullptr;
  }

  fs::path log_of(const Member& member) const { return vehicle_folder(options_.out, member.id) / "log.txt"; }

  void start(Member& member) {
    std::vector<std::string> command{this_program().string(), "vehicle", member.config.string()};
    if (camera_) command.push_back("--sightings");
    member.process = std::make_unique<ChildProcess>(command, log_of(member));
    member.status = json::object();
    member.heard_unix_s = unix_now_s();
  }

  void drive() {
    double agreed_since_s = 0.0, exhausted_since_s = 0.0, next_progress_s = 0.0;
    while (true) {
      if (interrupted) {
        settled_ = false;
        std::printf("\n      interrupted at %.0f s after the start; stopping the vehicles and judging what there is\n",
                    unix_now_s() - start_unix_s_);
        break;
      }
      for (Member& member : members_) watch(member);
      if (camera_ && !tend_camera()) break;
      const double now_s = unix_now_s();
      if (now_s >= next_progress_s) {
        progress();
        next_progress_s = now_s + (isatty(STDOUT_FILENO) ? 0.5 : 5.0);
      }
      if (alive() == 0) return;
      if (!all_alive([](const json& s) { return s.value("exhausted", false); }))
        exhausted_since_s = agreed_since_s = 0.0;
      else if (exhausted_since_s == 0.0) exhausted_since_s = now_s;
      if (!agreed()) agreed_since_s = 0.0;
      else if (agreed_since_s == 0.0) agreed_since_s = now_s;
      if (agreed_since_s > 0.0 && now_s - agreed_since_s > 1.0) break;
      if (exhausted_since_s > 0.0 && now_s - exhausted_since_s > options_.settle_timeout_s) {
        settled_ = false;
        std::printf(
            "\n      the vehicles do not hold the same facts %.0f s after the sensors ended; stopping all the same\n",
            options_.settle_timeout_s);
        break;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(camera_ ? 5 : 20));
    }
    progress();
    if (isatty(STDOUT_FILENO)) std::printf("\n");
  }

  // False: the simulator has given up, and there is nothing to wait for.
  bool tend_camera() {
    camera_->tend();
    if (const auto warning = camera_->warning()) std::printf("\n      %s\n", warning->c_str());
    const auto fault = camera_->fault();
    if (!fault) return true;
    settled_ = false;
    std::printf("\n      the simulator has ended (%s); judging what there is\n", fault->c_str());
    return false;
  }

  void watch(Member& member) {
    if (member.lost) return;
    for (const std::string& line : member.process->lines()) {
      json status = json::parse(line, nullptr, false);
      if (!status.is_object()) continue;
      member.status = std::move(status);
      member.heard_unix_s = unix_now_s();
    }
    watch_integrity(member);
    watch_silence(member);
    if (!member.process->ended()) return;
    member.lost = true;
    std::printf("\n      vehicle %u is gone (%s); %s\n", member.id, member.process->ended()->c_str(),
                others_run(member) ? "the others go on and keep its submap" : "none is left");
    if (const std::string why = last_error(log_of(member)); !why.empty())
      std::printf("      it says: %s\n", why.c_str());
    std::fflush(stdout);
    if (!options_.restart_lost || member.restarted) return;
    std::printf("      vehicle %u starts again, in a new epoch\n", member.id);
    member.lost = false;
    member.restarted = true;
    start(member);
  }

  bool others_run(const Member& gone) const {
    return std::any_of(members_.begin(), members_.end(),
                       [&](const Member& m) { return m.id != gone.id && !m.lost && !m.process->ended(); });
  }

  // Says so at once when somebody else speaks in a vehicle's name: what comes of the run is worth nothing then.
  void watch_integrity(Member& member) {
    const json reasons = member.status.value("reasons", json::array());
    if (member.impersonated || std::find(reasons.begin(), reasons.end(), "impersonated") == reasons.end()) return;
    member.impersonated = true;
    std::printf("\n      vehicle %u is SUSPECT: somebody else speaks under its id on DDS domain %u\n", member.id,
                domain_);
    std::fflush(stdout);
  }

  // A process that lives and says nothing: stopped, swapped out, or stuck.
  void watch_silence(Member& member) {
    member.silent = unix_now_s() - member.heard_unix_s > silence_s;
    if (!member.silent || member.told_silent || member.process->ended()) return;
    member.told_silent = true;
    std::printf("\n      vehicle %u has been silent for %.0f s, though process %d lives; the others go on without it\n",
                member.id, silence_s, static_cast<int>(member.process->pid()));
    std::fflush(stdout);
  }

  std::size_t alive() const {
    return static_cast<std::size_t>(
        std::count_if(members_.begin(), members_.end(), [](const Member& m) { return !m.lost; }));
  }
  template <class Predicate>
  bool all_alive(Predicate predicate) const {
    return std::all_of(members_.begin(), members_.end(),
                       [&](const Member& m) { return m.lost || predicate(m.status); });
  }
  // Sensors ended, nothing missing, and everybody alive holds the same facts and the same map.
  bool agreed() const {
    std::set<std::string> facts, maps;
    return all_alive([&](const json& s) {
      facts.insert(s.value("facts_digest", ""));
      maps.insert(s.value("map_digest", ""));
      return s.value("exhausted", false) && s.value("settled", false) && facts.size() == 1 && maps.size() == 1;
    });
  }

  void progress() const {
    double t_s = 0.0;
    std::string text;
    for (const Member& m : members_) {
      t_s = std::max(t_s, std::min(m.status.value("vehicle_s", 0.0), scenario_.duration_s));
      char part[96];
      const std::string state = m.lost ? "LOST" : m.silent ? "SILENT" : m.status.value("integrity", "...");
      std::snprintf(part, sizeof part, "  v%u %s %d/%d", m.id, state.c_str(), m.status.value("landmarks_exported", 0),
                    m.status.value("landmarks_known", 0));
      text += part;
    }
    std::printf("%s      %3.0f %%  t %4.0f s%s%s", isatty(STDOUT_FILENO) ? "\r" : "",
                100.0 * std::max(0.0, t_s) / scenario_.duration_s, std::max(0.0, t_s), text.c_str(),
                isatty(STDOUT_FILENO) ? "" : "\n");
    std::fflush(stdout);
  }

  void collect(double wall_s) {
    for (Member& member : members_)
      if (!member.lost) member.process->terminate();
    json lost = json::array();
    for (Member& member : members_) {
      if (!member.lost && (!member.process->wait(30.0) || !member.process->succeeded())) {
        std::printf("      vehicle %u did not end well (%s); see %s\n", member.id,
                    member.process->ended().value_or("no answer to SIGTERM").c_str(), log_of(member).c_str());
        member.lost = true;
      }
      if (member.lost) lost.push_back(member.id);
    }
    json run;
    if constexpr (G::Dim == 3)
      if (camera_) {
        camera_->write_truth(scenario_);
        if (const auto factor = camera_->real_time_factor()) run["real_time_factor"] = *factor;
      }
    run["scenario"] = scenario_.name;
    run["source"] = scenario_.source;
    run["seed"] = scenario_.seed;
    run["dimension"] = G::Dim;
    run["rate"] = options_.rate;
    run["vehicles"] = json::array();
    for (const Member& member : members_) run["vehicles"].push_back(member.id);
    run["impair"] = options_.impair;
    run["method"] = options_.literal ? "literal" : "convoy";
    run["common_frame_vehicle"] = scenario_.common_frame_vehicle;
    run["wall_s"] = wall_s;
    run["vehicle_s"] = scenario_.duration_s;
    run["interrupted"] = interrupted != 0;
    run["lost_vehicles"] = lost;
    write_text_file(options_.out / "run.json", run.dump(1) + "\n");
  }

  int judge() const {
    const RunRecord<G> run = read_run<G>(options_.out);
    const Evaluation<G> evaluation = evaluate(run);
    write_evaluation(run, evaluation);
    write_report(run, evaluation);
    std::printf("\n%s\n\nReport:  %s\nMetrics: %s\n", headline(run, evaluation.metrics).c_str(),
                fs::absolute(options_.out / "report.html").c_str(),
                fs::absolute(options_.out / "metrics.json").c_str());
    const bool alone = std::none_of(members_.begin(), members_.end(), [](const Member& m) { return m.impersonated; });
    return alive() > 0 && settled_ && alone && evaluation.metrics.at("map_digests_equal") == json(true) ? 0 : 1;
  }

  DemoOptions options_;
  Impairments impairment_;
  fs::path profile_;
  Scenario<G> scenario_;
  std::uint32_t domain_ = 0;
  double start_unix_s_ = 0.0;
  std::vector<Member> members_;
  bool cameras_ = false;
  std::unique_ptr<CameraDrive> camera_;  // if with cameras
  bool settled_ = true;                  // all that lived held the same facts and the same map in the end
};

}  // namespace

bool drives_with_cameras(const DemoOptions& options) {
  return !options.fast && !options.space && options.dataset.empty() && can_drive_with_cameras();
}

int run_demo(const DemoOptions& options) {
  const bool landmarks = options.fast || options.space || !options.dataset.empty();
  if (drives_with_cameras(options)) return Demo<SE3>(options).run_with_cameras();
  if (!landmarks)
    std::printf("no cameras here (the simulator or OpenCV was not there when convoy was built): driving as --fast\n");
  return options.space ? Demo<SE3>(options).run() : Demo<SE2>(options).run();
}

}  // namespace convoy::cli
