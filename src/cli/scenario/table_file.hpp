// Text tables on disk: strict reading (a cut or malformed line is refused with file:line) and atomic writing.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace convoy::cli {

/// The whole file. Throws ConfigError if it cannot be read.
std::string read_text_file(const std::filesystem::path& path);

/// Writes beside `path` and renames, so that a reader sees the old file, the new file or none, never half of one.
/// Makes the folders it needs. Throws ConfigError.
void write_text_file(const std::filesystem::path& path, std::string_view content);

/// Throws ConfigError if `folder` (empty: the current one) can hold nothing: to be told before the work and not after.
/// Makes nothing.
void expect_writable(const std::filesystem::path& folder);

/// Shortest text that reads back as the same double, without regard to the locale.
void append_number(std::string& text, double value);
void append_number(std::string& text, std::uint64_t value);

/// "a,b,c\n" from numbers (any arithmetic type).
template <class... Numbers>
void append_csv_row(std::string& text, Numbers... numbers) {
  bool first = true;
  const auto append = [&](auto value) {
    if (!first) text += ',';
    first = false;
    if constexpr (std::is_integral_v<decltype(value)>) append_number(text, static_cast<std::uint64_t>(value));
    else append_number(text, static_cast<double>(value));
  };
  (append(numbers), ...);
  text += '\n';
}

/// What a table looks like, and what to do with a last line that has no line end.
struct TableFormat {
  char separator = ',';     ///< ' ' stands for any run of blanks and tabs; '#' then begins a comment line
  std::string_view header;  ///< the first line, word for word; empty: there is none
  std::size_t columns = 0;  ///< every row has exactly this many fields; 0: as many as the header
  /// A process that was killed leaves half a line; for its files (and no others) that line is left out.
  bool drop_cut_last_line = false;
};

/// Walks through a table. Every access throws ConfigError with file:line when the text is not what it asks for.
class TableFile {
 public:
  TableFile(std::filesystem::path path, const TableFormat& format);

  /// Advances to the next row; false at the end.
  bool next();

  std::string_view text(std::size_t column) const { return fields_[column]; }
  double number(std::size_t column) const;                          ///< a finite number
  std::optional<double> optional_number(std::size_t column) const;  ///< nullopt if the field is empty
  std::uint64_t whole_number(std::size_t column) const;             ///< 0..2^64-1
  std::uint32_t small_number(std::size_t column) const;             ///< 0..2^32-1

  /// Of the current row; the first line of the file is 1.
  std::size_t line() const { return line_number_; }
  /// Refuses the current row: "file:line: what".
  [[noreturn]] void refuse(const std::string& what) const;

 private:
  bool next_line(std::string_view& line);
  void split(std::string_view line);

  std::filesystem::path path_;
  TableFormat format_;
  std::string content_;
  std::size_t position_ = 0;
  std::size_t line_number_ = 0;
  std::vector<std::string_view> fields_;
};

}  // namespace convoy::cli
