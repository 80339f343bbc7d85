// The one exception of the library: thrown while something is set up or configured, never afterwards.
#pragma once

#include <stdexcept>

namespace convoy {

/// what() says what is wrong, where (file:line where there is one) and how to mend it.
class ConfigError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace convoy
