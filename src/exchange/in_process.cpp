#include <convoy/exchange/in_process.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/fact_codec.hpp>
#include <convoy/submap/rounding.hpp>

#include <algorithm>
#include <mutex>

namespace convoy {

namespace {

constexpr std::size_t bytes_per_message = 128;  // headers
constexpr std::size_t bytes_per_pose = 256, bytes_per_mark = 32, bytes_per_range = 8;

/// About what a rounded landmark takes on a wire: its index, position and covariance, the columns of its loading.
template <class G>
std::size_t size_of(const LandmarkFact<G>& landmark) {
  constexpr std::size_t dim = G::Dim, reals = dim + dim * (dim + 1) / 2;
  const bool described = landmark.descriptor.kind != Descriptor::Kind::none;
  const std::size_t columns = columns_of<G>(landmark.loading);
  return 4 + 4 * reals + (columns > 0) + (columns + 1) / 2 + dim * columns + (landmark.kind != 0) +
         (described ? 1 + landmark.descriptor.bytes.size() : 0);
}

/// About what it takes on a wire.
template <class G>
std::size_t size_of(const Payload<G>& payload) {
  Bytes bytes;
  std::size_t more = bytes_per_message;
  std::visit(
      [&](const auto& p) {
        using P = std::decay_t<decltype(p)>;
        if constexpr (std::is_same_v<P, LandmarkBatch<G>>) {
          for (const LandmarkFact<G>& landmark : p.landmarks) more += size_of(landmark);
        } else if constexpr (std::is_same_v<P, LivePose<G>>) {
          more += bytes_per_pose;
        } else if constexpr (std::is_same_v<P, Digest>) {
          more += bytes_per_mark * p.marks.size();
        } else if constexpr (std::is_same_v<P, Request>) {
          more += bytes_per_range * p.ranges.size();
        } else {
          encode<G>(p, bytes);
        }
      },
      payload);
  return bytes.size() + more;
}

}  // namespace

template <class G>
struct InProcessNetwork<G>::Medium {
  std::mutex mutex;  // of all that endpoints share: their inboxes, and who they are
  std::vector<Endpoint*> endpoints;
  std::uint64_t joined = 0;
};

template <class G>
class InProcessNetwork<G>::Endpoint final : public SubmapExchange<G> {
 public:
  Endpoint(std::shared_ptr<Medium> medium, const Impairment& impairment)
      : medium_(std::move(medium)), queue_(impairment) {
    const std::lock_guard lock(medium_->mutex);
    medium_->endpoints.push_back(this);
  }
  ~Endpoint() override {
    const std::lock_guard lock(medium_->mutex);
    std::erase(medium_->endpoints, this);
  }

  SendStatus send(const Message<G>& message) override {
    const std::lock_guard lock(medium_->mutex);
    ++counters_.messages_sent;
    counters_.bytes_sent += size_of<G>(message.payload);
    for (Endpoint* peer : medium_->endpoints)
      if (peer != this) peer->inbox_.push_back(message);
    return SendStatus::sent;
  }

  std::vector<Message<G>> take(double now_s) override {
    const std::lock_guard lock(medium_->mutex);
    for (Message<G>& message : inbox_) queue_.push(std::move(message), now_s);
    inbox_.clear();
    auto taken = queue_.take(now_s);
    counters_.messages_taken += taken.size();
    return taken;
  }

  ExchangeCounters counters() const override {
    const std::lock_guard lock(medium_->mutex);
    ExchangeCounters counters = counters_;
    counters.dropped = queue_.lost();
    return counters;
  }

 private:
  std::shared_ptr<Medium> medium_;
  std::vector<Message<G>> inbox_;
  ImpairedQueue<G> queue_;
  ExchangeCounters counters_;
};

template <class G>
InProcessNetwork<G>::InProcessNetwork() : medium_(std::make_shared<Medium>()) {}
template <class G>
InProcessNetwork<G>::~InProcessNetwork() = default;

template <class G>
std::unique_ptr<SubmapExchange<G>> InProcessNetwork<G>::join(const Impairment& impairment) {
  Impairment own = impairment;
  {
    const std::lock_guard lock(medium_->mutex);
    own.seed += 0x9e3779b97f4a7c15U * ++medium_->joined;
  }
  return std::make_unique<Endpoint>(medium_, own);
}

#define CONVOY_INSTANTIATE(G) template class InProcessNetwork<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
