// A whole vehicle in a process of its own: convoy_chaos_vehicle PROFILES DOMAIN VEHICLE STATE_FOLDER STATED [OPTION...]
// It appends a line "KIND VEHICLE EPOCH INDEX HASH ." to the file STATED for each fact of its own, once that is stated
// (and in the journal). Options: no_journal, loss=PROBABILITY, clock=SECONDS (that its clock is ahead), flood=MESSAGES
// (that are one at once), and as often as needed block=VEHICLE. Prints "ready EPOCH" or "error WHAT". Driven by lines
// on standard input:
//   segment       drives on and states a segment, prints "stated COUNT"
//   status        prints "status" and the figures of Status (chaos_testing.hpp)
//   ahead V       prints "ahead SECONDS" of the clock of vehicle V, as far as is known
//   dump FILE     writes all facts held to FILE, as to STATED, prints "dumped COUNT"
//   block V, unblock V, loss PROBABILITY  changes the network, prints "done"
//   quit          ends
#include <convoy/components/vehicle.hpp>
#include <convoy/config_error.hpp>
#include <convoy/dds/impaired_transport.hpp>
#include <convoy/frontend/frozen_landmarks.hpp>
#include <convoy/geometry/se2.hpp>

#include <fastdds/dds/log/Log.hpp>

#include <signal.h>
#include <sys/prctl.h>

#include <array>
#include <chrono>
#include <fstream>
#include <iostream>
#include <random>
#include <sstream>
#include <string>

using namespace convoy;

namespace {

double steady_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

template <class Fact>
void write(std::ostream& out, const Fact& fact) {
  out << static_cast<int>(kind_of<Fact>) << ' ' << fact.key.chain.vehicle << ' ' << fact.key.chain.epoch << ' '
      << fact.key.index << ' ' << hash_of(fact) << " .\n";
}

/// Drives straight on, past two landmarks in each segment: too few to be recognised, since what is tried here is
/// whether facts arrive.
class Road {
 public:
  explicit Road(std::uint64_t seed) : random_(seed) {}
  void drive(FrozenLandmarks<SE2>& slam) {
    FrontEndState<SE2> state = slam.state();
    state.stamp_s += 1.0;
    state.abscissa_m += 5.0;
    state.pose = state.pose * SE2::Exp({5.0, 0.0, 0.0});
    if (!slam.advance(state)) throw std::logic_error("the road goes backwards");
    std::vector<FrozenLandmark<SE2>> seen(2);
    for (auto& landmark : seen) {
      landmark.position = {coordinate_m_(random_), coordinate_m_(random_)};
      landmark.covariance = 0.01 * SE2::PointCovariance::Identity();
      landmark.track = ++track_;
    }
    slam.close(std::move(seen));
  }

 private:
  std::mt19937_64 random_;
  std::uniform_real_distribution<double> coordinate_m_{-15.0, 15.0};
  std::uint64_t track_ = 0;
};

class StatedFacts {
 public:
  explicit StatedFacts(const std::string& file) : out_(file, std::ios::app) { out_ << '\n'; }  // after a cut line
  /// Writes what is new.
  std::uint64_t note(Vehicle<SE2>& vehicle) {
    vehicle.inspect([&](SubmapManager<SE2>& manager, auto&) {
      const auto& chain = manager.store().chains().at(manager.self());
      for (std::size_t kind = 0; kind < noted_.size(); ++kind)
        FactStore<SE2>::with_sequence(chain, static_cast<FactKind>(kind), [&](const auto& sequence) {
          for (auto it = sequence.lower_bound(noted_[kind]); it != sequence.end(); ++it, ++count_) {
            write(out_, it->second);
            noted_[kind] = it->first + 1;
          }
        });
    });
    out_.flush();
    return count_;
  }

 private:
  std::ofstream out_;
  std::array<std::uint32_t, fact_kind_count> noted_{};
  std::uint64_t count_ = 0;
};

void print_status(Vehicle<SE2>& vehicle) {
  const auto look = vehicle.snapshot();
  Hash holdings = 0;
  std::uint64_t known = 0;
  vehicle.inspect([&](SubmapManager<SE2>& manager, auto&) {
    holdings = manager.store().holdings();
    known = manager.store().size();
  });
  std::uint64_t unfit = look.submaps.facts_unfit;
  for (const Insertion kind : {Insertion::not_finite, Insertion::not_covariance, Insertion::out_of_range,
                               Insertion::malformed, Insertion::over_share})
    unfit += look.insertions[static_cast<std::size_t>(kind)];
  std::cout << "status " << look.self.epoch << ' ' << holdings << ' ' << look.facts_digest << ' ' << known << ' '
            << look.facts_missing << ' ' << look.facts_lost << ' ' << look.refused << ' '
            << look.insertions[static_cast<std::size_t>(Insertion::conflict)] << ' ' << unfit << ' '
            << look.submaps.disagreements << ' ' << look.repair.requests_sent << ' ' << look.repair.facts_relayed << ' '
            << look.network.reopened << ' ' << look.exchange.dropped << ' ' << look.journal.restored << ' '
            << look.journal.cut_bytes << ' ' << look.journal.failed_writes << ' ' << look.journal.waiting << ' '
            << look.peers.quarantines << std::endl;
}

void print_ahead(const VehicleSnapshot<SE2>& look, VehicleId of) {
  std::cout << "ahead";
  for (const auto& state : look.vehicles)
    if (state.chain.vehicle == of && state.clock_offset_s) std::cout << ' ' << *state.clock_offset_s;
  std::cout << std::endl;
}

void dump(Vehicle<SE2>& vehicle, const std::string& file) {
  std::uint64_t count = 0;
  {
    std::ofstream out(file);
    vehicle.inspect([&](SubmapManager<SE2>& manager, auto&) {
      manager.store().for_each_fact([&](const auto& fact) { write(out, fact); });
      count = manager.store().size();
    });
  }
  std::cout << "dumped " << count << std::endl;
}

void run(int argc, char** argv) {
  dds::DdsConfig network;
  network.profile_file = argv[1];
  network.domain = static_cast<std::uint32_t>(std::stoul(argv[2]));
  network.interface_whitelist = {"127.0.0.1"};
  VehicleParams<SE2> params;
  params.id = network.vehicle = static_cast<VehicleId>(std::stoul(argv[3]));
  params.state_folder = argv[4];
  params.journal = true;
  params.drift.rate = {4e-4, 4e-4, 4e-6};
  double ahead_s = 0.0;
  const auto weather = dds::impair(network, Impairments::parse("seed=" + std::string(argv[3])));
  for (int i = 6; i < argc; ++i) {
    const std::string option = argv[i];
    if (option == "no_journal") params.journal = false;
    else if (option.starts_with("loss=")) weather->set_loss_received(std::stod(option.substr(5)));
    else if (option.starts_with("clock=")) ahead_s = std::stod(option.substr(6));
    else if (option.starts_with("flood=")) {
      params.submaps.peers.burst = std::stod(option.substr(6));
      params.submaps.peers.messages_per_s = 0.2 * params.submaps.peers.burst;
    } else if (option.starts_with("block=")) weather->block(static_cast<VehicleId>(std::stoul(option.substr(6))));
    else throw ConfigError("no option " + option);
  }

  FrozenLandmarks<SE2> slam;
  Vehicle<SE2> vehicle(
      params, slam, [&] { return std::make_unique<dds::DdsExchange<SE2>>(network); },
      [&] { return steady_s() + ahead_s; });
  vehicle.configure();
  const Epoch epoch = vehicle.snapshot().self.epoch;
  Road road(epoch);
  StatedFacts stated(argv[5]);
  stated.note(vehicle);
  vehicle.activate();
  std::cout << "ready " << epoch << std::endl;

  for (std::string line; std::getline(std::cin, line) && line != "quit";) {
    std::istringstream words(line);
    std::string verb, what;
    words >> verb >> what;
    if (verb == "segment") {
      vehicle.feed([&] { road.drive(slam); });
      std::cout << "stated " << stated.note(vehicle) << std::endl;
    } else if (verb == "status") {
      print_status(vehicle);
    } else if (verb == "ahead") {
      print_ahead(vehicle.snapshot(), static_cast<VehicleId>(std::stoul(what)));
    } else if (verb == "dump") {
      dump(vehicle, what);
    } else {
      if (verb == "block") weather->block(static_cast<VehicleId>(std::stoul(what)));
      else if (verb == "unblock") weather->unblock(static_cast<VehicleId>(std::stoul(what)));
      else if (verb == "loss") weather->set_loss_received(std::stod(what));
      else throw ConfigError("no command " + line);
      std::cout << "done" << std::endl;
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 6) return 2;
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // a test that is broken off leaves nobody behind, not even who stands still
  eprosima::fastdds::dds::Log::ClearConsumers();  // they write to standard output, where our answers go
  try {
    run(argc, argv);
  } catch (const std::exception& error) {
    std::cout << "error " << error.what() << std::endl;
    return 1;
  }
}
