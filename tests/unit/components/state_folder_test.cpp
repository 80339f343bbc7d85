#include <convoy/components/state_folder.hpp>
#include <convoy/config_error.hpp>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <limits>
#include <memory>
#include <set>
#include <sstream>

namespace convoy {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class StateFolderTest : public testing::Test {
 protected:
  StateFolderTest() {
    std::string name = (fs::temp_directory_path() / "convoy_state_XXXXXX").string();
    base_ = ::mkdtemp(name.data());
    folder_ = base_ / "state";
  }
  ~StateFolderTest() override { fs::remove_all(base_); }

  StateFolder::NextEpoch next(Epoch fresh) {
    return StateFolder(folder_).next_epoch([=] { return fresh; });
  }
  std::string epoch_file() const {
    std::stringstream text;
    text << std::ifstream(folder_ / "epoch").rdbuf();
    return text.str();
  }
  void write_epoch_file(const std::string& text) const { std::ofstream(folder_ / "epoch", std::ios::trunc) << text; }
  static std::string text_of(const std::function<void()>& call) {
    try {
      call();
    } catch (const ConfigError& error) {
      return error.what();
    }
    return "no error";
  }

  fs::path base_, folder_;
};

TEST_F(StateFolderTest, TheFirstEpochIsFreshAndEveryLaterOneIsHigher) {
  const auto first = next(1000);
  EXPECT_TRUE(first.first);
  EXPECT_EQ(first.epoch, 1000U);
  const auto second = next(2000);
  EXPECT_FALSE(second.first);
  EXPECT_EQ(second.epoch, 2000U);
  EXPECT_EQ(next(2000).epoch, 2001U);  // within one tick
  EXPECT_EQ(next(5).epoch, 2002U);     // a clock that was set back
}

TEST_F(StateFolderTest, FreshFoldersDoNotBeginAlike) {
  std::set<Epoch> epochs;
  for (int i = 0; i < 20; ++i) epochs.insert(StateFolder(base_ / std::to_string(i)).next_epoch(epoch_from_clock).epoch);
  EXPECT_EQ(epochs.size(), 20U);
  EXPECT_EQ(epochs.count(1), 0U);
}

TEST_F(StateFolderTest, ACutEpochFileIsNeverTakenForASmallerNumber) {
  next(7353630972448687602U);
  const std::string whole = epoch_file();
  ASSERT_GT(whole.size(), 30U);
  for (std::size_t length = 0; length < whole.size(); ++length) {
    write_epoch_file(whole.substr(0, length));
    EXPECT_THAT(text_of([&] { next(1); }), HasSubstr((folder_ / "epoch").string() + ":1: damaged")) << length;
    EXPECT_EQ(epoch_file(), whole.substr(0, length));  // and is left as it is
  }
}

TEST_F(StateFolderTest, AnyChangedByteOfTheEpochFileIsNoticed) {
  next(41);
  const std::string whole = epoch_file();
  for (std::size_t i = 0; i < whole.size(); ++i)
    for (const char other : {'0', '7', 'x', '\0', '\n'}) {
      std::string changed = whole;
      if (changed[i] == other) continue;
      changed[i] = other;
      write_epoch_file(changed);
      EXPECT_THAT(text_of([&] { next(1); }), HasSubstr("delete the file")) << i;
    }
  write_epoch_file(whole + whole);
  EXPECT_THAT(text_of([&] { next(1); }), HasSubstr("damaged"));
  write_epoch_file(whole);
  EXPECT_EQ(next(1).epoch, 42U);
  fs::remove(folder_ / "epoch");  // what the text says
  EXPECT_TRUE(next(100).first);
}

TEST_F(StateFolderTest, TheLastNumberLeavesNoneAfterIt) {
  next(std::numeric_limits<Epoch>::max());
  EXPECT_THAT(text_of([&] { next(1); }), HasSubstr("damaged"));
}

TEST_F(StateFolderTest, IsLockedAgainstASecondOneUntilTheFirstIsGone) {
  auto first = std::make_unique<StateFolder>(folder_);
  const std::string text = text_of([&] { StateFolder second(folder_); });
  EXPECT_THAT(text, HasSubstr("process " + std::to_string(getpid())));
  EXPECT_THAT(text, HasSubstr("stop that one, or give this one a state_folder of its own"));
  StateFolder elsewhere(base_ / "other");
  first.reset();
  EXPECT_EQ(text_of([&] { StateFolder again(folder_); }), "no error");
}

TEST_F(StateFolderTest, TheLockGoesWithAProcessThatIsKilled) {
  int ready[2];
  ASSERT_EQ(pipe(ready), 0);
  const pid_t child = fork();
  if (child == 0) {
    const StateFolder held(folder_);
    if (write(ready[1], "x", 1) == 1) pause();
    _exit(1);
  }
  char byte = 0;
  ASSERT_EQ(read(ready[0], &byte, 1), 1);
  EXPECT_THAT(text_of([&] { StateFolder second(folder_); }), HasSubstr("process " + std::to_string(child)));
  kill(child, SIGKILL);
  ASSERT_EQ(waitpid(child, nullptr, 0), child);
  EXPECT_EQ(text_of([&] { StateFolder second(folder_); }), "no error");
  close(ready[0]);
  close(ready[1]);
}

TEST_F(StateFolderTest, AFolderThatCannotBeIsAClearError) {
  std::ofstream(folder_) << "a file";
  EXPECT_THAT(text_of([&] { StateFolder s(folder_); }), HasSubstr(folder_.string() + "/lock: cannot write"));
  EXPECT_THAT(text_of([] { StateFolder s("/proc/convoy/state"); }), HasSubstr("must be writable"));
}

}  // namespace
}  // namespace convoy
