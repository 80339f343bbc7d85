#include "digest.hpp"

#include <cstdio>
#include <fstream>

namespace convoy::simulator {

void Digest::add_bytes(const void* data, std::size_t size) {
  const auto* bytes = static_cast<const std::uint8_t*>(data);
  for (std::size_t i = 0; i < size; ++i) value_ = (value_ ^ bytes[i]) * 0x100000001b3ULL;
}

void Digest::add(const VehicleStep& step) {
  for (const FrameData& frame : step.frames) {
    add(std::uint64_t{frame.frame});
    add(frame.stamp_s);
    add_bytes(frame.grey.data(), frame.grey.size());
  }
  for (const OdometryData& reading : step.odometry) {
    add(std::uint64_t{reading.reading});
    for (const std::int64_t ticks : {reading.left_ticks, reading.right_ticks}) add(static_cast<std::uint64_t>(ticks));
    for (const double value : {reading.stamp_s, reading.distance_m, reading.speed_mps, reading.wheels_yaw_rate_radps,
                               reading.gyro_yaw_rate_radps})
      add(value);
  }
  for (const GpsData& reading : step.gps) {
    add(std::uint64_t{reading.reading});
    add(std::uint64_t{reading.fix});
    add(reading.stamp_s);
    for (const double value : reading.position) add(value);
    for (const double value : reading.covariance) add(value);
  }
}

std::string Digest::text() const {
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(value_));
  return text;
}

std::string digest_of(const FrameData& frame) {
  Digest digest;
  digest.add_bytes(frame.grey.data(), frame.grey.size());
  return digest.text();
}

std::string digest_of(const std::filesystem::path& file) {
  Digest digest;
  std::ifstream in(file, std::ios::binary);
  std::vector<char> part(1 << 16);
  do {
    in.read(part.data(), static_cast<std::streamsize>(part.size()));
    digest.add_bytes(part.data(), static_cast<std::size_t>(in.gcount()));
  } while (in);
  return digest.text();
}

}  // namespace convoy::simulator
