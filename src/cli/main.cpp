// The command convoy.
#include <convoy/geometry/groups.hpp>

#include <cstdio>

#include "associate.hpp"
#include "bench_network.hpp"
#include "bench_peer.hpp"
#include "calibrate.hpp"
#include "consistency/suite.hpp"
#include "demo.hpp"
#include "evaluate/evaluate.hpp"
#include "evaluate/run_folder.hpp"
#include "other_program.hpp"
#include "report/report.hpp"
#include "run_program.hpp"
#include "solve.hpp"
#include "vehicle_options.hpp"

namespace {

using namespace convoy;

/// For numbers without sign: CLI11 takes "-1" for the largest of them.
const CLI::Validator whole_number(
    [](std::string& text) {
      const bool digits = !text.empty() && text.find_first_not_of("0123456789") == std::string::npos;
      return digits ? std::string() : "'" + text + "' is no whole number from 0 on";
    },
    "");

/// What is wrong with the first word, which names the command; empty: nothing.
std::string command_fault(const CLI::App& app, int argc, char** argv) {
  const std::string word = argc > 1 ? argv[1] : "";
  if (word.rfind('-', 0) == 0) return {};
  std::string commands;
  for (const CLI::App* command : app.get_subcommands({})) {
    if (command->get_name() == word) return {};
    if (command->get_group().empty()) continue;  // for this program's own use
    commands += (commands.empty() ? "" : ", ") + command->get_name();
  }
  return (word.empty() ? "no command given" : "no command '" + word + "'") + "; there are: " + commands +
         " (convoy COMMAND --help)";
}

}  // namespace

int main(int argc, char** argv) {
  cli::log_to_standard_error();
  CLI::App app{"convoy: one consistent map for several vehicles, without a server, over Fast DDS"};
  app.require_subcommand(1);
  app.set_version_flag("--version", CONVOY_VERSION);
  int status = 0;

  cli::DemoOptions demo;
  std::vector<std::string> dataset;
  auto* demo_command = app.add_subcommand("demo", "Drive a fleet on this machine, one process per vehicle, and report");
  demo.out = "convoy-demo";
  demo_command
      ->add_option("--distance", demo.streets.distance_m,
                   "metres that the cameras drive, 1 to 100000 (default: once around)")
      ->check(CLI::Range(1.0, 100000.0));
  demo_command->add_option("--world", demo.streets.world, "OpenStreetMap XML file of the streets that the cameras see")
      ->check(CLI::ExistingFile);
  demo_command
      ->add_option("--route", demo.streets.routes,
                   "of each vehicle, comma-separated, by convoy sim --list-routes (default: the world's first)")
      ->delimiter(',');
  demo_command->add_option("--vehicles", demo.streets.vehicles, "that have cameras, 1 to 10 (default: 2)")
      ->check(CLI::Range(1, 10));
  demo_command->add_flag("--fast", demo.fast,
                         "sensors that measure landmarks, in place of cameras and a simulator that shows them streets");
  demo_command->add_option("--out", demo.out, "run folder to make (default: convoy-demo)");
  demo_command->add_option("--dataset", dataset, "KIND FOLDER of a recorded data set; kinds: mrclam, victoria-park")
      ->expected(2);
  demo_command->add_flag("--space", demo.space, "a street that climbs and falls, in three dimensions");
  demo_command
      ->add_option("--seed", demo.seed, "seed of the simulated street, and of the priors of victoria-park (default: 1)")
      ->check(whole_number);
  demo_command->add_option("--rate", demo.rate, "vehicle seconds per second, 0.01 to 1000 (default: 10)")
      ->check(CLI::Range(0.01, 1000.0));
  demo_command->add_option("--impair", demo.impair, cli::impairment_help());
  demo_command->add_flag("--literal", demo.literal, "the paper's own method: literal drift, EKF map, Fig. 5 search");
  demo_command->add_flag("--encounters", demo.encounters,
                         "use what the vehicles see of each other (mrclam), beside landmarks");
  demo_command->add_flag("--restart-lost", demo.restart_lost, "start a vehicle whose process died again, once");
  demo_command
      ->add_option("--settle-timeout", demo.settle_timeout_s,
                   "seconds to agree after the sensors end, 0 to 86400 (default: 60)")
      ->check(CLI::Range(0.0, 86400.0));
  demo_command->add_option("--domain", demo.domain, "DDS domain 0..232 (default: a free one)")
      ->check(CLI::Range(0, 232));
  demo_command
      ->add_option("--first-epoch", demo.first_epoch,
                   "epoch of all vehicles; 1, so that runs can be compared to the bit; 0: by the clock")
      ->check(whole_number);
  demo_command->add_option(
      "--profile", demo.profile,
      "loopback, loopback_udp, lan, lossy_radio, low_bandwidth, or an XML profile file of one's own "
      "(default: loopback_udp)");
  demo_command->callback([&] {
    if (!dataset.empty()) {
      demo.dataset = dataset[0];
      demo.dataset_folder = dataset[1];
    }
    const bool has_landmarks = demo.fast || demo.space || !demo.dataset.empty();
    for (const char* of_cameras : {"--distance", "--world", "--route", "--vehicles"})
      if (has_landmarks && demo_command->count(of_cameras) > 0)
        throw ConfigError(std::string("demo: ") + of_cameras +
                          " is of cameras in the simulator's streets: leave out "
                          "--fast, --space and --dataset");
    for (const char* of_landmarks : {"--rate", "--encounters"})
      if (cli::drives_with_cameras(demo) && demo_command->count(of_landmarks) > 0)
        throw ConfigError(std::string("demo: ") + of_landmarks +
                          " is of sensors that measure landmarks; give --fast, too, or --dataset or --space");
    status = cli::run_demo(demo);
  });

  std::string config;
  cli::VehicleRunOptions vehicle;
  auto* vehicle_command = app.add_subcommand("vehicle", "Run one vehicle until SIGINT or SIGTERM");
  cli::add_vehicle_options(*vehicle_command, config, vehicle);
  vehicle_command->callback([&] {
    status = with_group(fleet_dimension(config), [&]<class G>(G) {
      const auto loaded = load_vehicle_config<G>(config);
      if (loaded.camera.given()) cli::become(cli::camera_program(), "CONVOY_BUILD_VISION", argc, argv);
      return cli::run_vehicle<G>(loaded, vehicle, cli::open_log<G>);
    });
  });

  std::string run_folder;
  auto* evaluate_command = app.add_subcommand("evaluate", "Judge a run folder again: metrics.json and report.html");
  evaluate_command->add_option("run", run_folder, "run folder")->required();
  evaluate_command->callback([&] {
    with_group(cli::run_dimension(run_folder), [&]<class G>(G) {
      const cli::RunRecord<G> run = cli::read_run<G>(run_folder);
      cli::expect_survivors(run);
      const cli::Evaluation<G> evaluation = cli::evaluate(run);
      cli::write_evaluation(run, evaluation);
      cli::write_report(run, evaluation);
      std::printf("%s\n", cli::headline(run, evaluation.metrics).c_str());
    });
  });

  cli::CalibrateOptions calibrate;
  auto* calibrate_command =
      app.add_subcommand("calibrate", "Learn the drift noise from runs: intervals and a <drift/> element");
  calibrate_command->add_option("runs", calibrate.runs, "run folders of convoy demo")->required();
  calibrate_command->add_option("--out", calibrate.out, "XML file to write the <drift/> element to");
  calibrate_command
      ->add_option("--by", calibrate.by, "truth, closures, or auto: truth if every run has it (default: auto)")
      ->check(CLI::IsMember({"auto", "truth", "closures"}));
  calibrate_command->add_option("--span", calibrate.span_m, "metres of a span against the truth (default: 80)");
  calibrate_command->callback([&] {
    calibrate.drift_of_config = [](const std::filesystem::path& file) {
      return load_vehicle_config<SE2>(file).vehicle.drift;
    };
    status = cli::run_calibrate(calibrate);
  });

  cli::SolveOptions solve;
  auto* solve_command = app.add_subcommand("solve", "Solve a pose graph: solve.json and solved.g2o");
  solve_command->add_option("graph", solve.graph, "g2o file")->required();
  solve_command->add_option("--out", solve.out, "folder for the results")->required();
  solve_command->add_flag("--incremental", solve.incremental,
                          "vertices one after the other, in the order of their ids");
  solve_command->add_option("--residual", solve.residual, "g2o (R^T dt, dtheta) or log (group logarithm; default: g2o)")
      ->check(CLI::IsMember({"g2o", "log"}));
  solve_command->callback([&] { status = cli::run_solve(solve); });

  cli::AssociateOptions association;
  std::vector<std::string> problems;
  auto* associate_command = app.add_subcommand("associate", "Find common landmarks in association problems");
  associate_command->add_option("problems", problems, "problem files (.assoc)")->required();
  associate_command->add_option("--method", association.method, "how to search (default: alignment)")
      ->check(CLI::IsMember(cli::association_methods()));
  associate_command->add_option("--out", association.out, "folder for NAME.result of each problem");
  associate_command->callback([&] {
    association.problems.assign(problems.begin(), problems.end());
    status = cli::run_associate(association);
  });

  cli::consistency::ConsistencyOptions consistency;
  auto* consistency_command =
      app.add_subcommand("consistency", "Measure by Monte Carlo whether the estimator is consistent");
  consistency_command->add_option("--runs", consistency.runs, "runs of each scenario (default: 200)")
      ->check(CLI::Range(2, 100000));
  consistency_command->add_option("--seed", consistency.seed, "seed of all draws (default: 1)")->check(whole_number);
  consistency_command->add_option(
      "--data", consistency.data,
      "folder of kitti_trajectories and pose_graphs, for real drift (default: CONVOY_DATA_DIR)");
  consistency_command->add_option("--only", consistency.only,
                                  "only scenarios whose name holds this, like '2-D EKF-SLAM'");
  consistency_command->add_option("--out", consistency.out, "folder for consistency.json and consistency.html")
      ->required();
  consistency_command->callback([&] { status = cli::consistency::run_consistency(consistency); });

  cli::BenchNetworkOptions network;
  auto* bench_command = app.add_subcommand("bench", "Measure on this machine");
  bench_command->require_subcommand(1);
  auto* network_command = bench_command->add_subcommand(
      "network", "Fleets of processes on a bad network: a table, and network.json; status 1 if a figure is missed");
  network_command->add_option("--out", network.out, "folder for network.json and the logs")->required();
  network_command->add_option("--case", network.cases, "case to run, as often as needed (default: all)")
      ->check(CLI::IsMember(cli::bench_network_cases()));
  network_command->callback([&] { status = cli::run_bench_network(network); });

  // Only for the list of commands: their words are the affair of programs of their own.
  app.add_subcommand("replay",
                     "A recording of sensors and an odometer through a vehicle or a fleet (convoy replay --help)");
  app.add_subcommand("sim", "Simulate vehicles in streets: what they sense, as DDS topics (convoy sim --help)");

  cli::BenchPeerOptions peer;
  auto* peer_command = app.add_subcommand("bench-peer", "One process of convoy bench network")->group("");
  peer_command->add_option("--profile", peer.profile)->required();
  peer_command->add_option("--domain", peer.domain)->required();
  peer_command->add_option("--vehicle", peer.vehicle)->required();
  peer_command->add_option("--impair", peer.impair);
  peer_command->add_option("--server", peer.servers);
  peer_command->add_option("--budget", peer.budget_bytes_per_s, "bytes per second");
  peer_command->add_flag("--alone", peer.alone, "no digests and no requests: the middleware alone");
  peer_command->callback([&] { status = cli::run_bench_peer(peer); });

  if (const std::string fault = command_fault(app, argc, argv); !fault.empty()) {
    spdlog::error("{}", fault);
    return 2;
  }
  return cli::run_program(app, [&] {
    const std::string command = argc > 1 ? argv[1] : "";
    if (command == "sim") cli::become(cli::simulator_program(), "CONVOY_BUILD_SIMULATOR", argc, argv);
    if (command == "replay") cli::become(cli::replay_program(), "CONVOY_WITH_DDS", argc, argv);
    app.parse(argc, argv);
    return status;
  });
}
