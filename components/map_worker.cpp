#include <convoy/components/map_worker.hpp>
#include <convoy/geometry/groups.hpp>

#include <chrono>
#include <utility>
#include <variant>

namespace convoy {

template <class G>
MapWorker<G>::MapWorker(const SubmapManagerParams& params, std::shared_ptr<const Backend<G>> backend)
    : backend_(std::move(backend)),
      replica_(params.limits),
      builder_(std::in_place, params.selection, *backend_),
      selection_(params.selection),
      thread_([this] { run(); }) {}

template <class G>
MapWorker<G>::~MapWorker() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

template <class G>
void MapWorker<G>::start(MapOrder<G> order) {
  {
    const std::lock_guard lock(mutex_);
    order_ = std::move(order);
  }
  ordered_ = true;
  wake_.notify_one();
}

template <class G>
std::optional<BuiltMap<G>> MapWorker<G>::collect() {
  if (!ordered_) return std::nullopt;
  const std::lock_guard lock(mutex_);
  std::optional<BuiltMap<G>> built = std::exchange(built_, std::nullopt);
  const std::exception_ptr failure = std::exchange(failure_, nullptr);
  ordered_ = !built && !failure;
  if (failure) std::rethrow_exception(failure);
  return built;
}

template <class G>
void MapWorker<G>::retire(GlobalMap<G> map) {
  {
    const std::lock_guard lock(mutex_);
    retired_.push_back(std::move(map));
  }
  wake_.notify_one();
}

template <class G>
void MapWorker<G>::run() {
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return stop_ || order_ || !retired_.empty(); });
    if (stop_) return;
    std::vector<GlobalMap<G>> retired = std::exchange(retired_, {});
    std::optional<MapOrder<G>> order = std::exchange(order_, std::nullopt);
    lock.unlock();
    retired.clear();
    std::optional<BuiltMap<G>> built;
    std::exception_ptr failure;
    try {
      if (order) built = build(std::move(*order));
    } catch (...) {
      failure = std::current_exception();
      builder_.emplace(selection_, *backend_);  // where the old one got to nobody knows
    }
    lock.lock();
    if (built) built_ = std::move(built);
    if (failure) failure_ = failure;
  }
}

template <class G>
BuiltMap<G> MapWorker<G>::build(MapOrder<G> order) {
  if (news_.empty()) news_ = std::move(order.news);
  else news_.insert(news_.end(), order.news.begin(), order.news.end());
  for (const AnyFact<G>& any : news_) std::visit([&](const auto& fact) { replica_.insert(fact); }, any);
  news_.clear();
  const auto start = std::chrono::steady_clock::now();
  BuiltMap<G> built{order.exact ? builder_->build(replica_) : builder_->update(replica_), order.revision};
  // The first question for a covariance pays for all of them: here, where nobody waits for the answer.
  for (const auto& [id, chain] : replica_.chains())
    if (!chain.anchors.empty()) built.map.map->pose(id, chain.anchors.rbegin()->second.state);
  built.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return built;
}

#define CONVOY_INSTANTIATE(G) template class MapWorker<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
