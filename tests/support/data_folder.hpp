// Recordings and public graphs, which some tests and benches use where they are on the machine.
#pragma once

#include <filesystem>

namespace convoy::test {

/// The folder of all of them: CONVOY_DATA_DIR, else `shared/data` beside the checkout. It need not exist.
std::filesystem::path data_folder();

}  // namespace convoy::test
