// Fleets of certificates for tests, made by scripts/make-certs, and what somebody with openssl can do to them.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <string>

namespace convoy::dds::testing {

/// Runs a command of the shell. Its output; `status` gets its exit status.
std::string shell(const std::string& command, int* status = nullptr);

/// A folder for the running test that is gone afterwards.
class Scratch {
 public:
  Scratch();
  ~Scratch();
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;
  const std::filesystem::path path;
};

/// A fleet in a scratch folder.
class Certificates {
 public:
  /// `vehicles`: "1,2,3"
  explicit Certificates(const std::string& vehicles);
  std::string folder(int vehicle) const { return (scratch_.path / ("vehicle_" + std::to_string(vehicle))).string(); }
  std::filesystem::path authority() const { return scratch_.path / "authority"; }

  /// Makes the certificate of a vehicle anew, with its key; in seconds from now.
  void certify(int vehicle, int from_s, int until_s) const;

 private:
  Scratch scratch_;
};

void append(const std::string& file, const std::string& text);
std::string text_of(const std::filesystem::path& file);

}  // namespace convoy::dds::testing
