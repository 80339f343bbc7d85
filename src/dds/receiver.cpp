#include <convoy/dds/receiver.hpp>

#include <chrono>
#include <utility>

namespace convoy::dds {

void Receiver::wake() {
  {
    const std::lock_guard lock(mutex_);
    if (std::exchange(woken_, true)) return;
  }
  changed_.notify_all();
}

void Receiver::start(std::function<void()> drain) {
  thread_ = std::thread([this, drain = std::move(drain)] { run(drain); });
}

void Receiver::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void Receiver::run(const std::function<void()>& drain) {
  constexpr std::chrono::milliseconds pause{2};
  std::unique_lock lock(mutex_);
  for (;;) {
    changed_.wait(lock, [this] { return woken_ || stopped_; });
    if (stopped_) return;
    woken_ = false;
    lock.unlock();
    drain();
    lock.lock();
    changed_.wait_for(lock, pause, [this] { return stopped_; });
  }
}

}  // namespace convoy::dds
