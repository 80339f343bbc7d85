#include "bench_network.hpp"

#include <convoy/config_error.hpp>
#include <convoy/submap/facts.hpp>

#include <nlohmann/json.hpp>

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <functional>
#include <memory>
#include <set>
#include <sstream>

#include "bench_fleet.hpp"
#include "child_process.hpp"
#include "qos_profile.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// Two figures behind the point are enough for seconds and bytes.
std::string text_of(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f", value);
  return text;
}

// Of a chain: its start, the static bias, landmarks and their anchors, 20 to each.
std::uint64_t facts_of(std::uint64_t vehicles, std::uint64_t landmarks) {
  return vehicles * (2 + landmarks + (landmarks + 19) / 20);
}

json row(const std::string& asked, const std::string& measured, bool met, json details) {
  return {{"asked", asked}, {"measured", measured}, {"met", met}, {"details", std::move(details)}};
}

// From written to held by all others, of every landmark of every vehicle.
json everywhere(BenchFleet& fleet) {
  const auto times = fleet.ask("times");
  std::vector<double> delays_s;
  std::uint64_t lacking = 0;
  for (const auto& [author, of_author] : times) {
    const auto written = of_author.at("written").get<std::vector<std::int64_t>>();
    std::vector<std::int64_t> everywhere_us = written;
    for (const auto& [other, of_other] : times) {
      if (other == author) continue;
      const json& held = of_other.at("held");
      const auto found = held.find(std::to_string(author));
      auto at = found == held.end() ? std::vector<std::int64_t>{} : found->get<std::vector<std::int64_t>>();
      at.resize(written.size());
      for (std::size_t i = 0; i < written.size(); ++i)
        everywhere_us[i] = at[i] == 0 || everywhere_us[i] == 0 ? 0 : std::max(everywhere_us[i], at[i]);
    }
    for (std::size_t i = 0; i < written.size(); ++i) {
      if (everywhere_us[i] == 0) ++lacking;
      else delays_s.push_back(seconds_between(written[i], everywhere_us[i]));
    }
  }
  std::sort(delays_s.begin(), delays_s.end());
  const auto quantile = [&](double q) {
    if (delays_s.empty()) return 0.0;
    return delays_s[static_cast<std::size_t>(std::ceil(q * static_cast<double>(delays_s.size())) - 1.0)];
  };
  return {{"landmarks_everywhere", delays_s.size()},
          {"landmarks_lacking_somewhere", lacking},
          {"p50_s", quantile(0.5)},
          {"p99_s", quantile(0.99)},
          {"max_s", delays_s.empty() ? 0.0 : delays_s.back()}};
}

constexpr char bad_radio[] = "loss=0.3,delay=100ms,jitter=50ms,duplicate=0.1,reorder=0.1";

// One run of `vehicles` that all write.
json run_fleet(const fs::path& folder, const BenchFleet::Setup& setup, VehicleId vehicles, std::uint64_t landmarks,
               double per_s, double timeout_s, const std::string& how = "") {
  BenchFleet fleet(folder, setup);
  const std::int64_t begun_us = now_us();
  fleet.start_all(vehicles);
  const BenchStates before = fleet.wait_for_each_other();
  fleet.say_all("write " + std::to_string(landmarks) + " " + std::to_string(per_s) + " " + how);
  const double writing_s = static_cast<double>(landmarks) / per_s;
  const auto after = fleet.wait_for_all(facts_of(vehicles, landmarks), writing_s + timeout_s);
  const BenchStates states = after ? *after : fleet.states();
  json result = everywhere(fleet);
  result["found_s"] = seconds_between(begun_us, last(before, "peers_since_us"));
  result["complete"] = after.has_value();
  result["complete_after_last_written_s"] = seconds_between(last(states, "written_us"), last(states, "facts_since_us"));
  result["bytes_per_vehicle"] = mean(states, "bytes");
  result["bytes_per_vehicle_until_found"] = mean(before, "bytes");
  result["cpu_s_per_vehicle"] = mean(states, "cpu_s");
  result["rss_kb_largest"] = most(states, "rss_kb");
  result["requests_per_vehicle"] = mean(states, "requests");
  result["facts_served_per_vehicle"] = mean(states, "served");
  result["quarantines"] = mean(states, "quarantines") * static_cast<double>(states.size());
  return result;
}

// A copy without the times of writers and readers: heartbeats every 3 s, as Fast DDS has them by default.
fs::path default_times(const fs::path& profile, const fs::path& folder) {
  std::ostringstream text;
  text << std::ifstream(profile).rdbuf();
  std::string content = text.str();
  for (std::size_t from; (from = content.find("<times>")) != std::string::npos;)
    content.erase(from, content.find("</times>", from) + 8 - from);
  write_text_file(folder / "default_times.xml", content);
  return folder / "default_times.xml";
}

json lossy(const fs::path& folder) {
  const fs::path profile = qos_profile("lossy_radio.xml");
  json details = run_fleet(folder, {profile, bad_radio}, 5, 5000, 500.0, 60.0);
  std::printf("      the baseline: Fast DDS alone, heartbeats every 3 s\n");
  details["baseline"] = run_fleet(folder, {default_times(profile, folder), bad_radio, {}, true}, 5, 5000, 500.0, 120.0);
  const auto told = [](const json& d) {
    return "p50 " + text_of(d["p50_s"]) + ", p99 " + text_of(d["p99_s"]) + ", max " + text_of(d["max_s"]) + " s" +
           (d["complete"] == true ? "" : ", NOT COMPLETE");
  };
  const bool met = details["complete"] == true && details["p99_s"] <= 1.0;
  return row("all facts on all 5; everywhere p99 <= 1 s",
             told(details) + " (default: " + told(details["baseline"]) + ")", met, details);
}

json half_lost(const fs::path& folder) {
  const json details = run_fleet(folder, {qos_profile("lossy_radio.xml"), "loss=0.5"}, 5, 500, 100.0, 60.0);
  const double took_s = details["complete_after_last_written_s"];
  const bool complete = details["complete"];
  return row("complete <= 5 s after the last was written", complete ? text_of(took_s) + " s" : "NOT COMPLETE",
             complete && took_s <= 5.0, details);
}

json dead_author(const fs::path& folder) {
  constexpr VehicleId author = 1, witness = 2, vehicles = 5;
  constexpr std::uint64_t landmarks = 200;
  BenchFleet fleet(folder, {qos_profile("loopback_udp.xml"), "loss=0"});
  fleet.start_all(vehicles);
  fleet.wait_for_each_other();
  for (VehicleId v = witness + 1; v <= vehicles; ++v) fleet.say(v, "block " + std::to_string(author));
  // Whatever came before the block was no landmark.
  pause_ms(100);
  fleet.say(author, "write " + std::to_string(landmarks) + " 10000");
  const std::uint64_t all = facts_of(1, landmarks) + 2 * (vehicles - 1);
  const auto reached = fleet.wait("reaching the one", 20.0,
                                  [&](const BenchStates& states) { return states.at(witness).at("facts") >= all; });
  const BenchStates at_death = fleet.states();
  fleet.kill(author);
  const std::int64_t killed_us = now_us();
  const auto after = fleet.wait_for_all(all, 60.0);
  json details = {{"complete", after.has_value()}, {"reached_the_one", reached.has_value()}};
  std::uint64_t before = 0;  // held by the others when the author died, of `all`
  for (VehicleId v = witness + 1; v <= vehicles; ++v)
    before = std::max(before, at_death.at(v).at("facts").get<std::uint64_t>());
  details["facts"] = all;
  details["most_facts_of_the_others_at_its_death"] = before;
  if (!after) return row("every fact reaches all others", "NOT COMPLETE", false, details);
  const double took_s = std::max(0.0, seconds_between(killed_us, last(*after, "facts_since_us")));
  details["complete_after_death_s"] = took_s;
  details["relayed_by_the_one"] = after->at(witness).at("relayed");
  return row("every fact reaches all others", "all, " + text_of(took_s) + " s after its death", reached.has_value(),
             details);
}

json partition(const fs::path& folder) {
  constexpr VehicleId vehicles = 6;
  constexpr std::uint64_t landmarks = 1200;
  constexpr double per_s = 20.0;  // for the 60 s that it lasts
  BenchFleet fleet(folder, {qos_profile("lossy_radio.xml"), "loss=0"});
  fleet.start_all(vehicles);
  fleet.wait_for_each_other();
  const auto cut = [&](const std::string& verb) {
    for (VehicleId v = 1; v <= vehicles; ++v)
      for (VehicleId other = 1; other <= vehicles; ++other)
        if ((v <= vehicles / 2) != (other <= vehicles / 2)) fleet.say(v, verb + " " + std::to_string(other));
  };
  cut("block");
  fleet.say_all("write " + std::to_string(landmarks) + " " + std::to_string(per_s));
  fleet.wait("cut in two", 90.0, [&](const BenchStates& states) {
    return std::none_of(states.begin(), states.end(), [](const auto& s) { return s.second.at("writing") == true; });
  });
  const BenchStates apart = fleet.states();
  const std::int64_t healed_us = now_us();
  cut("unblock");
  const std::uint64_t all = facts_of(vehicles, landmarks);
  const auto after = fleet.wait("healing", 60.0, [&](const BenchStates& states) {
    return std::all_of(states.begin(), states.end(), [&](const auto& s) {
      return s.second.at("facts") == all && s.second.at("peers") == vehicles - 1;
    });
  });
  const BenchStates states = after ? *after : fleet.states();
  std::set<std::uint64_t> holdings;
  for (const auto& [vehicle, state] : states) holdings.insert(state.at("holdings").get<std::uint64_t>());
  const double found_s = std::max(0.0, seconds_between(healed_us, last(states, "peers_since_us")));
  const double complete_s = seconds_between(healed_us, last(states, "facts_since_us"));
  json details = {{"facts", all},
                  {"most_facts_before_the_healing", most(apart, "facts")},
                  {"most_peers_before_the_healing", most(apart, "peers")},
                  {"all_found_after_healing_s", found_s},
                  {"complete_after_healing_s", complete_s},
                  {"complete", after.has_value()},
                  {"digests_equal", holdings.size() == 1},
                  {"requests_per_vehicle", mean(states, "requests")},
                  {"facts_served_per_vehicle", mean(states, "served")}};
  return row("complete <= 2 s after discovery, equal digests",
             after ? text_of(std::max(0.0, complete_s - found_s)) + " s after all had found each other, " +
                         text_of(complete_s) + " s after the healing"
                   : "NOT COMPLETE",
             after && holdings.size() == 1 && complete_s - found_s <= 2.0, details);
}

json late_joiner(const fs::path& folder) {
  constexpr VehicleId vehicles = 5;
  constexpr std::uint64_t landmarks = 10000;
  BenchFleet fleet(folder, {qos_profile("loopback_udp.xml")});
  fleet.start_all(vehicles);
  fleet.wait_for_each_other();
  fleet.say_all("write " + std::to_string(landmarks) + " 1000");
  if (!fleet.wait_for_all(facts_of(vehicles, landmarks), 120.0))
    return row("complete <= 3 s after its start", "the five were not complete before it", false, json::object());
  const BenchStates before = fleet.states();
  const std::int64_t started_us = now_us();
  fleet.start(vehicles + 1);
  const auto after = fleet.wait_for_all(facts_of(vehicles, landmarks) + 2, 60.0);
  json details = {{"landmarks", vehicles * landmarks}, {"complete", after.has_value()}};
  if (!after) return row("complete <= 3 s after its start", "NOT COMPLETE", false, details);
  const json& joiner = after->at(vehicles + 1);
  const double took_s = seconds_between(started_us, joiner.at("facts_since_us").get<std::int64_t>());
  details["complete_after_start_s"] = took_s;
  details["found_after_start_s"] = seconds_between(started_us, joiner.at("peers_since_us").get<std::int64_t>());
  details["joiner"] = joiner;
  details["bytes_of_the_others_each"] =
      (mean(*after, "bytes") * (vehicles + 1) - joiner.at("bytes").get<double>()) / vehicles - mean(before, "bytes");
  return row("complete <= 3 s after its start", text_of(took_s) + " s", took_s <= 3.0, details);
}

json bytes_per_landmark(const fs::path& folder) {
  constexpr std::uint64_t landmarks = 2000;
  json details = json::object();
  std::string measured;
  bool met = false;
  const auto measure = [&](const std::string& name, const char* profile, const std::string& how) {
    json pair = run_fleet(folder, {qos_profile(profile), "loss=0.1"}, 2, landmarks, 200.0, 60.0, how);
    const double bytes = pair["bytes_per_vehicle"].get<double>() / static_cast<double>(landmarks);
    pair["bytes_per_landmark"] = bytes;
    if (details.empty()) met = pair["complete"] == true && bytes <= 120.0;
    measured += (details.empty() ? "" : ", ") + text_of(bytes) + " (" + name + ")";
    details[name] = std::move(pair);
  };
  measure("low_bandwidth", "low_bandwidth.xml", "");  // the one that counts: landmarks as the front end makes them
  measure("low_bandwidth, without loadings", "low_bandwidth.xml", "bare");
  measure("loopback_udp", "loopback_udp.xml", "");
  measure("lossy_radio", "lossy_radio.xml", "");
  return row("<= 120 bytes per landmark, everything included, 10 % loss", measured, met, details);
}

// 2 m/s, 20 landmarks every 25 m, a live pose every second.
json paper_with(const fs::path& folder, const std::string& profile, double budget_bytes_per_s) {
  constexpr int duration_s = 100;
  BenchFleet fleet(folder, {qos_profile(profile), "", {}, false, budget_bytes_per_s});
  fleet.start_all(2);
  const std::int64_t begun_us = now_us();
  BenchStates found = fleet.wait_for_each_other();
  const double until_found = most(found, "bytes");
  fleet.say_all("live 1");
  fleet.say_all("write 160 1.6");
  double worst = 0.0;
  json each_second = json::array();  // of the vehicle that sent the most
  BenchStates now;
  for (int second = 1; second <= duration_s; ++second) {
    while (seconds_between(begun_us, now_us()) < second) pause_ms(5);
    now = fleet.states();
    double most = 0.0;
    for (const auto& [vehicle, state] : now) {
      const json& before = found.at(vehicle);
      most = std::max(most, (state.at("bytes").get<double>() - before.at("bytes").get<double>()) /
                                seconds_between(before.at("at_us"), state.at("at_us")));
    }
    each_second.push_back(most);
    if (second > 1) worst = std::max(worst, most);  // the first one is shorter
    found = now;
    if (second % 20 == 0) std::printf("      %s: %d of %d s\n", profile.c_str(), second, duration_s);
    std::fflush(stdout);
  }
  const double mean_rate = mean(now, "bytes") / duration_s;
  return {{"bytes_until_found", until_found},
          {"profile", profile},
          {"budget_bytes_per_s", budget_bytes_per_s},
          {"bytes_per_s_mean_with_discovery", mean_rate},
          {"bytes_per_s_worst_second_after_discovery", worst},
          {"bytes_per_s_each_second", each_second},
          {"landmarks_per_vehicle", mean(now, "written")}};
}

json paper(const fs::path& folder) {
  json details = paper_with(folder, "low_bandwidth.xml", 900.0);
  details["loopback_udp"] = paper_with(folder, "loopback_udp.xml", 0.0);
  const double mean_rate = details["bytes_per_s_mean_with_discovery"];
  const double worst = details["bytes_per_s_worst_second_after_discovery"];
  return row("<= 1 KB/s per vehicle mean, <= 2 KB/s in the worst second",
             text_of(1e-3 * mean_rate) + " and " + text_of(1e-3 * worst) + " KB/s (low_bandwidth.xml), after " +
                 text_of(1e-3 * details["bytes_until_found"].get<double>()) + " KB to find each other",
             mean_rate <= 1000.0 && worst <= 2000.0, details);
}

// fast-discovery-server with discovery_server.xml, if it is installed; at a port of its own.
std::unique_ptr<ChildProcess> discovery_server(const fs::path& folder, std::uint16_t port) {
  const fs::path program = "/usr/bin/fast-discovery-server";
  if (!fs::exists(program)) return nullptr;
  std::ostringstream text;
  text << std::ifstream(qos_profile("discovery_server.xml")).rdbuf();
  std::string profile = text.str();
  const std::string from = "<port>11811<", to = "<port>" + std::to_string(port) + "<";
  for (std::size_t at = 0; (at = profile.find(from, at)) != std::string::npos; at += to.size())
    profile.replace(at, from.size(), to);
  write_text_file(folder / "discovery_server.xml", profile);
  return std::make_unique<ChildProcess>(
      std::vector<std::string>{"/usr/bin/nice", "-n", "-10", program, "-x", folder / "discovery_server.xml"},
      folder / "server.log");
}

json forty(const fs::path& folder) {
  constexpr VehicleId vehicles = 40;
  constexpr std::uint64_t landmarks = 200;
  const auto port = static_cast<std::uint16_t>(12000 + getpid() % 1000);
  const auto server = discovery_server(folder, port);
  const std::string asked = "discovered <= 3 s, 20 facts/s each complete, <= 32 MB per process";
  if (!server) return row(asked, "not run: no fast-discovery-server (package fastdds-tools)", false, json::object());
  pause_ms(1000);  // until it listens
  BenchFleet fleet(folder, {qos_profile("large_fleet.xml"), "", {"127.0.0.1:" + std::to_string(port)}});
  const std::int64_t begun_us = now_us();
  fleet.start_all(vehicles);
  const BenchStates found = fleet.wait_for_each_other();
  const double found_s = seconds_between(begun_us, last(found, "peers_since_us"));
  fleet.say_all("write " + std::to_string(landmarks) + " 20");
  const auto after = fleet.wait_for_all(facts_of(vehicles, landmarks), 60.0);
  const BenchStates states = after ? *after : fleet.states();
  const double largest_mb = most(states, "rss_kb") / 1024.0;
  json details = everywhere(fleet);
  details["found_s"] = found_s;
  details["complete"] = after.has_value();
  details["complete_after_last_written_s"] =
      seconds_between(last(states, "written_us"), last(states, "facts_since_us"));
  details["largest_mb"] = largest_mb;
  details["mean_mb"] = mean(states, "rss_kb") / 1024.0;
  details["bytes_per_vehicle"] = mean(states, "bytes");
  details["cpu_s_per_vehicle"] = mean(states, "cpu_s");
  details["requests_per_vehicle"] = mean(states, "requests");
  return row(asked,
             "discovered " + text_of(found_s) + " s, " + (after ? "complete" : "NOT COMPLETE") + ", " +
                 text_of(largest_mb) + " MB",
             after && found_s <= 3.0 && largest_mb <= 32.0, details);
}

json growth(const fs::path& folder) {
  json fleets = json::array();
  std::string measured;
  bool met = true;
  for (const VehicleId vehicles : {2U, 5U, 10U, 20U}) {
    std::printf("      %u vehicles\n", vehicles);
    json fleet = run_fleet(folder, {qos_profile("loopback_udp.xml")}, vehicles, 5000, 50.0, 60.0);
    fleet["vehicles"] = vehicles;
    met = met && fleet["complete"] == true;
    measured += (measured.empty() ? "" : "; ") + std::to_string(vehicles) + ": " + text_of(fleet["cpu_s_per_vehicle"]) +
                " s CPU, " + text_of(1e-6 * fleet["bytes_per_vehicle"].get<double>()) + " MB" +
                (fleet["complete"] == true ? "" : " NOT COMPLETE");
    fleets.push_back(std::move(fleet));
  }
  return row("equal digests; CPU and bytes per vehicle (5000 landmarks each at 50/s)", measured, met,
             {{"fleets", fleets}});
}

// As growth, by the profile for so many.
json growth_forty(const fs::path& folder) {
  const auto port = static_cast<std::uint16_t>(12000 + getpid() % 1000);
  const auto server = discovery_server(folder, port);
  const std::string asked = "equal digests; CPU and bytes per vehicle (5000 landmarks each at 50/s)";
  if (!server) return row(asked, "not run: no fast-discovery-server (package fastdds-tools)", false, json::object());
  pause_ms(1000);  // until it listens
  const BenchFleet::Setup setup{qos_profile("large_fleet.xml"), "", {"127.0.0.1:" + std::to_string(port)}};
  json fleet = run_fleet(folder, setup, 40, 5000, 50.0, 60.0);
  const bool met = fleet["complete"] == true;
  return row(asked,
             text_of(fleet["cpu_s_per_vehicle"]) + " s CPU, " +
                 text_of(1e-6 * fleet["bytes_per_vehicle"].get<double>()) + " MB" + (met ? "" : " NOT COMPLETE"),
             met, fleet);
}

struct Case {
  const char* name;
  json (*run)(const fs::path& folder);
};
constexpr Case cases[] = {
    {"lossy", lossy},
    {"half_lost", half_lost},
    {"partition", partition},
    {"late_joiner", late_joiner},
    {"dead_author", dead_author},
    {"bytes_per_landmark", bytes_per_landmark},
    {"paper", paper},
    {"forty", forty},
    {"growth", growth},
    {"growth_forty", growth_forty},
};

}  // namespace

std::vector<std::string> bench_network_cases() {
  std::vector<std::string> names;
  for (const Case& c : cases) names.push_back(c.name);
  return names;
}

int run_bench_network(const BenchNetworkOptions& options) {
  std::signal(SIGPIPE, SIG_IGN);
  fs::create_directories(options.out);
  json rows = json::array();
  bool all_met = true;
  for (const Case& c : cases) {
    if (!options.cases.empty() && std::find(options.cases.begin(), options.cases.end(), c.name) == options.cases.end())
      continue;
    std::printf("      %s ...\n", c.name);
    std::fflush(stdout);
    json result;
    try {
      result = c.run(options.out);
    } catch (const ConfigError& error) {  // the other cases may yet be measured
      result = row("", error.what(), false, json::object());
    }
    result["case"] = c.name;
    all_met = all_met && result.at("met") == true;
    rows.push_back(std::move(result));
    write_text_file(options.out / "network.json", json{{"cases", rows}}.dump(1) + "\n");  // what there is so far
  }
  std::printf("\n| case | asked | measured | |\n|---|---|---|---|\n");
  for (const json& r : rows)
    std::printf("| %s | %s | %s | %s |\n", r.at("case").get<std::string>().c_str(),
                r.at("asked").get<std::string>().c_str(), r.at("measured").get<std::string>().c_str(),
                r.at("met") == true ? "met" : "MISSED");
  return all_met ? 0 : 1;
}

}  // namespace convoy::cli
