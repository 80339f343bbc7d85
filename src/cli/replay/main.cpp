// convoy replay, a program of its own: see other_program.hpp.
#include "replay/replay.hpp"
#include "run_program.hpp"

int main(int argc, char** argv) {
  using namespace convoy;
  cli::log_to_standard_error();
  CLI::App app{
      "convoy replay: a recording of sensors and an odometer through the front end of a vehicle, or of a fleet"};
  app.name("convoy replay");
  cli::ReplayOptions replay;
  std::vector<std::string> recording;
  app.add_option(
         "--dataset", recording,
         "KIND FOLDER; kinds: images (a vehicle's folder of convoy sim --record, or one's own recording of that "
         "layout), kitti (a drive of KITTI's odometry benchmark with poses.txt), victoria (Victoria Park's "
         "odometry.csv, "
         "gps.csv and tree_detections.csv: the drive in three parts, as a fleet)")
      ->expected(2)
      ->required();
  app.add_option("--out", replay.out, "run folder to make")->required();
  app.add_option("--rate", replay.rate_hz, "images per second, where no file says when they were taken")
      ->check(CLI::Range(0.001, 10000.0));
  app.add_option("--features", replay.features, "features followed at once, 12 to 400 (default: 50)")
      ->check(CLI::Range(12, 400));
  app.add_option("--seed", replay.seed, "of where the vehicles of victoria believe to start (default: 1)");
  return cli::run_program(app, [&] {
    app.parse(argc, argv);
    replay.dataset = recording[0];
    replay.folder = recording[1];
    return cli::run_replay(replay);
  });
}
