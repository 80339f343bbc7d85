// Tables of numbers as text (CSV with a header line), in full precision: what is read is what was written, to the bit.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

namespace convoy::simulator {

class TableWriter {
 public:
  /// Throws SetUpError if it cannot be written.
  TableWriter(const std::filesystem::path& file, std::string_view header);
  TableWriter& operator<<(double value);
  TableWriter& operator<<(std::int64_t value);
  TableWriter& operator<<(std::string_view text);
  template <class Range>
  TableWriter& all(const Range& values) {
    for (const double value : values) *this << value;
    return *this;
  }
  /// Ends the row and hands it to the system. Throws SetUpError if that fails (a full disk).
  void end_row();

 private:
  std::filesystem::path file_;
  std::ofstream out_;
  std::string row_;
};

/// One row; fields are asked for in order. Each throws SetUpError with file and line for what it is not.
class TableRow {
 public:
  TableRow(std::string where, std::vector<std::string> fields) : where_(std::move(where)), fields_(std::move(fields)) {}
  double number();
  std::int64_t whole(std::int64_t low, std::int64_t high);
  std::string text();
  template <class Range>
  void all(Range& values) {
    for (double& value : values) value = number();
  }
  const std::string& where() const { return where_; }  ///< "file:line"
  [[noreturn]] void fail(const std::string& fault) const;

 private:
  std::string where_;
  std::vector<std::string> fields_;
  std::size_t next_ = 0;
};

/// All rows that have an end. Throws SetUpError with file and line if the header or the number of fields is another.
std::vector<TableRow> read_table(const std::filesystem::path& file, std::string_view header);

}  // namespace convoy::simulator
