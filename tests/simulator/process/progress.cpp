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
  const bool terminal = isatty(STDERR_FILENO) == 1;
  int gone_s = 2;
  std::unique_lock lock(mutex_);
  const auto start = std::chrono::steady_clock::now();
  while (!changed_.wait_until(lock, start + std::chrono::seconds(gone_s), [&] { return done_; })) {
    std::fprintf(stderr, "%sconvoy sim: %s, for %d s%s", terminal ? "\r\033[K" : "", what_.c_str(), gone_s,
                 terminal ? "" : "\n");
    std::fflush(stderr);
    gone_s += terminal ? 1 : 10;
  }
  if (terminal && gone_s > 2) std::fputc('\n', stderr);
}

}  // namespace convoy::simulator
