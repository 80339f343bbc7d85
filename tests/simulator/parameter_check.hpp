// What is wrong with a parameter: the field, the value it has, and what it may be.
#pragma once

#include <string>

namespace convoy::simulator {

/// Throws std::invalid_argument unless low <= value <= high (NaN is neither): "`field` is `value`; `field` has to be
/// `low` to `high` [unit]: mend".
void check_range(const std::string& field, double value, double low, double high, const std::string& unit_and_mend);

/// Throws std::invalid_argument unless `ok`: "`field`: what is wrong and how to mend it".
void check_that(bool ok, const std::string& field, const std::string& wrong_and_mend);

}  // namespace convoy::simulator
