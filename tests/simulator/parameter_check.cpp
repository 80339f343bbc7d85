#include "parameter_check.hpp"

#include <sstream>
#include <stdexcept>

namespace convoy::simulator {

void check_range(const std::string& field, double value, double low, double high, const std::string& unit_and_mend) {
  if (value >= low && value <= high) return;
  std::ostringstream text;
  text << field << " is " << value << "; set it to " << low << " to " << high << " " << unit_and_mend;
  throw std::invalid_argument(text.str());
}

void check_that(bool ok, const std::string& field, const std::string& wrong_and_mend) {
  if (!ok) throw std::invalid_argument(field + ": " + wrong_and_mend);
}

}  // namespace convoy::simulator
