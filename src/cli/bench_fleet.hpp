// The processes of one case of `convoy bench network`, and what they answer.
#pragma once

#include <convoy/submap/facts.hpp>

#include <nlohmann/json.hpp>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "child_process.hpp"

namespace convoy::cli {

/// Of a clock that all processes of a machine share [us].
std::int64_t now_us();
double seconds_between(std::int64_t from_us, std::int64_t to_us);
void pause_ms(int ms);

/// What each process said.
using BenchStates = std::map<VehicleId, nlohmann::json>;
std::int64_t last(const BenchStates& states, const char* figure);  ///< the latest of all
double mean(const BenchStates& states, const char* figure);
double most(const BenchStates& states, const char* figure);

/// Processes of one domain. They are killed when this goes out of scope. Throws ConfigError if one ends or does not
/// answer.
class BenchFleet {
 public:
  struct Setup {
    std::filesystem::path profile;
    std::string impair = {};
    std::vector<std::string> servers = {};
    bool alone = false;
    double budget_bytes_per_s = 0.0;
  };

  BenchFleet(std::filesystem::path folder, Setup setup);

  void start(VehicleId vehicle);
  void start_all(VehicleId count);
  void say(VehicleId vehicle, const std::string& line);
  void say_all(const std::string& line);
  void kill(VehicleId vehicle);
  std::size_t size() const { return peers_.size(); }

  /// What each answers to `question`, within a minute.
  BenchStates ask(const std::string& question);
  BenchStates states() { return ask("state"); }

  /// Asks for the states until they satisfy `done`; empty if they do not within `timeout_s`.
  std::optional<BenchStates> wait(const std::string& what, double timeout_s,
                                  const std::function<bool(const BenchStates&)>& done);

  /// Until all know of each other. Throws ConfigError if they do not within three minutes (at 50 % loss one is not
  /// enough), or if strangers are there.
  BenchStates wait_for_each_other();

  /// Until nobody writes any more and everybody holds the same `facts`; see wait().
  std::optional<BenchStates> wait_for_all(std::uint64_t facts, double timeout_s);

 private:
  [[noreturn]] void fail(VehicleId vehicle) const;

  std::filesystem::path folder_;
  Setup setup_;
  std::uint32_t domain_;
  std::map<VehicleId, std::unique_ptr<ChildProcess>> peers_;
};

}  // namespace convoy::cli
