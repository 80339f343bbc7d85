// Files that are there as they were meant, or an error says which is not.
#pragma once

#include <filesystem>
#include <string_view>

namespace convoy::simulator {

/// Throws SetUpError that names the file and why it is not written to its last byte (a full disk).
void write_whole(const std::filesystem::path& file, std::string_view bytes);

/// For whoever has just failed to write it: errno says why.
[[noreturn]] void fail_to_write(const std::filesystem::path& file);

}  // namespace convoy::simulator
