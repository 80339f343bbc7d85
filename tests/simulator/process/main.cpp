// convoy-sim, which `convoy sim` runs.
#include "camera_file.hpp"
#include "live_source.hpp"
#include "recording.hpp"
#include "run.hpp"
#include "sim_error.hpp"

#include <csignal>
#include <cstdio>
#include <memory>

namespace {

using namespace convoy::simulator;

volatile std::sig_atomic_t stopped = 0;

void stop_at_signals() {
  struct sigaction action {};
  action.sa_handler = [](int) { stopped = 1; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

/// Who made the map is named wherever it is used.
void attribute(const std::string& attribution) {
  if (attribution.empty()) return;
  std::printf("%s\n", attribution.c_str());
  std::fflush(stdout);
}

void list_routes(const SimOptions& options) {
  const WorldNote world = describe_world(options);
  attribute(world.attribution);
  for (const RouteNote& route : world.routes)
    std::printf("%-24s %7.1f m, %s\n", route.name.c_str(), route.length_m, route.closed ? "closed" : "open");
}

void take_snapshot(SimOptions options) {
  options.drop_probability = 0.0;
  LiveSource source(options);
  attribute(source.attribution());
  const FrameData frame = source.snapshot();
  save_picture(options.snapshot, frame.width, frame.height, frame.grey);
}

void show(const SimOptions& options) {
  if (options.list_routes) return list_routes(options);
  if (!options.replay.empty()) {
    Replay replay(options.replay);
    attribute(replay.attribution());
    return run(replay, options, [] { return stopped != 0; });
  }
  std::fprintf(stderr, "convoy sim: building the world\n");
  if (!options.snapshot.empty()) return take_snapshot(options);
  LiveSource source(options);
  attribute(source.attribution());
  run(source, options, [] { return stopped != 0; });
}

}  // namespace

int main(int argc, char** argv) {
  const ParsedOptions parsed = parse_options(argc, argv);
  if (parsed.exit_status) return *parsed.exit_status;
  stop_at_signals();
  try {
    show(parsed.options);
  } catch (const SetUpError& error) {
    std::fprintf(stderr, "convoy sim: %s\n", error.what());
    return 2;
  } catch (const DeadlineError& error) {
    std::fprintf(stderr, "convoy sim: %s\n", error.what());
    return 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "convoy sim: unexpected: %s\n", error.what());
    return 3;
  }
  return 0;
}
