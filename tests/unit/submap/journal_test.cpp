#include <convoy/config_error.hpp>
#include <convoy/submap/journal.hpp>

#include "../random_world.hpp"
#include "../sample_facts.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <limits>

namespace convoy {
namespace {

/// A disk in memory.
struct Disk {
  Bytes bytes;
  std::size_t capacity = std::numeric_limits<std::size_t>::max();
  bool cuts = true;
};

class OnDisk final : public JournalMedium {
 public:
  explicit OnDisk(Disk& disk) : disk_(disk) {}
  Bytes read() override { return disk_.bytes; }
  bool append(std::span<const std::uint8_t> bytes) override {
    const std::size_t room = disk_.capacity - std::min(disk_.capacity, disk_.bytes.size());
    const bool fits = bytes.size() <= room;
    if (fits || !disk_.cuts)  // a disk that cannot even cut keeps the part that fitted
      disk_.bytes.insert(disk_.bytes.end(), bytes.begin(),
                         bytes.begin() + static_cast<long>(std::min(room, bytes.size())));
    return fits;
  }
  bool cut(std::uint64_t size) override {
    if (disk_.cuts) disk_.bytes.resize(size);
    return disk_.cuts;
  }

 private:
  Disk& disk_;
};

Journal<SE2> journal_on(Disk& disk) { return Journal<SE2>(std::make_unique<OnDisk>(disk)); }

test::Store restored(Disk& disk, JournalCounters* counters = nullptr) {
  test::Store store;
  auto journal = journal_on(disk);
  journal.restore(store);
  if (counters != nullptr) *counters = journal.counters();
  return store;
}

/// A disk with the facts of a chain.
Disk written(const std::vector<test::Fact>& facts) {
  Disk disk;
  auto journal = journal_on(disk);
  test::Store store;
  journal.restore(store);
  for (const auto& fact : facts) journal.append(fact, 0.0);
  EXPECT_EQ(journal.counters().written, facts.size());
  return disk;
}

Hash holdings_of(const std::vector<test::Fact>& facts) {
  test::Store store;
  for (const auto& fact : facts) test::insert(store, fact);
  return store.holdings();
}

template <class Fact>
void expect_same_after_a_round_trip(const Fact& fact) {
  using G = std::conditional_t<std::is_constructible_v<AnyFact<SE2>, Fact>, SE2, SE3>;
  Bytes bytes;
  encode<G>(fact, bytes);
  const auto back = decode<G>(bytes);
  ASSERT_TRUE(back) << to_string(kind_of<Fact>);
  ASSERT_TRUE(std::holds_alternative<Fact>(*back));
  EXPECT_EQ(hash_of(std::get<Fact>(*back)), hash_of(fact)) << to_string(kind_of<Fact>);
  for (std::size_t size = 0; size < bytes.size(); ++size)
    EXPECT_FALSE(decode<G>({bytes.data(), size})) << to_string(kind_of<Fact>) << " of " << size << " bytes";
  bytes.push_back(0);
  EXPECT_FALSE(decode<G>(bytes));
}

TEST(FactCodec, EveryKindOfAPlanarFleetComesBackToTheBit) {
  for (const auto& fact : test::chain_facts(2, 2))
    std::visit([](const auto& f) { expect_same_after_a_round_trip(f); }, fact);
}

TEST(FactCodec, PosesInSpaceComeBackToTheBit) {
  test::Random random(1);
  for (int k = 0; k < 100; ++k) {
    AnchorFact<SE3> anchor{{{3, 1}, 7}, {}, 5, 2};
    anchor.state.pose = SE3::Exp(random.unit_normal<6>()) * SE3::Exp(random.unit_normal<6>());
    anchor.state.drift = random.unit_normal<6>().asDiagonal();
    anchor.state.heading_lever = random.unit_normal<6>();
    expect_same_after_a_round_trip(anchor);
    LandmarkFact<SE3> landmark;
    landmark.key = {{3, 1}, 7};
    landmark.position = random.unit_normal<3>();
    landmark.loading.col(3) = random.unit_normal<3>();
    expect_same_after_a_round_trip(landmark);
  }
}

TEST(FactCodec, WhatIsNoFactIsNone) {
  EXPECT_FALSE(decode<SE2>({}));
  test::Random random(2);
  for (int k = 0; k < 20000; ++k) {  // never reads beyond the end, never reserves what is not there
    Bytes bytes(static_cast<std::size_t>(random.uniform(0.0, 200.0)));
    for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random.uniform(0.0, 256.0));
    if (!bytes.empty()) bytes[0] %= 9;
    (void)decode<SE2>(bytes);
    (void)decode<SE3>(bytes);
  }
  Bytes many;
  encode<SE2>(test::association(1, 0, test::pairings(1, 2, 0, 3)), many);
  for (std::size_t i = 17; i < 21; ++i) many[i] = 0xff;  // four billion pairings
  EXPECT_FALSE(decode<SE2>(many));
}

TEST(Journal, ARestartHasWhatWasHeld) {
  const auto facts = test::chain_facts(2, 20);
  Disk disk = written(facts);
  JournalCounters counters;
  EXPECT_EQ(restored(disk, &counters).holdings(), holdings_of(facts));
  EXPECT_EQ(counters.restored, facts.size());
  EXPECT_EQ(counters.damaged_bytes + counters.cut_bytes + counters.refused, 0U);
}

TEST(Journal, ATornTailIsCutOffWhereverItIsTorn) {
  const auto facts = test::chain_facts(2, 2);
  const Disk whole = written(facts);
  const Disk without_last = written({facts.begin(), facts.end() - 1});
  for (std::size_t size = without_last.bytes.size() + 1; size < whole.bytes.size(); ++size) {
    Disk disk = whole;
    disk.bytes.resize(size);
    JournalCounters counters;
    EXPECT_EQ(restored(disk, &counters).size(), facts.size() - 1) << size;
    EXPECT_EQ(counters.cut_bytes, size - without_last.bytes.size());
    EXPECT_EQ(disk.bytes, without_last.bytes);  // what is written next is not lost behind it
  }
}

TEST(Journal, AFlippedBitCostsOneFactAndNoOther) {
  const auto facts = test::chain_facts(2, 3);
  const Disk whole = written(facts);
  const std::size_t begin = written({}).bytes.size();
  for (std::size_t at = begin; at < whole.bytes.size(); ++at) {
    Disk disk = whole;
    disk.bytes[at] ^= static_cast<std::uint8_t>(1U << (at % 8));
    JournalCounters counters;
    const test::Store store = restored(disk, &counters);
    ASSERT_EQ(counters.restored, facts.size() - 1) << "byte " << at;
    ASSERT_GT(counters.damaged_bytes + counters.cut_bytes, 0U);
    for (const auto& fact : facts)  // nothing that was never said
      std::visit([&](const auto& f) { store.holds(f); }, fact);
    ASSERT_EQ(counters.refused, 0U);
  }
}

TEST(Journal, AfterDamageItGoesOn) {
  const auto facts = test::chain_facts(2, 3);
  Disk disk = written({facts.begin(), facts.end() - 5});
  disk.bytes[disk.bytes.size() / 2] ^= 4;
  {
    auto journal = journal_on(disk);
    test::Store store;
    journal.restore(store);
    for (const auto& fact : facts) journal.append(fact, 0.0);  // a peer has repaired what was lost
  }
  EXPECT_EQ(restored(disk).holdings(), holdings_of(facts));
}

TEST(Journal, DamageIsToldOfOnce) {
  const auto facts = test::chain_facts(2, 3);
  Disk disk = written(facts);
  const std::size_t begin = written({}).bytes.size();
  const auto told_of = [&disk] {
    JournalCounters counters;
    (void)restored(disk, &counters);
    EXPECT_EQ(counters.cut_bytes + counters.refused, 0U);
    return counters.damaged_bytes;
  };
  disk.bytes[begin] ^= 4;
  const std::size_t capacity = std::exchange(disk.capacity, disk.bytes.size());
  const std::uint64_t first = told_of();
  EXPECT_GT(first, 0U);
  EXPECT_EQ(told_of(), first) << "a full disk cannot note it";
  disk.capacity = capacity;
  EXPECT_EQ(told_of(), first);
  EXPECT_EQ(told_of(), 0U);
  disk.bytes[begin + static_cast<std::size_t>(first)] ^= 4;  // the next fact
  EXPECT_GT(told_of(), 0U);
  EXPECT_EQ(told_of(), 0U);
  EXPECT_EQ(restored(disk).size(), facts.size() - 2);
}

TEST(Journal, WhatAFullDiskDoesNotTakeIsWrittenWhenThereIsRoom) {
  const auto facts = test::chain_facts(2, 10);
  for (const bool cuts : {true, false}) {
    Disk disk;
    disk.cuts = cuts;
    disk.capacity = 2000;
    auto journal = journal_on(disk);
    test::Store store;
    journal.restore(store);
    for (const auto& fact : facts) journal.append(fact, 1.0);
    EXPECT_GT(journal.counters().waiting, 0U);
    EXPECT_EQ(journal.counters().waiting + journal.counters().written, facts.size());
    EXPECT_LT(journal.counters().failed_writes, 3U) << "one attempt, not one per fact";
    EXPECT_EQ(restored(disk).size(), journal.counters().written);  // a crash now
    disk.capacity = 1000000;
    journal.retry(1.0 + 0.9 * Journal<SE2>::retry_s);
    EXPECT_GT(journal.counters().waiting, 0U);
    journal.retry(1.0 + 1.1 * Journal<SE2>::retry_s);
    EXPECT_EQ(journal.counters().waiting, 0U);
    EXPECT_EQ(restored(disk).holdings(), holdings_of(facts));
  }
}

TEST(Journal, WhatIsNoJournalIsRefusedAndLeftAlone) {
  const auto message_of = [](Disk disk) -> std::string {
    const Bytes before = disk.bytes;
    try {
      (void)restored(disk);
    } catch (const ConfigError& error) {
      EXPECT_EQ(disk.bytes, before);
      return error.what();
    }
    return "accepted";
  };
  const std::string text = "my diary\nof a long journey through the hills\n";
  EXPECT_THAT(message_of({{text.begin(), text.end()}}), testing::HasSubstr("no journal of an SE(2) fleet"));
  Disk of_space;
  {
    FactStore<SE3> store;
    Journal<SE3> journal(std::make_unique<OnDisk>(of_space));
    journal.restore(store);
  }
  EXPECT_THAT(message_of(of_space), testing::HasSubstr("move the file away"));
  Disk torn = written({});
  torn.bytes.resize(10);  // died in its first line
  EXPECT_EQ(message_of(torn), "accepted");
}

TEST(Journal, FactsBeyondTheLimitsOfTheStoreAreCounted) {
  Disk disk = written(test::chain_facts(2, 3));
  FactLimits limits;
  limits.roster = {1};
  test::Store store(limits);
  auto journal = journal_on(disk);
  journal.restore(store);
  EXPECT_EQ(store.size(), 0U);
  EXPECT_EQ(journal.counters().refused, test::chain_facts(2, 3).size());
}

TEST(Journal, AFileOutlivesItsWriter) {
  const auto folder = std::filesystem::path(testing::TempDir()) / "convoy_journal_test";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  const auto file = folder / "facts.journal";
  const auto facts = test::chain_facts(2, 5);
  for (int run = 0; run < 2; ++run) {
    Journal<SE2> journal(open_journal_file(file), file.string());
    test::Store store;
    journal.restore(store);
    EXPECT_EQ(store.size(), run == 0 ? 0U : facts.size());
    if (run == 0)
      for (const auto& fact : facts) journal.append(fact, 0.0);
  }
  std::filesystem::resize_file(file, std::filesystem::file_size(file) - 3);
  Journal<SE2> journal(open_journal_file(file), file.string());
  test::Store store;
  journal.restore(store);
  EXPECT_EQ(store.size(), facts.size() - 1);
  EXPECT_THROW((void)open_journal_file(folder), ConfigError);
  EXPECT_THROW((void)open_journal_file(folder / "none" / "facts.journal"), ConfigError);
  std::filesystem::remove_all(folder);
}

// /dev/full takes nothing, as a full disk does.
TEST(Journal, AFullDeviceIsNoFile) { EXPECT_THROW((void)open_journal_file("/dev/full"), ConfigError); }

}  // namespace
}  // namespace convoy
