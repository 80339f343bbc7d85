// A bad network for trials: seeded loss, duplication, delay, jitter, reordering, a rate limit and partitions of the
// datagrams of a DdsExchange, between its byte counter and its sockets. In convoy::dds_testing, for the tests of a host
// as for convoy's own.
#pragma once

#include <convoy/dds/dds_exchange.hpp>
#include <convoy/exchange/impairment.hpp>

#include <memory>
#include <mutex>

namespace convoy::dds {

/// The network of one exchange, to be changed while it runs. All functions may be called from any thread.
class ImpairedNetwork {
 public:
  /// Throws ConfigError; see validate().
  explicit ImpairedNetwork(const Impairments& impairments);

  /// From now on nothing is heard of `vehicle`; until unblock(). For a partition both sides block each other.
  void block(VehicleId vehicle);
  void unblock(VehicleId vehicle);

  /// Throws ConfigError unless the probability is in [0, 1).
  void set_loss_received(double loss);
  void set_loss_sent(double loss);

  /// What becomes of a datagram; times are seconds since the opening.
  ImpairedLink::Fate of_received(std::size_t bytes, VehicleId sender);
  ImpairedLink::Fate of_sent(std::size_t bytes);

  const Impairments& impairments() const { return impairments_; }

 private:
  double now_s() const;

  const Impairments impairments_;
  std::mutex mutex_;
  ImpairedLink received_, sent_;
};

/// Impairs the network of the exchanges that are opened with `config` from now on. A datagram from A to B meets what A
/// sends through and what B receives through. A vehicle is recognised by DdsConfig::vehicle of the sender; DDS Security
/// replaces these bytes of the GUID, so that partitions and block() do not work with it. What a vehicle tells itself
/// is left alone. Bytes are counted before the loss, and what is lost is in counters().dropped.
///
/// Nothing goes past the impairment: even vehicles of one process meet on sockets (or in shared memory).
///
/// Throws ConfigError if a value is out of range, or if the host brings its own participant.
std::shared_ptr<ImpairedNetwork> impair(DdsConfig& config, const Impairments& impairments);

}  // namespace convoy::dds
