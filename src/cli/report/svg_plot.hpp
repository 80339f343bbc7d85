// A small plot, drawn as inline SVG: axes with round ticks, a legend above the plotting area, clipped content, long
// lines thinned to what a screen can show. Coordinates are data units; sizes are pixels of the drawing (px).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace convoy::cli {

/// Text for XML content and attributes.
std::string xml_escaped(std::string_view text);

/// Fixed decimals, without "-0".
std::string fixed(double value, int decimals);

/// Round tick positions (1, 2 or 5 times a power of ten apart) inside [low, high], about `wanted` of them.
std::vector<double> round_ticks(double low, double high, int wanted);

/// Douglas-Peucker: the points of a line that matter at this tolerance. First and last always stay.
std::vector<Eigen::Vector2d> thinned(const std::vector<Eigen::Vector2d>& line, double tolerance);

class SvgPlot {
 public:
  using Point = Eigen::Vector2d;

  struct Style {
    Style(std::string color_, double width_px = 1.5, std::string dash_ = {}, double opacity_ = 1.0)
        : color(std::move(color_)), width(width_px), dash(std::move(dash_)), opacity(opacity_) {}
    std::string color;  ///< "#rrggbb"
    double width;       ///< of the line [px]
    std::string dash;   ///< SVG dash pattern, empty: solid
    double opacity;     ///< 0..1
  };

  SvgPlot(double width_px, double height_px) : width_(width_px), height_(height_px) {}

  void title(std::string text) { title_ = std::move(text); }
  void x_label(std::string text) { x_label_ = std::move(text); }
  void y_label(std::string text) { y_label_ = std::move(text); }
  void font_size(double px) { font_ = px; }
  void no_legend() { legend_shown_ = false; }

  /// One metre is as long across as up. The height then follows the data, within these bounds.
  void equal_aspect(double min_height_px, double max_height_px);
  /// Powers of ten upwards; values below `floor` are drawn at `floor`.
  void log_y(double floor);
  void x_range(double low, double high) { x_range_ = {low, high}; }
  void y_range(double low, double high) { y_range_ = {low, high}; }
  /// Makes room for a point without drawing it.
  void include(const Point& point) { extent_.push_back(point); }

  // Content, drawn in the order of the calls. The first item of a legend text makes its entry; no text, no entry.
  /// Points that are not finite break the line.
  void line(const std::vector<Point>& points, const Style& style, const std::string& legend = {});
  void dots(const std::vector<Point>& points, double radius_px, const Style& style, const std::string& legend = {});
  /// Circles with an empty middle.
  void rings(const std::vector<Point>& points, double radius_px, const Style& style, const std::string& legend = {});
  void segments(const std::vector<std::pair<Point, Point>>& segments, const Style& style,
                const std::string& legend = {});
  /// The ellipse that holds 95 % of N(centre, covariance).
  void ellipse(const Point& centre, const Eigen::Matrix2d& covariance, const Style& style,
               const std::string& legend = {});
  /// A shaded range of y over the whole width; does not widen the axes.
  void band(double y_low, double y_high, const Style& style, const std::string& legend = {});
  /// The shaded area between two lines of equally many points.
  void ribbon(const std::vector<Point>& low, const std::vector<Point>& high, const Style& style,
              const std::string& legend = {});
  /// A vertical line over the whole height; does not widen the axes.
  void vertical(double x, const Style& style, const std::string& legend = {});
  /// A frame around an area, at least 12 px large.
  void box(const Point& low, const Point& high, const Style& style, const std::string& legend = {});

  /// <svg ...>...</svg>
  std::string svg() const;

 private:
  enum class Kind { line, dots, rings, segments, band, ribbon, vertical, box };
  struct Item {
    Kind kind;
    std::vector<Point> points;
    double radius_px;
    Style style;
    std::string legend;
  };
  struct Range {
    double low, high;
    double span() const { return high - low; }
  };
  struct Frame;

  void add(Kind kind, std::vector<Point> points, double radius_px, const Style& style, const std::string& legend,
           bool counts_for_axes = true);
  Frame layout() const;
  void draw_axes(std::string& out, const Frame& frame) const;
  void draw_legend(std::string& out, const Frame& frame) const;
  void draw_item(std::string& out, const Item& item, const Frame& frame) const;
  std::vector<std::vector<const Item*>> legend_rows() const;
  double legend_width(const Item& item) const;

  double width_, height_;
  double font_ = 12.0;
  std::string title_, x_label_, y_label_;
  bool legend_shown_ = true;
  bool equal_ = false;
  double min_height_ = 0.0, max_height_ = 0.0;
  std::optional<double> log_floor_;
  std::optional<Range> x_range_, y_range_;
  std::vector<Item> items_;
  std::vector<Point> extent_;
};

}  // namespace convoy::cli
