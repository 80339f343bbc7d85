// bench.html: what is asked of the speed and what was measured, the misses named as misses. Self-contained XHTML.
#pragma once

#include "page/judgement.hpp"
#include "page/machine.hpp"

namespace convoy::bench {

std::string bench_page(const Judgement& judgement, const Machine& machine);

/// bench.json: the same for programs.
nlohmann::ordered_json bench_json(const Judgement& judgement, const Machine& machine);

/// "30 of 32 demands met, 2 missed", for the head of the page and for a terminal.
std::string headline(const Judgement& judgement);

/// "MISS  SECTION: WHAT: 467 MB (asked: <= 300 MB)", for a terminal.
std::string verdict_line(const Row& row);

}  // namespace convoy::bench
