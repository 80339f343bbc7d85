// The figures of the report, numbered as in the paper (Section V).
#pragma once

#include <string>
#include <vector>

#include "evaluate/evaluate.hpp"

namespace convoy::cli {

struct Figure {
  std::string title;
  std::string body;     ///< XHTML: one or more drawings
  std::string caption;  ///< plain text
};

/// Figures 9 to 14 and the consistency over time; in space, paths and maps from above, and the heights besides. A
/// figure whose data are missing says so in its caption.
template <class G>
std::vector<Figure> make_figures(const RunRecord<G>& run, const Evaluation<G>& evaluation);

/// How far the gauges "start" and "fit" (evaluate.hpp) lie apart, and why "fit" may give the common-frame vehicle a
/// huge ANEES, with both gauges' numbers, as sentences with a blank before; empty if one of the gauges is not known.
template <class G>
std::string gauge_note(const RunRecord<G>& run, const nlohmann::json& metrics);

/// "front vehicle", "back vehicle" on the street; "robot N" otherwise.
template <class G>
std::string vehicle_name(const RunRecord<G>& run, VehicleId id);

/// The same within a sentence: "the front vehicle", "robot 3".
template <class G>
std::string the_vehicle(const RunRecord<G>& run, VehicleId id);

/// The colour of a vehicle in all figures: green for the first, blue for the second (as in the paper), then others.
template <class G>
std::string vehicle_color(const RunRecord<G>& run, VehicleId id);

}  // namespace convoy::cli
