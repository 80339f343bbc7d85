#include "associate.hpp"

#include <convoy/association/baselines.hpp>
#include <convoy/association/problem_file.hpp>
#include <convoy/config_error.hpp>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <map>
#include <set>
#include <variant>

#include "scenario/table_file.hpp"

namespace convoy::cli {
namespace {

constexpr std::uint64_t max_nodes = 20'000'000;

/// Ways that decide whether what they found means anything ...
const std::map<std::string, SearchMethod> methods = {
    {"alignment", SearchMethod::alignment}, {"gcbb", SearchMethod::gcbb}, {"fig5", SearchMethod::fig5}};

/// ... and those that cannot: they accept whatever is large enough. They know of no signatures.
const std::vector<std::string> baselines = {"delaunay", "jcbb", "triplets"};

template <class G>
AssociationResult<G> by_baseline(const std::string& name, const AssociationProblem<G>& p) {
  const SearchResult found = name == "jcbb"       ? jcbb(p.map, p.fresh, p.prior, p.confidence, max_nodes)
                             : name == "delaunay" ? delaunay(p.map, p.fresh, p.prior, p.confidence)
                                                  : triplets(p.map, p.fresh, p.prior, p.confidence);
  AssociationResult<G> result;
  result.nodes = found.nodes;
  result.support = static_cast<int>(found.pairings.size());
  for (const auto& [i, j] : found.pairings)
    result.pairings.emplace_back(p.map.landmarks[static_cast<std::size_t>(i)].key,
                                 p.fresh.landmarks[static_cast<std::size_t>(j)].key);
  if (found.cut_off) {
    result.rejection = Rejection::search_cut_off;
    return result;
  }
  const bool large = result.support >= AssociationParams().min_pairings;
  result.decision = large ? Decision::accepted : Decision::none;
  result.rejection = large ? Rejection::not_rejected : Rejection::too_few_pairings;
  return result;
}

AssociationParams params_for(const AssociateOptions& options, double confidence) {
  AssociationParams params;
  params.method = methods.at(options.method);
  params.constraints.compatibility = confidence;
  params.max_nodes = max_nodes;
  return params;
}

/// What is written of a result. Pairs by the IDs of the file.
template <class G>
std::string result_text(const AssociationProblem<G>& problem, const AssociationResult<G>& result, double ms) {
  char line[160];
  std::string text = "name " + problem.name + "\n";
  const auto add = [&]<class... Values>(const char* format, Values... values) {
    std::snprintf(line, sizeof line, format, values...);
    text += line;
  };
  const auto add_pairs = [&](const char* word, const std::vector<Pairing>& pairings) {
    for (const auto& [of_map, of_fresh] : pairings)
      add("%s %llu %llu\n", word, static_cast<unsigned long long>(problem.fresh_id[of_fresh.index]),
          static_cast<unsigned long long>(problem.map_id[of_map.index]));
  };
  const auto add_row = [&](const char* word, const auto& values) {
    add("%s", word);
    for (const double x : values) add(" %.9g", x);
    add("\n");
  };
  add_pairs("pair", result.pairings);
  add_pairs("runner_up_pair", result.runner_up_pairings);
  if (result.alignment.dof > 0) {  // of the submap a in the frame of the map b
    const G& T = result.alignment.T_a_b;
    typename G::Tangent motion = G::from_rotation(T.rotation(), G::Point::Zero()).Log();
    motion.template head<G::Dim>() = T.translation();
    add_row("transform", motion);
    add_row("transform_covariance", result.alignment.covariance().reshaped());
  }
  add("time_ms %.3f\n", ms);
  add("verdict %s\n", result.decision == Decision::accepted ? "accept" : "refuse");
  add("decision %s\n", to_string(result.decision));
  add("rejection %s\n", to_string(result.rejection));
  add("support %d\nrunner_up %d\n", result.support, result.runner_up);
  add("log_likelihood_ratio %.6g\nrunner_up_log_likelihood_ratio %.6g\n", result.log_likelihood_ratio,
      result.runner_up_log_likelihood_ratio);
  add("expected_false_alarms %.3g\n", result.expected_false_alarms);
  add("chance_pairings %.3g\n", result.chance_pairings);
  add("nodes %llu\n", static_cast<unsigned long long>(result.nodes));
  return text;
}

template <class G>
void solve(const AssociationProblem<G>& problem, const AssociateOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const AssociationResult<G> result = methods.count(options.method) == 0
                                          ? by_baseline(options.method, problem)
                                          : associate(problem.map, problem.fresh, problem.prior,
                                                      params_for(options, problem.confidence), problem.looks_alike);
  const double ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  std::printf("%-40s %-9s %-18s %3zu pairs, runner-up %2d, %8.1f ms\n", problem.name.c_str(),
              to_string(result.decision), to_string(result.rejection), result.pairings.size(), result.runner_up, ms);
  std::fflush(stdout);
  if (!options.out.empty()) write_text_file(options.out / (problem.name + ".result"), result_text(problem, result, ms));
}

/// Results are named by problems.
void refuse_bad_names(const std::vector<AnyAssociationProblem>& problems, const AssociateOptions& options) {
  std::set<std::string> names;
  for (std::size_t k = 0; k < problems.size(); ++k) {
    const std::string name = std::visit([](const auto& p) { return p.name; }, problems[k]);
    const std::string where = options.problems[k].string() + ": the name '" + name + "' ";
    if (name.empty() || name.find('/') != std::string::npos || name.front() == '.')
      throw ConfigError(where + "cannot name a file of results; give it a line 'name' of letters and digits");
    if (!names.insert(name).second)
      throw ConfigError(where + "is that of another problem, too; give one of them another");
  }
}

}  // namespace

std::vector<std::string> association_methods() {
  std::vector<std::string> names = baselines;
  for (const auto& [name, method] : methods) names.push_back(name);
  return names;
}

int run_associate(const AssociateOptions& options) {
  if (!options.out.empty()) expect_writable(options.out);
  std::vector<AnyAssociationProblem> problems;
  for (const auto& path : options.problems) problems.push_back(read_association_problem(path));
  refuse_bad_names(problems, options);
  for (const AnyAssociationProblem& any : problems)
    std::visit([&](const auto& problem) { solve(problem, options); }, any);
  return 0;
}

}  // namespace convoy::cli
