// A baseline: CHOLMOD's supernodal factorisation of the fleets of bench_solver, in the same order of blocks.
// Built where CHOLMOD is. Its supernodal part is under the GPL, so it stays in this executable.
#include <convoy/solver/block_cholesky.hpp>
#include <convoy/solver/block_ordering.hpp>

#include <benchmark/benchmark.h>

#include <Eigen/CholmodSupport>
#include <vector>

#include "blas.hpp"
#include "fleet_system.hpp"

namespace {

using namespace convoy;

template <int D>
std::vector<int> scalar_order(const BlockPattern& pattern) {
  std::vector<int> order;
  for (const int block : minimum_degree_order(pattern))
    for (int d = 0; d < D; ++d) order.push_back(D * block + d);
  return order;
}

class Cholmod {
 public:
  /// Lower triangle; both must outlive this.
  Cholmod(const Eigen::SparseMatrix<double>& H, std::vector<int> order) {
    cholmod_start(&common_);
    common_.supernodal = CHOLMOD_SUPERNODAL;
    common_.nmethods = 1;
    common_.method[0].ordering = CHOLMOD_GIVEN;
    H_ = Eigen::viewAsCholmod(H.selfadjointView<Eigen::Lower>());
    factor_ = cholmod_analyze_p(&H_, order.data(), nullptr, 0, &common_);
  }
  ~Cholmod() {
    cholmod_free_factor(&factor_, &common_);
    cholmod_finish(&common_);
  }
  Cholmod(const Cholmod&) = delete;
  Cholmod& operator=(const Cholmod&) = delete;

  bool factor() { return factor_ && cholmod_factorize(&H_, factor_, &common_) && common_.status == CHOLMOD_OK; }

  Eigen::VectorXd solve(Eigen::VectorXd b) {
    cholmod_dense view = Eigen::viewAsCholmod(b);
    cholmod_dense* x = cholmod_solve(CHOLMOD_A, factor_, &view, &common_);
    const Eigen::VectorXd solution = Eigen::Map<Eigen::VectorXd>(static_cast<double*>(x->x), b.size());
    cholmod_free_dense(&x, &common_);
    return solution;
  }

  /// The numbers of L and their pattern.
  double held_MB() const {
    return 1e-6 *
           (static_cast<double>(factor_->xsize) * sizeof(double) + static_cast<double>(factor_->ssize) * sizeof(int));
  }

 private:
  cholmod_common common_{};
  cholmod_sparse H_{};
  cholmod_factor* factor_ = nullptr;
};

template <int D>
bool agrees(const bench::System<D>& system, Cholmod& cholmod) {
  BlockCholesky ours(system.pattern);
  system.fill(ours);
  if (!ours.factor().ok()) return false;
  Eigen::VectorXd x = Eigen::VectorXd::Ones(ours.size());
  const Eigen::VectorXd y = cholmod.solve(x);
  ours.solve(x);
  return (x - y).norm() <= 1e-6 * y.norm();
}

template <int D>
void BM_cholmod_factor(benchmark::State& state) {
  const std::string blas = bench::one_thread_of_blas();
  if (!bench::one_thread_of_openmp()) {
    state.SkipWithError(bench::several_threads);
    return;
  }
  const auto& system = bench::fleet<D>(static_cast<int>(state.range(0)));
  Cholmod cholmod(system.scalar, scalar_order<D>(system.pattern));
  bool ok = true;
  for (auto _ : state) ok = cholmod.factor() && ok;
  if (!ok) state.SkipWithError("not positive definite");
  else if (!agrees(system, cholmod)) state.SkipWithError("the solutions differ");
  state.counters["held_MB"] = cholmod.held_MB();
  state.SetLabel("CHOLMOD " + std::to_string(CHOLMOD_MAIN_VERSION) + "." + std::to_string(CHOLMOD_SUB_VERSION) + ", " +
                 blas);
}
BENCHMARK_TEMPLATE(BM_cholmod_factor, 3)->Arg(300)->Arg(20000)->Arg(68000)->Unit(benchmark::kMillisecond);
BENCHMARK_TEMPLATE(BM_cholmod_factor, 6)->Arg(300)->Arg(20000)->Arg(68000)->Unit(benchmark::kMillisecond);

}  // namespace
