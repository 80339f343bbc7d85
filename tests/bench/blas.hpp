// The BLAS that a baseline runs on: whichever this machine has, on one thread.
#pragma once

#include <dlfcn.h>

#include <filesystem>
#include <string>

namespace convoy::bench {

/// Keeps it to one thread, where it has several, and tells its name, "openblas-serial/libblas.so.3".
inline std::string one_thread_of_blas() {
  if (void* set_threads = dlsym(RTLD_DEFAULT, "openblas_set_num_threads"))
    reinterpret_cast<void (*)(int)>(set_threads)(1);
  Dl_info info{};
  void* symbol = dlsym(RTLD_DEFAULT, "dgemm_");
  if (!symbol || !dladdr(symbol, &info) || !info.dli_fname) return "no BLAS";
  const std::filesystem::path file = std::filesystem::canonical(info.dli_fname);
  return (file.parent_path().filename() / file.filename()).string();
}

/// Whether OpenMP, where it is loaded, keeps to one thread. Only the environment can tell it to: OMP_THREAD_LIMIT=1.
inline bool one_thread_of_openmp() {
  const auto limit = reinterpret_cast<int (*)()>(dlsym(RTLD_DEFAULT, "omp_get_thread_limit"));
  return !limit || limit() == 1;
}
constexpr const char* several_threads = "OpenMP may use several threads; set OMP_THREAD_LIMIT=1";

}  // namespace convoy::bench
