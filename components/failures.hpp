// What goes wrong in a thread of a vehicle ends neither the thread nor the process: it is counted, and told.
#pragma once

#include <cstdint>
#include <exception>
#include <mutex>
#include <string>

namespace convoy {

struct Failures {
  std::uint64_t count = 0;
  std::string last_error;  ///< what the last one said; empty: there was none
};

/// Only within a handler: adds the exception in flight.
inline void add_current(Failures& failures) {
  ++failures.count;
  try {
    throw;
  } catch (const std::exception& failure) {
    failures.last_error = failure.what();
  } catch (...) {
    failures.last_error = "not a std::exception";
  }
}

/// part(), of a thread that holds the lock and has it again afterwards, whatever part() throws.
template <class Part>
void attempt(Failures& failures, std::unique_lock<std::mutex>& lock, const Part& part) {
  try {
    part();
  } catch (...) {
    if (!lock.owns_lock()) lock.lock();
    add_current(failures);
  }
}

}  // namespace convoy
