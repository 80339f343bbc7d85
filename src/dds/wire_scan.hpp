// A look at a serialised sample before it is decoded. The generated code believes every length it reads: forty bytes
// can make it allocate gigabytes. The scan walks the same fields, trusts nothing and allocates nothing.
#pragma once

#include <convoy/idl/convoy.h>

#include <cstddef>
#include <cstdint>

namespace convoy::dds {

/// What became of a sample on its way in.
enum class Decoding : std::uint8_t {
  none,  ///< nothing was decoded
  ok,
  undecodable,  ///< unknown encapsulation, cut, or too long: not of this type
  hostile,      ///< well-formed so far, but a sequence is longer than the format allows
};

/// Walks plain CDR (XCDR1, both byte orders). After a failure it stays where it is and says why in result().
class WireScan {
 public:
  WireScan(const std::uint8_t* bytes, std::size_t size);

  void skip(std::size_t width, std::size_t count = 1);  ///< `count` primitives of `width` bytes
  std::uint32_t u32();
  std::uint32_t length(std::uint32_t bound);  ///< of a sequence; 0 after a failure
  void sequence(std::size_t width, std::uint32_t bound) { skip(width, length(bound)); }

  bool ok() const { return result_ == Decoding::ok; }
  /// ok only if no more than the padding of a submessage is left.
  Decoding finish();

 private:
  bool fail(Decoding why);
  bool align(std::size_t width);

  const std::uint8_t* body_ = nullptr;
  std::size_t size_ = 0;
  std::size_t at_ = 0;
  bool swapped_ = false;
  Decoding result_ = Decoding::ok;
};

void scan(WireScan& wire, const v1::Bias*);
void scan(WireScan& wire, const v1::Landmark*);
void scan(WireScan& wire, const v1::Prior*);
void scan(WireScan& wire, const v1::Association*);
void scan(WireScan& wire, const v1::Verdict*);
void scan(WireScan& wire, const v1::AbsoluteFix*);
void scan(WireScan& wire, const v1::Encounter*);
void scan(WireScan& wire, const v1::Waypoint*);
void scan(WireScan& wire, const v1::Pose*);
void scan(WireScan& wire, const v1::Request*);
void scan(WireScan& wire, const v1::Answer*);
void scan(WireScan& wire, const v1::Digest*);

/// Whether a payload (with its encapsulation header) may be handed to the generated code of `Sample`.
template <class Sample>
Decoding scan_payload(const std::uint8_t* bytes, std::size_t size) {
  WireScan wire(bytes, size);
  scan(wire, static_cast<const Sample*>(nullptr));
  return wire.finish();
}

}  // namespace convoy::dds
