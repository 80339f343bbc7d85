// The public pose graphs, if they are on this machine.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "../../support/data_folder.hpp"

namespace convoy::test {

/// pose_graphs/FOLDER/NAME in the data folder.
inline std::optional<std::filesystem::path> pose_graph_file(const std::string& name,
                                                            const std::string& folder = "single") {
  const std::filesystem::path path = data_folder() / "pose_graphs" / folder / name;
  return std::filesystem::exists(path) ? std::optional(path) : std::nullopt;
}

}  // namespace convoy::test
