#include "consistency/real_drift_page.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>

#include "report/page_parts.hpp"
#include "report/svg_plot.hpp"

namespace convoy::cli::consistency {
namespace {

using Point = SvgPlot::Point;
using Points = std::vector<Point>;

constexpr double covered_share = 0.9;  // of the spans within their 95 % region, to call a length covered
constexpr int least_spans = 10;        // fewer say nothing of that
constexpr const char* vehicle_colors[] = {"#1f5fbf", "#d62728"};

// ---- what the page says whatever was measured ------------------------------------------------------------------

constexpr const char* about_spans = R"(Recordings of KITTI's vehicle. The SLAM is a black box that states no covariance:
all of its drift is described by rates, variance per metre, and, in one model, by two constants of each chain as well, a
relative error of all distances and a heading error per metre. The shipped rates are meant to come on top of what a SLAM
states itself, so they have to be far too small here. Judged is the error of the motion over spans of one length by the
SLAM's own odometer, one every 25 m: they overlap, so the figures of long spans rest on few independent ones. What is
judged was never fitted. The truth counts as known to 5 cm and 0.5 mrad. One chain is one draw of its constants: their
variances rest on as many draws as there are chains.)";

constexpr const char* covered_caveat =
    R"( of its spans or more, and there are ten at least, lie within their 95 % region. A model that is too wide
covers as well; NEES per degree of freedom, far below 1 then, tells the two apart.)";

constexpr const char* what_is_covered =
    R"(What is covered: errors that come independently, metre by metre, on drives like
those that were fitted; with constants also a scale and a heading rate that stay what they are for a whole drive, which
rates alone understate the more, the longer the span. What is not: a scale that wanders within the drive (its halves find
different constants, below), which is neither white nor constant, so that rates fitted over 80 m are too small beyond; and
a drive better or worse than those that were fitted. The lag-1 correlation shows the first; its alarm waits until it is
beyond chance, which drives of few spans do not reach.)";

constexpr const char* about_halves =
    R"(The first vehicle knows its start, the second one only a circle of 22 m and 0.3 rad
(one draw of it), or nothing. Each vehicle's SLAM is the odometry of the graph; anchors stand every 25 m and at the ends of
loop edges. A loop edge becomes six landmarks around one of its poses that both ends have seen, where the edge puts them,
its uncertainty being the error they share: so facts go through selection, problem and sparse map as they do in a vehicle.
To put the edges into a pose graph as they are would be nearer to the file, and judge none of that. Nothing is aligned to
the truth. Loop edges agree with the truth suspiciously well, perhaps they were made from it: the fused figures are
optimistic. Landmarks and pairings are perfect, so association is not judged here. With constants, the map estimates a
scale and a heading rate of each vehicle beside everything else.)";

SvgPlot::Style look_of(const std::string& model) {
  if (model.find("shipped") != std::string::npos) return {"#7b8794", 1.5, "2 3"};
  if (model.find("literal") != std::string::npos) return {"#ff7f0e", 1.5};
  if (model.find("constants") != std::string::npos) return {"#2ca02c", 2.5};
  return {"#2ca02c", 1.5, "6 3"};
}

std::string head(std::initializer_list<const char*> texts, std::initializer_list<const char*> numbers) {
  std::string html = "<div class=\"scroll\"><table><tr>";
  for (const char* t : texts) html += "<th class=\"text\">" + xml_escaped(t) + "</th>";
  for (const char* n : numbers) html += "<th>" + xml_escaped(n) + "</th>";
  return html + "</tr>\n";
}
const std::string table_end = "</table></div>\n";
std::string paragraph(const std::string& text) { return "<p>" + xml_escaped(text) + "</p>\n"; }
std::string percent(double share) { return fixed(100.0 * share, 0) + " %"; }
/// Three digits that say something.
std::string number(double value) { return fixed(value, value < 10.0 ? 2 : value < 100.0 ? 1 : 0); }

/// The lengths at which a model holds what it says: "25 to 100 m, 400 m".
std::string covered_lengths(const SpanStudy& study, std::size_t model) {
  std::string words;
  const auto covered = [&](std::size_t i) {
    return study.rows[i].spans >= least_spans && study.rows[i].models[model].coverage95 >= covered_share;
  };
  for (std::size_t i = 0; i < study.rows.size(); ++i) {
    if (!covered(i)) continue;
    const std::size_t first = i;
    while (i + 1 < study.rows.size() && covered(i + 1)) ++i;
    words += (words.empty() ? "" : ", ") + fixed(study.rows[first].span_m, 0);
    if (i > first) words += " to " + fixed(study.rows[i].span_m, 0);
  }
  return words.empty() ? "none" : words + " m";
}

std::string lag_words(const LagWords& lag) {
  return (lag.largest < 0.0 ? "−" : "") + fixed(std::abs(lag.largest), 2) + " of " + std::to_string(lag.pairs) +
         " pairs" + (lag.alarm ? ", alarm" : "");
}

std::string overview(const RealDrift& drift) {
  std::string html = head({"recording", "lengths covered: shipped rates", "fitted rates", "fitted rates and constants",
                           "literal, fitted", "lag-1: rates", "with constants"},
                          {});
  for (const SpanStudy& study : drift.spans) {
    html += "<tr>" + text_cell(study.name + " (" + std::to_string(study.dim) + "‑D)");
    for (std::size_t m = 0; m < study.models.size(); ++m) html += text_cell(covered_lengths(study, m));
    html += text_cell(lag_words(study.lag_plain)) + text_cell(lag_words(study.lag_constants)) + "</tr>\n";
  }
  return html + table_end;
}

// ---- spans ---------------------------------------------------------------------------------------------------------

std::string span_drawing(const SpanStudy& study, const std::string& title,
                         const std::function<double(const SpanFigure&)>& value,
                         const std::function<void(SvgPlot&)>& decorate, bool legend) {
  SvgPlot plot(520.0, legend ? 400.0 : 360.0);
  plot.title(title);
  plot.x_label("length of the span [m]");
  if (!legend) plot.no_legend();
  decorate(plot);
  for (std::size_t m = 0; m < study.models.size(); ++m) {
    Points line;
    for (const SpanRow& row : study.rows) line.emplace_back(row.span_m, value(row.models[m]));
    plot.line(line, look_of(study.models[m]), study.models[m]);
    plot.dots(line, 2.5, look_of(study.models[m]));
  }
  return "<figure>" + plot.svg() + "</figure>\n";
}

std::string span_section(const SpanStudy& study) {
  std::string html = "<h3>" + xml_escaped(study.name + ": " + study.about) + "</h3>\n";
  html += paragraph(
      fixed(study.length_m, 0) + " m. Fitted on: " + study.fitted_on + "." +
      (study.scale == 1.0 ? "" : " Scaled by " + fixed(study.scale, 2) + ", which makes the first 100 m right."));
  html += "<div class=\"row\">\n";
  html += span_drawing(
      study, "NEES / degrees of freedom (1 is honest)", [](const SpanFigure& f) { return std::max(0.01, f.anees); },
      [](SvgPlot& plot) {
        plot.log_y(0.1);
        plot.line({{25.0, 1.0}, {800.0, 1.0}}, {"#9aa5b1", 1.0});
      },
      true);
  html += span_drawing(
      study, "share of spans within their 95 % region", [](const SpanFigure& f) { return f.coverage95; },
      [](SvgPlot& plot) {
        plot.y_range(0.0, 1.0);
        plot.band(covered_share, 1.0, {"#2ca02c", 0.0, "", 0.15});
      },
      false);
  html += span_drawing(
      study, "position error: measured (black), predicted [m]",
      [](const SpanFigure& f) { return std::max(1e-3, f.predicted_position_m); },
      [&](SvgPlot& plot) {
        plot.log_y(0.01);
        Points measured;
        for (const SpanRow& row : study.rows) measured.emplace_back(row.span_m, row.position_rmse_m);
        plot.line(measured, {"#000000", 2.5});
      },
      false);
  return html + "</div>\n";
}

std::string short_number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2g", value);
  return text;
}

std::string signed_number(double value, int decimals) {
  return (value < 0.0 ? "−" : "+") + fixed(std::abs(value), decimals);
}

std::string fit_row(const std::string& judged, const FitFigures& f) {
  std::string found;
  for (const auto& [name, mean] : f.constants)
    found += (found.empty() ? "" : "; ") + name + ": " + signed_number(100.0 * mean[0], 1) + " %, " +
             signed_number(1000.0 * mean[1], 3);
  std::string html = "<tr>" + text_cell(judged) + text_cell(found);
  for (const double value : {f.plain_translation, f.plain_rotation, f.translation, f.rotation})
    html += cell(short_number(value));
  html += cell(fixed(100.0 * f.scale, 1) + " %") + cell(fixed(1000.0 * f.heading, 3));
  for (const double value : {f.literal_translation, f.literal_rotation}) html += cell(short_number(value));
  return html + "</tr>\n";
}

std::string fit_table(const RealDrift& drift) {
  std::string html = head({"judged", "fitted on, and its constants: scale, heading rate [mrad/m]"},
                          {"rates alone [m²/m]", "[rad²/m]", "beside constants [m²/m]", "[rad²/m]", "σ of scale",
                           "σ of heading [mrad/m]", "literal [m²/m]", "[rad²/m]"});
  for (const SpanStudy& study : drift.spans)
    for (const FitFigures& f : study.fits) html += fit_row(study.name, f);
  for (const HalvesStudy& study : drift.halves) html += fit_row(study.name + ", cut", study.fit);
  return html + table_end;
}

std::string span_table(const RealDrift& drift) {
  std::string html = head({"recording", "model"}, {"span [m]", "spans", "ANEES", "coverage", "position RMSE [m]",
                                                   "predicted [m]", "rotation RMSE [mrad]"});
  for (const SpanStudy& study : drift.spans)
    for (std::size_t m = 0; m < study.models.size(); ++m)
      for (const SpanRow& row : study.rows)
        html += "<tr>" + text_cell(study.name) + text_cell(study.models[m]) + cell(fixed(row.span_m, 0)) +
                cell(std::to_string(row.spans)) + cell(number(row.models[m].anees)) +
                cell(percent(row.models[m].coverage95)) + cell(number(row.position_rmse_m)) +
                cell(number(row.models[m].predicted_position_m)) + cell(fixed(1000.0 * row.rotation_rmse_rad, 1)) +
                "</tr>\n";
  return html + table_end;
}

// ---- halves --------------------------------------------------------------------------------------------------------

const HalvesRow* row_of(const HalvesStudy& study, const std::string& model, bool fused) {
  for (const HalvesRow& row : study.rows)
    if (row.fused == fused && row.model == model) return &row;
  return nullptr;
}

std::string halves_map(const HalvesStudy& study) {
  SvgPlot plot(520.0, 520.0);
  plot.equal_aspect(180.0, 560.0);
  plot.title("from above [m]");
  for (const Points& line : study.truth) plot.line(line, {"#000000", 1.5}, "truth");
  const HalvesRow* alone = row_of(study, "dead reckoning, local, fitted rates", false);
  const HalvesRow* together = row_of(study, "local, fitted rates", true);
  for (std::size_t v = 0; v < 2; ++v) {
    const std::string name = "vehicle " + std::to_string(v + 1);
    if (alone) plot.line(alone->paths[v], {vehicle_colors[v], 1.0, "2 3"}, name + " alone");
    if (together) plot.line(together->paths[v], {vehicle_colors[v], 2.0}, name + " fused");
  }
  return "<figure style=\"width:calc(50% - 7px)\">" + plot.svg() + "</figure>\n";
}

std::string halves_nees(const HalvesStudy& study) {
  SvgPlot plot(520.0, 460.0);
  plot.title("fused: NEES / 3 of each pose (lines: both vehicles)");
  plot.x_label("distance driven by each [m]");
  plot.log_y(0.01);
  double end_m = 0.0;
  for (const HalvesRow& row : study.rows) {
    if (!row.fused || row.start == "unknown") continue;
    for (Points line : row.nees) {
      for (Point& p : line) {
        p.y() = std::max(0.01, p.y());
        end_m = std::max(end_m, p.x());
      }
      plot.line(line, look_of(row.model), row.model);
    }
  }
  plot.line({{0.0, 1.0}, {end_m, 1.0}}, {"#9aa5b1", 1.0});
  return "<figure style=\"width:calc(50% - 7px)\">" + plot.svg() + "</figure>\n";
}

std::string halves_section(const HalvesStudy& study) {
  const LoopQuality& q = study.loops;
  std::string html = "<h3>" + xml_escaped(study.name + " cut in the middle: two vehicles") + "</h3>\n";
  html +=
      paragraph(fixed(study.length_m, 0) + " m; " + std::to_string(q.edges) + " loop edges, " +
                std::to_string(q.crossing) + " of them between the two vehicles. Against the truth, edges are off by " +
                fixed(100.0 * q.median_error_m, 1) + " cm and " + fixed(1000.0 * q.median_error_rad, 2) +
                " mrad (medians; they claim " + fixed(100.0 * q.stated_sigma_m, 1) + " cm per axis), the worst by " +
                number(q.worst_error_m) + " m; NEES / 3 is " + number(q.anees) + ". " + std::to_string(study.anchors) +
                " anchors are judged. Rates were fitted on the halves of the other graphs.");
  const HalvesRow* alone = row_of(study, "dead reckoning, local, fitted rates", false);
  const HalvesRow* together = row_of(study, "local, fitted rates", true);
  if (alone && together)
    html += paragraph("By fitted rates, what the map says of the distance between the two is off by " +
                      number(together->distance_rmse_m) + " m instead of " + number(alone->distance_rmse_m) +
                      " m, positions by " + number(together->ate_m) + " m instead of " + number(alone->ate_m) +
                      " m; ANEES " + number(together->anees) + ", " + percent(together->coverage95) +
                      " of the anchors within their 95 % region.");
  html += "<div class=\"row\">\n" + halves_map(study) + halves_nees(study) + "</div>\n";
  html += head({"model", "start of vehicle 2"},
               {"position RMSE [m]", "ANEES", "vehicle 1", "vehicle 2", "coverage", "distance RMSE [m]", "loops used"});
  for (const HalvesRow& row : study.rows)
    html += (row.fused ? "<tr class=\"ours\">" : "<tr>") + text_cell(row.fused ? row.model + ", fused" : row.model) +
            text_cell(row.start) + cell(number(row.ate_m)) + cell(number(row.anees)) + cell(number(row.first_anees)) +
            cell(number(row.second_anees)) + cell(percent(row.coverage95)) + cell(number(row.distance_rmse_m)) +
            cell(row.fused ? std::to_string(row.accepted) + " of " + std::to_string(row.stated) +
                                 (row.left_out.empty() ? "" : " (" + row.left_out + ")") +
                                 (row.linked ? "" : "; the vehicles stay apart")
                           : "–") +
            "</tr>\n";
  return html + table_end;
}

std::string lateral_words(const RealDrift& drift) {
  std::string names;
  for (const auto& [name, sense] : drift.lateral)
    if (sense.mirrored())
      names += (names.empty() ? "" : ", ") + name + " (" + signed_number(sense.said_m_per_rad, 2) +
               " m per radian, truth " + signed_number(sense.true_m_per_rad, 2) + ")";
  if (names.empty()) return "";
  return "The odometry edges of these graphs are published with their lateral component mirrored, their angles and "
         "loop edges are "
         "not: in turns they move the camera to the wrong side: " +
         names + ". That is no drift, so it is turned round before anything is measured.";
}

std::string absent_words(const RealDrift& drift) {
  std::string names;
  for (const std::string& name : drift.absent) names += (names.empty() ? "" : ", ") + name;
  return names.empty() ? "" : "Not in the folder, and so not judged: " + names + ".";
}

}  // namespace

std::string real_drift_section(const RealDrift& drift) {
  std::string html = "<section><h2>Real drift</h2>\n";
  if (!drift.left_out.empty()) return html + paragraph(drift.left_out) + "</section>\n";
  html += paragraph(about_spans);
  html += paragraph("A length is called covered where " + percent(covered_share) + covered_caveat);
  if (!lateral_words(drift).empty()) html += paragraph(lateral_words(drift));
  if (!absent_words(drift).empty()) html += paragraph(absent_words(drift));
  html += overview(drift) + paragraph(what_is_covered);
  for (const SpanStudy& study : drift.spans) html += span_section(study);
  if (!drift.halves.empty()) html += "<h2>Real drives as two vehicles</h2>\n" + paragraph(about_halves);
  for (const HalvesStudy& study : drift.halves) html += halves_section(study);
  html += "<h3>What was fitted</h3>\n" + fit_table(drift);
  html += "<h3>Every span</h3>\n" + span_table(drift);
  return html + "</section>\n";
}

}  // namespace convoy::cli::consistency
