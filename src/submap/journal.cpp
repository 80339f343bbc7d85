#include <convoy/config_error.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/content_hash.hpp>
#include <convoy/submap/journal.hpp>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <string>
#include <string_view>

namespace convoy {
namespace {

constexpr std::string_view mark = "fact";
constexpr std::size_t head_size = mark.size() + 4 + 8;
constexpr std::size_t largest_content = 1 << 20;  // an association of 4096 pairings takes 128 KB
constexpr std::size_t note_size = 8;              // no fact is so short

template <class G>
std::string first_line() {
  return "convoy journal 2 of an SE(" + std::to_string(G::Dim) + ") fleet\n";
}

Hash hash_of_bytes(std::span<const std::uint8_t> bytes) {
  ContentHash hash;
  for (const std::uint8_t byte : bytes) hash.add(byte, 1);
  return hash.value();
}

void put(std::uint64_t value, int bytes, Bytes& out) {
  for (int i = 0; i < bytes; ++i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

std::uint64_t get(std::span<const std::uint8_t> in) {
  std::uint64_t value = 0;
  for (std::size_t i = in.size(); i-- > 0;) value = value << 8 | in[i];
  return value;
}

Bytes record_around(const Bytes& content) {
  Bytes record(mark.begin(), mark.end());
  put(content.size(), 4, record);
  put(hash_of_bytes(content), 8, record);
  record.insert(record.end(), content.begin(), content.end());
  return record;
}

template <class G>
Bytes record_of(const AnyFact<G>& fact) {
  Bytes content;
  encode<G>(fact, content);
  return record_around(content);
}

Bytes note_of(std::uint64_t damaged_bytes) {
  Bytes content;
  put(damaged_bytes, note_size, content);
  return record_around(content);
}

/// The content of the record that begins here; empty if none does.
std::span<const std::uint8_t> content_of_record(std::span<const std::uint8_t> in) {
  if (in.size() < head_size || !std::equal(mark.begin(), mark.end(), in.begin())) return {};
  const std::uint64_t size = get(in.subspan(mark.size(), 4));
  if (size > largest_content || size > in.size() - head_size) return {};
  const auto content = in.subspan(head_size, size);
  return hash_of_bytes(content) == get(in.subspan(mark.size() + 4, 8)) ? content : std::span<const std::uint8_t>{};
}

class JournalFile final : public JournalMedium {
 public:
  explicit JournalFile(std::filesystem::path path) : path_(std::move(path)) {
    file_ = open(path_.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
    if (file_ < 0) fail("cannot be opened");
    struct stat status = {};
    if (fstat(file_, &status) != 0 || !S_ISREG(status.st_mode)) {
      close(file_);
      fail("is no file that can be written");
    }
    size_ = static_cast<std::uint64_t>(status.st_size);
  }
  ~JournalFile() override {
    fdatasync(file_);
    close(file_);
  }
  JournalFile(const JournalFile&) = delete;
  JournalFile& operator=(const JournalFile&) = delete;

  Bytes read() override {
    Bytes all(size_);
    for (std::uint64_t at = 0; at < size_;) {
      const ssize_t n = pread(file_, all.data() + at, size_ - at, static_cast<off_t>(at));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) fail("cannot be read");
      if (n == 0) all.resize(size_ = at);  // somebody has cut it
      at += static_cast<std::uint64_t>(n);
    }
    return all;
  }

  bool append(std::span<const std::uint8_t> bytes) override {
    for (std::size_t done = 0; done < bytes.size();) {
      const ssize_t n = ::write(file_, bytes.data() + done, bytes.size() - done);
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) {
        cut(size_);
        return false;
      }
      done += static_cast<std::size_t>(n);
    }
    size_ += bytes.size();
    return true;
  }

  bool cut(std::uint64_t size) override {
    if (ftruncate(file_, static_cast<off_t>(size)) != 0) return false;
    size_ = size;
    return true;
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw ConfigError(path_.string() + ": " + what + " (" + std::strerror(errno) +
                      "); the journal lies in the state folder, which must be writable");
  }
  std::filesystem::path path_;
  int file_ = -1;
  std::uint64_t size_ = 0;
};

}  // namespace

std::unique_ptr<JournalMedium> open_journal_file(const std::filesystem::path& file) {
  return std::make_unique<JournalFile>(file);
}

template <class G>
Journal<G>::Journal(std::unique_ptr<JournalMedium> medium, std::string name)
    : medium_(std::move(medium)), name_(std::move(name)) {}

template <class G>
void Journal<G>::restore(FactStore<G>& store) {
  const Bytes all = medium_->read();
  const std::string line = first_line<G>();
  // A file that ends within the first line was begun by a vehicle that died there.
  const std::size_t common = std::min(all.size(), line.size());
  if (!std::equal(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(common), line.begin()))
    throw ConfigError(
        name_ + ":1: this is no journal of an SE(" + std::to_string(G::Dim) +
        ") fleet, or its first line is damaged; move the file away, and the vehicle begins without it and "
        "asks its peers for what it held");
  if (all.size() < line.size()) {
    medium_->cut(0);
    if (!write(Bytes(line.begin(), line.end()))) waiting_.emplace_back(line.begin(), line.end());
    return;
  }
  std::span<const std::uint8_t> rest(all);
  rest = rest.subspan(line.size());
  std::uint64_t not_whole = 0;  // since the last record that was
  std::uint64_t damaged = 0, told_of = 0;
  while (!rest.empty()) {
    const auto content = content_of_record(rest);
    const auto fact = decode<G>(content);
    const bool note = content.size() == note_size;
    if (!fact && !note) {
      const auto next = std::search(rest.begin() + 1, rest.end(), mark.begin(), mark.end());
      not_whole += static_cast<std::uint64_t>(next - rest.begin());
      rest = rest.subspan(static_cast<std::size_t>(next - rest.begin()));
      continue;
    }
    damaged += std::exchange(not_whole, 0);
    rest = rest.subspan(head_size + content.size());
    if (note) {
      told_of = std::max(told_of, get(content));
      continue;
    }
    const Insertion taken = std::visit([&](const auto& f) { return store.insert(f); }, *fact);
    counters_.restored += taken == Insertion::inserted;
    counters_.refused += taken != Insertion::inserted && taken != Insertion::duplicate;
  }
  if (not_whole > 0 && medium_->cut(all.size() - not_whole)) counters_.cut_bytes = not_whole;
  if (damaged <= told_of) return;
  counters_.damaged_bytes = damaged - told_of;
  (void)medium_->append(note_of(damaged));  // a disk that does not take it is told of once more
}

template <class G>
bool Journal<G>::write(const Bytes& record) {
  if (medium_->append(record)) return true;
  ++counters_.failed_writes;
  return false;
}

template <class G>
void Journal<G>::append(const AnyFact<G>& fact, double now_s) {
  Bytes record = record_of<G>(fact);
  if (waiting_.empty() && write(record)) {
    ++counters_.written;
    return;
  }
  if (waiting_.empty()) retry_s_ = now_s + retry_s;
  waiting_.push_back(std::move(record));
  counters_.waiting = waiting_.size();
}

template <class G>
void Journal<G>::retry(double now_s) {
  if (waiting_.empty() || now_s < retry_s_) return;
  while (!waiting_.empty() && write(waiting_.front())) {
    ++counters_.written;
    waiting_.pop_front();
  }
  counters_.waiting = waiting_.size();
  retry_s_ = now_s + retry_s;
}

#define CONVOY_INSTANTIATE(G) template class Journal<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
