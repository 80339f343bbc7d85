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

}  // namespace convoy::simulator
