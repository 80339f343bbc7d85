#include "vehicle_warnings.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace convoy::cli {
namespace {

using Level = Notice::Level;
// Of landmarks with full loadings in the plane, everything included (qos_profiles/README.md).
constexpr double message_bytes = 225.0, landmark_bytes = 55.0;

template <class List>
std::string joined(const List& list, const char* between = ", ") {
  std::string text;
  for (const auto& item : list) {
    if (!text.empty()) text += between;
    if constexpr (std::is_arithmetic_v<std::decay_t<decltype(item)>>) text += std::to_string(item);
    else text += item;
  }
  return text;
}

std::string number(double value, const char* format = "%g") {
  char text[32];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string file_name(const std::string& path) { return std::filesystem::path(path).filename().string(); }

}  // namespace

template <class G>
std::string speech_of(const VehicleConfig<G>& config) {
  const dds::DdsConfig& dds = config.dds;
  return "domain " + std::to_string(dds.domain) + ", profile " + file_name(dds.profile_file) + ", interfaces " +
         (dds.interface_whitelist.empty() ? "of the profile" : joined(dds.interface_whitelist)) +
         (dds.security_folder.empty() ? ", without DDS Security" : ", secured by " + dds.security_folder);
}

template <class G>
std::string start_line(const VehicleConfig<G>& config, Epoch epoch) {
  const double budget = config.vehicle.budget.bytes_per_s;
  return "vehicle " + std::to_string(config.vehicle.id) + " epoch " + std::to_string(epoch) + " on " +
         speech_of(config) +
         (config.impairment.any() ? ", IMPAIRED on purpose (" + to_string(config.impairment) + ")" : "") +
         (budget > 0.0 ? ", budget " + number(budget) + " B/s" : "") +
         (config.vehicle.journal ? ", journal in " + config.vehicle.state_folder.string() : ", no journal");
}

template <class G>
std::optional<Notice> start_notice(const VehicleConfig<G>& config, bool restarted) {
  if (!restarted || !config.vehicle.static_bias) return std::nullopt;
  return Notice{Level::info, "not the first run of " + config.vehicle.state_folder.string() +
                                 ": <static_bias> does not hold for where this one begins, it is aligned by landmarks; "
                                 "delete the folder to begin anew at the known start"};
}

template <class G>
std::optional<Notice> journal_notice(const VehicleConfig<G>& config, const JournalCounters& journal) {
  if (!config.vehicle.journal) return std::nullopt;
  const std::uint64_t damaged = journal.damaged_bytes + journal.cut_bytes;
  std::string text = "journal: " + std::to_string(journal.restored) + " facts restored";
  if (damaged > 0) text += ", " + std::to_string(damaged) + " bytes were damaged and are passed over";
  if (journal.refused > 0)
    text += ", " + std::to_string(journal.refused) + " facts refused (roster or <peers> have changed?)";
  if (damaged > 0) text += "; peers are asked for what is missing";
  return Notice{damaged + journal.refused > 0 ? Level::warning : Level::info, text};
}

template <class G>
std::vector<Notice> budget_notices(const VehicleConfig<G>& config, bool keeps_history) {
  const BudgetParams& budget = config.vehicle.budget;
  std::vector<Notice> notices;
  if (budget.bytes_per_s <= 0.0) return notices;
  if (keeps_history)
    notices.push_back(
        {Level::warning, config.dds.profile_file +
                             ": this profile keeps history, which late joiners get at once and not as the "
                             "budget says; a budget wants a profile without, such as low_bandwidth.xml"});
  const double batch_bytes = message_bytes + landmark_bytes * budget.batch_limit;
  if (const double burst_bytes = budget.burst_s * budget.bytes_per_s; batch_bytes > burst_bytes)
    notices.push_back({Level::warning, "a message of <budget batch_limit> " + std::to_string(budget.batch_limit) +
                                           " landmarks takes some " + number(batch_bytes) +
                                           " bytes to each peer, and burst_s is worth " + number(burst_bytes) +
                                           ": take a smaller batch_limit or a longer burst_s"});
  return notices;
}

template <class G>
VehicleWarnings<G>::VehicleWarnings(const VehicleConfig<G>& config, bool clock_is_real)
    : config_(config),
      clock_is_real_(clock_is_real),
      unheard_s_(std::max(lonely_s, 2.0 * config.vehicle.submaps.repair.digest_idle_s / config.sensors.rate)) {
  for (const VehicleId id : config.vehicle.submaps.limits.roster)
    if (id != config.vehicle.id) heard_[id];
}

template <class G>
void VehicleWarnings<G>::say_while(bool holds, bool& said, Level level, const std::string& text) {
  if (holds && !said) say(level, text);
  said = holds;
}

template <class G>
std::string VehicleWarnings<G>::how_to_be_heard() const {
  const dds::DdsConfig& dds = config_.dds;
  return "check that others run, with the same domain, profile and " +
         std::string(dds.security_folder.empty() ? "also without DDS Security" : "certificates of the same fleet") +
         (dds.initial_peers.empty() ? ""
                                    : ", that they are where <dds peers> says (" + joined(dds.initial_peers) + ")") +
         (dds.discovery_servers.empty() ? ""
                                        : ", that a Discovery Server answers at " + joined(dds.discovery_servers)) +
         ", and that the interfaces are up";
}

template <class G>
void VehicleWarnings<G>::look_at_peers(const VehicleSnapshot<G>& s, double wall_s) {
  if (!s.live_peers) return;  // the network is being opened, or cannot tell
  if (*s.live_peers > 0) {
    if (alone_) say(Level::info, "others are there now: " + std::to_string(*s.live_peers));
    alone_ = false;
    alone_since_s_.reset();
    return;
  }
  if (!alone_since_s_) alone_since_s_ = wall_s;
  say_while(wall_s - *alone_since_s_ >= lonely_s, alone_, Level::warning,
            "no other vehicle is there for " + number(lonely_s) + " s; this one speaks on " + speech_of(config_) +
                ": " + how_to_be_heard());
}

template <class G>
void VehicleWarnings<G>::look_at_roster(const VehicleSnapshot<G>& s, double wall_s) {
  std::vector<VehicleId> unheard;
  for (auto& [id, heard] : heard_) {
    double stamp_s = heard.stamp_s;
    for (const VehicleState<G>& v : s.vehicles)
      if (v.chain.vehicle == id) stamp_s = std::max(stamp_s, v.heard_s);
    // While nobody at all is there, look_at_peers() says what there is to say.
    if (heard.wall_s < 0.0 || stamp_s > heard.stamp_s || s.live_peers.value_or(1) == 0)
      heard = {stamp_s, wall_s, false};
    if (heard.told || wall_s - heard.wall_s < unheard_s_) continue;
    heard.told = true;
    unheard.push_back(id);
  }
  if (!unheard.empty())
    say(Level::warning, "of the roster, nothing is heard for " + number(unheard_s_) + " s of vehicle " +
                            joined(unheard) + "; do they run, and with the same domain and profile?");
}

template <class G>
void VehicleWarnings<G>::look_at_clocks(const VehicleSnapshot<G>& s) {
  constexpr double noticeable_s = 1.0;
  if (!clock_is_real_) return;
  for (const VehicleState<G>& v : s.vehicles)
    if (v.clock_offset_s && std::abs(*v.clock_offset_s) > noticeable_s && clocks_.insert(v.chain.vehicle).second)
      say(Level::warning, "what vehicle " + std::to_string(v.chain.vehicle) + " sends is stamped " +
                              number(std::abs(*v.clock_offset_s), "%.1f") + " s " +
                              (*v.clock_offset_s > 0.0 ? "before it comes in: its clock is late, or its messages are"
                                                       : "after it comes in: its clock is ahead") +
                              ". Maps do not mind, but encounters with it need stamps of one clock (run NTP or PTP)");
}

// Discovery alone may take more than the budget, for seconds: no reason to speak.
template <class G>
void VehicleWarnings<G>::look_at_debts(std::uint64_t in_debt, double wall_s) {
  if (debts_looked_s_ && wall_s < *debts_looked_s_ + debts_window_s) return;
  const bool first = !debts_looked_s_ || debts_before_ == none_yet;
  debts_grow_ = !first && in_debt - debts_before_ >= many_in_debt;
  debts_before_ = debts_looked_s_ ? in_debt : none_yet;
  debts_looked_s_ = wall_s;
}

template <class G>
std::vector<Notice> VehicleWarnings<G>::look(const VehicleSnapshot<G>& s, double wall_s) {
  notices_.clear();
  look_at_clocks(s);
  look_at_peers(s, wall_s);
  look_at_roster(s, wall_s);
  say_while(
      s.submaps.unknown_senders > 0, strangers_, Level::warning,
      "vehicle " + std::to_string(s.submaps.last_unknown_sender) +
          ", which is not on the roster, speaks, and is not listened to; add it to <vehicle roster> everywhere, or "
          "give the fleets domains of their own");
  if (s.network.reopened > reopened_)
    say(Level::warning, std::string("the network was ") + to_string(s.network.last_ailment) +
                            "; it was opened anew, and what was missed is asked for");
  reopened_ = s.network.reopened;
  say_while(s.network.reopen_failed > 0, reopening_failed_, Level::error,
            "the network cannot be opened anew: " + s.network.last_error + "; it is tried again");
  say_while(s.exchange.incompatible_peers > 0, incompatible_, Level::warning,
            "somebody's quality of service does not match: not all it says is heard; use one profile for a fleet");
  say_while(s.exchange.unauthorised > 0, unauthorised_, Level::warning,
            "somebody without the credentials of this fleet speaks on its network, and is refused" +
                (s.exchange.last_unauthorised.empty() ? "" : ": " + s.exchange.last_unauthorised));
  if (s.failures.count > failures_)
    say(Level::error, "something has failed in a thread of this vehicle (" + std::to_string(s.failures.count) +
                          " times by now), which went on: " + s.failures.last_error);
  failures_ = s.failures.count;
  look_at_debts(s.network.outbox.in_debt, wall_s);
  say_while(
      debts_grow_, in_debt_, Level::warning,
      "what the network spends by itself (discovery, heartbeats) takes the whole byte budget: messages get a tenth "
      "of it; give <budget bytes_per_s> more");
  say_while(s.network.outbox.unfit > 0, unfit_, Level::error,
            "a message of this vehicle cannot be carried by the wire format and was dropped (sends_unfit counts them): "
            "peers will lack what was in it");
  if (s.peers.quarantines > quarantines_)
    say(Level::warning, "somebody floods the network as vehicle " + std::to_string(s.peers.last_quarantined) +
                            ": nothing is taken from it for a while (<peers> says how much is too much)");
  quarantines_ = s.peers.quarantines;
  say_while(s.journal.waiting > 0, journal_waits_, Level::error,
            "the journal cannot be written (is the disk full?); facts wait in memory until it can");
  return std::move(notices_);
}

#define CONVOY_INSTANTIATE(G)                                                                     \
  template std::string speech_of(const VehicleConfig<G>&);                                        \
  template std::string start_line(const VehicleConfig<G>&, Epoch);                                \
  template std::optional<Notice> start_notice(const VehicleConfig<G>&, bool);                     \
  template std::optional<Notice> journal_notice(const VehicleConfig<G>&, const JournalCounters&); \
  template std::vector<Notice> budget_notices(const VehicleConfig<G>&, bool);                     \
  template class VehicleWarnings<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
