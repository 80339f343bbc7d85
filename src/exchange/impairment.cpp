#include <convoy/config_error.hpp>
#include <convoy/exchange/impairment.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <span>
#include <utility>

namespace convoy {

namespace {

constexpr double longest_s = 3600.0;

void demand(bool holds, const char* name, double value, const char* range) {
  if (holds) return;
  char text[128];
  std::snprintf(text, sizeof text, "impairment: %s is %g; it must lie in %s", name, value, range);
  throw ConfigError(text);
}

using Unit = std::pair<std::string_view, double>;
constexpr Unit seconds[] = {{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}};
constexpr Unit bytes_per_s[] = {{"B/s", 1.0}, {"kB/s", 1e3}, {"MB/s", 1e6}};

double number(const std::string& text, std::span<const Unit> units = {}) {
  char* rest = nullptr;
  const double value = std::strtod(text.c_str(), &rest);
  const std::string_view unit = rest;
  if (rest != text.c_str() && unit.empty()) return value;
  if (rest != text.c_str())
    for (const auto& [name, factor] : units)
      if (unit == name) return value * factor;
  throw ConfigError("impairment: '" + text + "' is no number");
}

// "delay=100" is likelier meant in milliseconds than in seconds.
double duration(const std::string& text) {
  const double value = number(text, seconds);
  const bool has_unit = text.ends_with('s');
  if (value >= 1.0 && !has_unit)
    throw ConfigError("impairment: '" + text + "' has no unit; write " + text + "s or " + text + "ms");
  return value;
}

std::uint64_t seed_of(const std::string& text) {
  const double value = number(text);
  if (value >= 0.0 && value == std::floor(value) && value < 0x1p53) return static_cast<std::uint64_t>(value);
  throw ConfigError("impairment: the seed is a whole number from 0 on");
}

void read_entry(const std::string& name, const std::string& text, Impairment& into) {
  if (name == "loss") into.loss = number(text);
  else if (name == "duplicate") into.duplicate = number(text);
  else if (name == "delay") into.delay_s = duration(text);
  else if (name == "jitter") into.jitter_s = duration(text);
  else if (name == "reorder") into.reorder = number(text);
  else if (name == "rate") into.rate_bytes_per_s = number(text, bytes_per_s);
  else if (name == "queue") into.queue_s = duration(text);
  else if (name == "partition") into.partitions.push_back(Partition::parse(text));
  else if (name == "seed") into.seed = seed_of(text);
  else throw ConfigError("impairment: no such entry");
  validate(into);
}

}  // namespace

Partition Partition::parse(std::string_view text) {
  const auto fail = [&]() -> Partition {
    throw ConfigError("impairment: '" + std::string(text) + "' is no partition like 3+4@10s..70s");
  };
  const std::size_t at = text.find('@'), dots = text.find("..");
  if (at == std::string_view::npos || dots == std::string_view::npos || dots < at) return fail();
  Partition partition;
  for (std::string_view ids = text.substr(0, at); partition.vehicles.empty() || !ids.empty();) {
    VehicleId id = 0;
    const auto [rest, error] = std::from_chars(ids.data(), ids.data() + ids.size(), id);
    const std::size_t used = static_cast<std::size_t>(rest - ids.data());
    if (error != std::errc() || id == 0 || (used < ids.size() && (ids[used] != '+' || used + 1 == ids.size())))
      return fail();
    partition.vehicles.push_back(id);
    ids.remove_prefix(std::min(used + 1, ids.size()));
  }
  partition.from_s = number(std::string(text.substr(at + 1, dots - at - 1)), seconds);
  partition.to_s = number(std::string(text.substr(dots + 2)), seconds);
  return partition;
}

std::string to_string(const Partition& partition) {
  std::string text;
  for (const VehicleId id : partition.vehicles) text += (text.empty() ? "" : "+") + std::to_string(id);
  char window[64];
  std::snprintf(window, sizeof window, "@%.17g..%.17g", partition.from_s, partition.to_s);
  return text + window;
}

void validate(const Impairment& i) {
  demand(i.loss >= 0.0 && i.loss < 1.0, "loss", i.loss, "[0, 1)");
  demand(i.duplicate >= 0.0 && i.duplicate <= 1.0, "duplicate", i.duplicate, "[0, 1]");
  demand(i.delay_s >= 0.0 && i.delay_s <= longest_s, "delay", i.delay_s, "[0, 3600] s");
  demand(i.jitter_s >= 0.0 && i.jitter_s <= longest_s, "jitter", i.jitter_s, "[0, 3600] s");
  demand(i.reorder >= 0.0 && i.reorder <= 1.0, "reorder", i.reorder, "[0, 1]");
  demand(i.rate_bytes_per_s == 0.0 || (i.rate_bytes_per_s >= 100.0 && i.rate_bytes_per_s <= 1e12), "rate",
         i.rate_bytes_per_s, "[100, 1e12] B/s");
  demand(i.queue_s > 0.0 && i.queue_s <= longest_s, "queue", i.queue_s, "(0, 3600] s");
  for (const Partition& p : i.partitions) {
    demand(p.from_s >= 0.0 && std::isfinite(p.from_s), "the start of a partition", p.from_s, "[0, inf) s");
    demand(p.to_s > p.from_s && std::isfinite(p.to_s), "the end of a partition", p.to_s, "(its start, inf) s");
  }
}

Impairments Impairments::parse(std::string_view text) {
  Impairments result;
  std::optional<std::uint64_t> seed_sent;
  std::set<std::string> seen;
  const std::string all(text);
  for (std::size_t at = 0; !all.empty() && at <= all.size();) {
    const std::size_t end = std::min(all.find(',', at), all.size());
    const std::string entry = all.substr(at, end - at);
    at = end + 1;
    const std::size_t equals = entry.find('=');
    const bool out = entry.starts_with("out.");
    try {
      if (equals == std::string::npos) throw ConfigError("impairment: no '='");
      const std::string name = entry.substr(out ? 4 : 0, equals - (out ? 4 : 0));
      if (name != "partition" && !seen.insert(entry.substr(0, equals)).second)
        throw ConfigError("impairment: it is given twice");
      read_entry(name, entry.substr(equals + 1), out ? result.sent : result.received);
      if (out && name == "seed") seed_sent = result.sent.seed;
    } catch (const ConfigError& error) {
      const std::string fault = error.what();
      throw ConfigError("impairment '" + all + "': cannot use '" + entry + "' (" + fault.substr(fault.find(' ') + 1) +
                        "); write loss=0..0.99,duplicate=0..1,delay=100ms,jitter=50ms,reorder=0..1,rate=100kB/s,"
                        "queue=500ms,partition=3+4@10s..70s,seed=N, each also as out.loss=... for what is sent");
    }
  }
  result.sent.seed = seed_sent.value_or(result.received.seed);
  return result;
}

std::string to_string(const Impairments& impairments) {
  std::string text;
  const auto write = [&](const std::string& name, const std::string& value) {
    text += (text.empty() ? "" : ",") + name + "=" + value;
  };
  const auto write_direction = [&](const std::string& prefix, const Impairment& i) {
    const auto write_number = [&](const char* name, double value, double by_default, const char* unit = "") {
      char digits[32];
      const char* end = std::to_chars(digits, digits + sizeof digits, value).ptr;
      if (value != by_default) write(prefix + name, std::string(static_cast<const char*>(digits), end) + unit);
    };
    write_number("loss", i.loss, 0.0);
    write_number("duplicate", i.duplicate, 0.0);
    write_number("delay", i.delay_s, 0.0, "s");
    write_number("jitter", i.jitter_s, 0.0, "s");
    write_number("reorder", i.reorder, 0.0);
    write_number("rate", i.rate_bytes_per_s, 0.0, "B/s");
    write_number("queue", i.queue_s, Impairment().queue_s, "s");
    for (const Partition& partition : i.partitions) write(prefix + "partition", to_string(partition));
    write(prefix + "seed", std::to_string(i.seed));
  };
  if (impairments.received.any()) write_direction("", impairments.received);
  if (impairments.sent.any()) write_direction("out.", impairments.sent);
  return text;
}

Impairment Impairment::parse(std::string_view text) {
  const Impairments both = Impairments::parse(text);
  if (both.sent.any()) throw ConfigError("impairment '" + std::string(text) + "': here is one direction, without out.");
  return both.received;
}

ImpairedLink::ImpairedLink(const Impairment& impairment) : impairment_(impairment), random_(impairment.seed) {
  validate(impairment);
}

void ImpairedLink::set_loss(double loss) {
  Impairment changed = impairment_;
  changed.loss = loss;
  validate(changed);
  impairment_ = std::move(changed);
}

double ImpairedLink::uniform() {
  return static_cast<double>(random_() >> 11) * 0x1.0p-53;  // the same on every platform, unlike std distributions
}

bool ImpairedLink::cut_off(double now_s, VehicleId sender) const {
  if (blocked_.contains(sender)) return true;
  return std::any_of(impairment_.partitions.begin(), impairment_.partitions.end(), [&](const Partition& p) {
    return now_s >= p.from_s && now_s < p.to_s &&
           std::find(p.vehicles.begin(), p.vehicles.end(), sender) != p.vehicles.end();
  });
}

ImpairedLink::Fate ImpairedLink::fate(double now_s, std::size_t bytes, VehicleId sender) {
  Fate fate;
  if (cut_off(now_s, sender)) {
    ++lost_;
    return fate;
  }
  const int copies = uniform() < impairment_.duplicate ? 2 : 1;
  for (int i = 0; i < copies; ++i) {
    if (uniform() < impairment_.loss) {
      ++lost_;
      continue;
    }
    double due_s = now_s + impairment_.delay_s + impairment_.jitter_s * uniform();
    if (impairment_.reorder > 0.0 && uniform() < impairment_.reorder) due_s += Impairment::hold_s;
    if (impairment_.rate_bytes_per_s > 0.0) {
      const double start_s = std::max(now_s, link_free_s_);
      if (start_s - now_s > impairment_.queue_s) {
        ++lost_;
        continue;
      }
      link_free_s_ = start_s + static_cast<double>(bytes) / impairment_.rate_bytes_per_s;
      due_s += link_free_s_ - now_s;
    }
    fate.due_s[static_cast<std::size_t>(fate.copies++)] = due_s;
  }
  return fate;
}

template <class G>
ImpairedQueue<G>::ImpairedQueue(const Impairment& impairment) : link_(impairment) {
  if (impairment.rate_bytes_per_s > 0.0)
    throw ConfigError("impairment: a rate is of datagrams; messages within a process have no size");
}

template <class G>
void ImpairedQueue<G>::push(Message<G> message, double now_s) {
  const ImpairedLink::Fate fate = link_.fate(now_s, 0, message.sender.vehicle);
  for (int i = 0; i < fate.copies; ++i) due_.emplace(fate.due_s[static_cast<std::size_t>(i)], message);
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

#define CONVOY_INSTANTIATE(G) template class ImpairedQueue<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
