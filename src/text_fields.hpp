// TextFields: a text of lines of fields, read strictly. Every refusal says file:line, what is wrong, and how to mend
// it.
#pragma once

#include <convoy/config_error.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace convoy {

class TextFields {
 public:
  /// `text` must outlive it; `name` stands for the file in errors, `kind` for what it should be ("a g2o file"). Throws
  /// ConfigError if it is no text.
  TextFields(std::string_view text, std::string name, const std::string& kind) : text_(text), name_(std::move(name)) {
    if (text.find('\0') != std::string_view::npos)
      throw ConfigError(name_ + ": a binary file; give " + kind + ", which is text");
  }

  const std::string& name() const { return name_; }
  std::size_t line() const { return line_; }
  std::size_t size() const { return fields_.size(); }
  bool empty() const { return fields_.empty(); }
  std::string_view operator[](std::size_t field) const { return fields_[field]; }

  /// On to the next line; false at the end.
  bool next_line() {
    if (position_ >= text_.size()) return false;
    const std::size_t end = std::min(text_.find('\n', position_), text_.size());
    const std::string_view line = text_.substr(position_, end - position_);
    position_ = end + 1;
    ++line_;
    fields_.clear();
    constexpr std::string_view kBlank = " \t\r";
    for (std::size_t at = line.find_first_not_of(kBlank); at != std::string_view::npos;) {
      const std::size_t stop = std::min(line.find_first_of(kBlank, at), line.size());
      fields_.push_back(line.substr(at, stop - at));
      at = line.find_first_not_of(kBlank, stop);
    }
    return true;
  }

  void expect_fields(std::size_t count) const {
    if (fields_.size() != count)
      refuse("the line has " + std::to_string(fields_.size()) + " fields, " + std::string(fields_[0]) + " has " +
             std::to_string(count));
  }

  std::uint64_t id(std::size_t field) const {
    std::uint64_t value = 0;
    const std::string_view text = fields_[field];
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size())
      refuse("field " + std::to_string(field + 1) + " is " + quoted(text) +
             "; it must be an id, a whole number from 0");
    return value;
  }

  double number(std::size_t field) const {
    double value = 0.0;
    std::string_view text = fields_[field];
    if (text.size() > 1 && text.front() == '+') text.remove_prefix(1);
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
      refuse("field " + std::to_string(field + 1) + " is " + quoted(fields_[field]) + "; it must be a finite number");
    return value;
  }

  [[noreturn]] void refuse_at(std::size_t line, const std::string& what) const {
    throw ConfigError(name_ + ":" + std::to_string(line) + ": " + what);
  }
  [[noreturn]] void refuse(const std::string& what) const { refuse_at(line_, what); }

  /// What is printed of a damaged file is short and of plain characters.
  static std::string quoted(std::string_view text) {
    constexpr std::size_t longest = 40;
    std::string plain(text.substr(0, longest));
    for (char& c : plain)
      if (c < ' ' || c > '~') c = '?';
    return "'" + plain + (text.size() > longest ? "..." : "") + "'";
  }

 private:
  std::string_view text_;
  std::string name_;
  std::size_t position_ = 0, line_ = 0;
  std::vector<std::string_view> fields_;
};

/// The whole of a file. Throws ConfigError.
inline std::string read_text(const std::filesystem::path& path, const std::string& kind) {
  std::ifstream in(path, std::ios::binary);
  if (!in || std::filesystem::is_directory(path)) throw ConfigError(path.string() + ": cannot be read; give " + kind);
  return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace convoy
