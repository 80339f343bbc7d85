// How each of the programs ends.
#pragma once

#include <convoy/config_error.hpp>

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>
#include <CLI/CLI.hpp>

#include <exception>

namespace convoy::cli {

/// What a program logs goes to standard error; standard output is for results.
inline void log_to_standard_error() { spdlog::set_default_logger(spdlog::stderr_logger_mt("convoy")); }

/// The exit status that `body` returns, and if it throws: 2 for what its user can mend, 3 for what he cannot.
template <class Body>
int run_program(const CLI::App& app, const Body& body) {
  try {
    return body();
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;  // 0: --help, --version
  } catch (const ConfigError& error) {
    spdlog::error("{}", error.what());
    return 2;
  } catch (const std::exception& error) {
    spdlog::critical("unexpected: {}", error.what());
    return 3;
  }
}

}  // namespace convoy::cli
