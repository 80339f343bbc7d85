#include <convoy/geometry/covariance.hpp>
#include <convoy/geometry/groups.hpp>
#include <convoy/submap/rounding.hpp>

#include <algorithm>
#include <cmath>
#include <limits>

namespace convoy {
namespace {

constexpr int exponent_bias = 64, max_exponent = 127, max_shift = 15, max_mantissa = 127;

template <class Matrix>
bool fits_single(const Matrix& m) {
  return m.allFinite() && m.cwiseAbs().maxCoeff() <= double{std::numeric_limits<float>::max()};
}

/// By way of memory: where several neighbours are rounded at once, GCC 12 leaves some of them as they are.
template <class Matrix>
Matrix to_single(const Matrix& m) {
  return m.unaryExpr([](double value) {
    const volatile float single = static_cast<float>(value);
    return static_cast<double>(single);
  });
}

template <class Matrix>
bool is_single(const Matrix& m) {
  return fits_single(m) && to_single(m) == m;
}

/// The least exponent that leaves `largest` eight bits.
int exponent_of(double largest) {
  if (largest == 0.0) return 0;
  int exponent = 0;
  std::frexp(largest / (max_mantissa + 0.5), &exponent);  // largest < 127.5 * 2^exponent
  return std::max(0, exponent + exponent_bias);
}

/// A covariance that is not below P when it has been rounded to single precision. That moves each number by half a unit
/// in the last place at most; twice as much as this can take from an eigenvalue is added to all of them.
template <class Matrix>
Matrix raised(const Matrix& P) {
  constexpr double unit = std::numeric_limits<float>::epsilon(), least = std::numeric_limits<float>::min();
  const double largest = P.cwiseAbs().maxCoeff();
  if (largest == 0.0) return P;
  return P + static_cast<double>(P.rows()) * std::max(unit * largest, least) * Matrix::Identity();
}

bool is_sound(const Descriptor& descriptor) {
  return descriptor.kind != Descriptor::Kind::none || descriptor == Descriptor{};
}

}  // namespace

template <class G>
std::optional<BlockLoading<G>> block_loading(const typename G::Loading& loading) {
  if (!loading.allFinite()) return std::nullopt;
  const int largest = exponent_of(loading.cwiseAbs().maxCoeff());
  if (largest > max_exponent) return std::nullopt;
  BlockLoading<G> block;
  block.exponent = static_cast<std::uint8_t>(largest);
  for (Eigen::Index k = 0; k < loading.cols(); ++k) {
    const int exponent = std::max(largest - max_shift, exponent_of(loading.col(k).cwiseAbs().maxCoeff()));
    block.shift[static_cast<std::size_t>(k)] = static_cast<std::uint8_t>(largest - exponent);
    for (Eigen::Index r = 0; r < loading.rows(); ++r)
      block.mantissa[static_cast<std::size_t>(loading.rows() * k + r)] =
          static_cast<std::int8_t>(std::lround(std::ldexp(loading(r, k), exponent_bias - exponent)));
  }
  return block;
}

template <class G>
typename G::Loading loading_of(const BlockLoading<G>& block) {
  typename G::Loading loading;
  for (std::size_t k = 0; k < block.columns; ++k)
    for (std::size_t r = 0; r < block.rows; ++r)
      loading(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(k)) = std::ldexp(
          static_cast<double>(block.mantissa[block.rows * k + r]), block.exponent - block.shift[k] - exponent_bias);
  return loading;
}

template <class G>
std::size_t columns_of(const typename G::Loading& loading) {
  Eigen::Index n = loading.cols();
  while (n > 0 && loading.col(n - 1).isZero(0.0)) --n;
  return static_cast<std::size_t>(n);
}

template <class G>
bool is_rounded(const LandmarkFact<G>& l) {
  if (!is_single(l.position) || !is_single(l.covariance) || l.covariance != l.covariance.transpose()) return false;
  if (!is_sound(l.descriptor)) return false;
  const auto block = block_loading<G>(l.loading);
  return block && loading_of(*block) == l.loading;
}

template <class G>
LandmarkFact<G> rounded(LandmarkFact<G> l) {
  if (is_rounded(l)) return l;
  const auto block = block_loading<G>(l.loading);
  if (!block || !fits_single(l.position) || !fits_single(l.covariance)) return l;
  using Covariance = typename G::PointCovariance;
  const typename G::Loading loading = loading_of(*block), change = loading - l.loading;
  const Covariance own = l.own_covariance() + 8.0 * change * change.transpose();
  const Covariance covariance = raised(symmetrised(Covariance(own + loading * loading.transpose())));
  if (!fits_single(covariance)) return l;
  l.position = to_single(l.position);
  l.covariance = to_single(covariance);
  l.loading = loading;
  if (!is_sound(l.descriptor)) l.descriptor = {};
  return l;
}

#define CONVOY_INSTANTIATE(G)                                                           \
  template std::optional<BlockLoading<G>> block_loading<G>(const typename G::Loading&); \
  template typename G::Loading loading_of<G>(const BlockLoading<G>&);                   \
  template std::size_t columns_of<G>(const typename G::Loading&);                       \
  template LandmarkFact<G> rounded<G>(LandmarkFact<G>);                                 \
  template bool is_rounded<G>(const LandmarkFact<G>&);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
