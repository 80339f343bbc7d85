// What goes wrong in a thread of a vehicle ends neither the thread nor the process: it is counted, and told.
#pragma once

#include <cstdint>
#include <exception>
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

}  // namespace convoy
