// What is wrong with a JSON text, in words for a user rather than those of the JSON library.
#pragma once

#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

namespace convoy::cli {

/// "no JSON in line 3 (the text ends too early, or is damaged)", "the entry 'seed' is missing", "a value is of kind
/// string where number should be", ... `text` is what was read; of a text of one line, no line is named.
std::string json_fault(const nlohmann::json::exception& error, std::string_view text);

}  // namespace convoy::cli
