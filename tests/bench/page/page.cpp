#include "page/page.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "report/page_parts.hpp"
#include "report/svg_plot.hpp"

namespace convoy::bench {
namespace {

using cli::cell, cli::fixed, cli::text_cell, cli::whole_cell, cli::xml_escaped;

constexpr const char* about =
    R"(Times are CPU time of one thread, so that other load on the machine counts as little as can
be. A figure is the median over repetitions of its bench, the least and the greatest beside it; where a bench has quantiles of
its own, they are over the updates of one run. Times are asked of an idle machine with two cores and repeat to ±30 % from run to run and from machine to machine, so
that a time above what is asked by no more is told as "met within the 30 %"; sizes do repeat, and have no such tolerance. Baselines were measured in the same run, on one thread as well; a ratio
is ours to theirs, below 1 where convoy takes less. Costs are equal if they differ by no more than 1e-6, relative.)";

// Three digits, and no exponent where the figure is a time or a size.
std::string digits(double value) {
  if (!std::isfinite(value)) return "not finite";
  if (value == 0.0) return "0";
  const int decimals = 2 - static_cast<int>(std::floor(std::log10(std::abs(value))));
  return decimals > 8 ? fixed(value, 8) : fixed(value, std::max(0, decimals));
}

bool is_cost(const Demand& demand) { return demand.asked.kind == Asked::Kind::equal; }

std::string number(const Demand& demand, double value) {
  return (is_cost(demand) ? fixed(value, 8) : digits(value)) + (demand.unit.empty() ? "" : " " + demand.unit);
}

// As it was asked: 0.3, not 0.300.
std::string asked_words(const Demand& demand) {
  char plain[32];
  std::snprintf(plain, sizeof plain, "%.10g", demand.asked.figure);
  switch (demand.asked.kind) {
    case Asked::Kind::at_most: return "≤ " + std::string(plain) + " " + demand.unit;
    case Asked::Kind::equal: return number(demand, demand.asked.figure);
    case Asked::Kind::nothing: break;
  }
  return "–";
}

std::string measured_words(const Demand& demand, const Figure& figure) {
  return figure.measured() ? number(demand, figure.median) : figure.why_not;
}

std::string spread_words(const Demand& demand, const Figure& figure) {
  if (figure.repetitions < 2) return "–";
  const auto plain = [&](double value) { return is_cost(demand) ? fixed(value, 8) : digits(value); };
  return plain(figure.low) + " – " + plain(figure.high);
}

std::string ratio_words(const Row& row, double ratio) {
  if (!is_cost(row.demand)) return ", ratio " + digits(ratio);
  char text[40];
  std::snprintf(text, sizeof text, ", differs by %.1e", ratio);
  return text;
}

std::string baseline_words(const Row& row, const Compared& compared) {
  const Figure& figure = compared.figure;
  if (!figure.measured()) return compared.baseline.what + ": " + figure.why_not;
  const bool says_more = compared.baseline.source.bench != row.demand.source.bench && !figure.label.empty();
  return compared.baseline.what + ": " + number(row.demand, figure.median) +
         (compared.ratio ? ratio_words(row, *compared.ratio) : "") + (says_more ? " (" + figure.label + ")" : "");
}

std::string baseline_cell(const Row& row) {
  std::string html = "<td class=\"text\">";
  for (const Compared& compared : row.baselines)
    html += (&compared == &row.baselines.front() ? "" : "<br/>") + xml_escaped(baseline_words(row, compared));
  return html + (row.baselines.empty() ? "–</td>" : "</td>");
}

const char* look_of(Verdict verdict) {
  return verdict == Verdict::miss || verdict == Verdict::not_measured ? "text miss" : "text";
}

std::string verdict_cell(Verdict verdict) {
  return std::string("<td class=\"") + look_of(verdict) + "\">" + to_string(verdict) + "</td>";
}

std::string table_row(const Row& row) {
  return "<tr>" + whole_cell(row.demand.what) + whole_cell(asked_words(row.demand)) +
         text_cell(measured_words(row.demand, row.figure)) + cell(spread_words(row.demand, row.figure)) +
         verdict_cell(row.verdict) + baseline_cell(row) + "</tr>\n";
}

// Rows of one section stand together.
std::string row_tables(const Judgement& judgement) {
  std::string html, section;
  for (const Row& row : judgement.rows) {
    if (row.demand.section != section) {
      if (!section.empty()) html += "</table></div>\n";
      section = row.demand.section;
      html += "<h3>" + xml_escaped(section) +
              "</h3>\n<div class=\"scroll\"><table><tr><th class=\"text\"></th><th class=\"text\">asked</th><th "
              "class=\"text\">"
              "measured</th><th>least – greatest</th><th class=\"text\"></th><th class=\"text\">baselines</th></tr>\n";
    }
    html += table_row(row);
  }
  return section.empty() ? html : html + "</table></div>\n";
}

std::string list_of(const Judgement& judgement, Verdict verdict) {
  if (judgement.count(verdict) == 0) return {};
  std::string html = "<ul>\n";
  for (const Row& row : judgement.rows)
    if (row.verdict == verdict)
      html += std::string("<li><span class=\"") + look_of(verdict) + "\">" + to_string(verdict) +
              "</span>: " + xml_escaped(row.demand.section) + ": " + xml_escaped(row.demand.what) + ": " +
              xml_escaped(measured_words(row.demand, row.figure)) + ", asked " + xml_escaped(asked_words(row.demand)) +
              "</li>\n";
  return html + "</ul>\n";
}

std::string machine_words(const Machine& machine) {
  return machine.cpu + ", " + std::to_string(machine.cores) + (machine.cores == 1 ? " core" : " cores") +
         "; load average " + fixed(machine.load_at_start, 2) + " before the benches, " + fixed(machine.load_at_end, 2) +
         " after them (their own is 1).";
}

std::string machine_section(const Machine& machine) {
  std::string html = "<p class=\"source\">" + xml_escaped(machine_words(machine)) + "</p>\n";
  if (!machine.idle())
    html +=
        "<p class=\"lead miss\">Warning: others were computing on this machine. These are not the figures of an idle "
        "machine; run scripts/bench again when it is idle.</p>\n";
  return html;
}

bool was_run(const Judgement& judgement, const std::string& bench) { return judgement.results.contains(bench); }

std::string optional_section(const Judgement& judgement) {
  std::string html =
      "<section><h2>Baselines that are optional</h2>\n<p>Only benches link them, each in an executable of its "
      "own; convoy does not need them, and scripts/setup does not install them.</p>\n<ul>\n";
  for (const OptionalBench& optional : optional_benches())
    html += "<li>" + xml_escaped(optional.library) + ": " +
            (was_run(judgement, optional.bench) ? "installed" : "not installed") + "; <code>apt-get install " +
            xml_escaped(optional.packages) + "</code>, then scripts/bench</li>\n";
  return html + "</ul></section>\n";
}

std::string median_words(const Judgement& judgement, const Source& source) {
  const Figure figure = figure_of(source, judgement.results);
  return figure.measured() ? digits(figure.median) : "–";
}

std::string all_section(const Judgement& judgement) {
  std::string html =
      "<section><h2>Every benchmark</h2>\n<p>All counters of all repetitions are in the folder results "
      "beside this page.</p>\n<div class=\"scroll\"><table><tr><th class=\"text\">program"
      "</th><th class=\"text\">benchmark</th><th>CPU time [ms]</th><th>ratio to baseline</th><th class=\"text\"></th>"
      "</tr>\n";
  for (const auto& [bench, results] : judgement.results) {
    if (!results.fault.empty())
      html += "<tr>" + text_cell("convoy_bench_" + bench) + "<td></td><td></td><td></td>" + text_cell(results.fault) +
              "</tr>\n";
    for (const auto& [name, measured] : results.by_name)
      html += "<tr>" + text_cell("convoy_bench_" + bench) + text_cell(name) +
              cell(median_words(judgement, {bench, name, "cpu_ms"})) +
              cell(median_words(judgement, {bench, name, "ratio_to_baseline"})) +
              text_cell(measured.fault.empty() ? measured.label : "not measured: " + measured.fault) + "</tr>\n";
  }
  return html + "</table></div></section>\n";
}

}  // namespace

std::string headline(const Judgement& judgement) {
  const std::size_t narrowly = judgement.count(Verdict::met_within_tolerance);
  const std::size_t met = judgement.count(Verdict::met) + narrowly, missed = judgement.count(Verdict::miss),
                    unmeasured = judgement.count(Verdict::not_measured);
  const auto if_any = [](std::size_t n, const std::string& words) { return n ? words : std::string(); };
  return std::to_string(met) + " of " + std::to_string(met + missed + unmeasured) + " demands met" +
         if_any(narrowly, " (" + std::to_string(narrowly) + " of them within the 30 %)") + ", " +
         std::to_string(missed) + " missed" + if_any(unmeasured, ", " + std::to_string(unmeasured) + " not measured");
}

std::string verdict_line(const Row& row) {
  return std::string(to_string(row.verdict)) + "  " + row.demand.section + ": " + row.demand.what + ": " +
         measured_words(row.demand, row.figure) + " (asked: " + asked_words(row.demand) + ")";
}

std::string bench_page(const Judgement& judgement, const Machine& machine) {
  return cli::page_begin("convoy: speed") + "<h1>Speed</h1>\n<p class=\"lead\">" + xml_escaped(headline(judgement)) +
         ".</p>\n" + machine_section(machine) + list_of(judgement, Verdict::miss) +
         list_of(judgement, Verdict::not_measured) + list_of(judgement, Verdict::met_within_tolerance) +
         "<section><h2>What is asked, and what was measured</h2>\n<p>" + xml_escaped(about) + "</p>\n" +
         row_tables(judgement) + "</section>\n" + optional_section(judgement) + all_section(judgement) +
         cli::page_end();
}

nlohmann::ordered_json bench_json(const Judgement& judgement, const Machine& machine) {
  nlohmann::ordered_json out{{"cpu", machine.cpu},
                             {"cores", machine.cores},
                             {"load_average_at_start", machine.load_at_start},
                             {"load_average_at_end", machine.load_at_end},
                             {"idle", machine.idle()}};
  out.update(to_json(judgement));
  return out;
}

}  // namespace convoy::bench
