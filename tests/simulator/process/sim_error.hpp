// How a run ends that cannot go on. what() says what is wrong, where (file:line where there is one) and how to mend it.
#pragma once

#include <stdexcept>

namespace convoy::simulator {

/// Of what the user asked for: a world, a recording, an option. Exit status 2.
class SetUpError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Of a vehicle or another subscriber that did not answer in time. Exit status 1.
class DeadlineError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace convoy::simulator
