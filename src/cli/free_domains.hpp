// The DDS domains that demos and benches take by themselves: 69 to 99. Those below are left to fleets; from 102 on a
// domain's ports are those that the kernel gives to any socket.
#pragma once

#include <cstdint>

namespace convoy::cli {

constexpr std::uint32_t free_domains = 31;  // a prime, so that steps of any length reach all

/// The one of that number, which starts again at `free_domains`.
constexpr std::uint32_t free_domain(std::uint32_t number) { return 69 + number % free_domains; }

/// So many further than that one; the same only after `free_domains` steps.
constexpr std::uint32_t free_domain_beside(std::uint32_t domain, std::uint32_t steps) {
  return free_domain((domain >= 69 ? domain - 69 : domain) + steps % free_domains);
}

}  // namespace convoy::cli
