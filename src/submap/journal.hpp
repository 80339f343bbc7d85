// Journal: the facts of a vehicle on its disk, append-only, so that a restart begins with what it had (DESIGN A2).
//
// The file begins with one line that names the format and the dimension; then one record per fact: "fact", the length
// of the content (4 bytes), its hash (8 bytes), the content (fact_codec.hpp). A record whose hash does not match is
// passed over up to the next one that is whole; a tail that is none is cut off. The set of facts is what counts:
// records may repeat, and come in any order. A content of 8 bytes is no fact but a note: how many damaged bytes the
// restarts until then have told of.
#pragma once

#include <convoy/submap/fact_codec.hpp>
#include <convoy/submap/fact_store.hpp>

#include <deque>
#include <filesystem>
#include <memory>

namespace convoy {

/// Where the bytes of a journal lie.
class JournalMedium {
 public:
  virtual ~JournalMedium() = default;
  /// All there is. Throws ConfigError if it cannot be read.
  virtual Bytes read() = 0;
  /// False if the bytes could not be written (a full disk); then none of them are there, as far as can be helped.
  virtual bool append(std::span<const std::uint8_t> bytes) = 0;
  /// Keeps the first `size` bytes. False if that fails.
  virtual bool cut(std::uint64_t size) = 0;
};

/// A file. What was appended survives the death of the process; what survives the death of the machine is up to the
/// kernel (some seconds may be missing, which the peers hold). Throws ConfigError if it cannot be opened.
std::unique_ptr<JournalMedium> open_journal_file(const std::filesystem::path& file);

struct JournalCounters {
  std::uint64_t restored = 0;  ///< facts read back
  std::uint64_t refused = 0;   ///< whole records that the store did not take (limits, roster)
  std::uint64_t damaged_bytes =
      0;  ///< of records that are not whole, in the middle; only those that no restart before has told of
  std::uint64_t cut_bytes = 0;      ///< of a torn tail
  std::uint64_t written = 0;        ///< facts
  std::uint64_t failed_writes = 0;  ///< the medium would not take it; it is tried again
  std::uint64_t waiting = 0;        ///< facts that could not be written yet
};

template <class G>
class Journal {
 public:
  /// Time between two attempts while the medium takes nothing.
  static constexpr double retry_s = 5.0;

  /// `name` is for errors: the file.
  explicit Journal(std::unique_ptr<JournalMedium> medium, std::string name = "journal");

  /// Gives every fact of the journal to the store. Call once, first. Throws ConfigError if this is no journal or one of
  /// a fleet of another dimension; then nothing is changed.
  void restore(FactStore<G>& store);

  /// Writes the fact, or keeps it until the medium takes something again. `now_s` does not decrease.
  void append(const AnyFact<G>& fact, double now_s);
  /// Tries again what waits, if it is time.
  void retry(double now_s);

  const JournalCounters& counters() const { return counters_; }

 private:
  bool write(const Bytes& record);

  std::unique_ptr<JournalMedium> medium_;
  std::string name_;
  std::deque<Bytes> waiting_;
  double retry_s_ = 0.0;
  JournalCounters counters_;
};

}  // namespace convoy
