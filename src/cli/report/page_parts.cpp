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
p.source { color: #52606d; margin: 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { border-bottom: 1px solid #e4e7eb; padding: 4px 9px; text-align: right; vertical-align: top; }
th { color: #52606d; font-weight: 600; vertical-align: bottom; }
th.text, td.text { text-align: left; }
td.whole { white-space: nowrap; }
tr.ours td { background: #f0f7f2; }
.miss { color: #b3191b; font-weight: 600; }
.row { display: flex; flex-wrap: wrap; gap: 10px; align-items: flex-start; }
figure { margin: 0; width: calc(33.3% - 7px); }
figure svg { display: block; width: 100%; height: auto; }
@media screen and (max-width: 700px) { figure { width: 100%; } }
)";

}  // namespace

std::string page_begin(const std::string& title) {
  return "<!DOCTYPE html>\n<html xmlns=\"http://www.w3.org/1999/xhtml\" lang=\"en\">\n<head><meta "
         "charset=\"utf-8\"/><title>" +
         xml_escaped(title) + "</title><style>" + style + "</style></head>\n<body>\n";
}

std::string page_end() { return "</body>\n</html>\n"; }

std::string text_cell(const std::string& text) { return "<td class=\"text\">" + xml_escaped(text) + "</td>"; }
std::string whole_cell(const std::string& text) { return "<td class=\"text whole\">" + xml_escaped(text) + "</td>"; }
std::string cell(const std::string& text) { return "<td>" + xml_escaped(text) + "</td>"; }

}  // namespace convoy::cli
