// What convoy replay says in the end.
#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

namespace convoy::cli {

/// `front_end`: of metrics.json, not null. `frames`: what a frame of it is, such as "images".
void print_front_end(const nlohmann::json& front_end, const std::string& frames);
/// Where report and metrics are.
void print_where(const std::filesystem::path& out);

}  // namespace convoy::cli
