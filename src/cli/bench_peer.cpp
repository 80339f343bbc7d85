#include "bench_peer.hpp"

#include <convoy/components/exchange_worker.hpp>
#include <convoy/components/submap_manager.hpp>
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/dds/impaired_transport.hpp>
#include <convoy/geometry/se2.hpp>

#include <nlohmann/json.hpp>

#include <poll.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <map>
#include <memory>
#include <sstream>

namespace convoy::cli {
namespace {

using nlohmann::json;

std::int64_t now_us() {
  return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

using Times = std::vector<std::int64_t>;  // by index; 0: not yet

void note(Times& times, std::uint32_t index, std::int64_t at_us) {
  if (times.size() <= index) times.resize(index + 1);
  if (times[index] == 0) times[index] = at_us;
}

// Notes when each landmark came in first. Alone: what only the repair protocol says is not sent.
class NotingExchange final : public SubmapExchange<SE2> {
 public:
  NotingExchange(SubmapExchange<SE2>& inner, bool alone) : inner_(inner), alone_(alone) {}

  SendStatus send(const Message<SE2>& message) override {
    const bool repair =
        std::holds_alternative<Digest>(message.payload) || std::holds_alternative<Request>(message.payload);
    return alone_ && repair ? SendStatus::sent : inner_.send(message);
  }
  std::vector<Message<SE2>> take(double now_s) override {
    auto messages = inner_.take(now_s);
    const std::int64_t at_us = now_us();
    for (const auto& message : messages)
      if (const auto* batch = std::get_if<LandmarkBatch<SE2>>(&message.payload))
        for (const auto& landmark : batch->landmarks)
          note(held_[landmark.key.chain.vehicle], landmark.key.index, at_us);
    return messages;
  }
  ExchangeCounters counters() const override { return inner_.counters(); }
  const std::map<VehicleId, Times>& held() const { return held_; }

 private:
  SubmapExchange<SE2>& inner_;
  bool alone_;
  std::map<VehicleId, Times> held_;
};

// So many per second, up to a count.
struct Schedule {
  std::uint64_t count = 0, done = 0;
  double per_s = 0.0;
  std::int64_t begun_us = 0;
  std::uint64_t due() const {
    const double passed_s = 1e-6 * static_cast<double>(now_us() - begun_us);
    return std::min(count, static_cast<std::uint64_t>(passed_s * per_s)) - std::min(count, done);
  }
};

class BenchPeer {
 public:
  explicit BenchPeer(const BenchPeerOptions& options)
      : self_{options.vehicle, 1},
        config_(config(options)),
        network_(options.impair.empty() ? nullptr : dds::impair(config_, Impairments::parse(options.impair))),
        worker_([this] { return std::make_unique<dds::DdsExchange<SE2>>(config_); }, budget(options), WatchdogParams{}),
        exchange_(worker_, options.alone),
        manager_(self_, exchange_, params(options)) {
    manager_.open_chain(1e-6 * static_cast<double>(now_us()), std::nullopt);
  }

  void run() {
    constexpr int period_ms = 20;  // as a Vehicle steps
    std::string input;
    for (;;) {
      pollfd in{STDIN_FILENO, POLLIN, 0};
      if (poll(&in, 1, period_ms) > 0) {
        char buffer[4096];
        const ssize_t n = read(STDIN_FILENO, buffer, sizeof buffer);
        if (n <= 0) return;
        input.append(buffer, static_cast<std::size_t>(n));
        for (std::size_t end; (end = input.find('\n')) != std::string::npos; input.erase(0, end + 1))
          obey(input.substr(0, end));
      }
      publish();
      manager_.step(1e-6 * static_cast<double>(now_us()));
      observe();
    }
  }

 private:
  static constexpr std::uint64_t batch = 20;

  static SubmapManagerParams params(const BenchPeerOptions& options) {
    SubmapManagerParams p;
    p.seed = options.vehicle;
    p.repair = under_budget(p.repair, options.budget_bytes_per_s);
    return p;
  }

  // No message is larger than a second bears.
  static BudgetParams budget(const BenchPeerOptions& options) {
    BudgetParams p;
    if (options.budget_bytes_per_s > 0.0) p = {options.budget_bytes_per_s, 0.2, 10};
    return p;
  }

  static dds::DdsConfig config(const BenchPeerOptions& options) {
    dds::DdsConfig config;
    config.domain = options.domain;
    config.profile_file = options.profile;
    config.interface_whitelist = {"127.0.0.1"};
    config.vehicle = options.vehicle;
    config.discovery_servers = options.servers;
    return config;
  }

  void obey(const std::string& line) {
    std::istringstream words(line);
    std::string verb;
    words >> verb;
    if (verb == "write") {
      written_ = {0, 0, 0.0, now_us()};
      std::string how;
      words >> written_.count >> written_.per_s >> how;
      bare_ = how == "bare";
    } else if (verb == "live") {
      live_ = {~std::uint64_t{0}, 0, 0.0, now_us()};
      words >> live_.per_s;
    } else if (verb == "block" || verb == "unblock") {
      VehicleId vehicle = 0;
      words >> vehicle;
      if (network_) verb == "block" ? network_->block(vehicle) : network_->unblock(vehicle);
    } else if (verb == "state") {
      answer(state());
    } else if (verb == "times") {
      json held = json::object();
      for (const auto& [vehicle, times] : exchange_.held()) held[std::to_string(vehicle)] = times;
      answer({{"answer", "times"}, {"written", own_}, {"held", held}});
    }
  }

  static void answer(const json& object) {
    std::printf("%s\n", object.dump().c_str());
    std::fflush(stdout);
  }

  json state() const {
    rusage used{};
    getrusage(RUSAGE_SELF, &used);
    const auto seconds = [](const timeval& t) {
      return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
    };
    return {{"answer", "state"},
            {"at_us", now_us()},
            {"peers", peers_},
            {"peers_since_us", peers_since_us_},
            {"facts", size_},
            {"facts_since_us", size_since_us_},
            {"missing", manager_.facts_missing()},
            {"holdings", manager_.store().holdings()},
            {"written", own_.size()},
            {"written_us", own_.empty() ? 0 : own_.back()},
            {"writing", written_.count > written_.done},
            {"bytes", manager_.exchange_counters().bytes_sent},
            {"requests", manager_.repair_counters().requests_sent},
            {"served", manager_.repair_counters().facts_served},
            {"relayed", manager_.repair_counters().facts_relayed},
            {"quarantines", manager_.peer_counters().quarantines},
            {"cpu_s", seconds(used.ru_utime) + seconds(used.ru_stime)},
            {"rss_kb", resident_kb()}};
  }

  static std::uint64_t resident_kb() {
    std::ifstream file("/proc/self/status");
    for (std::string line; std::getline(file, line);)
      if (line.rfind("VmRSS:", 0) == 0) return std::stoull(line.substr(6));
    return 0;
  }

  ChainState<SE2> where() const {
    ChainState<SE2> state;
    state.stamp_s = 1e-6 * static_cast<double>(now_us());
    state.abscissa_m = 25.0 * static_cast<double>(segments_);
    state.drift = 1e-3 * static_cast<double>(segments_) * SE2::Covariance::Identity();
    return state;
  }

  void publish() {
    while (written_.due() >= batch || (written_.due() > 0 && written_.done + written_.due() == written_.count)) {
      ++segments_;
      std::vector<LandmarkFact<SE2>> landmarks(std::min(batch, written_.due()));
      for (std::size_t i = 0; i < landmarks.size(); ++i) {
        landmarks[i].position = {0.71 * static_cast<double>(i), 3.3 + 0.17 * static_cast<double>(i % 7)};
        landmarks[i].covariance = 0.04 * SE2::PointCovariance::Identity();
        // As the front end states it: what the errors of a batch have in common fills all columns.
        if (!bare_) landmarks[i].loading.setConstant(0.02);
      }
      written_.done += landmarks.size();
      const std::int64_t at_us = now_us();
      for (const auto& index : manager_.publish_segment(where(), std::move(landmarks)))
        if (index) note(own_, *index, at_us);
    }
    if (live_.due() == 0) return;
    live_.done += live_.due();
    LivePose<SE2> live;
    live.chain = self_;
    live.anchor = segments_;
    live.state = where();
    manager_.publish_live(live);
  }

  void observe() {
    if (const auto size = manager_.store().size(); size != size_) {
      size_ = size;
      size_since_us_ = now_us();
    }
    if (const auto peers = worker_.live_peers().value_or(0); peers != peers_) {
      peers_ = peers;
      peers_since_us_ = now_us();
    }
  }

  ChainId self_;
  dds::DdsConfig config_;
  std::shared_ptr<dds::ImpairedNetwork> network_;
  ExchangeWorker<SE2> worker_;
  NotingExchange exchange_;
  SubmapManager<SE2> manager_;
  Schedule written_, live_;
  bool bare_ = false;  // landmarks without a loading
  std::uint32_t segments_ = 0;
  Times own_;
  std::uint64_t size_ = 0;
  std::size_t peers_ = 0;
  std::int64_t size_since_us_ = 0, peers_since_us_ = 0;
};

}  // namespace

int run_bench_peer(const BenchPeerOptions& options) {
  BenchPeer(options).run();
  return 0;
}

}  // namespace convoy::cli
