#include "vehicle_options.hpp"

namespace convoy::cli {

std::string impairment_help() {
  return "loss=0.3,duplicate=0.2,delay=100ms,jitter=50ms,reorder=0.1,rate=100kB/s,"
         "partition=3+4@10s..70s,seed=7 on what is received, in real seconds; with out. before it, on what "
         "is sent";
}

void add_vehicle_options(CLI::App& command, std::string& config, VehicleRunOptions& options) {
  command.add_option("config", config, "its XML configuration")->required();
  command.add_flag("--until-end", options.until_end, "end when the sensor log has ended and all facts are settled");
  command
      .add_option("--status-period", options.status_period_s,
                  "seconds between status lines, 0.01 to 86400 (default: 0.25)")
      ->check(CLI::Range(0.01, 86400.0));
  command.add_flag("--now", options.now, "the sensor log begins now, not at the configuration's start_unix_s");
  command.add_flag("--sightings", options.sightings,
                   "write sightings.csv: in which pixel the camera saw each landmark, for a judge");
  command.add_option("--impair", options.impair, impairment_help() + "; instead of the configuration's");
  command.add_option("--out", options.out,
                     "folder for what it writes (default: the configuration's); the state folder, which holds "
                     "the last epoch, stays where it is");
}

}  // namespace convoy::cli
