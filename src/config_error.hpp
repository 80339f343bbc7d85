// The one exception of the library: thrown while something is set up or configured, never afterwards.
#pragma once

#include <cstdio>
#include <stdexcept>
#include <string>

namespace convoy {

/// what() says what is wrong, where (file:line where there is one) and how to mend it.
class ConfigError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A parameter out of its range. `name` is that of its entry in a configuration file.
class RangeError : public ConfigError {
 public:
  /// `range`: "be >= 0", "lie in (0, 1)", ...
  RangeError(const std::string& of, const std::string& name, double value, const std::string& range)
      : ConfigError(of + ": " + name + fault_of(value, range)), name_(name), fault_(fault_of(value, range)) {}
  const std::string& name() const { return name_; }
  /// " must be >= 0 (it is -1)"
  const std::string& fault() const { return fault_; }

 private:
  static std::string fault_of(double value, const std::string& range) {
    char number[32];
    std::snprintf(number, sizeof number, "%g", value);
    return " must " + range + " (it is " + number + ")";
  }
  std::string name_, fault_;
};

}  // namespace convoy
