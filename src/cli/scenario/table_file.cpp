#include "scenario/table_file.hpp"

#include <cerrno>
#include <charconv>
#include <cmath>
#include <convoy/config_error.hpp>
#include <cstring>
#include <fstream>
#include <system_error>

#include <unistd.h>

namespace convoy::cli {
namespace fs = std::filesystem;

std::string read_text_file(const fs::path& path) {
  std::error_code error;
  if (!fs::is_regular_file(path, error))
    throw ConfigError(path.string() + ": no such file; it is needed here, check the folder given");
  std::ifstream file(path, std::ios::binary);
  const auto size = fs::file_size(path, error);
  std::string content(error ? 0 : static_cast<std::size_t>(size), '\0');
  file.read(content.data(), static_cast<std::streamsize>(content.size()));
  if (error || !file || file.gcount() != static_cast<std::streamsize>(content.size()))
    throw ConfigError(path.string() + ": cannot be read (" + std::strerror(errno) + "); check its permissions");
  return content;
}

void write_text_file(const fs::path& path, std::string_view content) {
  std::error_code error;
  if (path.has_parent_path()) fs::create_directories(path.parent_path(), error);
  fs::path temporary = path;
  temporary += ".part" + std::to_string(::getpid());
  std::ofstream file(temporary, std::ios::binary | std::ios::trunc);
  file.write(content.data(), static_cast<std::streamsize>(content.size()));
  file.close();
  const bool written = static_cast<bool>(file);
  if (written) fs::rename(temporary, path, error);
  if (!written || error) {
    const std::string reason = error ? error.message() : std::strerror(errno);
    fs::remove(temporary, error);
    throw ConfigError(path.string() + ": cannot be written (" + reason +
                      "); check the folder and the space on its disk");
  }
}

void expect_writable(const fs::path& folder) {
  std::error_code error;
  fs::path there = folder.empty() ? fs::current_path(error) : fs::absolute(folder, error);
  while (!fs::exists(there, error) && there.has_relative_path()) there = there.parent_path();
  const std::string where = folder.string() + ": nothing can be written there, for " + there.string();
  if (!fs::is_directory(there, error)) throw ConfigError(where + " is no folder; choose another one with --out");
  if (::access(there.c_str(), W_OK | X_OK) != 0)
    throw ConfigError(where + " is not writable (" + std::strerror(errno) + "); choose another one with --out");
}

void append_number(std::string& text, double value) {
  char buffer[32];
  text.append(buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr);
}

void append_number(std::string& text, std::uint64_t value) {
  char buffer[32];
  text.append(buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr);
}

TableFile::TableFile(fs::path path, const TableFormat& format)
    : path_(std::move(path)), format_(format), content_(read_text_file(path_)) {
  if (format_.header.empty()) return;
  if (format_.columns == 0) {
    format_.columns = 1;
    for (const char c : format_.header) format_.columns += c == ',';
  }
  std::string_view line;
  if (!next_line(line)) {
    line_number_ = 1;
    refuse("the file is empty; its first line must be '" + std::string(format_.header) + "'");
  }
  if (line != format_.header)
    refuse("the first line is '" + std::string(line.substr(0, 80)) + "'; it must be '" + std::string(format_.header) +
           "'");
}

bool TableFile::next_line(std::string_view& line) {
  if (position_ >= content_.size()) return false;
  ++line_number_;
  const std::size_t end = content_.find('\n', position_);
  if (end == std::string::npos) {
    if (format_.drop_cut_last_line) {
      position_ = content_.size();
      return false;
    }
    refuse("the last line has no line end, so the file has been cut; fetch or write it again");
  }
  line = std::string_view(content_).substr(position_, end - position_);
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  position_ = end + 1;
  return true;
}

bool TableFile::next() {
  std::string_view line;
  while (next_line(line)) {
    if (format_.separator == ' ') {
      const std::size_t begin = line.find_first_not_of(" \t");
      if (begin == std::string_view::npos || line[begin] == '#') continue;
    }
    split(line);
    if (fields_.size() != format_.columns)
      refuse("the line has " + std::to_string(fields_.size()) + " fields; " + std::to_string(format_.columns) +
             " are needed, so it is cut or damaged; fetch or write the file again");
    return true;
  }
  return false;
}

void TableFile::split(std::string_view line) {
  fields_.clear();
  if (format_.separator == ' ') {
    for (std::size_t at = line.find_first_not_of(" \t"); at != std::string_view::npos;) {
      const std::size_t end = std::min(line.find_first_of(" \t", at), line.size());
      fields_.push_back(line.substr(at, end - at));
      at = line.find_first_not_of(" \t", end);
    }
    return;
  }
  for (std::size_t at = 0;;) {
    const bool quoted = at < line.size() && line[at] == '"';
    const std::size_t close = quoted ? line.find('"', at + 1) : at;
    if (close == std::string_view::npos) refuse("a quotation mark is never closed; write the file again");
    const std::size_t end = std::min(line.find(format_.separator, close), line.size());
    fields_.push_back(quoted ? line.substr(at + 1, close - at - 1) : line.substr(at, end - at));
    if (end == line.size()) return;
    at = end + 1;
  }
}

double TableFile::number(std::size_t column) const {
  const std::string_view field = fields_[column];
  double value = 0.0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  if (error != std::errc() || end != field.data() + field.size() || !std::isfinite(value))
    refuse("field " + std::to_string(column + 1) + " is '" + std::string(field.substr(0, 40)) +
           "'; it must be a finite number");
  return value;
}

std::optional<double> TableFile::optional_number(std::size_t column) const {
  if (fields_[column].empty()) return std::nullopt;
  return number(column);
}

std::uint64_t TableFile::whole_number(std::size_t column) const {
  const std::string_view field = fields_[column];
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  if (error != std::errc() || end != field.data() + field.size())
    refuse("field " + std::to_string(column + 1) + " is '" + std::string(field.substr(0, 40)) +
           "'; it must be a whole number");
  return value;
}

std::uint32_t TableFile::small_number(std::size_t column) const {
  const std::uint64_t value = whole_number(column);
  if (value > UINT32_MAX) refuse("field " + std::to_string(column + 1) + " is beyond 4294967295");
  return static_cast<std::uint32_t>(value);
}

void TableFile::refuse(const std::string& what) const {
  throw ConfigError(path_.string() + ":" + std::to_string(line_number_) + ": " + what);
}

}  // namespace convoy::cli
