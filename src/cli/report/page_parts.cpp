#include "report/page_parts.hpp"

#include "report/svg_plot.hpp"

namespace convoy::cli {
namespace {

constexpr const char* style = R"(
:root { color: #1f2933; background: #ffffff; font-family: system-ui, "DejaVu Sans", Helvetica, Arial, sans-serif; }
body { max-width: 1100px; margin: 0 auto; padding: 24px 20px 60px; font-size: 15px; line-height: 1.5; }
h1 { font-size: 26px; margin: 0 0 4px; }
h2 { font-size: 18px; margin: 36px 0 8px; }
h3 { font-size: 15px; margin: 24px 0 4px; }
p.lead { font-size: 17px; margin: 6px 0 14px; }
p.note { color: #3e4c59; font-size: 14px; margin: 6px 0 0; }
p.source { color: #52606d; margin: 0; }
.tiles { display: flex; flex-wrap: wrap; gap: 10px; margin: 14px 0; }
.tile { border: 1px solid #cbd2d9; border-radius: 6px; padding: 8px 14px; min-width: 118px; }
.tile b { display: block; font-size: 20px; font-variant-numeric: tabular-nums; }
.tile span { color: #52606d; font-size: 13px; }
.tile.bad { border-color: #d62728; }
.tile.bad b { color: #b3191b; }
figure { margin: 0; }
figure svg, figure img { display: block; width: 100%; height: auto; }
figcaption { color: #3e4c59; font-size: 14px; margin-top: 4px; }
p.key { margin: 0 0 4px; font-size: 13px; }
p.key span { margin-right: 22px; white-space: nowrap; }
p.key svg { display: inline-block; width: 26px; height: 10px; }
.row { display: flex; flex-wrap: wrap; gap: 10px; align-items: flex-start; }
.two-thirds { width: calc(66.4% - 5px); }
.half { width: calc(50% - 5px); }
.third, .row figure { width: calc(33.3% - 7px); }
@media screen and (max-width: 700px) { .two-thirds, .half, .third, .row figure { width: 100%; } }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid #e4e7eb; padding: 4px 9px; text-align: right; vertical-align: top; }
th { color: #52606d; font-weight: 600; vertical-align: bottom; }
th:first-child, td:first-child, th.text, td.text { text-align: left; }
td.whole { white-space: nowrap; }
tr.ours td { background: #f0f7f2; }
.miss { color: #b3191b; font-weight: 600; }
@media print {
  body { max-width: none; padding: 0; font-size: 11px; }
  section { break-inside: avoid; }
  table { font-size: 9px; }
}
)";

}  // namespace

std::string page_begin(const std::string& title) {
  return "<!DOCTYPE html>\n<html xmlns=\"http://www.w3.org/1999/xhtml\" lang=\"en\">\n<head>\n<meta "
         "charset=\"utf-8\"/>\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>" +
         xml_escaped(title) + "</title>\n<style>" + style + "</style>\n</head>\n<body>\n";
}

std::string page_end() { return "</body>\n</html>\n"; }

std::string text_cell(const std::string& text) { return "<td class=\"text\">" + xml_escaped(text) + "</td>"; }
std::string whole_cell(const std::string& text) { return "<td class=\"text whole\">" + xml_escaped(text) + "</td>"; }
std::string cell(const std::string& text) { return "<td>" + xml_escaped(text) + "</td>"; }

}  // namespace convoy::cli
