// What a vehicle program does to host convoy. Two vehicles drive along the same street; neither knows where it started.
// They exchange their landmarks over Fast DDS and learn where they are with respect to each other. Both live in this
// one process here; on the road each has its own, with the same code.
//
//   example_02_embed_a_vehicle qos_profiles/loopback.xml DOMAIN
#include <convoy/components/vehicle.hpp>
#include <convoy/config_error.hpp>
#include <convoy/dds/dds_exchange.hpp>
#include <convoy/frontend/frozen_landmarks.hpp>
#include <convoy/geometry/groups.hpp>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <memory>
#include <random>
#include <thread>
#include <vector>

using namespace convoy;

namespace {

double steady_s() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

/// Seeded, and the same with every standard library.
class Random {
 public:
  explicit Random(std::uint32_t seed) : engine_(seed) {}
  double uniform(double low, double high) { return low + (high - low) * static_cast<double>(engine_()) / 4294967296.0; }

 private:
  std::mt19937 engine_;
};

/// The posts along the street, which stand where they stand for everybody.
std::vector<SE2::Point> street() {
  Random random(1);
  std::vector<SE2::Point> posts;
  for (int i = 0; i < 60; ++i) {
    const double x_m = random.uniform(-20.0, 120.0);
    posts.emplace_back(x_m, random.uniform(-15.0, 15.0));
  }
  return posts;
}

/// A vehicle whose own SLAM already delivers converged landmarks. convoy::RangeBearingEkf is a SLAM to start with;
/// anything else that implements convoy::FrontEnd does as well.
class Host {
 public:
  Host(VehicleId id, const SE2& T_street_start, const dds::DdsConfig& network)
      : T_street_start_(T_street_start),
        random_(id),
        vehicle_(
            params(id), slam_, [network] { return std::make_unique<dds::DdsExchange<SE2>>(network); }, steady_s) {
    vehicle_.configure();
    vehicle_.activate();
  }

  /// 20 m further on, with what was seen of the street on the way.
  void drive(const std::vector<SE2::Point>& posts) {
    vehicle_.feed([&] {
      FrontEndState<SE2> state = slam_.state();
      state.stamp_s += 10.0;
      state.abscissa_m += 20.0;
      state.pose = state.pose * SE2(20.0, 0.0, 0.0);
      if (!slam_.advance(state)) return;  // refused: the state goes back in time, or is not finite
      std::vector<FrozenLandmark<SE2>> seen;
      for (std::size_t i = 0; i < posts.size(); ++i) {
        const SE2::Point p_body = (T_street_start_ * state.pose).inverse() * posts[i];
        if (p_body.norm() > 20.0) continue;
        FrozenLandmark<SE2> landmark;
        landmark.position = p_body + SE2::Point(error_m(), error_m());
        landmark.covariance = sigma_m * sigma_m * SE2::PointCovariance::Identity();
        seen.push_back(landmark);
      }
      slam_.close(seen);
    });
  }

  VehicleSnapshot<SE2> look() { return vehicle_.snapshot(); }
  SE2 T_street_body() const { return T_street_start_ * slam_.state().pose; }

 private:
  static constexpr double sigma_m = 0.05;
  double error_m() { return std::sqrt(3.0) * random_.uniform(-sigma_m, sigma_m); }

  static VehicleParams<SE2> params(VehicleId id) {
    VehicleParams<SE2> params;
    params.id = id;
    params.submaps.map_period_s = 0.1;
    return params;
  }

  SE2 T_street_start_;
  Random random_;
  FrozenLandmarks<SE2> slam_;
  Vehicle<SE2> vehicle_;
};

/// Both have everything, have built the same map of it, and know where both vehicles are.
bool agree(const VehicleSnapshot<SE2>& a, const VehicleSnapshot<SE2>& b) {
  if (!a.settled || !b.settled || a.facts_digest != b.facts_digest || a.map_digest != b.map_digest) return false;
  for (const auto* view : {&a, &b}) {
    if (view->vehicles.size() != 2) return false;
    for (const auto& vehicle : view->vehicles)
      if (vehicle.integrity != Integrity::ok) return false;
  }
  return true;
}

bool wait_until(const std::function<bool()>& done, double timeout_s) {
  for (const double end_s = steady_s() + timeout_s; steady_s() < end_s;) {
    if (done()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return false;
}

void print_second_from_first(const SE2& T_first, const SE2& T_second) {
  const SE2 T = T_first.inverse() * T_second;
  const double ahead_m = T.translation().x(), left_m = T.translation().y(), turn_deg = T.theta() * 180.0 / M_PI;
  std::printf("vehicle 2 is %.1f m ahead of vehicle 1, %.1f m to its left, turned by %.0f degrees\n", ahead_m, left_m,
              turn_deg);
}

void print(const VehicleSnapshot<SE2>& view) {
  std::printf("vehicle %u knows %llu landmarks, %llu of its own\n", view.self.vehicle,
              static_cast<unsigned long long>(view.landmarks_known),
              static_cast<unsigned long long>(view.landmarks_exported));
  for (const auto& vehicle : view.vehicles)
    std::printf("  vehicle %u: integrity %s\n", vehicle.chain.vehicle, to_string(vehicle.integrity));
  const auto &first = view.vehicles[0].estimate, &second = view.vehicles[1].estimate;
  if (!first || !second) return;
  std::printf("  ");
  print_second_from_first(first->mean, second->mean);
}

int run(const dds::DdsConfig& network) {
  const std::vector<SE2::Point> posts = street();
  Host one(1, SE2(0.0, 0.0, 0.0), network);
  Host two(2, SE2(12.0, 3.0, 0.1), network);
  for (int k = 0; k < 3; ++k) {
    one.drive(posts);
    two.drive(posts);
  }
  const bool agreed = wait_until([&] { return agree(one.look(), two.look()); }, 60.0);
  print(one.look());
  print(two.look());
  std::printf("in truth ");
  print_second_from_first(one.T_street_body(), two.T_street_body());
  std::printf("one map: %s\n", agreed ? "yes" : "no");
  return agreed ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: %s PROFILES.xml DOMAIN\n", argv[0]);
    return 2;
  }
  dds::DdsConfig network;
  network.profile_file = argv[1];
  network.domain = static_cast<std::uint32_t>(std::strtoul(argv[2], nullptr, 10));
  try {
    return run(network);
  } catch (const ConfigError& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
  }
}
