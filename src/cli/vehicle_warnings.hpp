// What `convoy vehicle` tells its user of the network and the journal, besides the status lines.
#pragma once

#include <convoy/components/vehicle.hpp>
#include <convoy/components/vehicle_config.hpp>
#include <convoy/geometry/groups.hpp>

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

namespace convoy::cli {

struct Notice {
  enum class Level : std::uint8_t { info, warning, error } level = Level::info;
  std::string text;
};

/// How the vehicle speaks: domain, profile, interfaces, with or without DDS Security.
template <class G>
std::string speech_of(const VehicleConfig<G>& config);

/// What a user should know at the start: how the vehicle speaks, and what it was told of impairment, budget and
/// journal.
template <class G>
std::string start_line(const VehicleConfig<G>& config, Epoch epoch);

/// That a known start holds for the first epoch only, if this is none.
template <class G>
std::optional<Notice> start_notice(const VehicleConfig<G>& config, bool restarted);

/// What the journal gave back; nothing without one.
template <class G>
std::optional<Notice> journal_notice(const VehicleConfig<G>& config, const JournalCounters& journal);

/// What a budget does not hold back. `keeps_history`: DdsExchange::keeps_history().
template <class G>
std::vector<Notice> budget_notices(const VehicleConfig<G>& config, bool keeps_history);

/// What a host should know of its network: said once for as long as it lasts.
template <class G>
class VehicleWarnings {
 public:
  /// A vehicle that hears nobody for so long is told so [s].
  static constexpr double lonely_s = 10.0;

  /// `clock_is_real`: the vehicle's clock is one that others can be compared with, and not that of a replayed log.
  VehicleWarnings(const VehicleConfig<G>& config, bool clock_is_real);

  /// `wall_s` does not decrease.
  std::vector<Notice> look(const VehicleSnapshot<G>& snapshot, double wall_s);

 private:
  struct Heard {
    double stamp_s = -1e300, wall_s = -1.0;  // wall_s < 0: not looked at yet
    bool told = false;
  };
  void say(Notice::Level level, std::string text) { notices_.push_back({level, std::move(text)}); }
  void say_while(bool holds, bool& said, Notice::Level level, const std::string& text);
  void look_at_peers(const VehicleSnapshot<G>& snapshot, double wall_s);
  void look_at_roster(const VehicleSnapshot<G>& snapshot, double wall_s);
  void look_at_debts(std::uint64_t in_debt, double wall_s);
  void look_at_clocks(const VehicleSnapshot<G>& snapshot);
  std::string how_to_be_heard() const;

  VehicleConfig<G> config_;
  bool clock_is_real_;
  double unheard_s_;  // vehicles say something more often than that
  std::vector<Notice> notices_;
  std::optional<double> alone_since_s_;
  std::map<VehicleId, Heard> heard_;  // of the roster
  std::set<VehicleId> clocks_;
  static constexpr std::uint64_t many_in_debt = 20, none_yet = ~std::uint64_t{0};
  static constexpr double debts_window_s = 30.0;
  std::optional<double> debts_looked_s_;
  std::uint64_t debts_before_ = none_yet;
  std::uint64_t reopened_ = 0, quarantines_ = 0, failures_ = 0;
  bool debts_grow_ = false, alone_ = false, strangers_ = false, reopening_failed_ = false, journal_waits_ = false,
       incompatible_ = false, unauthorised_ = false, unfit_ = false, in_debt_ = false;
};

}  // namespace convoy::cli
