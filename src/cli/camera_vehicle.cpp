// convoy vehicle with a <camera>, a program of its own: see other_program.hpp.
#include "run_program.hpp"
#include "sensor_source.hpp"
#include "vehicle_options.hpp"

int main(int argc, char** argv) {
  using namespace convoy;
  cli::log_to_standard_error();
  CLI::App app{"convoy vehicle: run one vehicle with a camera until SIGINT or SIGTERM"};
  app.name("convoy vehicle");
  std::string file;
  cli::VehicleRunOptions options;
  cli::add_vehicle_options(app, file, options);
  return cli::run_program(app, [&] {
    app.parse(argc, argv);
    const auto config = load_vehicle_config<SE3>(file);
    if (!config.camera.given()) throw ConfigError(file + ":1: no <camera>; this is for convoy vehicle " + file);
    return cli::run_vehicle<SE3>(config, options, cli::open_camera);
  });
}
