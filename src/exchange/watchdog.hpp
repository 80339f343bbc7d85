// Watchdog: notices that a network has gone deaf or mute although it should not have, so that it can be opened anew.
// Pure: driven by observations and by the caller's clock.
#pragma once

#include <convoy/exchange/submap_exchange.hpp>

#include <cstddef>
#include <cstdint>
#include <optional>

namespace convoy {

struct WatchdogParams {
  double deaf_s = 20.0;    ///< peers are there, and nothing has come in for so long; above RepairParams::digest_idle_s
  double mute_s = 10.0;    ///< everything that was to be sent has been refused for so long
  double lonely_s = 60.0;  ///< there were peers, and there has been none for so long
  double pause_s = 30.0;   ///< between two attempts at least; doubles with each that brings nothing, up to max_pause_s
  double max_pause_s = 600.0;
};

/// Throws RangeError.
void validate(const WatchdogParams& params);

enum class Ailment : std::uint8_t { none, deaf, mute, lonely };
const char* to_string(Ailment ailment);

class Watchdog {
 public:
  explicit Watchdog(const WatchdogParams& params);

  /// `peers` and `counters` of the network as of now; `listened_s`: when somebody last took from it what had come in,
  /// since nothing else tells that nothing had. Anything but `none`: open it anew, now, and say so by reopened(). Deaf
  /// it is said to be three times in a row at most: then these peers have nothing to say, until one speaks or more
  /// come.
  Ailment observe(double now_s, std::optional<std::size_t> peers, const ExchangeCounters& counters, double listened_s);
  /// The network was opened anew, or that failed: it is given time.
  void reopened(double now_s);
  /// The pause since then is over.
  bool rested(double now_s) const { return now_s >= not_before_s_; }

 private:
  WatchdogParams params_;
  std::optional<double> begun_s_;
  std::uint64_t taken_ = 0, sent_ = 0, rejected_ = 0;
  std::size_t most_peers_ = 0;
  int deaf_in_vain_ = 0;                                    // times in a row
  double heard_s_ = 0.0, spoke_s_ = 0.0, company_s_ = 0.0;  // last times of: taken, sent or nothing refused, peers
  double not_before_s_ = 0.0;
  double pause_s_;
};

}  // namespace convoy
