#include <convoy/config_error.hpp>
#include <convoy/exchange/watchdog.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {

void validate(const WatchdogParams& p) {
  const auto demand = [](bool holds, const char* name, double value, const char* range) {
    if (!(holds && std::isfinite(value))) throw RangeError("watchdog", name, value, range);
  };
  demand(p.deaf_s > 0.0, "deaf_s", p.deaf_s, "be > 0");
  demand(p.mute_s > 0.0, "mute_s", p.mute_s, "be > 0");
  demand(p.lonely_s > 0.0, "lonely_s", p.lonely_s, "be > 0");
  demand(p.pause_s > 0.0, "pause_s", p.pause_s, "be > 0");
  demand(p.max_pause_s >= p.pause_s, "max_pause_s", p.max_pause_s, "be at least pause_s");
}

const char* to_string(Ailment ailment) {
  switch (ailment) {
    case Ailment::none: return "none";
    case Ailment::deaf: return "deaf: peers are there, and nothing comes in";
    case Ailment::mute: return "mute: nothing can be sent";
    case Ailment::lonely: return "lonely: all peers are gone";
  }
  return "unknown";
}

constexpr int max_deaf_in_vain = 3;

Watchdog::Watchdog(const WatchdogParams& params) : params_(params), pause_s_(params.pause_s) { validate(params); }

Ailment Watchdog::observe(double now_s, std::optional<std::size_t> peers, const ExchangeCounters& counters,
                          double listened_s) {
  if (!begun_s_) begun_s_ = heard_s_ = spoke_s_ = company_s_ = now_s;
  if (counters.messages_taken != taken_) {
    heard_s_ = now_s;
    pause_s_ = params_.pause_s;  // whatever was done, it helped
    deaf_in_vain_ = 0;
  }
  if (counters.messages_sent != sent_ || counters.send_rejected == rejected_) spoke_s_ = now_s;
  taken_ = counters.messages_taken;
  sent_ = counters.messages_sent;
  rejected_ = counters.send_rejected;
  const std::size_t known = peers.value_or(0);
  if (known == 0) heard_s_ = now_s;  // nobody to hear: silence says nothing
  if (known > most_peers_) {
    most_peers_ = known;
    deaf_in_vain_ = 0;
  }
  if (known > 0 || most_peers_ == 0 || !peers) company_s_ = now_s;
  if (!rested(now_s)) return Ailment::none;
  if (listened_s >= heard_s_ + params_.deaf_s && deaf_in_vain_ < max_deaf_in_vain) {
    ++deaf_in_vain_;
    return Ailment::deaf;
  }
  if (now_s >= spoke_s_ + params_.mute_s) return Ailment::mute;
  if (now_s >= company_s_ + params_.lonely_s) return Ailment::lonely;
  return Ailment::none;
}

void Watchdog::reopened(double now_s) {
  heard_s_ = spoke_s_ = company_s_ = now_s;
  not_before_s_ = now_s + pause_s_;
  pause_s_ = std::min(2.0 * pause_s_, params_.max_pause_s);
}

}  // namespace convoy
