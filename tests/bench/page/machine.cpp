#include "page/machine.hpp"

#include <thread>

namespace convoy::bench {

Machine this_machine(const std::string& cpuinfo, double load_at_start, double load_at_end) {
  Machine machine{"unknown CPU", std::thread::hardware_concurrency(), load_at_start, load_at_end};
  const auto line = cpuinfo.find("model name");
  const auto begin = cpuinfo.find(": ", line);
  if (line == std::string::npos || begin == std::string::npos) return machine;
  machine.cpu = cpuinfo.substr(begin + 2, cpuinfo.find('\n', begin) - begin - 2);
  return machine;
}

}  // namespace convoy::bench
