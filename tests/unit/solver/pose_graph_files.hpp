// The public pose graphs, if they are on this machine.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>

namespace convoy::test {

/// $CONVOY_DATA_DIR/pose_graphs/FOLDER/NAME, or in ../shared/data beside the source tree.
inline std::optional<std::filesystem::path> pose_graph_file(const std::string& name,
                                                            const std::string& folder = "single") {
  namespace fs = std::filesystem;
  const char* variable = std::getenv("CONVOY_DATA_DIR");
  const fs::path root = variable ? fs::path(variable) : fs::path(__FILE__).parent_path() / "../../../../shared/data";
  const fs::path path = root / "pose_graphs" / folder / name;
  return fs::exists(path) ? std::optional(path) : std::nullopt;
}

}  // namespace convoy::test
