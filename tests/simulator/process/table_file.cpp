#include "table_file.hpp"

#include "sim_error.hpp"
#include "whole_file.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>

namespace convoy::simulator {
namespace {

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> fields;
  for (std::size_t from = 0;;) {
    const std::size_t comma = line.find(',', from);
    fields.push_back(line.substr(from, comma - from));
    if (comma == std::string::npos) return fields;
    from = comma + 1;
  }
}

}  // namespace

TableWriter::TableWriter(const std::filesystem::path& file, std::string_view header) : file_(file), out_(file) {
  row_ = header;
  end_row();
}

TableWriter& TableWriter::operator<<(double value) {
  char text[32];
  const auto end = std::to_chars(text, text + sizeof text, value).ptr;
  return *this << std::string_view(text, static_cast<std::size_t>(end - text));
}

TableWriter& TableWriter::operator<<(std::int64_t value) { return *this << std::string_view(std::to_string(value)); }

TableWriter& TableWriter::operator<<(std::string_view text) {
  if (!row_.empty()) row_ += ',';
  row_ += text;
  return *this;
}

void TableWriter::end_row() {
  out_ << row_ << '\n' << std::flush;
  row_.clear();
  if (!out_) fail_to_write(file_);
}

void TableRow::fail(const std::string& fault) const { throw SetUpError(where_ + ": " + fault); }

std::string TableRow::text() { return fields_.at(next_++); }

double TableRow::number() {
  const std::string field = text();
  double value = 0.0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  if (error != std::errc() || end != field.data() + field.size() || !std::isfinite(value))
    fail("field " + std::to_string(next_) + ": '" + field + "' is no number");
  return value;
}

std::int64_t TableRow::whole(std::int64_t low, std::int64_t high) {
  const std::string field = text();
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  if (error != std::errc() || end != field.data() + field.size() || value < low || value > high)
    fail("field " + std::to_string(next_) + ": '" + field + "' is no whole number from " + std::to_string(low) +
         " to " + std::to_string(high));
  return value;
}

std::vector<TableRow> read_table(const std::filesystem::path& file, std::string_view header) {
  std::ifstream in(file);
  if (!in) throw SetUpError(file.string() + " cannot be read; is the folder a recording of convoy sim?");
  const auto columns = static_cast<std::size_t>(std::count(header.begin(), header.end(), ',')) + 1;
  std::vector<TableRow> rows;
  std::string line;
  int number = 1;
  for (; std::getline(in, line); ++number) {
    if (in.eof()) break;  // a row without its end was cut while it was written
    const std::string where = file.string() + ":" + std::to_string(number);
    if (number == 1) {
      if (line != header) throw SetUpError(where + ": the header is '" + line + "', not '" + std::string(header) + "'");
      continue;
    }
    std::vector<std::string> fields = split(line);
    if (fields.size() != columns)
      throw SetUpError(where + ": " + std::to_string(fields.size()) + " fields instead of " + std::to_string(columns));
    rows.emplace_back(where, std::move(fields));
  }
  if (number == 1) throw SetUpError(file.string() + ":1: the file is empty");
  return rows;
}

}  // namespace convoy::simulator
