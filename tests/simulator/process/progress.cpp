#include "progress.hpp"

#include <unistd.h>

#include <cstdio>

namespace convoy::simulator {

Progress::Progress(double duration_s)
    : duration_s_(duration_s), terminal_(isatty(STDERR_FILENO) == 1), next_(start_ + std::chrono::seconds(2)) {}

Progress::~Progress() {
  if (open_) std::fputc('\n', stderr);
}

void Progress::tell(double time_s, const std::string& what) {
  const auto now = Clock::now();
  if (now < next_) return;
  next_ = now + (terminal_ ? std::chrono::milliseconds(500) : std::chrono::milliseconds(10'000));
  const double gone_s = std::chrono::duration<double>(now - start_).count();
  std::fprintf(stderr, "%sconvoy sim: %.1f of %.1f s, %.2f s per second%s%s", terminal_ ? "\r\033[K" : "", time_s,
               duration_s_, time_s / gone_s, what.empty() ? "" : "; ", what.c_str());
  if (!terminal_) std::fputc('\n', stderr);
  std::fflush(stderr);
  open_ = terminal_;
}

LongWait::~LongWait() {
  if (open_) std::fputc('\n', stderr);
}

void LongWait::tell(const std::string& what, const std::string& rest) {
  if (Clock::now() < next()) return;
  open_ = isatty(STDERR_FILENO) == 1;
  std::fprintf(stderr, "%sconvoy sim: %s, for %d s%s%s", open_ ? "\r\033[K" : "", what.c_str(), next_s_, rest.c_str(),
               open_ ? "" : "\n");
  std::fflush(stderr);
  next_s_ += open_ ? 1 : 10;
}

StillAt::StillAt(std::string what) : what_(std::move(what)) {
  std::fprintf(stderr, "convoy sim: %s\n", what_.c_str());
  teller_ = std::thread([this] { tell(); });
}

StillAt::~StillAt() {
  {
    const std::lock_guard lock(mutex_);
    done_ = true;
  }
  changed_.notify_all();
  teller_.join();
}

void StillAt::tell() {
  LongWait wait;
  std::unique_lock lock(mutex_);
  while (!changed_.wait_until(lock, wait.next(), [&] { return done_; })) wait.tell(what_);
}

}  // namespace convoy::simulator
