#include "page/results.hpp"

#include <convoy/config_error.hpp>

#include <nlohmann/json.hpp>

#include "scenario/json_fault.hpp"
#include "scenario/table_file.hpp"

namespace convoy::bench {
namespace {

using nlohmann::json;

constexpr std::string_view skipped = "skipped: ";

double seconds_per(const std::string& unit) {
  if (unit == "ns") return 1e-9;
  if (unit == "us") return 1e-6;
  if (unit == "ms") return 1e-3;
  if (unit == "s") return 1.0;
  throw ConfigError("time_unit '" + unit + "' is none of ns, us, ms, s");
}

std::string without_iterations(std::string name) {
  const auto at = name.find("/iterations:");
  if (at == std::string::npos) return name;
  return name.erase(at, name.find('/', at + 1) - at);
}

void add_value(Measured& measured, const std::string& name, double value) {
  measured.values[name].push_back(value);
  if (name.ends_with("_s")) measured.values[name.substr(0, name.size() - 1) + "ms"].push_back(1e3 * value);
}

void add_repetition(const json& entry, Measured& measured) {
  measured.label = entry.value("label", "");
  if (entry.value("error_occurred", false)) measured.fault = entry.at("error_message").get<std::string>();
  else if (measured.label.starts_with(skipped)) measured.fault = measured.label.substr(skipped.size());
  if (!measured.fault.empty()) return;
  add_value(measured, "cpu_s",
            entry.at("cpu_time").get<double>() * seconds_per(entry.at("time_unit").get<std::string>()));
  for (const auto& [key, value] : entry.items())
    if (value.is_number()) add_value(measured, key, value.get<double>());
}

// google-benchmark writes NaN and Infinity, which JSON does not have: a coefficient of variation of zeros is one.
std::string proper_json(std::string text) {
  for (const std::string word : {"NaN", "-NaN", "Infinity", "-Infinity"})
    for (auto at = text.find("\": " + word); at != std::string::npos; at = text.find("\": " + word, at))
      text.replace(at + 3, word.size(), "null");
  return text;
}

BenchResults of_run(const json& run) {
  BenchResults results;
  if (run.contains("failed")) {
    results.fault = run.at("failed").get<std::string>();
    return results;
  }
  for (const json& entry : run.at("benchmarks"))
    if (entry.at("run_type") == "iteration")
      add_repetition(entry, results.by_name[without_iterations(entry.at("run_name").get<std::string>())]);
  return results;
}

}  // namespace

BenchResults parse_results(std::string_view text, const std::string& source) {
  const std::string mend = "; run this bench again (scripts/bench)";
  try {
    return of_run(json::parse(proper_json(std::string(text))));
  } catch (const json::exception& error) {
    throw ConfigError(source + ": no results of google-benchmark: " + cli::json_fault(error, text) + mend);
  } catch (const ConfigError& error) {
    throw ConfigError(source + ": no results of google-benchmark: " + error.what() + mend);
  }
}

BenchResults read_results(const std::filesystem::path& file) {
  return parse_results(cli::read_text_file(file), file.string());
}

}  // namespace convoy::bench
