// The sparse map (DESIGN B2): Gauss-Newton with Levenberg-Marquardt damping on the whole problem, iterated until it no
// longer moves, so that the result does not depend on the way there. Block-sparse Cholesky: src/solver/README.md.
#pragma once

#include <convoy/map/map.hpp>

namespace convoy {

struct SparseMapParams {
  int max_iterations = 100;
  double convergence = 1e-12;  ///< squared length of a step in units of its own standard deviation
};

template <class G>
class SparseMap final : public Backend<G> {
 public:
  explicit SparseMap(const SparseMapParams& params = {}) : params_(params) {}
  std::unique_ptr<Map<G>> solve(Problem<G> problem) const override;
  std::shared_ptr<IncrementalMap<G>> incremental() const override;

 private:
  SparseMapParams params_;
};

}  // namespace convoy
