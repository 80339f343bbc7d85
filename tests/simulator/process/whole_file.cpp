#include "whole_file.hpp"

#include "sim_error.hpp"

#include <cerrno>
#include <fstream>
#include <system_error>

namespace convoy::simulator {

void write_whole(const std::filesystem::path& file, std::string_view bytes) {
  std::ofstream out(file, std::ios::binary);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  out.close();
  if (!out) fail_to_write(file);
}

void fail_to_write(const std::filesystem::path& file) {
  throw SetUpError(file.string() + " cannot be written: " + std::generic_category().message(errno) +
                   "; make room there, or name another place");
}

}  // namespace convoy::simulator
