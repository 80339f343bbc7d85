// Single faults, each between whole vehicles in processes of their own.
#include "chaos_testing.hpp"

#include <sys/mount.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <fstream>
#include <stdexcept>

namespace convoy::chaos {
namespace {

namespace fs = std::filesystem;
using dds::testing::eventually;

constexpr double patience_s = 60.0;

Garage garage_in(const fs::path& folder, VehicleId id) {
  fs::create_directories(folder);
  return {folder, dds::testing::loopback_profile(), dds::testing::domain_of_this_test(), id};
}

bool hold_the_same(Life& a, Life& b) {
  return eventually([&] { return a.status().holdings == b.status().holdings; }, patience_s);
}

std::ptrdiff_t facts_of(const Facts& facts, const ChainId& chain) {
  return std::count_if(facts.begin(), facts.end(), [&](const auto& f) { return f.first.second.chain == chain; });
}

TEST(TwoProcessesOfOneId, TheSecondIsRefusedAndTheFirstIsUnharmed) {
  const TestFolder folder;
  Life other(garage_in(folder.path() / "other", 2)), first(garage_in(folder.path() / "first", 1));
  for (int i = 0; i < 5; ++i) (void)first.segment();
  ASSERT_TRUE(hold_the_same(first, other));

  Life second(garage_in(folder.path() / "second", 1));  // a state folder of its own: no lock is in its way
  ASSERT_GT(second.epoch(), first.epoch());
  ASSERT_TRUE(eventually(
      [&] {
        (void)first.segment();
        return second.status().refused == 1;
      },
      patience_s));
  const ChainId late{1, second.epoch()};
  const auto told_before = facts_of(other.facts(), late);
  for (int i = 0; i < 5; ++i) (void)second.segment();
  const std::uint64_t stated = first.segment();
  EXPECT_TRUE(eventually(
      [&] {
        return facts_of(other.facts(), {1, first.epoch()}) == static_cast<std::ptrdiff_t>(stated) &&
               second.status().refused == 1;
      },
      patience_s));
  EXPECT_EQ(facts_of(other.facts(), late), told_before) << "the second one goes on telling";
  EXPECT_EQ(first.status().refused, 0U);
  EXPECT_EQ(first.status().conflicts + other.status().conflicts, 0U);
}

TEST(TwoProcessesOfOneId, InOneStateFolderTheSecondDoesNotStart) {
  const TestFolder folder;
  const Garage garage = garage_in(folder.path(), 1);
  Life first(garage);
  try {
    const Life second(garage);
    FAIL() << "it started";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("runs already, as process " + std::to_string(first.pid())),
              std::string::npos)
        << error.what();
  }
  EXPECT_GT(first.segment(), 0U);
}

/// A disk of some pages that this test may fill. It is unmounted when this goes out of scope.
class SmallDisk {
 public:
  explicit SmallDisk(fs::path folder) : folder_(std::move(folder)) {
    fs::create_directories(folder_);
    mounted_ = mount("none", folder_.c_str(), "tmpfs", 0, "size=256k,mode=0700") == 0;
  }
  ~SmallDisk() {
    if (mounted_) umount2(folder_.c_str(), MNT_DETACH);
  }
  SmallDisk(const SmallDisk&) = delete;
  SmallDisk& operator=(const SmallDisk&) = delete;
  bool mounted() const { return mounted_; }
  void fill() {
    std::ofstream out(folder_ / "filler", std::ios::binary);
    const std::string page(4096, 'x');
    while (out.write(page.data(), static_cast<std::streamsize>(page.size())).flush()) {
    }
  }
  void free() { fs::remove(folder_ / "filler"); }

 private:
  fs::path folder_;
  bool mounted_ = false;
};

TEST(FullDisk, TheVehicleGoesOnAndItsJournalIsWholeOnceThereIsSpace) {
  const TestFolder folder;
  const Garage garage = garage_in(folder.path(), 1);
  SmallDisk disk(garage.state());
  if (!disk.mounted()) GTEST_SKIP() << "cannot mount a small disk: " << std::strerror(errno) << "; it takes root";
  std::uint64_t known = 0;
  {
    Life vehicle(garage), other(garage_in(folder.path(), 2));
    (void)vehicle.segment();
    ASSERT_TRUE(hold_the_same(vehicle, other));
    disk.fill();
    for (int i = 0; i < 30; ++i) (void)vehicle.segment();
    const Status full = vehicle.status();
    EXPECT_GT(full.failed_writes, 0U);
    EXPECT_GT(full.waiting, 0U);
    EXPECT_TRUE(hold_the_same(vehicle, other)) << "what is not on the disk is told all the same";

    disk.free();
    EXPECT_TRUE(eventually([&] { return vehicle.status().waiting == 0; }, patience_s));
    (void)vehicle.segment();
    EXPECT_TRUE(hold_the_same(vehicle, other));
    known = vehicle.status().known;
    vehicle.kill_hard();
  }
  const Status again = Life(garage).status();  // nobody else is there to tell it
  EXPECT_EQ(again.restored, known);
  EXPECT_EQ(again.cut_bytes, 0U);
}

TEST(TornJournal, TheRestWasReadAndThePeersBringWhatIsMissing) {
  const TestFolder folder;
  const Garage garage = garage_in(folder.path(), 1);
  Life other(garage_in(folder.path(), 2));
  std::uint64_t known = 0;
  Epoch before = 0;
  {
    Life vehicle(garage);
    before = vehicle.epoch();
    for (int i = 0; i < 10; ++i) (void)vehicle.segment();
    ASSERT_TRUE(hold_the_same(vehicle, other));
    known = vehicle.status().known;
    vehicle.kill_hard();
  }
  ASSERT_TRUE(tear(garage.journal(), 10));
  Life vehicle(garage);
  EXPECT_GT(vehicle.epoch(), before);
  const Status torn = vehicle.status();
  EXPECT_EQ(torn.restored, known - 1);
  EXPECT_GT(torn.cut_bytes, 0U);
  EXPECT_TRUE(hold_the_same(vehicle, other));
  EXPECT_EQ(vehicle.status().known, known + 2) << "its second chain begins with an anchor and a prior";
  EXPECT_EQ(vehicle.status().conflicts + other.status().conflicts, 0U);
}

TEST(Clocks, ThatDifferAreToldOfAndTheFactsAreTheSame) {
  constexpr double ahead_s = 1000.0, delay_s = 1.0;
  const TestFolder folder;
  Life a(garage_in(folder.path(), 1)), b(garage_in(folder.path(), 2), {"clock=" + std::to_string(ahead_s)});
  for (int i = 0; i < 5; ++i) {
    (void)a.segment();
    (void)b.segment();
  }
  EXPECT_TRUE(hold_the_same(a, b));
  const auto tells = [](Life& of, VehicleId vehicle, double seconds) {
    return eventually([&] { return std::abs(of.ahead_of(vehicle) - seconds) < delay_s; }, patience_s);
  };
  EXPECT_TRUE(tells(a, 2, -ahead_s)) << a.ahead_of(2);
  EXPECT_TRUE(tells(b, 1, ahead_s)) << b.ahead_of(1);
  EXPECT_EQ(a.status().digest, b.status().digest);
}

TEST(Flood, ItsSenderIsQuarantinedAndTheOthersDoNotNotice) {
  const TestFolder folder;
  const Garage garage = garage_in(folder.path(), 1);
  Life a(garage, {"flood=500"}), b(garage_in(folder.path(), 2), {"flood=500"});
  dds::testing::Child flooder({CONVOY_DDS_PEER, garage.profile, std::to_string(garage.domain), "3", "127.0.0.1"});
  ASSERT_EQ(flooder.hear(), "ready");
  flooder.tell("peers 2");
  ASSERT_EQ(flooder.hear(), "peers 2");
  flooder.tell("send 0 40000");
  std::uint64_t of_a = 0, of_b = 0;
  for (int i = 0; i < 10; ++i) {
    of_a = a.segment();
    of_b = b.segment();
  }
  const auto hold_each_others = [&] {
    return facts_of(a.facts(), {2, b.epoch()}) == static_cast<std::ptrdiff_t>(of_b) &&
           facts_of(b.facts(), {1, a.epoch()}) == static_cast<std::ptrdiff_t>(of_a);
  };
  EXPECT_TRUE(eventually(hold_each_others, patience_s));
  for (Life* vehicle : {&a, &b}) {
    EXPECT_TRUE(eventually([&] { return vehicle->status().quarantines > 0; }, patience_s));
    EXPECT_LT(facts_of(vehicle->facts(), {3, 1}), 40000) << "nothing was passed over";
  }
}

}  // namespace
}  // namespace convoy::chaos
