#include <convoy/config_error.hpp>
#include <convoy/map/selection.hpp>

#include <cmath>

namespace convoy {

void validate(const SelectionParams& p) {
  const auto demand = [](bool holds, const char* name, double value, const char* range) {
    if (!(holds && std::isfinite(value))) throw RangeError("map", name, value, range);
  };
  const auto confidence = [&](const char* name, double value) {
    demand(value > 0.0 && value < 1.0, name, value, "lie in (0, 1)");
  };
  demand(p.min_pairings >= 3, "min_pairings", p.min_pairings, "be 3 or more; two pairs align with anything");
  confidence("residual", p.residual);
  confidence("map_residual", p.map_residual);
  demand(p.max_runner_up_share > 0.0 && p.max_runner_up_share <= 1.0, "max_runner_up_share", p.max_runner_up_share,
         "lie in (0, 1]");
  demand(p.slack.scale >= 0.0, "scale_slack", p.slack.scale, "be >= 0");
  demand(p.slack.heading_rad_per_m >= 0.0, "heading_slack_rad_per_m", p.slack.heading_rad_per_m, "be >= 0");
  demand(p.min_confirmed >= 1, "min_confirmed", p.min_confirmed, "be 1 or more; 1 trusts the first association");
  confidence("separation", p.separation);
  demand(p.fix_correlation_s >= 0.0, "fix_correlation_s", p.fix_correlation_s, "be >= 0");
  confidence("fix_residual", p.fix_residual);
}

}  // namespace convoy
