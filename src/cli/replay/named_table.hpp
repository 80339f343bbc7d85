// A CSV table whose columns are found by their names, in whatever order: what a user's own recorder writes.
#pragma once

#include <convoy/config_error.hpp>

#include <algorithm>
#include <filesystem>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

#include "scenario/table_file.hpp"

namespace convoy::cli {

class NamedTable {
 public:
  /// Throws ConfigError if it cannot be read.
  explicit NamedTable(const std::filesystem::path& file)
      : file_(file), header_(first_line(read_text_file(file))), rows_(file, {.header = header_}) {
    for (std::size_t at = 0; at <= header_.size();) {
      const std::size_t end = std::min(header_.find(',', at), header_.size());
      names_.push_back(header_.substr(at, end - at));
      at = end + 1;
    }
  }
  NamedTable(const NamedTable&) = delete;
  NamedTable& operator=(const NamedTable&) = delete;

  std::size_t column(const std::string& name) const { return column_of({name}); }

  /// The first of them that is there. Throws ConfigError if none is.
  std::size_t column_of(std::initializer_list<std::string> names) const {
    std::string wanted;
    for (const std::string& name : names) {
      const auto found = std::find(names_.begin(), names_.end(), name);
      if (found != names_.end()) return static_cast<std::size_t>(found - names_.begin());
      wanted += (wanted.empty() ? "" : " or ") + name;
    }
    throw ConfigError(file_.string() + ":1: has no column " + wanted + "; name it in the first line");
  }

  TableFile& rows() { return rows_; }

 private:
  static std::string first_line(const std::string& text) {
    std::string line = text.substr(0, text.find('\n'));
    if (!line.empty() && line.back() == '\r') line.pop_back();
    return line;
  }

  std::filesystem::path file_;
  std::string header_;
  TableFile rows_;
  std::vector<std::string> names_;
};

}  // namespace convoy::cli
