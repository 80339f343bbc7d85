// MapWorker: builds maps in a thread of its own, from a replica of the facts, so that neither receiving nor the live
// pose ever waits for a solution. Only new facts are handed over, so that an order takes no longer than what is new;
// the price is that the facts are held twice.
#pragma once

#include <convoy/components/submap_manager.hpp>

#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>

namespace convoy {

/// One order at a time. All calls from one thread, or under one lock; none of them waits.
template <class G>
class MapWorker {
 public:
  MapWorker(const SubmapManagerParams& params, std::shared_ptr<const Backend<G>> backend);
  /// Waits for the build in progress.
  ~MapWorker();
  MapWorker(const MapWorker&) = delete;
  MapWorker& operator=(const MapWorker&) = delete;

  /// False from start() until its map is collected.
  bool idle() const { return !ordered_; }
  /// Only when idle.
  void start(MapOrder<G> order);
  /// The map of the last order, once it is there. Throws what building it threw; what was ordered is not lost, but the
  /// map has to be ordered again.
  std::optional<BuiltMap<G>> collect();
  /// Destroys a map in the worker's thread: a large one takes a while.
  void retire(GlobalMap<G> map);

 private:
  void run();
  BuiltMap<G> build(MapOrder<G> order);

  // Of the worker's thread alone.
  std::shared_ptr<const Backend<G>> backend_;
  FactStore<G> replica_;
  std::vector<AnyFact<G>> news_;  // not in the replica yet
  std::optional<MapBuilder<G>> builder_;
  SelectionParams selection_;

  bool ordered_ = false;  // of the callers alone

  std::mutex mutex_;  // guards what follows
  std::condition_variable wake_;
  std::optional<MapOrder<G>> order_;
  std::optional<BuiltMap<G>> built_;
  std::exception_ptr failure_;
  std::vector<GlobalMap<G>> retired_;
  bool stop_ = false;
  std::thread thread_;  // last: everything else is there when it starts
};

}  // namespace convoy
