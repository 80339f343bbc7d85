#include "replay/replay.hpp"

#include <convoy/config_error.hpp>

#include "replay/camera_replay.hpp"
#include "replay/fleet_replay.hpp"
#include "replay/outcome.hpp"
#include "scenario/table_file.hpp"
#include "scenario/victoria_park.hpp"

namespace convoy::cli {

namespace fs = std::filesystem;

namespace {

void expect_new_folder(const fs::path& out) {
  std::error_code none;
  if (fs::exists(out) && !fs::is_empty(out, none))
    throw ConfigError(out.string() + ": is there already; name another folder with --out, or delete it");
  expect_writable(out);
}

bool replay(const ReplayOptions& options) {
  if (options.dataset == "victoria") return replay_fleet(load_victoria_park(options.folder, options.seed), options.out);
  if (options.dataset != "images" && options.dataset != "kitti")
    throw ConfigError("replay: no kind of data set '" + options.dataset + "'; there are: images, kitti, victoria");
  replay_camera(options);
  return true;
}

}  // namespace

int run_replay(const ReplayOptions& options) {
  if (options.dataset == "victoria" && (options.rate_hz > 0.0 || options.features > 0))
    throw ConfigError("replay: --rate and --features are of images, and victoria has none; leave them out");
  expect_new_folder(options.out);
  const bool agreed = replay(options);
  print_where(options.out);
  return agreed ? 0 : 1;
}

}  // namespace convoy::cli
