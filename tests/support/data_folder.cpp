#include "data_folder.hpp"

#include <cstdlib>

namespace convoy::test {

std::filesystem::path data_folder() {
  if (const char* folder = std::getenv("CONVOY_DATA_DIR")) return folder;
  return CONVOY_DATA_BESIDE_CHECKOUT;
}

}  // namespace convoy::test
