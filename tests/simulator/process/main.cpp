// convoy-sim, which `convoy sim` runs.
#include "camera_file.hpp"
#include "live_source.hpp"
#include "progress.hpp"
#include "recording.hpp"
#include "run.hpp"
#include "sim_error.hpp"

#include <csignal>
#include <cstdio>
#include <memory>

namespace {

using namespace convoy::simulator;

volatile std::sig_atomic_t stopped_by = 0;

/// The run ends in order, at the first of them; a second one ends it anyhow.
void stop_at_signals() {
  struct sigaction action {};
  action.sa_handler = [](int signal) { stopped_by = signal; };
  action.sa_flags = static_cast<int>(SA_RESETHAND);
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
  Progress progress(source.duration_s());
  const FrameData frame = source.snapshot([&](double time_s) { progress.tell(time_s); });
  save_picture(options.snapshot, frame.width, frame.height, frame.grey);
  std::printf("%s: what vehicle 1 sees at %g s\n", options.snapshot.c_str(), frame.stamp_s);
}

/// What was said there is lost on a full disk.
void expect_output_written() {
  if (std::fflush(stdout) != 0 || std::ferror(stdout) != 0)
    throw SetUpError("the standard output cannot be written; make room where it goes");
}

/// The exit status.
int run_until_signal(SensorSource& source, const SimOptions& options) {
  attribute(source.attribution());
  stop_at_signals();
  return run(source, options, [] { return stopped_by != 0; }) ? 0 : 128 + stopped_by;
}

int replay(const SimOptions& options) {
  Replay recorded(options.replay, options.as_is);
  if (!recorded.warning().empty()) std::fprintf(stderr, "convoy sim: %s\n", recorded.warning().c_str());
  return run_until_signal(recorded, options);
}

int show(const SimOptions& options) {
  if (!options.replay.empty()) return replay(options);
  // What needs no world is looked at before there is one.
  if (!options.snapshot.empty()) expect_room_for_picture(options.snapshot);
  if (!options.record.empty()) expect_room_for_recording(options.record);
  if (options.list_routes) {
    list_routes(options);
  } else if (!options.snapshot.empty()) {
    take_snapshot(options);
  } else {
    LiveSource source(options);
    return run_until_signal(source, options);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const ParsedOptions parsed = parse_options(argc, argv);
  if (parsed.exit_status) return *parsed.exit_status;
  try {
    const int status = show(parsed.options);
    expect_output_written();
    return status;
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
}
