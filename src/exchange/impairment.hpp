// Seeded loss, duplication, delay, reordering, a rate limit and partitions: what a bad network does, decided datagram
// by datagram.
#pragma once

#include <convoy/exchange/submap_exchange.hpp>

#include <array>
#include <chrono>
#include <map>
#include <random>
#include <set>
#include <string>
#include <string_view>
#include <vector>

namespace convoy {

/// Vehicles of which nothing is heard for a while.
struct Partition {
  std::vector<VehicleId> vehicles;
  double from_s = 0.0, to_s = 0.0;  ///< since the opening; 0 <= from < to

  /// From "3+4@10s..70s". Throws ConfigError.
  static Partition parse(std::string_view text);
};
std::string to_string(const Partition& partition);

/// What an impaired network does to each datagram (or message) of one direction, independently.
struct Impairment {
  double loss = 0.0;              ///< probability in [0, 1) that it is lost
  double duplicate = 0.0;         ///< probability in [0, 1] that it comes twice
  double delay_s = 0.0;           ///< every one is late by this, [0, 3600]
  double jitter_s = 0.0;          ///< and by a uniform share of this more, [0, 3600], so that they overtake each other
  double reorder = 0.0;           ///< probability in [0, 1] that it is held back by hold_s, so that later ones overtake
  double rate_bytes_per_s = 0.0;  ///< what the link carries, >= 100; 0: any rate. Of datagrams only
  double queue_s = 0.5;           ///< what would have to wait longer for the link is dropped, (0, 3600]
  std::vector<Partition> partitions = {};
  std::uint64_t seed = 1;

  static constexpr double hold_s = 0.1;

  bool any() const { return loss > 0 || duplicate > 0 || takes_time() || !partitions.empty(); }
  bool takes_time() const { return delay_s > 0 || jitter_s > 0 || reorder > 0 || rate_bytes_per_s > 0; }

  /// From "loss=0.3,duplicate=0.2,delay=100ms,jitter=50ms,reorder=0.1,rate=100kB/s,queue=1s,partition=3+4@10s..70s,
  /// seed=7". Plain numbers are seconds, if below 1, and bytes per second. Each entry once, but for partitions. Throws
  /// ConfigError that names the entry.
  static Impairment parse(std::string_view text);
};

/// Throws ConfigError that names the first value out of its range.
void validate(const Impairment& impairment);

/// Both directions of a vehicle's network.
struct Impairments {
  Impairment received, sent;
  std::chrono::steady_clock::time_point opened = std::chrono::steady_clock::now();  ///< of which partitions count

  bool any() const { return received.any() || sent.any(); }

  /// As Impairment::parse: an entry holds for what is received, or with the prefix "out." for what is sent. A seed
  /// without prefix is of both.
  static Impairments parse(std::string_view text);
};
/// What each impaired direction does, as parse() reads it; in SI units, whatever is as by default left out.
std::string to_string(const Impairments& impairments);

/// Decides what becomes of one datagram after the other: the same seed and calls, the same decisions. Not thread-safe.
class ImpairedLink {
 public:
  /// When the copies of a datagram are due; none if it is lost.
  struct Fate {
    std::array<double, 2> due_s = {};
    int copies = 0;
  };

  /// Throws ConfigError; see validate().
  explicit ImpairedLink(const Impairment& impairment);

  /// `now_s` counts from the opening. `bytes` matters for the rate, `sender` for partitions (0: not known).
  Fate fate(double now_s, std::size_t bytes, VehicleId sender);

  void block(VehicleId sender) { blocked_.insert(sender); }
  void unblock(VehicleId sender) { blocked_.erase(sender); }
  /// Throws ConfigError if it is not in [0, 1).
  void set_loss(double loss);

  std::uint64_t lost() const { return lost_; }

 private:
  double uniform();
  bool cut_off(double now_s, VehicleId sender) const;

  Impairment impairment_;
  std::mt19937_64 random_;
  std::set<VehicleId> blocked_;
  double link_free_s_ = 0.0;
  std::uint64_t lost_ = 0;
};

/// Holds messages back by an Impairment, on the caller's clock. Messages with equal due times leave in order of
/// arrival.
template <class G>
class ImpairedQueue {
 public:
  /// Throws ConfigError; see validate(). A rate is refused: messages have no size.
  explicit ImpairedQueue(const Impairment& impairment);
  void push(Message<G> message, double now_s);
  std::vector<Message<G>> take(double now_s);
  std::uint64_t lost() const { return link_.lost(); }

 private:
  ImpairedLink link_;
  std::multimap<double, Message<G>> due_;
};

}  // namespace convoy
