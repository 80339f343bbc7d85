#include <convoy/config_error.hpp>
#include <convoy/exchange/impairment.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>

namespace convoy {

namespace {

constexpr double longest_s = 3600.0;

void demand(bool holds, const char* name, double value, const char* range) {
  if (holds) return;
  char text[128];
  std::snprintf(text, sizeof text, "impairment: %s is %g; it must lie in %s", name, value, range);
  throw ConfigError(text);
}

}  // namespace

void validate(const Impairment& i) {
  demand(i.loss >= 0.0 && i.loss < 1.0, "loss", i.loss, "[0, 1)");
  demand(i.duplicate >= 0.0 && i.duplicate <= 1.0, "duplicate", i.duplicate, "[0, 1]");
  demand(i.delay_s >= 0.0 && i.delay_s <= longest_s, "delay", i.delay_s, "[0, 3600] s");
  demand(i.jitter_s >= 0.0 && i.jitter_s <= longest_s, "jitter", i.jitter_s, "[0, 3600] s");
}

Impairment Impairment::parse(std::string_view text) {
  Impairment result;
  const std::string all(text);
  for (std::size_t at = 0; !all.empty() && at <= all.size();) {
    const std::size_t end = std::min(all.find(',', at), all.size());
    const std::string entry = all.substr(at, end - at);
    at = end + 1;
    const std::size_t equals = entry.find('=');
    const std::string name = entry.substr(0, equals);
    char* rest = nullptr;
    const char* digits = equals == std::string::npos ? "" : entry.c_str() + equals + 1;
    const double value = std::strtod(digits, &rest);
    const bool number = rest != digits && *rest == '\0';
    const bool seed = number && value >= 0.0 && value == std::floor(value) && value < 0x1p53;
    std::string fault;
    if (equals != std::string::npos && !number) fault = std::string("impairment: '") + digits + "' is no number";
    else if (name == "loss" && number) result.loss = value;
    else if (name == "duplicate" && number) result.duplicate = value;
    else if (name == "delay" && number) result.delay_s = value;
    else if (name == "jitter" && number) result.jitter_s = value;
    else if (name == "seed" && seed) result.seed = static_cast<std::uint64_t>(value);
    else if (name == "seed" && number) fault = "impairment: the seed is a whole number from 0 on";
    else fault = equals == std::string::npos ? "impairment: no '='" : "impairment: no such entry";
    try {
      if (fault.empty()) validate(result);
    } catch (const ConfigError& error) {
      fault = error.what();
    }
    if (!fault.empty())
      throw ConfigError("impairment '" + all + "': cannot use '" + entry + "' (" + fault.substr(fault.find(' ') + 1) +
                        "); write loss=0..0.99,duplicate=0..1,delay=SECONDS,jitter=SECONDS,seed=N");
  }
  return result;
}

template <class G>
double ImpairedQueue<G>::uniform() {
  return static_cast<double>(random_() >> 11) * 0x1.0p-53;  // the same on every platform, unlike std distributions
}

template <class G>
void ImpairedQueue<G>::push(Message<G> message, double now_s) {
  const int copies = uniform() < impairment_.duplicate ? 2 : 1;
  for (int i = 0; i < copies; ++i) {
    if (uniform() < impairment_.loss) {
      ++lost_;
      continue;
    }
    due_.emplace(now_s + impairment_.delay_s + impairment_.jitter_s * uniform(), message);
  }
}

template <class G>
std::vector<Message<G>> ImpairedQueue<G>::take(double now_s) {
  std::vector<Message<G>> out;
  while (!due_.empty() && due_.begin()->first <= now_s) {
    out.push_back(std::move(due_.begin()->second));
    due_.erase(due_.begin());
  }
  return out;
}

template <class G>
std::vector<Message<G>> ImpairedExchange<G>::take(double now_s) {
  for (Message<G>& message : inner_->take(now_s)) queue_.push(std::move(message), now_s);
  return queue_.take(now_s);
}

template <class G>
ExchangeCounters ImpairedExchange<G>::counters() const {
  ExchangeCounters counters = inner_->counters();
  counters.dropped += queue_.lost();
  return counters;
}

#define CONVOY_INSTANTIATE(G)      \
  template class ImpairedQueue<G>; \
  template class ImpairedExchange<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
