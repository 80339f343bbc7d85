#include "fleet_simulation.hpp"

#include <convoy/exchange/paced_exchange.hpp>
#include <convoy/submap/content_hash.hpp>
#include <convoy/submap/journal.hpp>

#include "../unit/components/scripted_fleet.hpp"

#include <algorithm>
#include <array>
#include <set>
#include <sstream>

namespace convoy::simulation {
namespace {

using G = SE2;
using FactId = std::pair<FactKind, Key>;
using test::Random;

constexpr double step_s = 0.25;
constexpr double faults_end_s = 60.0;
// What nobody has is declared missing after RepairParams::lost_after_s without an answer.
const double declared_missing_s = RepairParams().lost_after_s + liveness_s;

/// A disk that may be full, and that is damaged when the power goes.
struct Disk {
  Bytes bytes;
  bool full = false;
};

class OnDisk final : public JournalMedium {
 public:
  explicit OnDisk(Disk& disk) : disk_(disk) {}
  Bytes read() override { return disk_.bytes; }
  bool append(std::span<const std::uint8_t> bytes) override {
    if (disk_.full) return false;
    disk_.bytes.insert(disk_.bytes.end(), bytes.begin(), bytes.end());
    return true;
  }
  bool cut(std::uint64_t size) override {
    disk_.bytes.resize(size);
    return true;
  }

 private:
  Disk& disk_;
};

/// What all vehicles share: the time and the weather.
struct World {
  explicit World(std::uint64_t seed) : random(seed) {}
  bool chance(double probability) { return random.uniform(0.0, 1.0) < probability; }
  bool reaches(VehicleId from, VehicleId to) const { return side.at(from) == side.at(to); }

  Random random;
  double now_s = 0.0;
  Impairment impairment;
  std::map<VehicleId, int> side;  // of the partition
  ContentHash trace;
  std::uint64_t lost = 0;
};

/// An endpoint of the in-process network in that weather.
class Link final : public SubmapExchange<G> {
 public:
  Link(World& world, VehicleId self, std::unique_ptr<SubmapExchange<G>> inner)
      : world_(world), self_(self), inner_(std::move(inner)) {}
  SendStatus send(const Message<G>& message) override { return inner_->send(message); }
  std::vector<Message<G>> take(double) override {
    for (Message<G>& message : inner_->take(world_.now_s)) push(std::move(message));
    std::vector<Message<G>> out;
    while (!due_.empty() && due_.begin()->first <= world_.now_s) {
      world_.trace.add(due_.begin()->first).add(self_, 4).add(due_.begin()->second.sender.vehicle, 4);
      world_.trace.add(due_.begin()->second.payload.index(), 1);
      out.push_back(std::move(due_.begin()->second));
      due_.erase(due_.begin());
    }
    return out;
  }
  ExchangeCounters counters() const override { return inner_->counters(); }

 private:
  void push(Message<G> message) {
    const Impairment& weather = world_.impairment;
    const int copies = world_.chance(weather.duplicate) ? 2 : 1;
    for (int i = 0; i < copies; ++i) {
      if (!world_.reaches(message.sender.vehicle, self_) || world_.chance(weather.loss)) ++world_.lost;
      else due_.emplace(world_.now_s + weather.delay_s + weather.jitter_s * world_.random.uniform(0.0, 1.0), message);
    }
  }
  World& world_;
  VehicleId self_;
  std::unique_ptr<SubmapExchange<G>> inner_;
  std::multimap<double, Message<G>> due_;
};

/// One run of a vehicle's program.
struct Life {
  Life(const ChainId& self, std::unique_ptr<SubmapExchange<G>> network, std::unique_ptr<Journal<G>> kept,
       const SubmapManagerParams& params, const FrontEndState<G>& start, double now_s)
      : journal(std::move(kept)), exchange(std::move(network)), manager(self, *exchange, params) {
    if (journal) manager.keep_in(*journal);
    EXPECT_TRUE(front_end.advance(start));
    DriftParams<G> drift;
    drift.rate = test::drift_per_m_of<G>();
    component = std::make_unique<FrontEndComponent<G>>(front_end, manager, drift);
    AssociationParams quick;  // what is found is a fact like any other: finding it is not what is tried here
    quick.method = SearchMethod::gcbb;
    quick.max_nodes = 5000;
    association = std::make_unique<AssociationComponent<G>>(manager, quick);
    manager.open_chain(now_s, std::nullopt);
  }
  std::unique_ptr<Journal<G>> journal;
  std::unique_ptr<SubmapExchange<G>> exchange;
  SubmapManager<G> manager;
  FrozenLandmarks<G> front_end;
  std::unique_ptr<FrontEndComponent<G>> component;
  std::unique_ptr<AssociationComponent<G>> association;
  std::array<std::uint32_t, fact_kind_count> noted{};  // facts of its own that the history has
};

/// A vehicle through all its lives.
struct Machine {
  VehicleId id = 0;
  std::vector<test::ScriptedStepOf<G>> script;
  std::size_t next = 0;
  double clock_offset_s = 0.0, clock_rate = 1.0;
  BudgetParams budget;
  bool keeps_journal = true;
  bool journal_intact = true;  // nothing of it was ever lost
  Disk disk;
  Epoch last_epoch = 0;
  std::unique_ptr<Life> life;
  double restart_s = 1e300;

  double clock(double now_s) const { return clock_offset_s + clock_rate * now_s; }
};

class Simulation {
 public:
  explicit Simulation(std::uint64_t seed) : world_(seed) {}
  Outcome run();

 private:
  double uniform(double low, double high) { return world_.random.uniform(low, high); }
  void draw_fleet();
  void draw_faults();
  void begin_life(Machine& machine);
  void crash(Machine& machine);
  void damage(Machine& machine);
  void step(Machine& machine);
  void note_own_facts(Machine& machine);
  void heal();
  bool equal() const;
  bool all_accounted_for() const;
  void check();
  void check_declared_missing(const SubmapManager<G>& manager, const std::set<FactId>& held);
  void expect(bool holds, const std::string& what) {
    if (!holds) outcome_.failures.push_back(what);
  }
  std::vector<Machine*> alive() const;

  World world_;
  InProcessNetwork<G> network_;
  std::vector<std::unique_ptr<Machine>> machines_;
  std::map<FactId, Hash> history_;
  std::set<FactId> held_at_the_end_of_faults_;
  Outcome outcome_;
};

void Simulation::draw_fleet() {
  outcome_.vehicles = world_.random.integer(2, 5);
  for (int v = 1; v <= outcome_.vehicles; ++v) {
    auto machine = std::make_unique<Machine>();
    machine->id = static_cast<VehicleId>(v);
    machine->script = test::script_of<G>(machine->id);
    machine->clock_offset_s = uniform(0.0, 1000.0);
    machine->clock_rate = uniform(0.99, 1.01);
    machine->keeps_journal = world_.chance(0.6);
    if (world_.chance(0.3)) machine->budget.bytes_per_s = uniform(3000.0, 10000.0);
    machine->restart_s = world_.chance(0.3) ? uniform(0.0, 30.0) : 0.0;  // some join late
    world_.side[machine->id] = 0;
    machines_.push_back(std::move(machine));
  }
  world_.impairment.loss = world_.chance(0.7) ? uniform(0.0, 0.7) : 0.0;
  world_.impairment.duplicate = world_.chance(0.5) ? uniform(0.0, 0.5) : 0.0;
  world_.impairment.delay_s = world_.chance(0.5) ? uniform(0.0, 0.5) : 0.0;
  world_.impairment.jitter_s = world_.chance(0.5) ? uniform(0.0, 2.0) : 0.0;
}

void Simulation::begin_life(Machine& machine) {
  machine.restart_s = 1e300;
  const double clock_s = machine.clock(world_.now_s);
  machine.last_epoch = std::max(machine.last_epoch + 1, static_cast<Epoch>(clock_s * 1e6));
  SubmapManagerParams params;
  params.map_period_s = 5.0;
  params.repair = under_budget(params.repair, machine.budget.bytes_per_s);
  params.seed = static_cast<std::uint64_t>(world_.random.integer(1, 1 << 30));
  auto link = std::make_unique<Link>(world_, machine.id, network_.join());
  auto paced = std::make_unique<PacedExchange<G>>(std::move(link), machine.budget);
  auto journal = machine.keeps_journal ? std::make_unique<Journal<G>>(std::make_unique<OnDisk>(machine.disk)) : nullptr;
  const std::size_t at = machine.next > 0 ? machine.next - 1 : 0;
  machine.life = std::make_unique<Life>(ChainId{machine.id, machine.last_epoch}, std::move(paced), std::move(journal),
                                        params, machine.script[at].state, clock_s);
  note_own_facts(machine);
}

void Simulation::damage(Machine& machine) {
  Bytes& bytes = machine.disk.bytes;
  if (bytes.size() < 100) return;
  ++outcome_.damaged_journals;
  machine.journal_intact = false;
  if (world_.chance(0.7)) bytes.resize(bytes.size() - static_cast<std::size_t>(uniform(1.0, 99.0)));
  if (world_.chance(0.4)) {
    const auto at = static_cast<std::size_t>(uniform(40.0, static_cast<double>(bytes.size())));
    bytes[at] ^= static_cast<std::uint8_t>(1 << world_.random.integer(0, 7));
  }
}

void Simulation::crash(Machine& machine) {
  ++outcome_.crashes;
  if (machine.life->journal && machine.life->journal->counters().waiting > 0) machine.journal_intact = false;
  machine.life.reset();
  if (machine.keeps_journal && world_.chance(0.3)) damage(machine);
  if (machine.keeps_journal && world_.chance(0.1)) {  // a new disk
    machine.disk.bytes.clear();
    machine.journal_intact = false;
  }
  if (world_.chance(0.75)) machine.restart_s = world_.now_s + uniform(0.5, 15.0);
}

void Simulation::draw_faults() {
  for (const auto& machine : machines_) {
    if (!machine->life) continue;
    if (world_.chance(step_s / 80.0)) crash(*machine);
    if (machine->keeps_journal && world_.chance(step_s / 60.0)) {
      machine->disk.full = !machine->disk.full;
      outcome_.full_disks += machine->disk.full;
    }
  }
  if (!world_.chance(step_s / 20.0)) return;
  ++outcome_.partitions;
  for (auto& [vehicle, side] : world_.side) side = world_.random.integer(0, world_.random.integer(0, 2));
}

void Simulation::step(Machine& machine) {
  if (!machine.life && world_.now_s >= machine.restart_s) {
    outcome_.restarts += machine.last_epoch != 0;
    begin_life(machine);
  }
  if (!machine.life) return;
  Life& life = *machine.life;
  const bool drives = machine.next < machine.script.size() && static_cast<int>(world_.now_s / step_s) % 2 == 0;
  if (drives && world_.now_s < faults_end_s) {
    const auto& scripted = machine.script[machine.next++];
    EXPECT_TRUE(life.front_end.advance(scripted.state));
    if (scripted.landmarks) life.front_end.close(*scripted.landmarks);
    life.component->poll();
  }
  const double clock_s = machine.clock(world_.now_s);
  life.manager.step(clock_s);
  life.association->step();
  life.manager.rebuild(clock_s);
  note_own_facts(machine);
}

void Simulation::note_own_facts(Machine& machine) {
  Life& life = *machine.life;
  const auto& chain = life.manager.store().chains().at(life.manager.self());
  for (int k = 0; k < fact_kind_count; ++k) {
    const auto kind = static_cast<FactKind>(k);
    FactStore<G>::with_sequence(chain, kind, [&](const auto& sequence) {
      std::uint32_t& noted = life.noted[static_cast<std::size_t>(k)];
      for (auto it = sequence.lower_bound(noted); it != sequence.end(); ++it) {
        const auto [known, fresh] = history_.try_emplace({kind, it->second.key}, hash_of(it->second));
        expect(fresh, "a key was used twice by vehicle " + std::to_string(machine.id));
        noted = it->first + 1;
      }
    });
  }
}

void Simulation::heal() {
  world_.impairment = {};
  for (auto& [vehicle, side] : world_.side) side = 0;
  for (const auto& machine : machines_) {
    machine->disk.full = false;
    if (!machine->life && machine->restart_s < 1e300) machine->restart_s = world_.now_s;
    if (machine->last_epoch == 0) machine->restart_s = world_.now_s;
  }
  if (alive().empty()) machines_.front()->restart_s = world_.now_s;
}

std::vector<Machine*> Simulation::alive() const {
  std::vector<Machine*> list;
  for (const auto& machine : machines_)
    if (machine->life) list.push_back(machine.get());
  return list;
}

bool Simulation::equal() const {
  const auto list = alive();
  return std::all_of(list.begin(), list.end(), [&](const Machine* machine) {
    const auto& manager = machine->life->manager;
    return manager.store().holdings() == list.front()->life->manager.store().holdings() &&
           manager.map().facts == manager.store().digest();
  });
}

// Nobody goes on waiting for what is gone.
bool Simulation::all_accounted_for() const {
  const auto list = alive();
  return std::all_of(list.begin(), list.end(),
                     [](const Machine* machine) { return machine->life->manager.facts_missing() == 0; });
}

Outcome Simulation::run() {
  draw_fleet();
  for (; world_.now_s < faults_end_s; world_.now_s += step_s) {
    draw_faults();
    for (const auto& machine : machines_) step(*machine);
  }
  heal();
  for (const auto& machine : machines_) step(*machine);
  for (const Machine* machine : alive())
    machine->life->manager.store().for_each_fact([&](const auto& fact) {
      held_at_the_end_of_faults_.insert({kind_of<std::decay_t<decltype(fact)>>, fact.key});
    });
  // Not before all could have noticed: equal for once may be chance.
  for (double quiet_s = 0.0; world_.now_s < faults_end_s + liveness_s + 10.0 && quiet_s < 10.0;
       world_.now_s += step_s) {
    for (const auto& machine : machines_) step(*machine);
    if (quiet_s == 0.0) outcome_.settled_s = world_.now_s - faults_end_s;
    quiet_s = equal() ? quiet_s + step_s : 0.0;
  }
  for (const double end_s = world_.now_s + declared_missing_s; world_.now_s < end_s && !all_accounted_for();
       world_.now_s += step_s)
    for (const auto& machine : machines_) step(*machine);
  check();
  return outcome_;
}

void Simulation::check() {
  const auto list = alive();
  expect(equal(), "not all vehicles hold the same facts");
  if (outcome_.settled_s > liveness_s || !equal()) {
    expect(false, "not settled within " + std::to_string(liveness_s) + " s");
    outcome_.settled_s = -1.0;
  }
  const auto& first = list.front()->life->manager;
  outcome_.facts = first.store().digest();
  outcome_.map = first.map().map->digest();
  outcome_.trace = world_.trace.value();
  outcome_.facts_stated = history_.size();
  outcome_.messages_lost = world_.lost;

  std::set<FactId> held;
  first.store().for_each_fact([&](const auto& fact) {
    const FactId id{kind_of<std::decay_t<decltype(fact)>>, fact.key};
    held.insert(id);
    const auto stated = history_.find(id);
    expect(stated != history_.end() && stated->second == hash_of(fact), "a fact that nobody ever stated");
  });
  for (const FactId& id : held_at_the_end_of_faults_)
    expect(held.contains(id), std::string("lost though somebody had it: ") + convoy::to_string(id.first));
  std::set<VehicleId> intact;
  for (const Machine* machine : list)
    if (machine->keeps_journal && machine->journal_intact) intact.insert(machine->id);
  for (const auto& [id, hash] : history_) {
    outcome_.facts_gone += !held.contains(id);
    expect(held.contains(id) || !intact.contains(id.second.chain.vehicle), "lost though its author's journal has it");
  }
  for (const Machine* machine : list) {
    const auto& manager = machine->life->manager;
    outcome_.requests += manager.repair_counters().requests_sent;
    outcome_.relayed += manager.repair_counters().facts_relayed;
    check_declared_missing(manager, held);
    expect(manager.map().map->digest() == outcome_.map, "not all vehicles have the same map");
    expect(manager.counters().disagreements == 0, "two vehicles made different maps of the same facts");
    expect(manager.counters().facts_unfit == 0, "a fact of its own was refused");
    for (const Insertion refused : {Insertion::conflict, Insertion::not_finite, Insertion::not_covariance,
                                    Insertion::out_of_range, Insertion::malformed, Insertion::over_share})
      expect(manager.store().insertions()[static_cast<std::size_t>(refused)] == 0,
             std::string("a fact was refused: ") + convoy::to_string(refused));
  }
}

// Every fact that was ever stated is held, or declared missing, or beyond all that this vehicle was ever told of.
void Simulation::check_declared_missing(const SubmapManager<G>& manager, const std::set<FactId>& held) {
  std::uint64_t gone = 0;
  for (const auto& [id, hash] : history_) {
    const auto& [kind, key] = id;
    const auto chain = manager.store().chains().find(key.chain);
    if (chain == manager.store().chains().end()) continue;
    const bool told = key.index < chain->second.marks[static_cast<std::size_t>(kind)].high_water;
    gone += told && !held.contains(id);
  }
  outcome_.facts_declared_missing = std::max(outcome_.facts_declared_missing, manager.facts_lost());
  expect(manager.facts_missing() == 0, "waits for " + std::to_string(manager.facts_missing()) + " facts that are gone");
  expect(manager.facts_lost() == gone, std::to_string(gone) + " facts are gone, of which it declares missing " +
                                           std::to_string(manager.facts_lost()));
}

}  // namespace

Outcome simulate(std::uint64_t seed) { return Simulation(seed).run(); }

std::string to_string(const Outcome& o) {
  std::ostringstream text;
  text << o.vehicles << " vehicles, " << o.crashes << " crashes, " << o.restarts << " restarts, " << o.partitions
       << " partitions, " << o.damaged_journals << " damaged journals, " << o.full_disks << " full disks, "
       << o.messages_lost << " messages lost, " << o.facts_stated << " facts, of which gone " << o.facts_gone
       << " (declared missing " << o.facts_declared_missing << "); " << o.requests << " requests, " << o.relayed
       << " relayed; settled after " << o.settled_s << " s";
  for (const std::string& failure : o.failures) text << "\n  FAILED: " << failure;
  return text.str();
}

std::string report(std::uint64_t seed, const Outcome& outcome) {
  std::ostringstream text;
  text << "seed " << seed << ": " << to_string(outcome) << std::hex << "\n  digest " << outcome.trace << " (facts "
       << outcome.facts << ", map " << outcome.map << ")" << std::dec;
  if (!outcome.failures.empty()) text << "\n  again, of the same commit: convoy_fleet_simulation " << seed << " 1";
  return text.str();
}

}  // namespace convoy::simulation
