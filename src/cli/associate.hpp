// `convoy associate`: association problems from files, solved one by one.
#pragma once

#include <convoy/association/associate.hpp>

#include <filesystem>
#include <string>
#include <vector>

namespace convoy::cli {

struct AssociateOptions {
  std::vector<std::filesystem::path> problems;  ///< problem files (association/problem_file.hpp)
  std::string method = "alignment";             ///< see association_methods()
  std::filesystem::path out;                    ///< folder; gets NAME.result of each problem; empty: nothing is written
};

/// Names that `method` can have.
std::vector<std::string> association_methods();

/// Solves and writes; prints a line per problem. A result has lines 'pair A_ID B_ID' (the best that was found, also if
/// it is not accepted), 'time_ms T', 'verdict accept|refuse' and what led to it. Returns 0. Throws ConfigError before
/// anything is written if a problem cannot be read.
int run_associate(const AssociateOptions& options);

}  // namespace convoy::cli
