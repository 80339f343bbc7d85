#include "report/svg_plot.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <convoy/geometry/chi2.hpp>
#include <cstdio>
#include <limits>
#include <set>

namespace convoy::cli {
namespace {

constexpr const char* text_color = "#1f2933";
constexpr const char* grid_color = "#e4e7eb";
constexpr const char* axis_color = "#7b8794";

std::string px(double value) { return fixed(value, 1); }

bool finite(const Eigen::Vector2d& p) { return std::isfinite(p.x()) && std::isfinite(p.y()); }

std::string text_at(double x, double y, const char* anchor, double size, const std::string& text,
                    const char* extra = "") {
  return "<text x=\"" + px(x) + "\" y=\"" + px(y) + "\" text-anchor=\"" + anchor + "\" font-size=\"" + px(size) +
         "\" fill=\"" + text_color + "\"" + extra + ">" + xml_escaped(text) + "</text>\n";
}

std::string stroke(const SvgPlot::Style& style) {
  std::string text = " stroke=\"" + style.color + "\" stroke-width=\"" + px(style.width) + "\"";
  if (!style.dash.empty()) text += " stroke-dasharray=\"" + style.dash + "\"";
  if (style.opacity < 1.0) text += " stroke-opacity=\"" + fixed(style.opacity, 2) + "\"";
  return text;
}

std::string fill(const SvgPlot::Style& style) {
  std::string text = " fill=\"" + style.color + "\"";
  if (style.opacity < 1.0) text += " fill-opacity=\"" + fixed(style.opacity, 2) + "\"";
  return text;
}

int decimals_for(double step) { return std::clamp(static_cast<int>(std::ceil(-std::log10(step) - 1e-9)), 0, 6); }

/// Thousands as "12k", so that labels stay short.
std::string tick_text(double value, double step) {
  if (std::abs(value) >= 10000.0 && step >= 1000.0) return fixed(value / 1000.0, 0) + "k";
  return fixed(value, decimals_for(step));
}

}  // namespace

std::string xml_escaped(std::string_view text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&': out += "&amp;"; break;
      case '<': out += "&lt;"; break;
      case '>': out += "&gt;"; break;
      case '"': out += "&quot;"; break;
      default: out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
    }
  }
  return out;
}

std::string fixed(double value, int decimals) {
  char buffer[64];
  std::snprintf(buffer, sizeof buffer, "%.*f", decimals, value);
  const std::string text = buffer;
  const bool zero = text.find_first_of("123456789") == std::string::npos;
  return zero && text.front() == '-' ? text.substr(1) : text;
}

std::vector<double> round_ticks(double low, double high, int wanted) {
  if (!(high > low) || wanted < 1) return {};
  const double rough = (high - low) / wanted;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  double step = 10.0 * power;
  for (const double factor : {5.0, 2.0, 1.0})
    if (factor * power >= rough * 0.999) step = factor * power;
  std::vector<double> ticks;
  for (double i = std::ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1.0) ticks.push_back(i * step);
  return ticks;
}

std::vector<Eigen::Vector2d> thinned(const std::vector<Eigen::Vector2d>& line, double tolerance) {
  if (line.size() < 3) return line;
  std::vector<char> kept(line.size(), 0);
  kept.front() = kept.back() = 1;
  std::vector<std::pair<std::size_t, std::size_t>> open{{0, line.size() - 1}};
  while (!open.empty()) {
    const auto [begin, end] = open.back();
    open.pop_back();
    const Eigen::Vector2d along = line[end] - line[begin];
    double worst = tolerance;
    std::size_t at = 0;
    for (std::size_t i = begin + 1; i < end; ++i) {
      const Eigen::Vector2d d = line[i] - line[begin];
      const double share = along.squaredNorm() > 0.0 ? std::clamp(d.dot(along) / along.squaredNorm(), 0.0, 1.0) : 0.0;
      const double distance = (d - share * along).norm();
      if (distance > worst) {
        worst = distance;
        at = i;
      }
    }
    if (at == 0) continue;
    kept[at] = 1;
    open.push_back({begin, at});
    open.push_back({at, end});
  }
  std::vector<Eigen::Vector2d> result;
  for (std::size_t i = 0; i < line.size(); ++i)
    if (kept[i]) result.push_back(line[i]);
  return result;
}

/// The plotting area in the drawing, and the data range that it shows.
struct SvgPlot::Frame {
  double left, top, width, height, total_height;
  Range x, y;
  std::optional<double> log_floor;

  double y_value(double value) const { return log_floor ? std::log10(std::max(value, *log_floor)) : value; }
  /// Position relative to the plotting area.
  Point at(const Point& p) const {
    return {(p.x() - x.low) / x.span() * width, height - (y_value(p.y()) - y.low) / y.span() * height};
  }
};

void SvgPlot::equal_aspect(double min_height_px, double max_height_px) {
  equal_ = true;
  min_height_ = min_height_px;
  max_height_ = max_height_px;
}

void SvgPlot::log_y(double floor) { log_floor_ = floor; }

void SvgPlot::add(Kind kind, std::vector<Point> points, double radius_px, const Style& style, const std::string& legend,
                  bool counts_for_axes) {
  if (counts_for_axes)
    for (const Point& p : points)
      if (finite(p)) extent_.push_back(p);
  items_.push_back({kind, std::move(points), radius_px, style, legend});
}

void SvgPlot::line(const std::vector<Point>& points, const Style& style, const std::string& legend) {
  add(Kind::line, points, 0.0, style, legend);
}

void SvgPlot::dots(const std::vector<Point>& points, double radius_px, const Style& style, const std::string& legend) {
  add(Kind::dots, points, radius_px, style, legend);
}

void SvgPlot::rings(const std::vector<Point>& points, double radius_px, const Style& style, const std::string& legend) {
  add(Kind::rings, points, radius_px, style, legend);
}

void SvgPlot::segments(const std::vector<std::pair<Point, Point>>& segments, const Style& style,
                       const std::string& legend) {
  std::vector<Point> ends;
  for (const auto& [a, b] : segments) {
    ends.push_back(a);
    ends.push_back(b);
  }
  add(Kind::segments, std::move(ends), 0.0, style, legend);
}

void SvgPlot::ellipse(const Point& centre, const Eigen::Matrix2d& covariance, const Style& style,
                      const std::string& legend) {
  static const double scale = std::sqrt(chi2_quantile(0.95, 2.0));
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(covariance);
  if (eigen.info() != Eigen::Success || !centre.allFinite()) return;
  const Eigen::Matrix2d axes = eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal();
  std::vector<Point> outline;
  constexpr int corners = 48;
  for (int i = 0; i <= corners; ++i) {
    const double angle = 2.0 * M_PI * i / corners;
    outline.push_back(centre + scale * (axes * Point(std::cos(angle), std::sin(angle))));
  }
  add(Kind::line, std::move(outline), 0.0, style, legend);
}

void SvgPlot::band(double y_low, double y_high, const Style& style, const std::string& legend) {
  add(Kind::band, {{0.0, y_low}, {0.0, y_high}}, 0.0, style, legend, false);
}

void SvgPlot::ribbon(const std::vector<Point>& low, const std::vector<Point>& high, const Style& style,
                     const std::string& legend) {
  std::vector<Point> outline = low;
  outline.insert(outline.end(), high.rbegin(), high.rend());
  add(Kind::ribbon, std::move(outline), 0.0, style, legend);
}

void SvgPlot::vertical(double x, const Style& style, const std::string& legend) {
  add(Kind::vertical, {{x, 0.0}}, 0.0, style, legend, false);
}

void SvgPlot::box(const Point& low, const Point& high, const Style& style, const std::string& legend) {
  add(Kind::box, {low, high}, 0.0, style, legend);
}

double SvgPlot::legend_width(const Item& item) const {
  return 26.0 + 0.6 * font_ * static_cast<double>(item.legend.size()) + 14.0;
}

std::vector<std::vector<const SvgPlot::Item*>> SvgPlot::legend_rows() const {
  std::vector<std::vector<const Item*>> rows;
  if (!legend_shown_) return rows;
  std::set<std::string> seen;
  double used = std::numeric_limits<double>::infinity();
  for (const Item& item : items_) {
    if (item.legend.empty() || !seen.insert(item.legend).second) continue;
    if (used + legend_width(item) > width_ - 60.0) {
      rows.emplace_back();
      used = 0.0;
    }
    rows.back().push_back(&item);
    used += legend_width(item);
  }
  return rows;
}

SvgPlot::Frame SvgPlot::layout() const {
  constexpr double infinity = std::numeric_limits<double>::infinity();
  Frame frame{};
  frame.log_floor = log_floor_;
  frame.x = {infinity, -infinity};
  frame.y = {infinity, -infinity};
  for (const Point& p : extent_) {
    frame.x = {std::min(frame.x.low, p.x()), std::max(frame.x.high, p.x())};
    frame.y = {std::min(frame.y.low, frame.y_value(p.y())), std::max(frame.y.high, frame.y_value(p.y()))};
  }
  const auto widen = [](Range& range, double margin) {
    if (!(range.low <= range.high)) range = {0.0, 1.0};
    const double extra = range.span() > 0.0 ? margin * range.span() : 0.5;
    range = {range.low - extra, range.high + extra};
  };
  widen(frame.x, equal_ ? 0.03 : 0.0);
  widen(frame.y, equal_ ? 0.03 : 0.06);
  if (x_range_) frame.x = *x_range_;
  if (y_range_) frame.y = {frame.y_value(y_range_->low), frame.y_value(y_range_->high)};

  frame.left = 4.6 * font_;
  frame.width = width_ - frame.left - 1.2 * font_;
  frame.top = (title_.empty() ? 0.7 : 2.2) * font_ + 1.6 * font_ * static_cast<double>(legend_rows().size());
  const double bottom = 3.6 * font_;
  frame.height = height_ - frame.top - bottom;
  if (equal_) {
    frame.height = std::clamp(frame.width * frame.y.span() / frame.x.span(), min_height_, max_height_);
    const double scale = std::max(frame.x.span() / frame.width, frame.y.span() / frame.height);  // units per px
    const auto grow = [](Range& range, double span) {
      const double extra = 0.5 * (span - range.span());
      range = {range.low - extra, range.high + extra};
    };
    grow(frame.x, scale * frame.width);
    grow(frame.y, scale * frame.height);
  }
  frame.total_height = frame.top + frame.height + bottom;
  return frame;
}

void SvgPlot::draw_axes(std::string& out, const Frame& frame) const {
  const double right = frame.left + frame.width, floor = frame.top + frame.height;
  const auto x_ticks =
      round_ticks(frame.x.low, frame.x.high, std::max(4, static_cast<int>(frame.width / (6.0 * font_))));
  const double x_step = x_ticks.size() > 1 ? x_ticks[1] - x_ticks[0] : 1.0;
  for (const double tick : x_ticks) {
    const double x = frame.left + (tick - frame.x.low) / frame.x.span() * frame.width;
    out += "<line x1=\"" + px(x) + "\" y1=\"" + px(frame.top) + "\" x2=\"" + px(x) + "\" y2=\"" + px(floor) +
           "\" stroke=\"" + grid_color + "\"/>\n";
    out += text_at(x, floor + 1.25 * font_, "middle", 0.92 * font_, tick_text(tick, x_step));
  }
  auto y_ticks = round_ticks(frame.y.low, frame.y.high, std::max(4, static_cast<int>(frame.height / (3.2 * font_))));
  if (log_floor_) std::erase_if(y_ticks, [](double tick) { return std::abs(tick - std::round(tick)) > 1e-9; });
  const double y_step = y_ticks.size() > 1 ? y_ticks[1] - y_ticks[0] : 1.0;
  for (const double tick : y_ticks) {
    const double y = floor - (tick - frame.y.low) / frame.y.span() * frame.height;
    out += "<line x1=\"" + px(frame.left) + "\" y1=\"" + px(y) + "\" x2=\"" + px(right) + "\" y2=\"" + px(y) +
           "\" stroke=\"" + grid_color + "\"/>\n";
    const std::string label = !log_floor_  ? tick_text(tick, y_step)
                              : tick > 3.5 ? "1e" + fixed(tick, 0)
                                           : fixed(std::pow(10.0, tick), tick < 0 ? static_cast<int>(-tick) : 0);
    out += text_at(frame.left - 0.5 * font_, y + 0.35 * font_, "end", 0.92 * font_, label);
  }
  out += "<rect x=\"" + px(frame.left) + "\" y=\"" + px(frame.top) + "\" width=\"" + px(frame.width) + "\" height=\"" +
         px(frame.height) + "\" fill=\"none\" stroke=\"" + axis_color + "\"/>\n";
  out += text_at(frame.left + 0.5 * frame.width, floor + 2.9 * font_, "middle", font_, x_label_);
  const std::string turn =
      " transform=\"rotate(-90 " + px(1.1 * font_) + " " + px(frame.top + 0.5 * frame.height) + ")\"";
  out += text_at(1.1 * font_, frame.top + 0.5 * frame.height, "middle", font_, y_label_, turn.c_str());
  if (!title_.empty()) out += text_at(frame.left, 1.4 * font_, "start", 1.08 * font_, title_, " font-weight=\"600\"");
}

void SvgPlot::draw_legend(std::string& out, const Frame& frame) const {
  double y = (title_.empty() ? 0.0 : 1.7 * font_) + 0.9 * font_;
  for (const auto& row : legend_rows()) {
    double x = frame.left;
    for (const Item* item : row) {
      const double middle = y - 0.1 * font_;
      switch (item->kind) {
        case Kind::dots:
          out += "<circle cx=\"" + px(x + 10) + "\" cy=\"" + px(middle) + "\" r=\"" +
                 px(std::max(3.0, item->radius_px)) + "\"" + fill(item->style) + "/>\n";
          break;
        case Kind::rings:
          out += "<circle cx=\"" + px(x + 10) + "\" cy=\"" + px(middle) + "\" r=\"" +
                 px(std::max(3.0, item->radius_px)) + "\" fill=\"none\"" + stroke(item->style) + "/>\n";
          break;
        case Kind::band:
        case Kind::ribbon:
          out += "<rect x=\"" + px(x) + "\" y=\"" + px(middle - 5) + "\" width=\"20\" height=\"10\"" +
                 fill(item->style) + "/>\n";
          break;
        default: {
          Style style = item->style;
          style.width = std::max(1.6, style.width);
          style.opacity = std::max(0.8, style.opacity);
          out += "<line x1=\"" + px(x) + "\" y1=\"" + px(middle) + "\" x2=\"" + px(x + 20) + "\" y2=\"" + px(middle) +
                 "\"" + stroke(style) + "/>\n";
        }
      }
      out += text_at(x + 26.0, y + 0.25 * font_, "start", font_, item->legend);
      x += legend_width(*item);
    }
    y += 1.6 * font_;
  }
}

void SvgPlot::draw_item(std::string& out, const Item& item, const Frame& frame) const {
  std::vector<Point> at;
  for (const Point& p : item.points) at.push_back(finite(p) ? frame.at(p) : p);
  const auto inside = [&frame](const Point& p, double margin) {
    return finite(p) && p.x() > -margin && p.y() > -margin && p.x() < frame.width + margin &&
           p.y() < frame.height + margin;
  };
  switch (item.kind) {
    case Kind::line: {
      std::vector<Point> run;
      const auto flush = [&] {
        if (run.size() > 1) {
          out += "<polyline fill=\"none\" stroke-linejoin=\"round\"" + stroke(item.style) + " points=\"";
          for (const Point& p : thinned(run, 0.3)) out += px(p.x()) + "," + px(p.y()) + " ";
          out += "\"/>\n";
        }
        run.clear();
      };
      // Far outside nothing is drawn: a zoomed view does not carry the whole line along.
      for (std::size_t i = 0; i < at.size(); ++i) {
        const bool near = inside(at[i], frame.width) || (i + 1 < at.size() && inside(at[i + 1], 0.0)) ||
                          (i > 0 && inside(at[i - 1], 0.0));
        if (!finite(at[i]) || !near) flush();
        else run.push_back(at[i]);
      }
      flush();
      break;
    }
    case Kind::dots:
    case Kind::rings: {
      const bool full = item.kind == Kind::dots;
      out += "<g" + (full ? fill(item.style) : " fill=\"none\"" + stroke(item.style)) + ">";
      for (const Point& p : at)
        if (inside(p, item.radius_px))
          out += "<circle cx=\"" + px(p.x()) + "\" cy=\"" + px(p.y()) + "\" r=\"" + px(item.radius_px) + "\"/>";
      out += "</g>\n";
      break;
    }
    case Kind::segments: {
      std::string path;
      for (std::size_t i = 0; i + 1 < at.size(); i += 2)
        path += "M" + px(at[i].x()) + " " + px(at[i].y()) + "L" + px(at[i + 1].x()) + " " + px(at[i + 1].y());
      if (!path.empty()) out += "<path fill=\"none\"" + stroke(item.style) + " d=\"" + path + "\"/>\n";
      break;
    }
    case Kind::band: {
      const double top = std::clamp(at[1].y(), 0.0, frame.height), bottom = std::clamp(at[0].y(), 0.0, frame.height);
      out += "<rect x=\"0\" y=\"" + px(top) + "\" width=\"" + px(frame.width) + "\" height=\"" + px(bottom - top) +
             "\"" + fill(item.style) + "/>\n";
      break;
    }
    case Kind::ribbon: {
      std::string corners;
      for (const Point& p : at)
        if (finite(p)) corners += px(p.x()) + "," + px(p.y()) + " ";
      if (!corners.empty()) out += "<polygon" + fill(item.style) + " points=\"" + corners + "\"/>\n";
      break;
    }
    case Kind::vertical:
      out += "<line x1=\"" + px(at[0].x()) + "\" y1=\"0\" x2=\"" + px(at[0].x()) + "\" y2=\"" + px(frame.height) +
             "\"" + stroke(item.style) + "/>\n";
      break;
    case Kind::box: {
      const Point middle = 0.5 * (at[0] + at[1]);
      const double w = std::max(12.0, at[1].x() - at[0].x()), h = std::max(12.0, at[0].y() - at[1].y());
      out += "<rect x=\"" + px(middle.x() - 0.5 * w) + "\" y=\"" + px(middle.y() - 0.5 * h) + "\" width=\"" + px(w) +
             "\" height=\"" + px(h) + "\" fill=\"none\"" + stroke(item.style) + "/>\n";
      break;
    }
  }
}

std::string SvgPlot::svg() const {
  const Frame frame = layout();
  std::string out = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 " + px(width_) + " " +
                    px(frame.total_height) + "\" role=\"img\" font-family=\"inherit\">\n";
  draw_axes(out, frame);
  draw_legend(out, frame);
  out += "<svg x=\"" + px(frame.left) + "\" y=\"" + px(frame.top) + "\" width=\"" + px(frame.width) + "\" height=\"" +
         px(frame.height) + "\" overflow=\"hidden\">\n";
  for (const Item& item : items_) draw_item(out, item, frame);
  return out + "</svg>\n</svg>\n";
}

}  // namespace convoy::cli
