// Vehicle: all components of one vehicle behind one door, with the thread that drives them and the one that builds
// maps.
//
//   convoy::RangeBearingEkf<convoy::SE2> slam(ekf_params);      // or any other FrontEnd
//   convoy::Vehicle<convoy::SE2> vehicle(params, slam,          // see VehicleParams
//                                        [&] { return std::make_unique<convoy::dds::DdsExchange<convoy::SE2>>(dds); },
//                                        now_s);                // seconds on the time base of the sensor stamps
//   vehicle.configure();                                        // opens the exchange, a new epoch
//   vehicle.activate();                                         // starts talking
//   vehicle.feed([&] { slam.on_odometry(t, v, omega); });       // on every sensor input
//   auto fleet = vehicle.snapshot();                            // poses of all vehicles, with integrity
#pragma once

#include <convoy/components/association_component.hpp>
#include <convoy/components/exchange_worker.hpp>
#include <convoy/components/front_end_component.hpp>
#include <convoy/components/map_worker.hpp>
#include <convoy/components/state_folder.hpp>
#include <convoy/components/submap_manager.hpp>

#include <condition_variable>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace convoy {

/// What a vehicle needs besides its front end and its network.
template <class G>
struct VehicleParams {
  VehicleId id = 0;                    ///< 1 or more, unique in the fleet
  std::filesystem::path state_folder;  ///< keeps the last epoch and a lock (StateFolder); empty: neither
  bool journal = false;                ///< the state folder keeps all facts, too, and a restart begins with them
  std::function<Epoch()> fresh_epoch = epoch_from_clock;  ///< an epoch that this vehicle id never used; a fixed number
                                                          ///< makes runs repeatable, and collides with other runs
  std::optional<Estimate<G>> static_bias;     ///< where its first epoch starts in the common frame, if known
  typename G::Point mark = G::Point::Zero();  ///< what other vehicles see of this one, body frame [m]
  DriftParams<G> drift;
  AssociationParams association;
  /// A constraint of one's own, see AssociationComponent. Asked from the vehicle's thread, also while feed() runs.
  LooksAlike<G> looks_alike = {};
  SubmapManagerParams submaps;
  BudgetParams budget;          ///< of bytes sent
  WatchdogParams watchdog;      ///< of the network
  double live_period_s = 1.0;   ///< between two live poses, of the front end's time
  double step_period_s = 0.02;  ///< of the thread, wall time, (0, 60]
  int searches_per_step = 8;    ///< pairs of batches compared per step at most, >= 1
};

/// One look at everything, consistent in itself.
template <class G>
struct VehicleSnapshot {
  ChainId self;
  /// All chains heard of, each as of its own slam.stamp_s: this one now, a peer when it last spoke (VehicleParams::
  /// live_period_s of its own, or its last anchor).
  std::vector<VehicleState<G>> vehicles;
  Hash facts_digest = 0, map_digest = 0, selection_digest = 0;  ///< all three of the last exact map
  /// Nothing missing, nothing to search, nothing waiting to be sent, and the map is exact and holds every fact.
  bool settled = false;
  std::uint64_t facts_missing = 0;
  std::uint64_t facts_lost = 0;  ///< declared missing: nobody who is left has them
  bool peers_agree = true;       ///< SubmapManager::peers_agree()
  bool restarted = false;  ///< not the first epoch of this state folder: VehicleParams::static_bias does not apply
  bool refused = false;    ///< another process claims this vehicle's id and began earlier: nothing is sent
  std::uint64_t landmarks_known = 0;
  std::uint64_t landmarks_exported = 0;
  std::uint64_t encounters_unanswered = 0;  ///< others saw this vehicle at a moment that it does not remember
  SubmapManagerCounters submaps;
  RepairCounters repair;
  AssociationCounters association;
  ExchangeCounters exchange;
  ExchangeWorkerCounters network;
  PeerGuardCounters peers;
  std::optional<std::size_t> live_peers;  ///< SubmapExchange::live_peers()
  JournalCounters journal;                ///< zero without one
  Failures failures;  ///< exceptions in the vehicle's threads, those of its network included: it went on
  std::array<std::uint64_t, insertion_count> insertions{};
};

template <class G>
class Vehicle {
 public:
  enum class State : std::uint8_t { unconfigured, inactive, active };
  using Clock = std::function<double()>;  ///< seconds, not decreasing; need not agree with other vehicles'
  using OpenExchange = std::function<std::unique_ptr<SubmapExchange<G>>()>;

  /// `front_end` must outlive it. `open` is called by configure(), and again from a thread of the vehicle when the
  /// network has gone deaf or mute (WatchdogParams); it may throw ConfigError.
  Vehicle(const VehicleParams<G>& params, FrontEnd<G>& front_end, OpenExchange open, Clock clock);
  ~Vehicle();
  Vehicle(const Vehicle&) = delete;
  Vehicle& operator=(const Vehicle&) = delete;

  // Lifecycle, each step reversible; a call in the wrong state throws ConfigError and changes nothing.
  void
  configure();  ///< unconfigured -> inactive: locks the state folder, a new epoch, the exchange opens, the chain begins
  void activate();    ///< inactive -> active: the thread starts
  void deactivate();  ///< active -> inactive: the thread stops; facts are kept, sensor input still counts
  void shutdown();    ///< any -> unconfigured: the exchange closes and the facts are gone
  State state() const;

  /// Runs `input` (which gives the front end one sensor input) and exports what converged. From any thread.
  /// Refused (false) while unconfigured. Throws what `input` or the front end throws.
  bool feed(const std::function<void()>& input);

  /// A receiver of absolute positions said where its antenna (`lever`, body frame [m]) is now: `position`,
  /// east-north(-up) of the fleet's datum [m], `covariance` [m^2]. From any thread, after the sensor input of the same
  /// moment. Refused (false) while unconfigured, or if it is not fit to be a fact (not finite, no covariance). Any rate
  /// will do: one per SelectionParams::fix_correlation_s is sent.
  bool feed_absolute_fix(const typename G::Point& lever, const typename G::Point& position,
                         const typename G::PointCovariance& covariance);

  /// This vehicle sees another one: its mark is at `position` in the body frame now [m], `covariance` [m^2]. From any
  /// thread, after the sensor input of the same moment. The other one says where it was then, so the stamps of both
  /// front ends must be of one clock. Refused (false) while unconfigured, or if it is not fit to be a fact. Any rate
  /// will do: one per SubmapManagerParams::encounter_period_s and vehicle is sent.
  bool feed_encounter(VehicleId other, const typename G::Point& position,
                      const typename G::PointCovariance& covariance);

  /// Throws ConfigError while unconfigured.
  VehicleSnapshot<G> snapshot();

  /// Runs `look` on the components with the thread held off: for what snapshot() does not tell.
  void inspect(const std::function<void(SubmapManager<G>&, FrontEndComponent<G>&)>& look);

  /// Set before configure(): solves the maps, instead of what params.submaps.backend names.
  void use_backend(std::shared_ptr<const Backend<G>> backend) { backend_ = std::move(backend); }
  /// Set before configure().
  void on_export(typename FrontEndComponent<G>::ExportListener listener) { on_export_ = std::move(listener); }

 private:
  void run();
  void step(std::unique_lock<std::mutex>& lock);
  void search(std::unique_lock<std::mutex>& lock);
  void tend_map(double now_s);

  VehicleParams<G> params_;
  FrontEnd<G>& front_end_;
  OpenExchange open_;
  Clock clock_;
  typename FrontEndComponent<G>::ExportListener on_export_;
  std::shared_ptr<const Backend<G>> backend_;

  mutable std::mutex mutex_;
  std::condition_variable wake_;
  State state_ = State::unconfigured;
  bool stop_ = false;
  std::thread thread_;
  Epoch last_epoch_ = 0;  // of this object
  bool restarted_ = false;
  std::unique_ptr<StateFolder> state_folder_;
  std::unique_ptr<ExchangeWorker<G>> exchange_;
  std::unique_ptr<Journal<G>> journal_;
  std::unique_ptr<SubmapManager<G>> manager_;
  std::unique_ptr<MapWorker<G>> map_worker_;
  std::unique_ptr<FrontEndComponent<G>> front_end_component_;
  std::unique_ptr<AssociationComponent<G>> association_;
  int searches_left_ = 0;
  Failures failures_;
};

}  // namespace convoy
