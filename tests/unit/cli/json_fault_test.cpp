#include "scenario/json_fault.hpp"

#include <gtest/gtest.h>

#include <functional>

namespace convoy::cli {
namespace {

using nlohmann::json;

std::string fault_of(
    const std::string& text, const std::function<void(const json&)>& use = [](const json&) {}) {
  try {
    use(json::parse(text));
  } catch (const json::exception& error) {
    return json_fault(error, text);
  }
  return {};
}

TEST(JsonFault, BrokenTextIsNamedWithItsLine) {
  EXPECT_EQ(fault_of("{\"a\":"), "no JSON (the text ends too early, or is damaged)");
  EXPECT_EQ(fault_of(""), "no JSON (the text ends too early, or is damaged)");
  EXPECT_EQ(fault_of("{\n \"a\": 1,\n \"b\" 2\n}\n"), "no JSON in line 3 (the text ends too early, or is damaged)");
}

TEST(JsonFault, WrongContentIsSaidInPlainWords) {
  EXPECT_EQ(fault_of("{}", [](const json& j) { j.at("seed"); }), "the entry 'seed' is missing");
  EXPECT_EQ(fault_of("[1]", [](const json& j) { j.at(2); }),
            "a list is too short, it ends before place 2 (counted from 0)");
  EXPECT_EQ(fault_of("{\"a\":\"x\"}", [](const json& j) { j.at("a").get<double>(); }),
            "a value is of kind string where number should be");
  EXPECT_EQ(fault_of("5", [](const json& j) { j.at("a"); }),
            "a value is of kind number where a list or an object should be");
  EXPECT_EQ(fault_of("[]", [](const json& j) { j.value("a", 1); }), "a value is of another kind than it should be");
}

}  // namespace
}  // namespace convoy::cli
