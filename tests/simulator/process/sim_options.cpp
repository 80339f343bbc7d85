#include "sim_options.hpp"

#include <CLI/CLI.hpp>

#include <charconv>
#include <cstdio>
#include <sstream>

namespace convoy::simulator {
namespace {

/// For numbers without sign: CLI11 takes "-1" for the largest of them, and so it does what is larger than any.
const CLI::Validator whole_number(
    [](std::string& text) {
      std::uint64_t value = 0;
      const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
      const bool whole = error == std::errc() && end == text.data() + text.size();
      return whole ? std::string() : "'" + text + "' is no whole number from 0 to 18446744073709551615";
    },
    "");

/// What an unset variable of a shell leaves is not the same as nothing asked for.
const CLI::Validator not_empty(
    [](std::string& text) { return text.empty() ? std::string("the name is empty") : std::string(); }, "");

/// Both ends included. CLI::Range lets through what is not a number ("nan").
CLI::Validator number_in(double low, double high) {
  return CLI::Validator(
      [=](std::string& text) {
        double value = 0.0;
        if (CLI::detail::lexical_cast(text, value) && value >= low && value <= high) return std::string();
        std::ostringstream fault;
        fault << "'" << text << "' is no number from " << low << " to " << high;
        return fault.str();
      },
      "");
}

/// "640x480" as two numbers; false if it is none.
bool read_size(const std::string& text, int& width, int& height) {
  char rest = 0;
  return std::sscanf(text.c_str(), "%dx%d%c", &width, &height, &rest) == 2 && width >= 32 && width <= 1280 &&
         height >= 24 && height <= 1024;
}

const CLI::Validator picture_size(
    [](std::string& text) {
      int width = 0, height = 0;
      return read_size(text, width, height)
                 ? std::string()
                 : "'" + text + "' is no size from 32x24 to 1280x1024, like 640x480 or 512x384";
    },
    "");

void add_world(CLI::App& app, SimOptions& options) {
  app.add_option("--world", options.world, "district (a generated one, the default), or a file of OpenStreetMap XML")
      ->check(not_empty);
  app.add_option("--seed", options.seed, "of everything that is drawn at random (default: 1)")->check(whole_number);
  app.add_option("--route", options.routes,
                 "by name, see --list-routes, of each vehicle, comma-separated; the last one is that of those who "
                 "follow (default: the first)")
      ->delimiter(',');
  app.add_flag("--traffic", options.traffic, "other cars drive, too");
  app.add_flag("--list-routes", options.list_routes, "say which routes the world has, and end");
}

void add_vehicles(CLI::App& app, SimOptions& options) {
  app.add_option("--vehicles", options.vehicles, "how many, numbered from 1 on, 1 to 100 (default: 1)")
      ->check(CLI::Range(1, 100));
  app.add_option("--gap", options.gap_m, "metres from one to the next, 0 to 10000 (default: 20)")
      ->check(number_in(0.0, 10000.0));
  app.add_option("--offset", options.offset_m,
                 "metres to the left of the route, of each vehicle, comma-separated, -20 to 20 (default: 0)")
      ->delimiter(',')
      ->check(number_in(-20.0, 20.0));
  app.add_option("--speed", options.speed_mps, "m/s, 0.1 to 10 (default: 2)")->check(number_in(0.1, 10.0));
  app.add_option("--duration", options.duration_s, "simulated seconds, 0.1 to 100000 (default: once along the route)")
      ->check(number_in(0.1, 100000.0));
  app.add_option("--distance", options.distance_m, "metres of the first vehicle, 0.1 to 1000000")
      ->check(number_in(0.1, 1e6));
}

void add_topics(CLI::App& app, SimOptions& options) {
  app.add_option("--domain-sensors", options.sensor_domain, "DDS domain of sensors and lock-step, 0..232 (default: 10)")
      ->check(CLI::Range(0, 232));
  app.add_option("--domain-truth", options.truth_domain, "DDS domain of the truth, 0..232 (default: 11)")
      ->check(CLI::Range(0, 232));
  app.add_option("--run", options.run,
                 "number of the run, 1 or more, another one than of the run before (default: the time)")
      ->check(whole_number);
  app.add_flag("--lock-step", options.lock_step, "each step waits until all vehicles have done it");
  app.add_option("--rate", options.rate, "simulated seconds per second, 0.01 to 1000 (default: 1)")
      ->check(number_in(0.01, 1000.0));
  app.add_option("--wait-for", options.wait_for,
                 "the first so many vehicles, before the first step (default: in lock-step all, else none)")
      ->check(CLI::Range(0, 100));
  app.add_option("--deadline", options.deadline_s, "seconds for a vehicle's answer, 0.1 to 86400 (default: 30)")
      ->check(number_in(0.1, 86400.0));
}

/// The first of these options that is given, and why it cannot be; empty: none is.
std::string fault_of_any(const CLI::App& app, std::initializer_list<const char*> names, const std::string& why) {
  for (const char* name : names)
    if (app.count(name) > 0) return std::string(name) + ": " + why;
  return {};
}

/// Of what only looks at the world.
std::string fault_of_a_look(const SimOptions& options, const CLI::App& app) {
  if (options.list_routes)
    return fault_of_any(
        app, {"--snapshot", "--record", "--lock-step", "--rate", "--wait-for", "--deadline", "--run", "--truth-depth"},
        "--list-routes ends before anybody drives; take one of the two out");
  if (!options.snapshot.empty())
    return fault_of_any(app,
                        {"--record", "--lock-step", "--rate", "--wait-for", "--deadline", "--run", "--truth-depth"},
                        "a snapshot speaks to nobody; take one of the two out");
  return {};
}

/// What is wrong with options that are right each by itself.
std::string fault_of(const SimOptions& options, const CLI::App& app) {
  if (options.sensor_domain == options.truth_domain)
    return "--domain-sensors and --domain-truth are the same; the truth is not for the vehicles";
  if (options.run == 0U) return "--run 0: runs are numbered from 1 on";
  if (!options.replay.empty() && !options.record.empty()) return "--record and --replay exclude each other";
  if (options.lock_step && app.count("--rate") > 0)
    return "--rate and --lock-step exclude each other: in lock-step the vehicles set the pace";
  if (options.as_is && options.replay.empty()) return "--as-is is of recordings; name one by --replay";
  if (options.replay.empty()) {
    if (options.wait_for.value_or(0) > options.vehicles)
      return "--wait-for " + std::to_string(*options.wait_for) + ": there are only " +
             std::to_string(options.vehicles) + " vehicles";
    if (options.offset_m.size() > static_cast<std::size_t>(options.vehicles))
      return "--offset: " + std::to_string(options.offset_m.size()) + " for " + std::to_string(options.vehicles) +
             (options.vehicles == 1 ? " vehicle" : " vehicles");
    return fault_of_a_look(options, app);
  }
  return fault_of_any(
      app,
      {"--world", "--seed", "--route", "--traffic", "--list-routes", "--vehicles", "--gap", "--offset", "--speed",
       "--duration", "--distance", "--camera", "--drop", "--gps", "--truth-depth", "--snapshot"},
      "a recording is as it was; take it out");
}

}  // namespace

ParsedOptions parse_options(int argc, char** argv) {
  ParsedOptions parsed;
  SimOptions& options = parsed.options;
  CLI::App app{"convoy sim: vehicles that drive in streets, and what they sense, as DDS topics on 127.0.0.1",
               "convoy sim"};
  add_world(app, options);
  add_vehicles(app, options);
  std::string size;
  app.add_option("--camera", size, "pixels, like 640x480 (the default) or 512x384")->check(picture_size);
  app.add_option("--drop", options.drop_probability,
                 "share of the frames that the camera drops, 0 to 1 (default: 0.002)")
      ->check(number_in(0.0, 1.0));
  app.add_option("--gps", options.gps, "none (the default), standard or rtk")
      ->check(CLI::IsMember({"none", "standard", "rtk"}));
  app.add_flag("--truth-depth", options.depth, "the truth tells the distance of each pixel, too; not recorded");
  add_topics(app, options);
  app.add_option("--record", options.record, "folder to make: what was sensed, to be read and replayed")
      ->check(not_empty);
  app.add_option("--replay", options.replay, "publish a recording instead of a world")->check(not_empty);
  app.add_flag("--as-is", options.as_is, "replay a recording that was cut or changed, too, as far as it goes");
  app.add_option("--snapshot", options.snapshot, "write what vehicle 1 sees at the end as a PNG file; speaks to nobody")
      ->check(not_empty);
  app.footer(
      "Exit status: 0 at the end; 1 a vehicle or another subscriber did not answer in time; 2 what was asked for\n"
      "cannot be done; 128 + the signal if it was stopped (SIGINT 130, SIGTERM 143).");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    parsed.exit_status = app.exit(error) == 0 ? 0 : 2;  // 0: --help
    return parsed;
  }
  if (!size.empty()) read_size(size, options.width, options.height);
  if (const std::string fault = fault_of(options, app); !fault.empty()) {
    std::fprintf(stderr, "convoy sim: %s\n", fault.c_str());
    parsed.exit_status = 2;
  }
  for (int i = 1; i < argc; ++i) options.command_line += (i > 1 ? " " : "") + std::string(argv[i]);
  return parsed;
}

}  // namespace convoy::simulator
