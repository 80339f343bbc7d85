#include <convoy/dds/wire_bounds.hpp>
#include <convoy/dds/wire_scan.hpp>

#include <bit>
#include <cstring>

namespace convoy::dds {
namespace {

constexpr std::size_t encapsulation_bytes = 4;
constexpr std::size_t max_padding_bytes = 7;

void scan_chain(WireScan& wire) {
  wire.skip(8);
  wire.skip(4);
}

void scan_author(WireScan& wire) {  // vehicle, epoch
  wire.skip(4);
  wire.skip(8);
}

void scan_state(WireScan& wire) {
  wire.skip(8, 2);
  wire.sequence(8, bounds::group);
  wire.sequence(8, bounds::group_covariance);
  wire.sequence(8, bounds::tangent);
}

}  // namespace

WireScan::WireScan(const std::uint8_t* bytes, std::size_t size) {
  if (bytes == nullptr || size < encapsulation_bytes || bytes[0] != 0 || bytes[1] > 1) {
    fail(Decoding::undecodable);
    return;
  }
  body_ = bytes + encapsulation_bytes;
  size_ = size - encapsulation_bytes;
  swapped_ = (bytes[1] == 1) != (std::endian::native == std::endian::little);
}

bool WireScan::fail(Decoding why) {
  if (ok()) result_ = why;
  return false;
}

bool WireScan::align(std::size_t width) {
  if (!ok()) return false;
  const std::size_t aligned = (at_ + width - 1) / width * width;
  if (aligned > size_) return fail(Decoding::undecodable);
  at_ = aligned;
  return true;
}

void WireScan::skip(std::size_t width, std::size_t count) {
  if (count == 0 || !align(width)) return;
  if (count > (size_ - at_) / width) {
    fail(Decoding::undecodable);
    return;
  }
  at_ += width * count;
}

std::uint32_t WireScan::u32() {
  if (!align(4)) return 0;
  if (size_ - at_ < 4) {
    fail(Decoding::undecodable);
    return 0;
  }
  std::uint32_t value = 0;
  std::memcpy(&value, body_ + at_, 4);
  at_ += 4;
  return swapped_ ? __builtin_bswap32(value) : value;
}

std::uint32_t WireScan::length(std::uint32_t bound) {
  const std::uint32_t length = u32();
  if (length <= bound) return length;
  fail(Decoding::hostile);
  return 0;
}

Decoding WireScan::finish() {
  if (ok() && size_ - at_ > max_padding_bytes) fail(Decoding::undecodable);
  return result_;
}

// The fields below stand in the order of convoy.idl; a test compares every type with the generated code.

void scan(WireScan& wire, const v1::Bias*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1);
  scan_state(wire);
  wire.skip(4, 2);
}

void scan(WireScan& wire, const v1::Landmark*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1);
  wire.sequence(4, bounds::landmarks);
  wire.sequence(1, bounds::landmarks);
  wire.sequence(1, bounds::landmarks);
  wire.sequence(1, bounds::descriptors);
  wire.sequence(4, bounds::points);
  wire.sequence(4, bounds::point_covariances);
  wire.sequence(1, bounds::loadings);
}

void scan(WireScan& wire, const v1::Prior*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1, 2);
  wire.sequence(8, bounds::group);
  wire.sequence(8, bounds::group_covariance);
  wire.skip(8, 2);
  wire.skip(1);
  wire.skip(8, 3);
  wire.sequence(8, bounds::point);
}

void scan(WireScan& wire, const v1::Association*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1);
  for (std::uint32_t n = wire.length(bounds::pairing_groups); n > 0 && wire.ok(); --n) {
    scan_chain(wire);
    scan_chain(wire);
    wire.skip(4, 2 * std::size_t{wire.length(bounds::pairs)});
  }
}

void scan(WireScan& wire, const v1::Verdict*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1);
  wire.skip(8);
  wire.skip(1);
}

void scan(WireScan& wire, const v1::AbsoluteFix*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1);
  wire.skip(4);
  scan_state(wire);
  wire.sequence(8, bounds::point);
  wire.sequence(8, bounds::point);
  wire.sequence(8, bounds::point_covariance);
}

void scan(WireScan& wire, const v1::Encounter*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1);
  wire.skip(4);
  scan_state(wire);
  wire.skip(4);
  wire.sequence(8, bounds::point);
  wire.sequence(8, bounds::point_covariance);
}

void scan(WireScan& wire, const v1::Waypoint*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1);
  wire.skip(4);
  scan_state(wire);
  scan_chain(wire);
  wire.skip(4);
  wire.sequence(8, bounds::point);
}

void scan(WireScan& wire, const v1::Pose*) {
  scan_chain(wire);
  scan_author(wire);
  wire.skip(4);
  wire.skip(1);
  wire.skip(4, 2);
  scan_state(wire);
  wire.sequence(4, bounds::remembered);
  wire.sequence(4, bounds::remembered_points);
  wire.sequence(8, bounds::group_covariance);
}

void scan(WireScan& wire, const v1::Request*) {
  scan_author(wire);
  scan_chain(wire);
  wire.skip(4);
  wire.skip(1);
  wire.skip(4, 2 * std::size_t{wire.length(bounds::ranges)});
}

void scan(WireScan& wire, const v1::Answer*) {
  scan_author(wire);
  for (std::uint32_t n = wire.length(bounds::repeated); n > 0 && wire.ok(); --n) {
    wire.skip(4);
    wire.sequence(1, bounds::repeated_bytes);
  }
}

void scan(WireScan& wire, const v1::Digest*) {
  scan_author(wire);
  wire.skip(1);
  wire.skip(8, 6);
  for (std::uint32_t n = wire.length(bounds::chains); n > 0 && wire.ok(); --n) {
    scan_chain(wire);
    wire.skip(1);
    wire.sequence(4, bounds::kinds);
    wire.sequence(4, bounds::kinds);
    wire.sequence(8, bounds::kinds);
  }
}

}  // namespace convoy::dds
