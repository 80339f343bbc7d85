#include "scenario/json_fault.hpp"

#include <algorithm>

namespace convoy::cli {
namespace {

/// What stands between two words of a message; empty if they are not there.
std::string between(std::string_view message, std::string_view before, std::string_view after) {
  const auto begin = message.find(before);
  if (begin == std::string_view::npos) return {};
  const auto rest = message.substr(begin + before.size());
  const auto end = after.empty() ? rest.size() : rest.find(after);
  return end == std::string_view::npos ? std::string() : std::string(rest.substr(0, end));
}

}  // namespace

std::string json_fault(const nlohmann::json::exception& error, std::string_view text) {
  if (const auto* cut = dynamic_cast<const nlohmann::json::parse_error*>(&error)) {
    const auto read = text.substr(0, cut->byte);
    const bool one_line = text.find('\n') == std::string_view::npos;
    return "no JSON" + (one_line ? "" : " in line " + std::to_string(1 + std::count(read.begin(), read.end(), '\n'))) +
           " (the text ends too early, or is damaged)";
  }
  const std::string_view message = error.what();
  if (const std::string key = between(message, "key '", "' not found"); !key.empty())
    return "the entry '" + key + "' is missing";
  if (const std::string index = between(message, "array index ", " is out of range"); !index.empty())
    return "a list is too short, it ends before place " + index + " (counted from 0)";
  const std::string wanted = between(message, "type must be ", ", but is ");
  const std::string found = between(message, ", but is ", "");
  if (!wanted.empty()) return "a value is of kind " + found + " where " + wanted + " should be";
  if (const std::string kind = between(message, "cannot use at() with ", ""); !kind.empty())
    return "a value is of kind " + kind + " where a list or an object should be";
  if (error.id == 501) return "it holds " + between(message, "] ", "");  // see pose_from_list()
  return "a value is of another kind than it should be";
}

}  // namespace convoy::cli
