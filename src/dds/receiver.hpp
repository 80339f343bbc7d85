// The thread that takes what an exchange's readers hold.
#pragma once

#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>

namespace convoy::dds {

/// Calls `drain` once for all that has been told of since the last call, every 2 ms at most.
///
/// Fast DDS 2.9.1 looks at everything that waits behind a lost sample, with a system call for each, whenever something
/// is taken. Taken one by one as they came, samples on a lossy network cost as much as all the rest together.
class Receiver {
 public:
  ~Receiver() { stop(); }

  /// Something has come in. From any thread; what came before start() is not forgotten.
  void wake();
  /// `drain` must not throw.
  void start(std::function<void()> drain);
  /// No call is in progress, nor comes one.
  void stop();

 private:
  void run(const std::function<void()>& drain);

  std::mutex mutex_;
  std::condition_variable changed_;
  bool woken_ = false, stopped_ = false;
  std::thread thread_;
};

}  // namespace convoy::dds
