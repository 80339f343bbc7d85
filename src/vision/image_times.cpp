#include "image_times.hpp"

#include <convoy/text_fields.hpp>

#include <chrono>

namespace convoy {
namespace {

constexpr const char* kind = "a text file with the stamp [s] of an image on each line";

template <class Number>
bool parse(std::string_view text, Number& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

/// "2011-09-26" [s since 1970]
std::optional<double> date(std::string_view text) {
  int year = 0;
  unsigned month = 0, day = 0;
  if (text.size() != 10 || text[4] != '-' || text[7] != '-') return std::nullopt;
  if (!parse(text.substr(0, 4), year) || !parse(text.substr(5, 2), month) || !parse(text.substr(8, 2), day))
    return std::nullopt;
  const std::chrono::year_month_day d{std::chrono::year(year), std::chrono::month(month), std::chrono::day(day)};
  if (!d.ok()) return std::nullopt;
  return 86400.0 * static_cast<double>(std::chrono::sys_days(d).time_since_epoch().count());
}

/// "13:02:25.964389445" [s]
std::optional<double> time_of_day(std::string_view text) {
  int hour = 0, minute = 0;
  double second = 0.0;
  if (text.size() < 8 || text[2] != ':' || text[5] != ':') return std::nullopt;
  if (!parse(text.substr(0, 2), hour) || !parse(text.substr(3, 2), minute) || !parse(text.substr(6), second))
    return std::nullopt;
  return 3600.0 * hour + 60.0 * minute + second;
}

StampedName plain_line(const TextFields& fields) {
  StampedName row{0.0, {}, fields.line()};
  const std::optional<double> day = date(fields[0]);
  const std::size_t stamp_fields = day ? 2 : 1;
  if (fields.size() < stamp_fields || fields.size() > stamp_fields + 1)
    fields.refuse("the line must have a stamp [s] and may have the name of a picture");
  if (day) {
    const std::optional<double> time = time_of_day(fields[1]);
    if (!time) fields.refuse(TextFields::quoted(fields[1]) + " is no time of day as 13:02:25.96");
    row.stamp_s = *day + *time;
  } else {
    row.stamp_s = fields.number(0);
  }
  if (fields.size() > stamp_fields) row.name = fields[stamp_fields];
  return row;
}

std::vector<std::string_view> cells_of(std::string_view line) {
  std::vector<std::string_view> cells;
  for (std::size_t at = 0; at <= line.size();) {
    const std::size_t end = std::min(line.find(',', at), line.size());
    cells.push_back(line.substr(at, end - at));
    at = end + 1;
  }
  return cells;
}

/// The column stamp_s of a header, if it is one.
std::optional<std::size_t> stamp_column(std::string_view line) {
  const std::vector<std::string_view> cells = cells_of(line);
  const auto found = std::find(cells.begin(), cells.end(), "stamp_s");
  if (found == cells.end() || cells.size() == 1) return std::nullopt;
  return static_cast<std::size_t>(found - cells.begin());
}

StampedName csv_line(const TextFields& fields, std::size_t column) {
  StampedName row{0.0, {}, fields.line()};
  const std::vector<std::string_view> cells = cells_of(fields[0]);
  if (fields.size() != 1 || column >= cells.size()) fields.refuse("the line does not have the columns of the header");
  if (!parse(cells[column], row.stamp_s) || !std::isfinite(row.stamp_s))
    fields.refuse("stamp_s is " + TextFields::quoted(cells[column]) + "; it must be a finite number");
  return row;
}

}  // namespace

std::vector<StampedName> read_times(const std::filesystem::path& file) {
  const std::string text = read_text(file, kind);
  TextFields fields(text, file.string(), kind);
  std::vector<StampedName> rows;
  std::optional<std::size_t> column;
  bool first = true;
  while (fields.next_line()) {
    if (fields.empty() || fields[0].front() == '#') continue;
    if (first && (column = stamp_column(fields[0]))) {
      first = false;
      continue;
    }
    first = false;
    rows.push_back(column ? csv_line(fields, *column) : plain_line(fields));
    if (rows.size() > 1 && !(rows.back().stamp_s > rows[rows.size() - 2].stamp_s))
      fields.refuse("the stamp is not later than that of the line before; stamps must grow");
  }
  if (rows.empty()) throw ConfigError(file.string() + ": says nothing; give " + kind);
  return rows;
}

void check_rate(double rate_hz, const std::string& source) {
  if (!(rate_hz > 0.0 && rate_hz <= 1e4)) throw RangeError(source, "rate_hz", rate_hz, "lie in (0, 10000]");
}

}  // namespace convoy
