// Two vehicles exchange their submaps over a network that loses every third message, and end with the same facts.
// No middleware: the exchange is the one inside a process, and time is a number.
#include <convoy/exchange/in_process.hpp>
#include <convoy/exchange/repair.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/fact_store.hpp>

#include <cstdio>
#include <memory>
#include <variant>

using namespace convoy;

struct Vehicle {
  Vehicle(VehicleId id, InProcessNetwork<SE2>& network)
      : chain{id, 1}, exchange(network.join({.loss = 1.0 / 3.0, .seed = 7})), repair(chain, {}, id) {}

  void send(Payload<SE2> payload) {
    // What the network does not take is repaired like what it loses.
    if (exchange->send({chain, std::move(payload)}) != SendStatus::sent) ++not_sent;
  }

  /// An anchor every 25 m, and the landmarks that were frozen there.
  void explore(std::uint32_t k) {
    AnchorFact<SE2> anchor{{chain, k}, {}};
    anchor.state.abscissa_m = 25.0 * k;
    anchor.state.pose = SE2(25.0 * k, 0.0, 0.0);
    anchor.state.drift = 1e-3 * k * SE2::Covariance::Identity();
    LandmarkBatch<SE2> batch;
    for (std::uint32_t i = 0; i < 3; ++i) {
      LandmarkFact<SE2> landmark;
      landmark.key = {chain, 3 * k + i};
      landmark.anchor = k;
      landmark.position = {5.0 * i, 4.0};
      landmark.covariance = 0.04 * SE2::PointCovariance::Identity();
      batch.landmarks.push_back(landmark);
      store.insert(landmark);
    }
    store.insert(anchor);
    send(anchor);
    send(batch);
  }

  /// Takes in what has come, and sends what the repair protocol wants to have sent.
  void step(double now_s) {
    for (const auto& message : exchange->take(now_s)) {
      if (const auto* anchor = std::get_if<AnchorFact<SE2>>(&message.payload)) {
        store.insert(*anchor);
        repair.on_fact_seen(FactKind::anchor, anchor->key);
      } else if (const auto* batch = std::get_if<LandmarkBatch<SE2>>(&message.payload)) {
        for (const auto& landmark : batch->landmarks) {
          store.insert(landmark);
          repair.on_fact_seen(FactKind::landmark, landmark.key);
        }
      } else if (const auto* request = std::get_if<Request>(&message.payload)) {
        repair.on_request(store, message.sender, *request, now_s);
      } else if (const auto* digest = std::get_if<Digest>(&message.payload)) {
        repair.on_digest(store, message.sender, *digest, now_s);
      }
    }
    for (auto& payload : repair.due(store, now_s)) send(std::move(payload));
    if (auto marks = repair.digest_due(store, now_s)) {
      Digest digest;
      digest.marks = std::move(*marks);
      digest.holdings = store.holdings();
      send(digest);
    }
  }

  ChainId chain;
  FactStore<SE2> store;
  std::unique_ptr<SubmapExchange<SE2>> exchange;
  RepairProtocol<SE2> repair;
  int not_sent = 0;
};

int main() {
  InProcessNetwork<SE2> network;
  Vehicle front(1, network), back(2, network);
  double now_s = 0.0;
  for (std::uint32_t k = 0; k < 10; ++k, now_s += 1.0)
    for (Vehicle* vehicle : {&front, &back}) {
      vehicle->explore(k);
      vehicle->step(now_s);
    }
  while (front.store.digest() != back.store.digest() && now_s < 100.0) {
    now_s += 1.0;
    for (Vehicle* vehicle : {&front, &back}) vehicle->step(now_s);
  }
  for (const Vehicle* vehicle : {&front, &back}) {
    const bool lossy = vehicle->exchange->counters().dropped > 0;
    std::printf("vehicle %u: %llu facts, %llu missing, messages were lost: %s\n", vehicle->chain.vehicle,
                static_cast<unsigned long long>(vehicle->store.size()),
                static_cast<unsigned long long>(vehicle->store.missing_count()), lossy ? "yes" : "no");
  }
  const bool equal = front.store.digest() == back.store.digest();
  std::printf("digests are equal: %s\n", equal ? "yes" : "no");
  return equal ? 0 : 1;
}
