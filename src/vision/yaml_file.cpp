#include "yaml_file.hpp"

#include <convoy/config_error.hpp>
#include <convoy/text_fields.hpp>

#include <charconv>
#include <cmath>
#include <set>

namespace convoy {
namespace {

constexpr std::size_t longest_file = 1 << 20;  // [byte]
constexpr std::size_t most_numbers = 64;       // of a list
constexpr int deepest = 8;                     // maps within maps

std::string at(const std::string& name, const YAML::Mark& mark) {
  return mark.line < 0 ? name : name + ":" + std::to_string(mark.line + 1);
}

}  // namespace

YamlFile::YamlFile(const std::filesystem::path& path, const std::string& kind) : name_(path.string()) {
  std::error_code error;
  if (std::filesystem::file_size(path, error) > longest_file && !error)
    throw ConfigError(name_ + ": longer than a megabyte; give " + kind);
  const std::string content = read_text(path, kind);
  if (content.find('\0') != std::string::npos) throw ConfigError(name_ + ": a binary file; give " + kind);
  try {
    root_ = YAML::Load(content);
  } catch (const YAML::Exception& fault) {
    throw ConfigError(at(name_, fault.mark) + ": no YAML: " + fault.msg + "; give " + kind);
  }
  if (!root_.IsMap()) throw ConfigError(name_ + ": has no keys; give " + kind);
  refuse_repeated_keys(root_, 0);
}

void YamlFile::refuse_repeated_keys(const YAML::Node& map, int depth) const {
  if (depth > deepest) refuse(map, "nested too deeply");  // or a part of itself
  std::set<std::string> seen;
  for (const auto& entry : map) {
    if (!entry.first.IsScalar()) refuse(entry.first, "a key must be a word");
    if (!seen.insert(entry.first.Scalar()).second)
      refuse(entry.first, "key " + TextFields::quoted(entry.first.Scalar()) + " is there twice; remove one");
    if (entry.second.IsMap()) refuse_repeated_keys(entry.second, depth + 1);
  }
}

YAML::Node YamlFile::required(const YAML::Node& map, const std::string& key, const std::string& what) const {
  if (!map.IsMap()) refuse(map, "there should be keys here; give '" + key + "', " + what);
  const YAML::Node node = map[key];
  if (!node.IsDefined() || node.IsNull()) refuse(map, "key '" + key + "' is missing; give " + what);
  return node;
}

std::string YamlFile::text(const YAML::Node& node, const std::string& what) const {
  if (!node.IsScalar()) refuse(node, what + " must be a word");
  return node.Scalar();
}

double YamlFile::number(const YAML::Node& node, const std::string& what) const {
  if (!node.IsScalar()) refuse(node, what + " must be a number");
  std::string_view text = node.Scalar();
  if (text.size() > 1 && text.front() == '+') text.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
    refuse(node, what + " is " + TextFields::quoted(node.Scalar()) + "; it must be a finite number");
  return value;
}

int YamlFile::whole_number(const YAML::Node& node, const std::string& what) const {
  const double value = number(node, what);
  if (value != std::floor(value) || std::abs(value) > 1e6)
    refuse(node, what + " is " + TextFields::quoted(node.Scalar()) + "; it must be a whole number");
  return static_cast<int>(value);
}

void YamlFile::append(const YAML::Node& list, const std::string& what, std::vector<double>& values) const {
  for (const auto& entry : list) {
    if (values.size() >= most_numbers) refuse(entry, what + " has too many numbers");
    values.push_back(number(entry, what));
  }
}

std::vector<double> YamlFile::numbers(const YAML::Node& node, const std::string& what) const {
  std::vector<double> values;
  if (node.IsMap()) {
    const int rows = whole_number(required(node, "rows", "the number of rows of " + what), what + ".rows");
    const int cols = whole_number(required(node, "cols", "the number of columns of " + what), what + ".cols");
    const YAML::Node data = required(node, "data", "the numbers of " + what + ", by rows");
    if (!data.IsSequence()) refuse(data, what + ".data must be a list of numbers");
    append(data, what, values);
    if (rows < 0 || cols < 0 || values.size() != static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols))
      refuse(data, what + ".data has " + std::to_string(values.size()) + " numbers, rows and cols say " +
                       std::to_string(rows) + " x " + std::to_string(cols));
    return values;
  }
  if (!node.IsSequence()) refuse(node, what + " must be a list of numbers");
  for (const auto& entry : node) {
    if (entry.IsSequence()) append(entry, what, values);
    else values.push_back(number(entry, what));
    if (values.size() > most_numbers) refuse(entry, what + " has too many numbers");
  }
  return values;
}

std::vector<double> YamlFile::numbers(const YAML::Node& node, const std::string& what, std::size_t count) const {
  std::vector<double> values = numbers(node, what);
  if (values.size() != count)
    refuse(node, what + " has " + std::to_string(values.size()) + " numbers; it must have " + std::to_string(count));
  return values;
}

void YamlFile::refuse(const YAML::Node& node, const std::string& what) const {
  throw ConfigError(at(name_, node.Mark()) + ": " + what);
}

}  // namespace convoy
