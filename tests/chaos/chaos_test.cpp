// Ten vehicles in processes of their own, over sockets, while a seed draws what happens to them: they are killed, stand
// still, lose their disks, their journals' ends and datagrams, and are cut off from each other. When that stops, all
// that live must come to hold the same, and nothing may be gone that somebody held or had in an intact journal.
// CONVOY_CHAOS_SECONDS (40) is how long it goes on, CONVOY_CHAOS_SEED (1) draws it. Processes are not repeatable to the
// bit: a seed gives the same faults at about the same times.
#include "chaos_testing.hpp"

#include "../unit/random_world.hpp"

#include <signal.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <memory>
#include <optional>
#include <set>
#include <sstream>
#include <thread>

namespace convoy::chaos {
namespace {

namespace fs = std::filesystem;

constexpr int vehicles = 10;
constexpr double tick_s = 0.25;
constexpr double segments_per_s = 0.5;  // of each vehicle
constexpr double faults_per_s = 0.7;    // of the fleet
constexpr double patience_s = 60.0;     // to settle
constexpr double quiet_s = 6.0;         // for so long all must be equal: a digest of each has told of what it knows
constexpr std::size_t max_down = 4, max_still = 3;

double number_of_environment(const char* name, double otherwise) {
  const char* text = std::getenv(name);
  return text == nullptr ? otherwise : std::stod(text);
}

struct Member {
  Garage garage;
  bool keeps_journal = true;
  std::unique_ptr<Life> run;
  double start_s = 0.0;                 // while there is no run
  std::optional<double> still_until_s;  // SIGSTOP
  double loss = 0.0;
  int side = 0;  // of the partition
  Epoch last_epoch = 0;
  Epoch whole_from = 0;         // of epochs since then the journal has lost nothing
  bool journal_hurt = true;     // since the last run began
  std::set<Epoch> interrupted;  // killed amid a statement, which may be on the wire and not in the file
};

class Chaos {
 public:
  Chaos(std::uint64_t seed, double seconds, std::uint32_t domain) : seconds_(seconds), random_(seed), driving_(seed) {
    for (int v = 1; v <= vehicles; ++v) {
      auto member = std::make_unique<Member>();
      member->garage = {folder_.path(), dds::testing::loopback_profile(), domain, static_cast<VehicleId>(v)};
      member->keeps_journal = v <= vehicles - 2;
      members_.push_back(std::move(member));
    }
  }

  void run() {
    for (; now_s() < seconds_; std::this_thread::sleep_for(std::chrono::duration<double>(tick_s))) {
      keep_going();
      while (next_fault_s_ < now_s()) {
        draw_fault();
        next_fault_s_ -= std::log(random_.uniform(1e-6, 1.0)) / faults_per_s;
      }
    }
    heal();
    settle();
    check();
  }

  const std::vector<std::string>& failures() const { return failures_; }
  std::string events() const {
    std::ostringstream text;
    for (const std::string& event : events_) text << "\n  " << event;
    return text.str();
  }
  std::string summary() const {
    std::ostringstream text;
    text << events_.size() << " events (" << kills_ << " kills, " << starts_ - vehicles << " restarts, " << torn_
         << " torn journals, " << wiped_ << " lost folders, " << stills_ << " standstills, " << partitions_
         << " partitions), " << history_.size() << " facts stated in " << starts_ << " runs, " << held_.size()
         << " held when the faults stopped, " << final_.size() << " at the end, " << gone_ << " gone for good; "
         << dropped_ << " datagrams dropped, " << requests_ << " requests, " << relayed_ << " facts relayed, "
         << reopened_ << " networks opened anew; settled after " << settled_s_ << " s";
    return text.str();
  }

 private:
  double now_s() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - begun_).count(); }
  bool chance(double probability) { return random_.uniform(0.0, 1.0) < probability; }
  void note(const std::string& what) {
    std::ostringstream text;
    text.precision(1);
    text << std::fixed << now_s() << " s: " << what;
    events_.push_back(text.str());
  }
  void expect(bool holds, const std::string& what) {
    if (!holds) failures_.push_back(what);
  }
  static std::string name(const Member& member) { return "vehicle " + std::to_string(member.garage.id); }

  std::vector<Member*> those(const std::function<bool(const Member&)>& which) const {
    std::vector<Member*> list;
    for (const auto& member : members_)
      if (which(*member)) list.push_back(member.get());
    return list;
  }
  static bool awake(const Member& member) { return member.run && !member.still_until_s; }
  std::vector<Member*> living() const {
    return those([](const Member& m) { return m.run != nullptr; });
  }
  Member* any(const std::vector<Member*>& list) {
    return list[static_cast<std::size_t>(random_.integer(0, static_cast<int>(list.size()) - 1))];
  }

  void keep_going() {
    for (const auto& member : members_) {
      if (member->still_until_s && now_s() >= *member->still_until_s) wake(*member);
      if (!member->run && now_s() >= member->start_s) start(*member);
      if (awake(*member) && driving_.uniform(0.0, 1.0) < segments_per_s * tick_s) (void)member->run->segment();
    }
    if (partition_until_s_ && now_s() >= *partition_until_s_) divide([](Member&) { return 0; }, "the partition ends");
  }

  void start(Member& member) {
    std::vector<std::string> options{"loss=" + std::to_string(member.loss)};
    if (!member.keeps_journal) options.emplace_back("no_journal");
    for (const auto& other : members_)
      if (other->side != member.side) options.push_back("block=" + std::to_string(other->garage.id));
    member.run = std::make_unique<Life>(member.garage, options);
    expect(member.run->epoch() > member.last_epoch, name(member) + " has used an epoch twice");
    member.last_epoch = member.run->epoch();
    if (member.journal_hurt) member.whole_from = member.last_epoch;
    member.journal_hurt = !member.keeps_journal;
    ++starts_;
    note(name(member) + " starts");
  }

  void wake(Member& member) {
    kill(member.run->pid(), SIGCONT);
    member.still_until_s.reset();
    block_anew(member);  // it has not heard of partitions since
    note(name(member) + " goes on");
  }

  void draw_fault() {
    const double what = random_.uniform(0.0, 1.0);
    if (what < 0.35) crash();
    else if (what < 0.55) stand_still();
    else if (what < 0.8) change_loss();
    else cut_off();
  }

  void crash() {
    const auto list = living();
    if (list.size() <= vehicles - max_down) return;
    Member& member = *any(list);
    if (awake(member) && chance(0.3)) {
      member.run->begin_segment();
      member.interrupted.insert(member.last_epoch);
      std::this_thread::sleep_for(std::chrono::microseconds(random_.integer(0, 2000)));
    }
    member.run->kill_hard();
    member.run.reset();
    member.still_until_s.reset();
    ++kills_;
    member.start_s = now_s() + random_.uniform(0.2, 8.0);
    note(name(member) + " is killed" + damage(member));
  }

  std::string damage(Member& member) {
    const double what = random_.uniform(0.0, 1.0);
    if (what < 0.2) {
      fs::remove_all(member.garage.state());
      member.journal_hurt = true;
      ++wiped_;
      return ", its folder is lost";
    }
    const int bytes = random_.integer(1, 300);
    if (what < 0.45 && member.keeps_journal && tear(member.garage.journal(), static_cast<std::uintmax_t>(bytes))) {
      member.journal_hurt = true;
      ++torn_;
      return ", its journal loses " + std::to_string(bytes) + " bytes";
    }
    return {};
  }

  void stand_still() {
    const auto list = those(awake);
    if (list.empty() || living().size() - list.size() >= max_still) return;
    Member& member = *any(list);
    kill(member.run->pid(), SIGSTOP);
    ++stills_;
    const double for_s = chance(0.15) ? random_.uniform(21.0, 26.0) : random_.uniform(0.5, 8.0);  // the lease is 20 s
    member.still_until_s = now_s() + for_s;
    note(name(member) + " stands still for " + std::to_string(for_s) + " s");
  }

  void change_loss() {
    const auto list = those(awake);
    if (list.empty()) return;
    Member& member = *any(list);
    member.loss = random_.uniform(0.0, 0.4);
    member.run->change("loss " + std::to_string(member.loss));
    note(name(member) + " loses " + std::to_string(member.loss));
  }

  void cut_off() {
    ++partitions_;
    partition_until_s_ = now_s() + random_.uniform(2.0, 12.0);
    const int sides = random_.integer(2, 3);
    std::string text = "partition";
    divide(
        [&](Member&) {
          const int side = random_.integer(1, sides);
          text += ' ' + std::to_string(side);
          return side;
        },
        "");
    note(text);
  }

  /// Who stands still is told when it goes on.
  void divide(const std::function<int(Member&)>& side_of, const std::string& what) {
    for (const auto& member : members_) member->side = side_of(*member);
    for (Member* member : those(awake)) block_anew(*member);
    if (!what.empty()) {
      partition_until_s_.reset();
      note(what);
    }
  }

  void block_anew(Member& member) {
    for (const auto& other : members_)
      if (other.get() != &member)
        member.run->change((other->side == member.side ? "unblock " : "block ") + std::to_string(other->garage.id));
  }

  /// The faults stop. What the living hold counts from here; of those that are down, one may stay away for good.
  void heal() {
    for (const auto& member : members_)
      if (member->still_until_s) wake(*member);
    for (Member* member : living())
      for (const auto& [id, hash] : member->run->facts()) take_down(id, hash, held_);
    const auto down = those([](const Member& m) { return !m.run; });
    const Member* gone = !down.empty() && chance(0.5) ? any(down) : nullptr;
    divide([](Member&) { return 0; }, "the faults stop");
    for (const auto& member : members_) {
      member->loss = 0.0;
      if (member->run) member->run->change("loss 0");
      else if (member.get() != gone) start(*member);
    }
    if (gone != nullptr) note(name(*gone) + " stays away");
    healed_s_ = now_s();
  }

  bool equal() const {
    const auto list = living();
    const Status first = list.front()->run->status();
    return std::all_of(list.begin() + 1, list.end(), [&](const Member* member) {
      const Status s = member->run->status();
      return s.holdings == first.holdings && s.digest == first.digest;
    });
  }

  void settle() {
    std::optional<double> equal_since_s;
    for (; now_s() < healed_s_ + patience_s + quiet_s;
         std::this_thread::sleep_for(std::chrono::duration<double>(tick_s))) {
      const double at_s = now_s();
      if (!equal()) equal_since_s.reset();
      else if (!equal_since_s) equal_since_s = at_s;
      else if (at_s >= *equal_since_s + quiet_s) break;
    }
    settled_s_ = equal_since_s ? *equal_since_s - healed_s_ : -1.0;
    expect(equal_since_s && settled_s_ <= patience_s, "not settled within " + std::to_string(patience_s) + " s");
  }

  /// Adds a fact to `facts`; all that was ever said under its key must be this.
  void take_down(const FactId& id, Hash hash, Facts& facts) {
    facts.emplace(id, hash);
    const auto [known, fresh] = ever_.emplace(id, hash);
    expect(fresh || known->second == hash, "a key was used twice: " + text_of(id));
  }
  static std::string text_of(const FactId& id) {
    return std::string(to_string(id.first)) + ' ' + std::to_string(id.second.index) + " of vehicle " +
           std::to_string(id.second.chain.vehicle) + " epoch " + std::to_string(id.second.chain.epoch);
  }

  void check() {
    for (const auto& member : members_)
      for (const auto& [id, hash] : read_facts(member->garage.stated())) take_down(id, hash, history_);
    const auto list = living();
    for (Member* member : list) {
      const Facts facts = member->run->facts();
      for (const auto& [id, hash] : facts) take_down(id, hash, final_);
      check_losses(*member, facts);
      const Status s = member->run->status();
      expect(s.refused == 0, name(*member) + " is refused");
      expect(s.conflicts == 0, name(*member) + " was told a key twice, with two contents");
      expect(s.unfit == 0, name(*member) + " was told unfit facts");
      expect(s.disagreements == 0, name(*member) + " made another map of the same facts");
      requests_ += s.requests;
      relayed_ += s.relayed;
      reopened_ += s.reopened;
      dropped_ += s.dropped;
    }
    std::uint64_t strange = 0;
    std::string example;
    for (const auto& [id, hash] : final_) {
      const Member& author = *members_.at(id.second.chain.vehicle - 1);
      if (history_.contains(id) || author.interrupted.contains(id.second.chain.epoch)) continue;
      ++strange;
      example = text_of(id);
    }
    expect(strange == 0, "nobody here ever stated " + std::to_string(strange) + " facts, such as " + example +
                             "; does another fleet speak in this domain?");
    for (const auto& [id, hash] : history_) gone_ += !final_.contains(id);
    expect(kills_ > 0 && stills_ > 0 && partitions_ > 0 && torn_ + wiped_ > 0 && dropped_ > 0,
           "too little happened: this proves nothing");
  }

  void check_losses(const Member& member, const Facts& facts) {
    std::uint64_t held = 0, journals = 0;
    std::string example;
    const auto miss = [&](const FactId& id, std::uint64_t& count) {
      if (facts.contains(id)) return;
      ++count;
      example = text_of(id);
    };
    for (const auto& [id, hash] : held_) miss(id, held);
    for (const auto& [id, hash] : history_) {
      const Member& author = *members_.at(id.second.chain.vehicle - 1);
      if (author.run && author.keeps_journal && id.second.chain.epoch >= author.whole_from) miss(id, journals);
    }
    expect(held + journals == 0, name(member) + " lacks " + std::to_string(held) + " facts that somebody held, and " +
                                     std::to_string(journals) + " of intact journals, such as " + example);
  }

  const TestFolder folder_;
  const double seconds_;
  test::Random random_;   // of the faults
  test::Random driving_;  // drawn as often as the machine is quick: what befalls whom does not depend on it
  const std::chrono::steady_clock::time_point begun_ = std::chrono::steady_clock::now();
  std::vector<std::unique_ptr<Member>> members_;
  double next_fault_s_ = 3.0, healed_s_ = 0.0, settled_s_ = -1.0;
  std::optional<double> partition_until_s_;
  std::vector<std::string> events_, failures_;
  Facts ever_, history_, held_, final_;
  int kills_ = 0, starts_ = 0, torn_ = 0, wiped_ = 0, stills_ = 0, partitions_ = 0;
  std::uint64_t gone_ = 0, requests_ = 0, relayed_ = 0, reopened_ = 0, dropped_ = 0;
};

TEST(Chaos, WhenTheFaultsStopAllHoldTheSameAndNothingIsLost) {
  const auto seed = static_cast<std::uint64_t>(number_of_environment("CONVOY_CHAOS_SEED", 1));
  const double seconds = number_of_environment("CONVOY_CHAOS_SECONDS", 40.0);
  std::cout << "seed " << seed << ", " << seconds << " s of faults" << std::endl;
  Chaos chaos(seed, seconds, dds::testing::domain_of_this_test());
  std::string broken_off;
  try {
    chaos.run();
  } catch (const std::exception& error) {
    broken_off = error.what();
  }
  std::cout << chaos.summary() << std::endl;
  std::ostringstream failures;
  for (const std::string& failure : chaos.failures()) failures << "\n  " << failure;
  EXPECT_TRUE(broken_off.empty() && chaos.failures().empty())
      << "seed " << seed << ": " << broken_off << failures.str() << "\nwhat happened:" << chaos.events();
}

}  // namespace
}  // namespace convoy::chaos
