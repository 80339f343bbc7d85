// The picture of a run: one self-contained page (XHTML with inline SVG, no scripts) that shows what the paper's
// figures 9 to 14 show, for this run, and the metrics as tables. Of a run with a camera its front end, too; only the
// camera's images lie beside the page.
#pragma once

#include <string>

#include "evaluate/evaluate.hpp"

namespace convoy::cli {

/// The page as text.
template <class G>
std::string make_report(const RunRecord<G>& run, const Evaluation<G>& evaluation);

/// Writes RUN/report.html. Throws ConfigError.
template <class G>
void write_report(const RunRecord<G>& run, const Evaluation<G>& evaluation);

/// The result in one or two sentences of plain text, for the head of the page and for a terminal.
template <class G>
std::string headline(const RunRecord<G>& run, const nlohmann::json& metrics);

}  // namespace convoy::cli
