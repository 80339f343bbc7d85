#include <convoy/components/vehicle.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/groups.hpp>

#include <chrono>
#include <fstream>
#include <random>

namespace convoy {
namespace {

// The last epoch used, on disk; written before it is used, so that a crash can only skip numbers.
Epoch epoch_from_folder(const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / "epoch", next = folder / "epoch.next";
  Epoch last = 0;
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (std::filesystem::exists(file)) {
    std::ifstream in(file);
    std::string text;
    std::getline(in, text);
    const bool digits = !text.empty() && text.size() <= 18 && text.find_first_not_of("0123456789") == std::string::npos;
    if (!digits)
      throw ConfigError(file.string() + ":1: no epoch number; delete the file only if this vehicle's id was never used");
    last = std::stoull(text);
  }
  {
    std::ofstream out(next, std::ios::trunc);
    out << last + 1 << '\n' << std::flush;
    if (!out) throw ConfigError(next.string() + ": cannot write; the state folder must be writable");
  }
  std::filesystem::rename(next, file, error);
  if (error) throw ConfigError(file.string() + ": cannot replace: " + error.message());
  return last + 1;
}

}  // namespace

template <class G>
Vehicle<G>::Vehicle(const VehicleParams<G>& params, FrontEnd<G>& front_end, OpenExchange open, Clock clock)
    : params_(params), front_end_(front_end), open_(std::move(open)), clock_(std::move(clock)) {
  if (params.id == 0) throw ConfigError("vehicle: id 0 means 'nobody'; use 1 or more");
  if (!(params.step_period_s > 0.0 && params.step_period_s <= 60.0))
    throw ConfigError("vehicle: step_period_s must lie in (0, 60] s");
  if (params.searches_per_step < 1) throw ConfigError("vehicle: searches_per_step must be >= 1");
  validate(params.drift);
  validate(params.association);
}

template <class G>
Vehicle<G>::~Vehicle() {
  shutdown();
}

// Without a folder: microseconds since 1970, then twelve random bits, so that it grows and does not repeat.
template <class G>
Epoch Vehicle<G>::next_epoch() const {
  if (!params_.state_folder.empty()) return epoch_from_folder(params_.state_folder);
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  const auto us = std::chrono::duration_cast<std::chrono::microseconds>(now).count();
  return (static_cast<Epoch>(us) << 12) | (std::random_device{}() & 0xfffU);
}

template <class G>
void Vehicle<G>::configure() {
  const std::lock_guard lock(mutex_);
  if (state_ != State::unconfigured) throw ConfigError("vehicle: configure() needs the state unconfigured; shut down first");
  auto exchange = open_();
  const Epoch epoch = next_epoch();
  auto manager = std::make_unique<SubmapManager<G>>(ChainId{params_.id, epoch}, *exchange, params_.submaps);
  auto front_end = std::make_unique<FrontEndComponent<G>>(front_end_, *manager, params_.drift, params_.live_period_s);
  auto association = std::make_unique<AssociationComponent<G>>(*manager, params_.association);
  front_end->on_export(on_export_);
  // The static bias is where the first epoch began; a later one begins somewhere else, which nobody knows.
  const bool elsewhere = !params_.state_folder.empty() && epoch > 1;
  manager->open_chain(front_end_.state().stamp_s, elsewhere ? std::nullopt : params_.static_bias);
  exchange_ = std::move(exchange);
  manager_ = std::move(manager);
  front_end_component_ = std::move(front_end);
  association_ = std::move(association);
  state_ = State::inactive;
}

template <class G>
void Vehicle<G>::activate() {
  const std::lock_guard lock(mutex_);
  if (state_ != State::inactive) throw ConfigError("vehicle: activate() needs the state inactive; configure first");
  stop_ = false;
  thread_ = std::thread([this] { run(); });
  state_ = State::active;
}

template <class G>
void Vehicle<G>::deactivate() {
  {
    const std::lock_guard lock(mutex_);
    if (state_ != State::active) throw ConfigError("vehicle: deactivate() needs the state active");
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
  const std::lock_guard lock(mutex_);
  state_ = State::inactive;
}

template <class G>
void Vehicle<G>::shutdown() {
  if (state() == State::active) deactivate();
  const std::lock_guard lock(mutex_);
  association_.reset();
  front_end_component_.reset();
  manager_.reset();
  exchange_.reset();
  state_ = State::unconfigured;
}

template <class G>
typename Vehicle<G>::State Vehicle<G>::state() const {
  const std::lock_guard lock(mutex_);
  return state_;
}

template <class G>
void Vehicle<G>::run() {
  std::unique_lock lock(mutex_);
  while (!stop_) {
    step();
    wake_.wait_for(lock, std::chrono::duration<double>(params_.step_period_s), [this] { return stop_; });
  }
}

template <class G>
void Vehicle<G>::step() {
  const double now_s = clock_();
  manager_->step(now_s);
  searches_left_ = association_->step(params_.searches_per_step);
  manager_->rebuild(now_s);
}

template <class G>
bool Vehicle<G>::feed(const std::function<void()>& input) {
  const std::lock_guard lock(mutex_);
  if (state_ == State::unconfigured) return false;
  input();
  front_end_component_->poll();
  return true;
}

template <class G>
VehicleSnapshot<G> Vehicle<G>::snapshot() {
  const std::lock_guard lock(mutex_);
  if (!manager_) throw ConfigError("vehicle: snapshot() needs a configured vehicle");
  VehicleSnapshot<G> s;
  const FactStore<G>& store = manager_->store();
  s.self = manager_->self();
  s.vehicles = manager_->vehicles(clock_());
  s.facts_digest = store.digest();
  s.map_digest = manager_->map().map->digest();
  s.selection_digest = manager_->map().selection.digest;
  s.facts_missing = store.missing_count();
  s.settled = s.facts_missing == 0 && searches_left_ == 0 && manager_->map().facts == s.facts_digest;
  for (const auto& [id, chain] : store.chains()) s.landmarks_known += chain.landmarks.size();
  s.landmarks_exported = front_end_component_->landmarks_exported();
  s.submaps = manager_->counters();
  s.repair = manager_->repair_counters();
  s.association = association_->counters();
  s.exchange = exchange_->counters();
  s.insertions = store.insertions();
  return s;
}

template <class G>
void Vehicle<G>::inspect(const std::function<void(SubmapManager<G>&, FrontEndComponent<G>&)>& look) {
  const std::lock_guard lock(mutex_);
  if (!manager_) throw ConfigError("vehicle: inspect() needs a configured vehicle");
  look(*manager_, *front_end_component_);
}

#define CONVOY_INSTANTIATE(G) template class Vehicle<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
