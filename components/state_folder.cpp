#include <convoy/components/state_folder.hpp>
#include <convoy/config_error.hpp>
#include <convoy/submap/content_hash.hpp>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <limits>
#include <optional>
#include <random>
#include <sstream>
#include <string>

#include <fstream>

namespace convoy {
namespace {

namespace fs = std::filesystem;

std::string reason() { return std::strerror(errno); }

// The number and its hash: a file that was cut or changed is never taken for a smaller number.
std::string line_of(Epoch epoch) {
  char text[48];
  std::snprintf(text, sizeof text, "%" PRIu64 " %016" PRIx64 "\n", epoch, ContentHash().add(epoch).value());
  return text;
}

std::string content_of(const fs::path& file) {
  std::ostringstream text;
  std::ifstream in(file, std::ios::binary);
  if (in.peek() != std::ifstream::traits_type::eof()) text << in.rdbuf();
  if (in.bad()) throw ConfigError(file.string() + ": cannot be read; check its permissions");
  return text.str();
}

std::optional<Epoch> last_epoch(const fs::path& file) {
  std::error_code error;
  if (fs::symlink_status(file, error).type() == fs::file_type::not_found) return std::nullopt;
  if (error)
    throw ConfigError(file.string() + ": cannot be read: " + error.message() + "; check the folder's permissions");
  const std::string text = content_of(file);
  Epoch last = 0;
  std::from_chars(text.data(), text.data() + text.size(), last);
  if (text != line_of(last) || last == std::numeric_limits<Epoch>::max())
    throw ConfigError(file.string() +
                      ":1: damaged, this is no epoch; delete the file, and the vehicle begins anew: with an "
                      "epoch by the clock, and with its static bias if it has one");
  return last;
}

void write_through(const fs::path& file, const std::string& text) {
  const int out = open(file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  const bool written =
      out >= 0 && write(out, text.data(), text.size()) == static_cast<ssize_t>(text.size()) && fsync(out) == 0;
  const std::string why = reason();
  if (out >= 0) close(out);
  if (!written)
    throw ConfigError(file.string() + ": cannot write (" + why +
                      "); the state folder must be writable, with space on its disk");
}

}  // namespace

Epoch epoch_from_clock() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  const auto us = std::chrono::duration_cast<std::chrono::microseconds>(now).count();
  return (static_cast<Epoch>(us) << 12) | (std::random_device{}() & 0xfffU);
}

StateFolder::StateFolder(fs::path folder) : folder_(std::move(folder)) {
  std::error_code error;
  fs::create_directories(folder_, error);
  const fs::path file = folder_ / "lock";
  const auto cannot = [&](const std::string& what) {
    if (lock_ >= 0) close(lock_);
    throw ConfigError(file.string() + ": " + what);
  };
  lock_ = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (lock_ < 0) cannot("cannot write (" + reason() + "); the state folder must be writable");
  if (flock(lock_, LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK) cannot("cannot lock (" + reason() + "); use a state folder on a local disk");
    char pid[24] = {};
    const ssize_t size = pread(lock_, pid, sizeof pid - 1, 0);
    const std::string other = size > 0 ? "process " + std::string(pid, std::strcspn(pid, "\n")) : "another process";
    cannot("this vehicle runs already, as " + other + "; stop that one, or give this one a state_folder of its own");
  }
  const std::string pid = std::to_string(getpid()) + "\n";
  if (ftruncate(lock_, 0) != 0 || pwrite(lock_, pid.data(), pid.size(), 0) != static_cast<ssize_t>(pid.size()))
    cannot("cannot write (" + reason() + "); is the disk full?");
}

StateFolder::~StateFolder() { close(lock_); }

StateFolder::NextEpoch StateFolder::next_epoch(const std::function<Epoch()>& fresh) {
  const fs::path file = folder_ / "epoch", next = folder_ / "epoch.next";
  const std::optional<Epoch> last = last_epoch(file);
  const Epoch epoch = last ? std::max(fresh(), *last + 1) : fresh();
  write_through(next, line_of(epoch));
  std::error_code error;
  fs::rename(next, file, error);
  if (error)
    throw ConfigError(file.string() + ": cannot replace: " + error.message() + "; check the folder's permissions");
  if (const int folder = open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC); folder >= 0) {
    fsync(folder);  // the new name, too
    close(folder);
  }
  return {epoch, !last};
}

}  // namespace convoy
