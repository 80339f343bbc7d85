// convoy_bench_page OUT LOAD_BEFORE LOAD_AFTER: reads OUT/results/*.json, writes OUT/bench.html and OUT/bench.json, and
// prints the verdicts. For scripts/bench. Misses are no failure of this program: they are what it tells.
#include <convoy/config_error.hpp>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include "page/page.hpp"
#include "scenario/table_file.hpp"

namespace {

using namespace convoy;

double load_average(const char* text) {
  char* end = nullptr;
  const double load = std::strtod(text, &end);
  if (end == text || *end != '\0' || !(load >= 0.0))
    throw ConfigError(std::string("'") + text + "' is no load average; it is the first number of /proc/loadavg");
  return load;
}

// /proc/cpuinfo has no size, so it is read to its end.
std::string cpuinfo() {
  std::ifstream file("/proc/cpuinfo");
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_page(const std::filesystem::path& out, double load_before, double load_after) {
  const auto machine = bench::this_machine(cpuinfo(), load_before, load_after);
  const auto judgement = bench::judge(bench::demands(), bench::read_all_results(out / "results"));
  cli::write_text_file(out / "bench.json", bench::bench_json(judgement, machine).dump(2) + "\n");
  cli::write_text_file(out / "bench.html", bench::bench_page(judgement, machine));
  for (const auto& row : judgement.rows)
    if (row.verdict != bench::Verdict::not_asked) std::printf("%s\n", bench::verdict_line(row).c_str());
  if (!machine.idle()) std::printf("warning: others were computing; these are not the figures of an idle machine\n");
  std::printf("%s\n", bench::headline(judgement).c_str());
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: convoy_bench_page OUT LOAD_BEFORE LOAD_AFTER; scripts/bench does all of it\n");
    return 2;
  }
  try {
    write_page(argv[1], load_average(argv[2]), load_average(argv[3]));
  } catch (const ConfigError& error) {
    std::fprintf(stderr, "convoy_bench_page: %s\n", error.what());
    return 2;
  }
  return 0;
}
