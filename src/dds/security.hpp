// DDS Security for one vehicle: what scripts/make-certs made for it, and whether a participant is the vehicle it claims
// to be.
#pragma once

#include <convoy/config_error.hpp>
#include <convoy/submap/facts.hpp>

#include <fastdds/rtps/common/GuidPrefix_t.hpp>

#include <cstdint>
#include <memory>
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
  ~SecurityFolder();
  SecurityFolder(const SecurityFolder&) = delete;
  SecurityFolder& operator=(const SecurityFolder&) = delete;

  /// Subject of the authority that makes vehicles of this fleet, as Fast DDS announces it.
  const std::string& authority() const { return authority_; }

  /// Turns security on. It is the same for every profile.
  void apply(eprosima::fastdds::dds::DomainParticipantQos& qos) const;

  /// True if the participant has the certificate of `vehicle`. Of an authenticated participant the first 47 bits of the
  /// GUID are a hash of the certificate's subject, and the handshake refuses one where they are not.
  bool belongs_to(const eprosima::fastrtps::rtps::GuidPrefix_t& participant, VehicleId vehicle) const;

 private:
  struct Subject;
  std::string path_;
  std::string authority_;
  std::unique_ptr<Subject> subject_;
};

}  // namespace convoy::dds
