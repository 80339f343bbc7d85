// Runs are independent, so they go side by side; their results stand in the order of the runs.
#pragma once

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace convoy::cli::consistency {

/// {f(0), ..., f(count - 1)}. The first exception of a run is thrown here.
template <class Function>
auto each_run(int count, Function&& f) {
  std::vector<decltype(f(0))> results(static_cast<std::size_t>(count));
  std::atomic<int> next{0};
  std::exception_ptr failure;
  std::mutex failure_mutex;
  const auto work = [&] {
    for (int run = next++; run < count; run = next++) {
      try {
        results[static_cast<std::size_t>(run)] = f(run);
      } catch (...) {
        const std::lock_guard lock(failure_mutex);
        if (!failure) failure = std::current_exception();
        next = count;
      }
    }
  };
  std::vector<std::thread> threads;
  const int cores = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  for (int t = 1; t < std::min(cores, count); ++t) threads.emplace_back(work);
  work();
  for (std::thread& thread : threads) thread.join();
  if (failure) std::rethrow_exception(failure);
  return results;
}

}  // namespace convoy::cli::consistency
