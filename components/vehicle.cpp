#include <convoy/components/vehicle.hpp>
#include <convoy/config_error.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <chrono>

namespace convoy {
namespace {

constexpr double hurried_s = 0.001;                // between two steps while something waits: others get the lock
constexpr std::uint64_t nodes_per_step = 100'000;  // about 10 ms

}  // namespace

template <class G>
Vehicle<G>::Vehicle(const VehicleParams<G>& params, FrontEnd<G>& front_end, OpenExchange open, Clock clock)
    : params_(params), front_end_(front_end), open_(std::move(open)), clock_(std::move(clock)) {
  if (params.id == 0) throw ConfigError("vehicle: id 0 means 'nobody'; use 1 or more");
  if (!(params.step_period_s > 0.0 && params.step_period_s <= 60.0))
    throw ConfigError("vehicle: step_period_s must lie in (0, 60] s");
  if (params.searches_per_step < 1) throw ConfigError("vehicle: searches_per_step must be >= 1");
  if (!params.fresh_epoch) throw ConfigError("vehicle: fresh_epoch must be callable; epoch_from_clock is the default");
  validate(params.drift);
  validate(params.association);
  validate(params.submaps.selection);
  validate(params.submaps.repair);
  validate(params.submaps.peers);
  validate(params.budget);
  validate(params.watchdog);
  if (params.watchdog.deaf_s <= params.submaps.repair.digest_idle_s)
    throw ConfigError(
        "vehicle: the watchdog's deaf_s must be longer than digest_idle_s of repair: peers may be silent that long");
  if (params.journal && params.state_folder.empty())
    throw ConfigError("vehicle: a journal needs a state_folder to lie in");
}

template <class G>
Vehicle<G>::~Vehicle() {
  shutdown();
}

template <class G>
void Vehicle<G>::configure() {
  const std::lock_guard lock(mutex_);
  if (state_ != State::unconfigured)
    throw ConfigError("vehicle: configure() needs the state unconfigured; shut down first");
  auto folder = params_.state_folder.empty() ? nullptr : std::make_unique<StateFolder>(params_.state_folder);
  auto exchange = std::make_unique<ExchangeWorker<G>>(open_, params_.budget, params_.watchdog);
  const auto [epoch, first] =
      folder ? folder->next_epoch(params_.fresh_epoch)
             : StateFolder::NextEpoch{std::max(params_.fresh_epoch(), last_epoch_ + 1), last_epoch_ == 0};
  last_epoch_ = epoch;
  SubmapManagerParams submaps = params_.submaps;
  submaps.repair = under_budget(submaps.repair, params_.budget.bytes_per_s);
  auto manager = std::make_unique<SubmapManager<G>>(ChainId{params_.id, epoch}, *exchange, submaps, backend_);
  std::unique_ptr<Journal<G>> journal;
  if (params_.journal) {
    const auto file = params_.state_folder / "facts.journal";
    journal = std::make_unique<Journal<G>>(open_journal_file(file), file.string());
    manager->keep_in(*journal);
  }
  auto map_worker = std::make_unique<MapWorker<G>>(params_.submaps, manager->backend());
  auto front_end = std::make_unique<FrontEndComponent<G>>(front_end_, *manager, params_.drift, params_.live_period_s);
  auto association = std::make_unique<AssociationComponent<G>>(*manager, params_.association, params_.looks_alike);
  front_end->on_export(on_export_);
  // The static bias is where the first epoch began; a later one begins somewhere else, which nobody knows.
  manager->open_chain(front_end_.state().stamp_s, first ? params_.static_bias : std::nullopt, front_end->persistent());
  front_end->set_mark(params_.mark);
  state_folder_ = std::move(folder);
  exchange_ = std::move(exchange);
  journal_ = std::move(journal);
  manager_ = std::move(manager);
  map_worker_ = std::move(map_worker);
  front_end_component_ = std::move(front_end);
  association_ = std::move(association);
  restarted_ = !first;
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
  std::unique_ptr<MapWorker<G>> worker;  // goes last, when nobody is locked out: it may be in the middle of a map
  const std::lock_guard lock(mutex_);
  worker = std::move(map_worker_);
  association_.reset();
  front_end_component_.reset();
  manager_.reset();
  journal_.reset();
  exchange_.reset();
  state_folder_.reset();  // last: nobody else speaks for this vehicle before it is silent
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
    attempt(failures_, lock, [&] { step(lock); });
    const double pause_s = manager_->busy() ? std::min(hurried_s, params_.step_period_s) : params_.step_period_s;
    wake_.wait_for(lock, std::chrono::duration<double>(pause_s), [this] { return stop_; });
  }
}

template <class G>
void Vehicle<G>::step(std::unique_lock<std::mutex>& lock) {
  const double now_s = clock_();
  attempt(failures_, lock, [&] { manager_->step(now_s); });
  attempt(failures_, lock, [&] { front_end_component_->answer_encounters(); });
  attempt(failures_, lock, [&] { search(lock); });
  attempt(failures_, lock, [&] { tend_map(now_s); });
}

// The lock is open during a search.
template <class G>
void Vehicle<G>::search(std::unique_lock<std::mutex>& lock) {
  association_->find_new_batches();
  std::uint64_t nodes = 0;
  for (searches_left_ = 0; searches_left_ < params_.searches_per_step && nodes < nodes_per_step && !stop_;) {
    auto work = association_->begin();
    if (!work) return;
    ++searches_left_;
    lock.unlock();
    association_->search(*work);
    lock.lock();
    association_->finish(*work);
    nodes += work->result.nodes;
  }
}

template <class G>
void Vehicle<G>::tend_map(double now_s) {
  try {
    if (auto built = map_worker_->collect()) map_worker_->retire(manager_->adopt(std::move(*built)));
  } catch (...) {
    manager_->order_again();
    throw;
  }
  if (map_worker_->idle())
    if (auto order = manager_->order_map(now_s)) map_worker_->start(std::move(*order));
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
bool Vehicle<G>::feed_absolute_fix(const typename G::Point& lever, const typename G::Point& position,
                                   const typename G::PointCovariance& covariance) {
  const std::lock_guard lock(mutex_);
  if (state_ == State::unconfigured) return false;
  return manager_->publish_absolute_fix(front_end_component_->exportable_state(), lever, position, covariance);
}

template <class G>
bool Vehicle<G>::feed_encounter(VehicleId other, const typename G::Point& position,
                                const typename G::PointCovariance& covariance) {
  const std::lock_guard lock(mutex_);
  if (state_ == State::unconfigured) return false;
  return manager_->publish_encounter(front_end_component_->exportable_state(), other, position, covariance);
}

template <class G>
VehicleSnapshot<G> Vehicle<G>::snapshot() {
  const std::lock_guard lock(mutex_);
  if (!manager_) throw ConfigError("vehicle: snapshot() needs a configured vehicle");
  VehicleSnapshot<G> s;
  const FactStore<G>& store = manager_->store();
  s.self = manager_->self();
  manager_->update_live(front_end_component_->live());
  s.vehicles = manager_->vehicles(clock_());
  s.facts_digest = store.digest();
  s.map_digest = manager_->digests().map;
  s.selection_digest = manager_->digests().selection;
  s.facts_missing = manager_->facts_missing();
  s.facts_lost = manager_->facts_lost();
  s.peers_agree = manager_->peers_agree();
  s.refused = manager_->refused();
  s.restarted = restarted_;
  s.network = exchange_->worker_counters();
  s.settled = s.facts_missing == 0 && !manager_->busy() && s.network.outbox.facts_waiting == 0 && searches_left_ == 0 &&
              manager_->map().exact && manager_->map().facts == s.facts_digest;
  for (const auto& [id, chain] : store.chains()) s.landmarks_known += chain.landmarks.size();
  s.landmarks_exported = front_end_component_->landmarks_exported();
  s.submaps = manager_->counters();
  s.submaps.live_unfit += front_end_component_->remembered_unfit();
  s.encounters_unanswered = front_end_component_->encounters_unanswered();
  s.repair = manager_->repair_counters();
  s.association = association_->counters();
  s.exchange = exchange_->counters();
  s.live_peers = exchange_->live_peers();
  s.peers = manager_->peer_counters();
  s.failures = failures_.count > 0 ? failures_ : s.network.failures;
  s.failures.count = failures_.count + s.network.failures.count;
  if (journal_) s.journal = journal_->counters();
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
