#include "bench_fleet.hpp"

#include <convoy/config_error.hpp>

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <set>
#include <thread>
#include <utility>

#include "free_domains.hpp"

namespace convoy::cli {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

std::uint32_t next_domain() {
  static std::uint32_t next = static_cast<std::uint32_t>(getpid());
  return free_domain(next++);
}

}  // namespace

std::int64_t now_us() {
  return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}
double seconds_between(std::int64_t from_us, std::int64_t to_us) { return 1e-6 * static_cast<double>(to_us - from_us); }
void pause_ms(int ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }

std::int64_t last(const BenchStates& states, const char* figure) {
  std::int64_t latest = 0;
  for (const auto& [vehicle, state] : states) latest = std::max(latest, state.at(figure).get<std::int64_t>());
  return latest;
}
double mean(const BenchStates& states, const char* figure) {
  double sum = 0.0;
  for (const auto& [vehicle, state] : states) sum += state.at(figure).get<double>();
  return sum / static_cast<double>(states.size());
}
double most(const BenchStates& states, const char* figure) {
  double largest = 0.0;
  for (const auto& [vehicle, state] : states) largest = std::max(largest, state.at(figure).get<double>());
  return largest;
}

BenchFleet::BenchFleet(fs::path folder, Setup setup)
    : folder_(std::move(folder)), setup_(std::move(setup)), domain_(next_domain()) {}

void BenchFleet::start(VehicleId vehicle) {
  std::vector<std::string> command = {
      this_program(), "bench-peer",           "--profile", setup_.profile, "--domain", std::to_string(domain_),
      "--vehicle",    std::to_string(vehicle)};
  if (!setup_.impair.empty())
    command.insert(command.end(), {"--impair", setup_.impair + ",seed=" + std::to_string(vehicle)});
  for (const std::string& server : setup_.servers) command.insert(command.end(), {"--server", server});
  if (setup_.alone) command.push_back("--alone");
  if (setup_.budget_bytes_per_s > 0.0)
    command.insert(command.end(), {"--budget", std::to_string(setup_.budget_bytes_per_s)});
  peers_[vehicle] = std::make_unique<ChildProcess>(command, folder_ / "peers.log");
}

void BenchFleet::start_all(VehicleId count) {
  for (VehicleId v = 1; v <= count; ++v) start(v);
}

void BenchFleet::say(VehicleId vehicle, const std::string& line) {
  if (!peers_.at(vehicle)->say(line)) fail(vehicle);
}

void BenchFleet::say_all(const std::string& line) {
  for (const auto& [vehicle, peer] : peers_) say(vehicle, line);
}

void BenchFleet::kill(VehicleId vehicle) {
  peers_.at(vehicle)->kill_hard();
  peers_.at(vehicle)->wait(5.0);
  peers_.erase(vehicle);
}

BenchStates BenchFleet::ask(const std::string& question) {
  say_all(question);
  BenchStates answers;
  const std::int64_t asked_us = now_us();
  while (answers.size() < peers_.size()) {
    for (const auto& [vehicle, peer] : peers_) {
      for (const std::string& line : peer->lines()) {
        json answer = json::parse(line, nullptr, false);
        if (answer.is_object() && answer.value("answer", "") == question) answers[vehicle] = std::move(answer);
      }
      if (!answers.contains(vehicle) && (peer->ended() || now_us() - asked_us > 60'000'000)) fail(vehicle);
    }
    pause_ms(2);
  }
  return answers;
}

std::optional<BenchStates> BenchFleet::wait(const std::string& what, double timeout_s,
                                            const std::function<bool(const BenchStates&)>& done) {
  const std::int64_t begun_us = now_us();
  std::int64_t told_us = begun_us;
  for (;;) {
    auto now = states();
    if (done(now)) return now;
    if (seconds_between(begun_us, now_us()) > timeout_s) return std::nullopt;
    if (now_us() - told_us > 2'000'000) {
      told_us = now_us();
      std::uint64_t least = ~std::uint64_t{0}, most = 0;
      for (const auto& [vehicle, state] : now) {
        least = std::min(least, state.at("facts").get<std::uint64_t>());
        most = std::max(most, state.at("facts").get<std::uint64_t>());
      }
      std::printf("      %s: %.0f s, each holds %llu to %llu facts\n", what.c_str(), seconds_between(begun_us, told_us),
                  static_cast<unsigned long long>(least), static_cast<unsigned long long>(most));
      std::fflush(stdout);
    }
    pause_ms(100);
  }
}

BenchStates BenchFleet::wait_for_each_other() {
  const std::size_t others = peers_.size() - 1;
  const auto found = wait("finding each other", 180.0, [&](const auto& states) {
    for (const auto& [vehicle, state] : states)
      if (state.at("peers") > others)
        throw ConfigError("bench: somebody else is heard on DDS domain " + std::to_string(domain_) +
                          "; wait until that has ended");
    return std::all_of(states.begin(), states.end(), [&](const auto& s) { return s.second.at("peers") == others; });
  });
  if (!found) throw ConfigError("bench: the processes do not find each other; see " + (folder_ / "peers.log").string());
  return *found;
}

std::optional<BenchStates> BenchFleet::wait_for_all(std::uint64_t facts, double timeout_s) {
  return wait("exchanging", timeout_s, [&](const auto& states) {
    std::set<std::uint64_t> holdings;
    for (const auto& [vehicle, state] : states) {
      holdings.insert(state.at("holdings").template get<std::uint64_t>());
      if (state.at("writing") || state.at("facts") < facts) return false;
    }
    return holdings.size() == 1;
  });
}

void BenchFleet::fail(VehicleId vehicle) const {
  throw ConfigError("bench: process " + std::to_string(vehicle) + " does not answer (" +
                    peers_.at(vehicle)->ended().value_or("it runs") + "); see " + (folder_ / "peers.log").string());
}

}  // namespace convoy::cli
