// The page of `convoy consistency`: verdict, demands, controls, drawings over distance, every row. Self-contained
// XHTML.
#pragma once

#include <string>

#include "consistency/suite.hpp"

namespace convoy::cli::consistency {

std::string consistency_page(const ConsistencyResult& result);

}  // namespace convoy::cli::consistency
