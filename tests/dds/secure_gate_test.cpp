// What may come in while DDS Security is on, byte by byte.
#include <convoy/dds/secure_gate.hpp>

#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

namespace convoy::dds {
namespace {

using Bytes = std::vector<unsigned char>;

Bytes operator+(Bytes a, const Bytes& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

Bytes header() { return Bytes{'R', 'T', 'P', 'S', 2, 3, 1, 15} + Bytes(12, 0xab); }

Bytes submessage(unsigned char kind, const Bytes& content) {
  return Bytes{kind, 1, static_cast<unsigned char>(content.size()), static_cast<unsigned char>(content.size() >> 8)} +
         content;
}

Bytes data_of(std::uint32_t writer, unsigned char kind = 0x15) {
  return submessage(kind, Bytes{0, 0, 16, 0, 0, 0, 0, 0, static_cast<unsigned char>(writer >> 24),
                                static_cast<unsigned char>(writer >> 16), static_cast<unsigned char>(writer >> 8),
                                static_cast<unsigned char>(writer)} +
                              Bytes(12, 0));
}

Bytes heartbeat_of(unsigned char writer_class, unsigned char kind = 0x07) {
  return submessage(kind, Bytes{0, 0, 0, 0, 0, 0, writer_class, 0xc2} + Bytes(20, 0));
}

Bytes prefix(unsigned char key) { return submessage(0x31, Bytes{0, 0, 0, 2, 0, 0, 0, key} + Bytes(12, 7)); }
Bytes body() { return submessage(0x30, Bytes(32, 9)); }
Bytes postfix(unsigned char receivers) {
  return submessage(0x32, Bytes(16, 5) + Bytes{0, 0, 0, receivers} + Bytes(20U * receivers, 6));
}
Bytes time_stamp() { return submessage(0x09, Bytes(8, 1)); }

constexpr std::uint32_t a_writer_of_convoy = 0x00000102;

TEST(SecureGate, LetsInWhatOpensAConversation) {
  EXPECT_TRUE(may_enter(header() + time_stamp() + data_of(0x000100c2))) << "announcement";
  EXPECT_TRUE(may_enter(header() + data_of(0x000201c3))) << "handshake";
  EXPECT_TRUE(may_enter(header() + data_of(0x000201c3, 0x16))) << "a fragment of it";
  EXPECT_TRUE(may_enter(header() + prefix(0) + body() + postfix(0))) << "keys";
  EXPECT_TRUE(may_enter(header() + submessage(0x0e, Bytes(12, 0)) + heartbeat_of(3) + submessage(0x80, Bytes(56, 0))));
}

TEST(SecureGate, LetsInWhatProvesItsAuthor) {
  EXPECT_TRUE(may_enter(header() + time_stamp() + prefix(4) + body() + postfix(1)));
  EXPECT_TRUE(may_enter(header() + prefix(4) + body() + postfix(3) + prefix(4) + body() + postfix(3)));
}

TEST(SecureGate, StopsWhatIsNotProtected) {
  EXPECT_FALSE(may_enter(header() + time_stamp() + data_of(a_writer_of_convoy)));
  EXPECT_FALSE(may_enter(header() + data_of(a_writer_of_convoy, 0x16)));
  EXPECT_FALSE(may_enter(header() + data_of(0x000003c2))) << "an endpoint announced in the open";
  for (const unsigned char kind : {0x06, 0x07, 0x08, 0x12, 0x13})
    EXPECT_FALSE(may_enter(header() + submessage(kind, Bytes{0, 0, 0, 0, 0, 0, 1, 2} + Bytes(20, 0)))) << int{kind};
  EXPECT_FALSE(may_enter(header() + data_of(0x000100c2) + data_of(a_writer_of_convoy))) << "behind an announcement";
  EXPECT_FALSE(may_enter(header() + prefix(4) + body() + postfix(1) + data_of(a_writer_of_convoy)));
}

TEST(SecureGate, StopsWhatEveryReaderCouldHaveMade) {
  EXPECT_FALSE(may_enter(header() + prefix(4) + body() + postfix(0))) << "no code of the author's";
  EXPECT_FALSE(may_enter(header() + prefix(0) + body() + postfix(0) + prefix(4) + body() + postfix(0)));
  EXPECT_FALSE(may_enter(header() + prefix(4) + data_of(a_writer_of_convoy) + postfix(1))) << "signed only";
  EXPECT_FALSE(may_enter(header() + submessage(0x33, Bytes(20, 0)) + body() + submessage(0x34, Bytes(40, 1))))
      << "a whole message in one cover: there is no looking into it";
}

TEST(SecureGate, StopsOtherSourcesAndWhatItDoesNotKnow) {
  EXPECT_FALSE(may_enter(header() + submessage(0x0c, Bytes(20, 0)) + data_of(0x000100c2)));
  EXPECT_FALSE(may_enter(header() + submessage(0x55, Bytes(4, 0))));
}

TEST(SecureGate, StopsWhatCouldBeReadInTwoWays) {
  EXPECT_FALSE(may_enter({}));
  EXPECT_FALSE(may_enter(Bytes(19, 0)));
  EXPECT_FALSE(may_enter(header() + Bytes{0x15, 1, 0}));
  EXPECT_FALSE(may_enter(header() + Bytes{0x0e, 1, 200, 0} + Bytes(12, 0))) << "longer than the message";
  EXPECT_FALSE(may_enter(header() + Bytes{0x0e, 1, 0, 0} + data_of(a_writer_of_convoy))) << "length 0: up to the end";
  EXPECT_FALSE(may_enter(header() + submessage(0x80, Bytes(7, 0)) + time_stamp())) << "not aligned";
  EXPECT_FALSE(may_enter(header() + prefix(4) + body())) << "no end";
  EXPECT_FALSE(may_enter(header() + prefix(4) + time_stamp() + body() + postfix(1)));
  EXPECT_FALSE(may_enter(header() + body() + postfix(1))) << "no beginning";
  EXPECT_FALSE(may_enter(header() + prefix(0) + submessage(0x31, Bytes(4, 0))));
}

TEST(SecureGate, AMessageCutAnywhereDoesNoHarm) {
  const Bytes whole = header() + time_stamp() + prefix(4) + body() + postfix(2);
  for (std::size_t n = 0; n < whole.size(); ++n) {
    const Bytes exact(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(n));  // so that ASan sees its end
    const bool complete = n == 20 || n == 32;
    EXPECT_EQ(may_enter(exact), complete) << n;
  }
}

}  // namespace
}  // namespace convoy::dds
