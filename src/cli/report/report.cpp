#include "report/report.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "report/figures.hpp"
#include "report/front_end_section.hpp"
#include "report/page_parts.hpp"
#include "report/svg_plot.hpp"
#include "scenario/table_file.hpp"

namespace convoy::cli {
using nlohmann::json;
namespace {

/// A number with fixed decimals and a unit, or a dash when it is not known.
std::string show(const json& value, int decimals, const std::string& unit = {}) {
  if (!value.is_number()) return "\u2013";
  return fixed(value.get<double>(), decimals) + (unit.empty() ? "" : " " + unit);
}

std::string show_percent(const json& share) {
  return share.is_number() ? fixed(100.0 * share.get<double>(), 1) + " %" : "\u2013";
}

/// "95.7 / 97.6 %"
std::string show_percents(const json& first, const json& second) {
  const auto number = [](const json& share) { return share.is_number() ? json(100.0 * share.get<double>()) : json(); };
  return show(number(first), 1) + " / " + show(number(second), 1) + " %";
}

std::string show_yes_no(const json& value) {
  if (!value.is_boolean()) return "\u2013";
  return value.get<bool>() ? "yes" : "no";
}

std::string show_text(const json& value) { return value.is_string() ? value.get<std::string>() : "\u2013"; }

/// The largest of a number over a list; null if nobody has it.
json worst(const json& list, const char* key) {
  json result;
  for (const json& entry : list) {
    const json value = entry.value(key, json());
    if (value.is_number() && (result.is_null() || value.get<double>() > result.get<double>())) result = value;
  }
  return result;
}

/// The pairs whose settled distances were compared often enough to say something.
json judged_pairs(const json& pairs) {
  json judged = json::array();
  for (const json& pair : pairs)
    if (pair.at("distance_samples_settled") >= enough_distance_samples) judged.push_back(pair);
  return judged;
}

std::string count_word(std::size_t count) {
  static const char* const words[] = {"No",  "One",   "Two",   "Three", "Four", "Five",
                                      "Six", "Seven", "Eight", "Nine",  "Ten"};
  return count < std::size(words) ? words[count] : std::to_string(count);
}

std::string tile(const std::string& value, const std::string& what, bool bad = false) {
  return std::string("<div class=\"tile") + (bad ? " bad" : "") + "\"><b>" + xml_escaped(value) + "</b><span>" +
         xml_escaped(what) + "</span></div>\n";
}

bool judged_by_poses(const json& associations) { return associations.value("judged_by", json()) == json("poses"); }

std::string tiles(const json& m) {
  const json& associations = m.at("associations");
  const auto above_zero = [](const json& value) { return value.is_number() && value.get<double>() > 0.0; };
  std::string out = "<div class=\"tiles\">\n";
  const json judged = judged_pairs(m.at("pairs"));
  out += tile(
      show(worst(judged, "distance_rmse_settled_m"), 3, "m"),
      judged.empty() ? "distance RMSE: too few samples" : "distance RMSE, worst pair, from 10 s after association");
  if (m.at("fleet_ate_m").is_number()) out += tile(show(m.at("fleet_ate_m"), 3, "m"), "fleet ATE");
  if (m.at("landmark_rmse_m").is_number()) out += tile(show(m.at("landmark_rmse_m"), 3, "m"), "landmark RMSE");
  out += tile(show_percent(m.at("fleet_coverage95")), "of live poses within 95 % bound");
  if (judged_by_poses(associations))
    out += tile(show(associations.at("hypotheses_accepted"), 0) + " / " + show(associations.at("hypotheses_false"), 0),
                "hypotheses accepted / false by the poses", above_zero(associations.at("hypotheses_false")));
  else
    out += tile(show(associations.at("true"), 0) + " / " + show(associations.at("false"), 0), "pairings true / false",
                above_zero(associations.at("false")));
  out += tile(show(m.at("facts_lost"), 0), "facts lost", above_zero(m.at("facts_lost")));
  out += tile(show_yes_no(m.at("map_digests_equal")), "all maps equal", m.at("map_digests_equal") == json(false));
  out += tile(show(worst(m.at("vehicles"), "bytes_per_s_mean"), 0, "B/s"), "sent, busiest vehicle");
  out += tile(show(m.at("real_time_factor"), 1, "x"), "vehicle time per second");
  return out + "</div>\n";
}

using Row = std::vector<std::string>;

std::string table(const Row& head, const std::vector<Row>& rows) {
  std::string out = "<div class=\"scroll\"><table>\n<thead><tr>";
  for (const std::string& text : head) out += "<th>" + xml_escaped(text) + "</th>";
  out += "</tr></thead>\n<tbody>\n";
  for (const Row& row : rows) {
    out += "<tr>";
    for (const std::string& text : row) out += "<td>" + xml_escaped(text) + "</td>";
    out += "</tr>\n";
  }
  return out + "</tbody></table></div>\n";
}

/// "OK", "SUSPECT: innovation, ...".
std::string show_integrity(const json& vehicle) {
  std::string text = show_text(vehicle.at("integrity")), separator = ": ";
  for (const json& reason : vehicle.value("reasons", json::array())) {
    text += separator + show_text(reason);
    separator = ", ";
  }
  return text;
}

template <class G>
std::string vehicle_table(const RunRecord<G>& run, const json& m) {
  std::vector<Row> rows;
  for (const json& v : m.at("vehicles"))
    rows.push_back({vehicle_name(run, v.at("id")) + (v.at("lost") == json(true) ? " (lost)" : ""),
                    show(v.at("landmarks_exported"), 0), show(v.at("landmarks_known"), 0),
                    show(v.at("facts_missing"), 0), show(v.at("ate_m"), 3),
                    show(v.at("pose_anees_fit"), 2) + " / " + show(v.at("pose_anees_start"), 2),
                    show_percents(v.at("pose_coverage95_fit"), v.at("pose_coverage95_start")),
                    show(v.at("trajectory_anees"), 2), show_percent(v.at("trajectory_coverage95")),
                    show(v.at("bytes_per_s_mean"), 0), show(v.at("bytes_per_s_max"), 0), show(v.at("requests_sent"), 0),
                    show(v.at("peak_rss_mb"), 0), show_integrity(v), show_text(v.at("map_digest")).substr(0, 8)});
  return table({"vehicle", "landmarks exported", "known", "facts missing", "ATE [m]", "live ANEES, gauge fit / start",
                "live within 95 %, gauge fit / start", "final ANEES", "final within 95 %", "mean [B/s]", "worst [B/s]",
                "requests", "memory [MB]", "integrity", "map digest"},
               rows);
}

/// Why a coarse truth says nothing of covariances.
std::string coarse_truth_note(const json& m) {
  const json& tolerance = m.at("pose_tolerance");
  if (tolerance.is_null()) return "";
  return " The truth of poses is itself a measurement: two of its poses may contradict each other by " +
         show(tolerance.at("position_m"), 1, "m") + " and " + show(tolerance.at("heading_rad"), 2, "rad") +
         ". Hypotheses are false if they contradict it by more; covariances are not judged, and its errors are part of "
         "every position and distance error.";
}

/// What a gauge is, and why one of them may be hard on the common-frame vehicle.
template <class G>
std::string vehicle_note(const RunRecord<G>& run, const json& m) {
  return "<p class=\"note\">Gauge start lays the truth onto the true start of " +
         xml_escaped(the_vehicle(run, run.common_frame_vehicle)) +
         ", gauge fit onto all corrected trajectories by one rigid motion; this run is judged in gauge " +
         show_text(m.at("gauge")) + "." + xml_escaped(gauge_note(run, m)) + coarse_truth_note(m) + "</p>\n";
}

/// "0.071 (154)": a distance of a pair, and how many samples it rests on.
std::string show_counted(const json& pair, const char* distance, const char* samples, int decimals = 3) {
  return show(pair.at(distance), decimals) + " (" + show(pair.at(samples), 0) + ")";
}

template <class G>
std::string pair_table(const RunRecord<G>& run, const json& m) {
  std::vector<Row> rows;
  for (const json& p : m.at("pairs"))
    rows.push_back({vehicle_name(run, p.at("a")) + " \u2013 " + vehicle_name(run, p.at("b")),
                    show(p.at("first_association_s"), 1),
                    show_counted(p, "distance_rmse_raw_m", "distance_samples_raw", 2),
                    show_counted(p, "distance_rmse_m", "distance_samples"),
                    show_counted(p, "distance_rmse_settled_m", "distance_samples_settled"),
                    show(p.at("distance_error_final_m"), 3) + " at " + show(p.at("distance_error_final_s"), 0, "s"),
                    show_counted(p, "distance_rmse_corrected_m", "distance_samples_corrected")});
  return table({"pair", "first association [s]", "distance RMSE, SLAM alone [m]", "live, after association [m]",
                "live, 10 s later on [m]", "live, final error [m]", "corrected, whole run [m]"},
               rows) +
         "<p class=\"note\">In brackets: how many comparisons with the truth a figure rests on; below " +
         std::to_string(enough_distance_samples) +
         " it says nothing. Live is what the vehicles knew at that moment; corrected is what they know of the whole "
         "run "
         "after it, from trajectories corrected with the final map.</p>\n";
}

std::string fleet_table(const json& m) {
  const json& a = m.at("associations");
  const auto number = [&a](const char* key) { return show(a.value(key, json()), 0); };
  return table(
      {"fleet", ""},
      {{"position error of the corrected trajectories (ATE, one rigid alignment)", show(m.at("fleet_ate_m"), 3, "m")},
       {"landmark error (one rigid alignment)", show(m.at("landmark_rmse_m"), 3, "m")},
       {"ANEES of the live poses, gauge fit / gauge start (1 is ideal)",
        show(m.at("fleet_anees_fit"), 2) + " / " + show(m.at("fleet_anees_start"), 2)},
       {"live poses within their 95 % bound, gauge fit / gauge start",
        show_percents(m.at("fleet_coverage95_fit"), m.at("fleet_coverage95_start"))},
       {judged_by_poses(a) ? "hypotheses accepted / false / unjudged, by the poses"
                           : "hypotheses accepted / with a false pairing",
        number("hypotheses_accepted") + " / " + number("hypotheses_false") +
            (judged_by_poses(a) ? " / " + number("hypotheses_unjudged") : "")},
       {"pairings accepted / true / false", number("accepted") + " / " + number("true") + " / " + number("false")},
       {"of these between vehicles / false", number("between_vehicles") + " / " + number("between_vehicles_false")},
       {"every vehicle in the common frame", show_yes_no(m.at("all_in_common_frame"))},
       {"every vehicle linked to the others by pairings", show_yes_no(m.at("all_linked"))},
       {"same map on every vehicle", show_yes_no(m.at("map_digests_equal"))},
       {"facts lost", show(m.at("facts_lost"), 0)},
       {"vehicle time / wall time", show(m.at("vehicle_s"), 1, "s") + " / " + show(m.at("wall_s"), 1, "s")}});
}

template <class G>
std::string source_line(const RunRecord<G>& run) {
  std::string text = "Scenario " + run.scenario;
  if (run.info.contains("source") && run.info.at("source").is_string())
    text += ", " + run.info.at("source").template get<std::string>();
  if (run.info.contains("seed") && run.info.at("seed").is_number()) text += ", seed " + show(run.info.at("seed"), 0);
  if (run.info.contains("impair") && run.info.at("impair").is_string() &&
      !run.info.at("impair").template get<std::string>().empty())
    text += ", impaired exchange: " + run.info.at("impair").template get<std::string>();
  text += ".";
  if (const std::string notice = run.info.value("notice", ""); !notice.empty()) text += " " + notice + ".";
  return text;
}

}  // namespace

namespace {

std::string count_false(const json& count) {
  return (count == json(0) ? "none is" : show(count, 0) + (count == json(1) ? " is" : " are")) + " false";
}

/// What the distances between vehicles are known to, once both have settled; only for the pairs that came so far.
std::string of_distances(const json& pairs) {
  const json judged = judged_pairs(pairs);
  if (judged.empty()) return "";
  const json distance = worst(judged, "distance_rmse_settled_m");
  json raw;
  std::size_t fewest = SIZE_MAX;
  for (const json& pair : judged) {
    fewest = std::min(fewest, pair.at("distance_samples_settled").get<std::size_t>());
    if (pair.at("distance_rmse_settled_m") == distance) raw = pair.at("distance_rmse_raw_settled_m");
  }
  const std::string which = judged.size() == pairs.size() ? "the distance between any two"
                                                          : "the distance of " + std::to_string(judged.size()) +
                                                                " of " + std::to_string(pairs.size()) + " pairs";
  return "from ten seconds after their association on, " + which + " is known to " + show(distance, 2, "m") +
         " RMSE or better (SLAM alone in the same time: " + show(raw, 1, "m") + "; " + std::to_string(fewest) +
         (judged.size() > 1 ? " samples of a pair or more)" : " samples)");
}

/// Why nothing is said of distances, where there are pairs.
std::string without_distances(const json& pairs) {
  if (pairs.empty()) return "";
  if (worst(pairs, "distance_samples_raw") == json(0))
    return "no live distance between vehicles could be compared with a truth";
  if (worst(pairs, "first_association_s").is_null()) return "no two vehicles were associated, so no distance is judged";
  return "live distances are not judged, for from ten seconds after association on there are at most " +
         show(worst(pairs, "distance_samples_settled"), 0) + " samples of a pair, and it takes " +
         std::to_string(enough_distance_samples) + " (a lower --rate gives more)";
}

std::string sentence_case(std::string text) {
  if (!text.empty() && text[0] >= 'a' && text[0] <= 'z') text[0] = static_cast<char>(text[0] - 'a' + 'A');
  return text;
}

/// What the fleet came to, without a full stop: one map, or the first thing that is in its way.
template <class G>
std::string outcome(const RunRecord<G>& run, const json& m) {
  const std::string fleet = run.vehicles.size() == 1 ? "One vehicle "
                                                     : count_word(run.vehicles.size()) +
                                                           " vehicles that did not know where the others started ";
  std::string idle;
  for (const json& vehicle : m.at("vehicles"))
    if (vehicle.at("landmarks_exported") == json(0))
      idle += (idle.empty() ? "" : ", ") + vehicle_name(run, vehicle.at("id"));
  if (!idle.empty()) return fleet + "do not share one map, for not all of them mapped anything (" + idle + ")";
  if (m.at("all_aligned") == json(true)) return fleet + (run.vehicles.size() == 1 ? "made a map" : "share one map");
  if (m.at("map_digests_equal") == json(false)) return fleet + "do not hold the same map";
  if (m.at("all_in_common_frame") == json(false)) return fleet + "have not all found one common frame";
  if (m.at("all_linked") == json(false)) return fleet + "have not all found landmarks in common";
  return fleet + "left too little to judge their map by";
}

}  // namespace

template <class G>
std::string headline(const RunRecord<G>& run, const json& m) {
  std::string text = outcome(run, m);
  std::string found = of_distances(m.at("pairs"));
  if (found.empty()) {
    found = without_distances(m.at("pairs"));
    if (m.at("landmark_rmse_m").is_number())
      found += (found.empty() ? "" : "; ") +
               ("landmarks are " + show(m.at("landmark_rmse_m"), 2, "m") + " RMSE from the truth");
  }
  text += (found.empty() ? "" : ": " + found) + ".";
  const json& a = m.at("associations");
  const json& false_pairings = a.at("false");
  if (false_pairings.is_number() && a.at("unjudged") != json(0))
    text += " " + show(a.at("unjudged"), 0) +
            " landmark pairings could not be judged, for nothing says what their landmarks are.";
  if (false_pairings.is_number())
    text += " Of " + show(a.at("between_vehicles"), 0) + " landmark pairings between vehicles " +
            count_false(a.at("between_vehicles_false")) +
            (a.at("within_a_vehicle") == json(0) ? ""
                                                 : ", of " + show(a.at("within_a_vehicle"), 0) + " within a vehicle " +
                                                       count_false(a.at("within_a_vehicle_false")));
  if (judged_by_poses(a))
    text += " Of " + show(a.at("hypotheses_accepted"), 0) + " accepted hypotheses " +
            count_false(a.at("hypotheses_false")) + " by the measured poses, and " +
            show(a.at("hypotheses_unjudged"), 0) + " could not be judged";
  const bool began = false_pairings.is_number() || judged_by_poses(a);
  const json bytes = worst(m.at("vehicles"), "bytes_per_s_mean");
  if (bytes.is_number())
    text += std::string(began ? "; " : " ") + "no vehicle sent more than " +
            show(bytes.get<double>() / 1000.0, 2, "KB/s") + " on average";
  if (began || bytes.is_number()) text += ".";
  if (!m.at("lost_vehicles").empty()) {
    text += " Lost on the way:";
    for (std::size_t i = 0; i < m.at("lost_vehicles").size(); ++i)
      text += (i > 0 ? ", " : " ") + vehicle_name(run, m.at("lost_vehicles")[i]);
    text += ".";
  }
  for (const json& vehicle : m.at("vehicles"))
    if (vehicle.at("integrity") == json("SUSPECT"))
      text += " " + sentence_case(vehicle_name(run, vehicle.at("id"))) + " is " + show_integrity(vehicle) + ".";
  return text;
}

namespace {

template <class G>
std::string front_ends(const RunRecord<G>& run, const json& m) {
  std::vector<FrontEndDrive> drives;
  for (const VehicleRecord<G>& vehicle : run.vehicles) drives.push_back({vehicle.front_end, in_space(vehicle.truth)});
  if (drives.size() == 1)
    return front_end_section(m.at("front_end"), drives.front().frames, drives.front().truth, run.folder);
  return front_end_section(m.at("front_end"), m.at("vehicles"), drives);
}

}  // namespace

template <class G>
std::string make_report(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  const json& m = evaluation.metrics;
  std::string page = page_begin("convoy: " + run.scenario);
  page += "<h1>convoy: what a run came to</h1>\n<p class=\"lead\">" + xml_escaped(headline(run, m)) +
          "</p>\n<p class=\"source\">" + xml_escaped(source_line(run)) + "</p>\n" + tiles(m);
  if (!m.at("front_end").is_null()) page += front_ends(run, m);
  for (const Figure& figure : make_figures(run, evaluation))
    page += "<section>\n<h2>" + xml_escaped(figure.title) + "</h2>\n<figure>\n" + figure.body + "<figcaption>" +
            xml_escaped(figure.caption) + "</figcaption>\n</figure>\n</section>\n";
  page += "<section>\n<h2>Metrics</h2>\n" + fleet_table(m) + "</section>\n<section>\n<h2>Vehicles</h2>\n" +
          vehicle_table(run, m) + vehicle_note(run, m) + "</section>\n";
  if (!m.at("pairs").empty()) page += "<section>\n<h2>Pairs</h2>\n" + pair_table(run, m) + "</section>\n";
  return page + page_end();
}

template <class G>
void write_report(const RunRecord<G>& run, const Evaluation<G>& evaluation) {
  write_text_file(run.folder / "report.html", make_report(run, evaluation));
}

#define CONVOY_INSTANTIATE(G)                                                  \
  template std::string headline(const RunRecord<G>&, const json&);             \
  template std::string make_report(const RunRecord<G>&, const Evaluation<G>&); \
  template void write_report(const RunRecord<G>&, const Evaluation<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy::cli
