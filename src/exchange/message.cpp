#include <convoy/exchange/message.hpp>

#include <array>
#include <utility>

namespace convoy {

const char* to_string(Integrity integrity) {
  switch (integrity) {
    case Integrity::unaligned: return "UNALIGNED";
    case Integrity::ok: return "OK";
    case Integrity::suspect: return "SUSPECT";
  }
  return "unknown";
}

std::vector<std::string> names_of_reasons(std::uint32_t reasons) {
  static constexpr std::array<std::pair<std::uint32_t, const char*>, 8> table{{{reason_innovation, "innovation"},
                                                                               {reason_disagreement, "disagreement"},
                                                                               {reason_stale_peer, "stale_peer"},
                                                                               {reason_equivocation, "equivocation"},
                                                                               {reason_missing_facts, "missing_facts"},
                                                                               {reason_impersonated, "impersonated"},
                                                                               {reason_drift, "drift"},
                                                                               {reason_ambiguous, "ambiguous"}}};
  std::vector<std::string> names;
  for (const auto& [bit, name] : table)
    if ((reasons & bit) != 0) names.emplace_back(name);
  return names;
}

}  // namespace convoy
