#include <convoy/exchange/in_process.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>

namespace convoy {

template <class G>
struct InProcessNetwork<G>::Medium {
  std::vector<Endpoint*> endpoints;
  std::uint64_t joined = 0;
};

template <class G>
class InProcessNetwork<G>::Endpoint final : public SubmapExchange<G> {
 public:
  Endpoint(std::shared_ptr<Medium> medium, const Impairment& impairment)
      : medium_(std::move(medium)), queue_(impairment) {
    medium_->endpoints.push_back(this);
  }
  ~Endpoint() override { std::erase(medium_->endpoints, this); }

  SendStatus send(const Message<G>& message) override {
    ++counters_.messages_sent;
    for (Endpoint* peer : medium_->endpoints)
      if (peer != this) peer->inbox_.push_back(message);
    return SendStatus::sent;
  }

  std::vector<Message<G>> take(double now_s) override {
    for (Message<G>& message : inbox_) queue_.push(std::move(message), now_s);
    inbox_.clear();
    auto taken = queue_.take(now_s);
    counters_.messages_taken += taken.size();
    return taken;
  }

  ExchangeCounters counters() const override {
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
  own.seed += 0x9e3779b97f4a7c15U * ++medium_->joined;
  return std::make_unique<Endpoint>(medium_, own);
}

#define CONVOY_INSTANTIATE(G) template class InProcessNetwork<G>;
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
