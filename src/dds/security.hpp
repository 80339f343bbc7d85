// DDS Security for one vehicle: what scripts/make-certs made for it.
#pragma once

#include <convoy/config_error.hpp>
#include <convoy/submap/facts.hpp>

#include <cstdint>
#include <string>

namespace eprosima::fastdds::dds {
class DomainParticipantQos;
}

namespace convoy::dds {

/// The folder of one vehicle. It holds identity_ca.pem, certificate.pem, key.pem, permissions_ca.pem, governance.p7s
/// and permissions.p7s.
class SecurityFolder {
 public:
  /// The handshake shows certificate and permissions: 5.3 KB with what scripts/make-certs makes.
  static constexpr std::uint32_t largest_handshake_bytes = 8192;

  /// Reads and checks everything that can be checked without a peer: Fast DDS would only fail to create a participant.
  /// Throws ConfigError that names the file. `vehicle`: who the certificate should be made for; 0: anybody.
  SecurityFolder(const std::string& path, VehicleId vehicle);

  /// The vehicle that the certificate was made for.
  VehicleId vehicle() const { return vehicle_; }

  /// Subject of the authority that makes vehicles of this fleet, as Fast DDS announces it.
  const std::string& authority() const { return authority_; }

  /// Turns security on. It is the same for every profile.
  void apply(eprosima::fastdds::dds::DomainParticipantQos& qos) const;

 private:
  std::string path_;
  VehicleId vehicle_ = 0;
  std::string authority_;
};

/// Each vehicle writes in a partition of its own, "vehicle/N", and its permissions, which all others check, allow no
/// other.
std::string partition_of(VehicleId vehicle);
/// 0 if this is no partition of a vehicle.
VehicleId vehicle_of_partition(const std::string& partition);
inline constexpr const char* partitions_of_all = "vehicle/*";

}  // namespace convoy::dds
