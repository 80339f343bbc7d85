#include "associate.hpp"

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

const std::map<std::string, SearchMethod> methods = {
    {"alignment", SearchMethod::alignment}, {"gcbb", SearchMethod::gcbb}, {"fig5", SearchMethod::fig5}};

AssociationParams params_for(const AssociateOptions& options, double confidence) {
  AssociationParams params;
  params.method = methods.at(options.method);
  params.constraints.compatibility = confidence;
  params.max_nodes = 20'000'000;
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
  for (const auto& [of_map, of_fresh] : result.pairings)
    add("pair %llu %llu\n", static_cast<unsigned long long>(problem.fresh_id[of_fresh.index]),
        static_cast<unsigned long long>(problem.map_id[of_map.index]));
  add("time_ms %.3f\n", ms);
  add("verdict %s\n", result.decision == Decision::accepted ? "accept" : "refuse");
  add("decision %s\n", to_string(result.decision));
  add("rejection %s\n", to_string(result.rejection));
  add("support %d\nrunner_up %d\n", result.support, result.runner_up);
  add("log_likelihood_ratio %.6g\nrunner_up_log_likelihood_ratio %.6g\n", result.log_likelihood_ratio,
      result.runner_up_log_likelihood_ratio);
  add("expected_false_alarms %.3g\n", result.expected_false_alarms);
  add("nodes %llu\n", static_cast<unsigned long long>(result.nodes));
  return text;
}

template <class G>
void solve(const AssociationProblem<G>& problem, const AssociateOptions& options) {
  const AssociationParams params = params_for(options, problem.confidence);
  const auto start = std::chrono::steady_clock::now();
  const AssociationResult<G> result = associate(problem.map, problem.fresh, problem.prior, params, problem.looks_alike);
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
  std::vector<std::string> names;
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
