#include "consistency/page.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include "consistency/real_drift_page.hpp"
#include "report/page_parts.hpp"
#include "report/svg_plot.hpp"

namespace convoy::cli::consistency {
namespace {

struct Look {
  const char* model;
  const char* color;
  const char* dash;
};
constexpr Look looks[] = {{"raw SLAM", "#7b8794", "2 3"},         {"literal, sparse map", "#d62728", ""},
                          {"literal, EKF map", "#d62728", "6 3"}, {"literal, fitted noise, sparse map", "#ff7f0e", ""},
                          {"local, EKF map", "#2ca02c", "6 3"},   {"local, sparse map", "#2ca02c", ""}};

SvgPlot::Style look_of(const std::string& model) {
  for (const Look& look : looks)
    if (model == look.model) return {look.color, model == "local, sparse map" ? 2.5 : 1.5, look.dash};
  return {"#1f77b4"};
}

std::string met_cell(const Demand& d) {
  return d.met          ? "<td class=\"text\">met</td>"
         : d.of_verdict ? "<td class=\"text miss\">miss</td>"
                        : "<td class=\"text miss\">miss, beside the verdict</td>";
}

using Rows = std::vector<const Row*>;

std::string drawing(const Rows& rows, const std::string& title, const std::function<double(const CurvePoint&)>& value,
                    const std::function<void(SvgPlot&)>& decorate, bool legend) {
  SvgPlot plot(520.0, legend ? 400.0 : 360.0);
  plot.title(title);
  plot.x_label("distance driven [m]");
  if (!legend) plot.no_legend();
  decorate(plot);
  for (const Row* row : rows) {
    std::vector<SvgPlot::Point> line;
    for (const CurvePoint& p : row->summary.curve) line.emplace_back(p.abscissa_m, value(p));
    plot.line(line, look_of(row->model), row->model);
  }
  return "<figure>" + plot.svg() + "</figure>\n";
}

// All models of one scenario, over distance.
std::string scenario_section(const std::string& heading, const Rows& rows) {
  const Summary& first = rows.front()->summary;
  std::string html = "<section><h2>" + xml_escaped(heading) + "</h2>\n<div class=\"row\">\n";
  html += drawing(
      rows, "ANEES (1 is honest)", [](const CurvePoint& p) { return std::max(0.01, p.anees); },
      [&](SvgPlot& plot) {
        plot.log_y(0.1);
        plot.band(first.band_low, first.band_high, {"#2ca02c", 0.0, "", 0.2}, "95 % band");
      },
      true);
  html += drawing(
      rows, "share of poses within their 95 % ellipsoid", [](const CurvePoint& p) { return p.coverage95; },
      [](SvgPlot& plot) {
        plot.y_range(0.0, 1.0);
        plot.band(0.93, 0.97, {"#2ca02c", 0.0, "", 0.2});
      },
      false);
  html += drawing(
      rows, "position RMSE [m]", [](const CurvePoint& p) { return std::max(1e-3, p.pos_rmse_m); },
      [](SvgPlot& plot) { plot.log_y(0.01); }, false);
  html += "</div>\n<ul>\n";
  for (const Row* row : rows)
    html += "<li><b>" + xml_escaped(row->model) + "</b>: ANEES " + fixed(row->summary.anees, 2) + ", coverage " +
            fixed(100.0 * row->summary.coverage95, 1) + " %, position " + fixed(row->summary.pos_rmse_m, 2) + " m. " +
            xml_escaped(row->remark) + "</li>\n";
  return html + "</ul></section>\n";
}

std::string demand_table(const ConsistencyResult& result) {
  std::string html =
      "<div class=\"scroll\"><table><tr><th class=\"text\">asked of the estimator</th><th class=\"text\">figure asked"
      "</th><th class=\"text\">measured</th><th class=\"text\"></th><th class=\"text\">why</th></tr>\n";
  for (const Demand& d : result.demands)
    html += "<tr>" + text_cell(d.what) + text_cell(d.asked) + text_cell(d.measured) + met_cell(d) +
            text_cell(d.met ? "" : d.reason) + "</tr>\n";
  return html + "</table></div>\n";
}

std::string control_table(const ConsistencyResult& result) {
  if (result.controls.empty()) return "<p>None belongs to what --only asked for.</p>\n";
  std::string html =
      "<div class=\"scroll\"><table><tr><th class=\"text\">control</th><th class=\"text\">must be</th><th "
      "class=\"text\">measured</th>"
      "<th class=\"text\"></th></tr>\n";
  for (const Control& c : result.controls)
    html += "<tr>" + text_cell(c.what) + text_cell(to_string(c.side)) + text_cell(c.measured) +
            (c.failed ? "<td class=\"text\">fails, as it must</td>"
                      : "<td class=\"text miss\">does not fail as it must</td>") +
            "</tr>\n";
  return html + "</table></div>\n";
}

std::string row_table(const ConsistencyResult& result) {
  std::string html = "<div class=\"scroll\"><table><tr>";
  for (const char* head : {"model", "", "simulator", "scenario"})
    html += std::string("<th class=\"text\">") + head + "</th>";
  for (const char* head : {"runs", "ANEES", "95 % interval", "steps in band", "coverage", "position RMSE [m]",
                           "distance RMSE [m]", "false fusions", "true dropped"})
    html += std::string("<th>") + head + "</th>";
  html += "</tr>\n";
  for (const Row& row : result.rows) {
    const Summary& s = row.summary;
    html += (row.ours ? "<tr class=\"ours\">" : "<tr>") + text_cell(row.model) +
            text_cell(std::to_string(row.dim) + "-D") + text_cell(row.simulator) + text_cell(row.scenario) +
            cell(std::to_string(s.runs)) + cell(fixed(s.anees, 3)) +
            cell(fixed(s.anees_low, 3) + " – " + fixed(s.anees_high, 3)) +
            cell(fixed(100.0 * s.steps_in_band, 1) + " %") + cell(fixed(100.0 * s.coverage95, 1) + " %") +
            cell(fixed(s.pos_rmse_m, 3)) + cell(std::isfinite(s.distance_rmse_m) ? fixed(s.distance_rmse_m, 3) : "–") +
            cell(std::to_string(s.false_fusions)) +
            cell(std::to_string(s.true_dropped) + " of " + std::to_string(s.true_stated)) + "</tr>\n";
  }
  return html + "</table></div>\n";
}

std::string lead(const ConsistencyResult& result) {
  if (!result.judged()) return "Nothing that was measured belongs to the verdict. ";
  if (!result.enough_runs())
    return "<span class=\"miss\">No verdict: " + xml_escaped(few_runs_words(result.options.runs)) + "</span> ";
  if (!result.pass()) return "<span class=\"miss\">The suite does not pass.</span> ";
  return result.controls.empty() ? "The estimator passes. "
                                 : "The estimator passes, and every negative control fails. ";
}

std::string misses(const ConsistencyResult& result) {
  const auto count =
      std::count_if(result.demands.begin(), result.demands.end(), [](const Demand& d) { return !d.met; });
  if (count == 0) return "Nothing that is asked is missed.";
  return std::to_string(count) +
         (count == 1 ? " figure that is asked is missed" : " figures that are asked are missed") +
         "; the table names " + (count == 1 ? "it." : "them.");
}

}  // namespace

std::string consistency_page(const ConsistencyResult& result) {
  std::string html = page_begin("convoy: consistency") + "<h1>Consistency</h1>\n<p class=\"lead\">";
  html += lead(result);
  if (!result.options.only.empty())
    html += "Only scenarios whose name holds '" + xml_escaped(result.options.only) + "' were measured. ";
  html +=
      xml_escaped(misses(result)) + "</p>\n<p class=\"source\">" + std::to_string(result.options.runs) +
      " runs of each scenario, seed " + std::to_string(result.options.seed) + "; noise fitted on " + "runs of seed " +
      std::to_string(result.calibration_seed) + "; intervals by 1000 bootstrap draws over runs, seed " +
      std::to_string(result.options.seed) +
      ". Error in tangent space, r = Log(T^⁻¹ T); ANEES = mean of r^T P⁻¹ r / d. A step is one vehicle at one "
      "distance; its band is the 95 % interval of chi-square with runs times d degrees of freedom. Drawings pool the "
      "vehicles of a run.</p>\n";
  html += "<section><h2>What is asked, and what was measured</h2>\n" + demand_table(result) + "</section>\n";
  html += "<section><h2>Negative controls</h2>\n<p>The same test on a covariance or a model that is wrong.</p>\n" +
          control_table(result) + "</section>\n";
  // Scenarios under several models are drawn.
  for (std::size_t i = 0; i < result.rows.size(); ++i) {
    const auto same = [&](const Row& row) {
      const Row& r = result.rows[i];
      return row.dim == r.dim && row.simulator == r.simulator && row.scenario == r.scenario;
    };
    if (std::any_of(result.rows.begin(), result.rows.begin() + static_cast<std::ptrdiff_t>(i), same)) continue;
    Rows rows;
    for (const Row& row : result.rows)
      if (same(row)) rows.push_back(&row);
    if (rows.size() < 2) continue;
    html += scenario_section(
        std::to_string(rows.front()->dim) + "-D, " + rows.front()->simulator + ": " + rows.front()->scenario, rows);
  }
  html += real_drift_section(result.real_drift);
  html +=
      "<section><h2>Every row</h2>\n<p>EKF-SLAM has all baselines in the plane; in space, the raw SLAM and the paper's "
      "own method. "
      "The EKF map takes landmarks of a batch as independent.</p>\n" +
      row_table(result) + "</section>\n";
  return html + page_end();
}

}  // namespace convoy::cli::consistency
