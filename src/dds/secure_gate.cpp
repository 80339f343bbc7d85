#include <convoy/dds/secure_gate.hpp>

namespace convoy::dds {

namespace {

using Bytes = std::span<const unsigned char>;

// RTPS 2.3, 9.4.5, and DDS Security 1.1, 7.3.6.
enum Submessage : unsigned char {
  acknack = 0x06,
  heartbeat = 0x07,
  gap = 0x08,
  info_ts = 0x09,
  info_dst = 0x0e,
  data = 0x15,
  data_frag = 0x16,
  sec_body = 0x30,
  sec_prefix = 0x31,
  sec_postfix = 0x32,
  statistics = 0x80,  // how much was sent; Fast DDS adds it to each message
};

constexpr std::uint32_t participant_announcer = 0x000100c2;
constexpr std::uint32_t handshake_writer = 0x000201c3;
constexpr std::uint32_t open_publications = 0x000003c2;
constexpr std::uint32_t open_subscriptions = 0x000004c2;
constexpr std::uint32_t open_liveliness = 0x000200c2;

constexpr std::size_t message_header = 20;
constexpr std::size_t submessage_header = 4;

std::uint32_t big_endian(Bytes bytes) {
  return std::uint32_t{bytes[0]} << 24 | std::uint32_t{bytes[1]} << 16 | std::uint32_t{bytes[2]} << 8 | bytes[3];
}

/// The 4 bytes that begin at `at`, 0 if they are not there.
std::uint32_t entity(Bytes content, std::size_t at) {
  return content.size() < at + 4 ? 0 : big_endian(content.subspan(at, 4));
}

/// Announcements, and the handshake, which may come in fragments.
bool opens_the_door(Bytes data_content) {
  const std::uint32_t writer = entity(data_content, 8);  // after flags, an offset, the reader
  return writer == participant_announcer || writer == handshake_writer;
}

/// Participants with security still have the open endpoints of discovery, which ask each other for what never comes:
/// what they would tell, the protected ones tell.
bool talks_of_nothing(Bytes content) {
  const std::uint32_t writer = entity(content, 4);  // after the reader
  return writer == open_publications || writer == open_subscriptions || writer == open_liveliness;
}

bool is_harmless(unsigned char kind, Bytes content) {
  switch (kind) {
    case info_ts:
    case info_dst:
    case statistics: return true;
    case data:
    case data_frag: return opens_the_door(content);
    case acknack:
    case heartbeat:
    case gap: return talks_of_nothing(content);
    default: return false;
  }
}

/// What is protected comes in three parts: which key, the encrypted submessage, the codes that prove it.
class Protected {
 public:
  /// The next submessage. False if it does not belong there.
  bool take(unsigned char kind, Bytes content) {
    if (kind != next_) return false;
    switch (kind) {
      case sec_prefix:
        next_ = sec_body;
        // Key number 0 is that of the exchange of all other keys: a secret of two, which proves its author by itself.
        two_alone_ = content.size() == 20 && big_endian(content.subspan(4, 4)) == 0;
        return content.size() == 20;
      case sec_body: next_ = sec_postfix; return true;
      default: next_ = sec_prefix; return two_alone_ || proves_author(content);
    }
  }
  bool complete() const { return next_ == sec_prefix; }

 private:
  /// At least one code that the author made for one receiver. If there are any, Fast DDS wants its own among them.
  static bool proves_author(Bytes postfix) { return postfix.size() >= 40 && big_endian(postfix.subspan(16, 4)) != 0; }

  unsigned char next_ = sec_prefix;
  bool two_alone_ = false;
};

}  // namespace

bool may_enter(std::span<const unsigned char> message) {
  if (message.size() < message_header) return false;
  Protected protected_part;
  for (Bytes rest = message.subspan(message_header); !rest.empty();) {
    if (rest.size() < submessage_header) return false;
    const unsigned char kind = rest[0];
    const bool little_endian = (rest[1] & 1) != 0;
    const std::size_t length = little_endian ? rest[2] | rest[3] << 8 : rest[2] << 8 | rest[3];
    rest = rest.subspan(submessage_header);
    // Where lengths could be read in two ways, Fast DDS might see something else than is seen here.
    if (length > rest.size() || length % 4 != 0 || (length == 0 && kind != info_ts)) return false;
    const Bytes content = rest.first(length);
    if (is_harmless(kind, content) ? !protected_part.complete() : !protected_part.take(kind, content)) return false;
    rest = rest.subspan(length);
  }
  return protected_part.complete();
}

eprosima::fastdds::rtps::TransportInterface* SecureGateDescriptor::create_transport() const {
  return new SecureGate(*this);
}

void SecureGate::receive(eprosima::fastdds::rtps::TransportReceiverInterface* next_receiver,
                         const eprosima::fastrtps::rtps::octet* buffer, std::uint32_t size,
                         const eprosima::fastrtps::rtps::Locator_t& local_locator,
                         const eprosima::fastrtps::rtps::Locator_t& remote_locator) {
  if (may_enter({buffer, size})) next_receiver->OnDataReceived(buffer, size, local_locator, remote_locator);
  else ++*descriptor_.stopped;
}

}  // namespace convoy::dds
