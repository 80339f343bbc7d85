#include <convoy/association/appearance.hpp>
#include <convoy/geometry/groups.hpp>

#include <algorithm>
#include <cmath>

namespace convoy {
namespace {

template <class G>
bool says_something(const Batch<G>& batch) {
  return std::any_of(batch.landmarks.begin(), batch.landmarks.end(), [](const LandmarkFact<G>& l) {
    return l.kind != 0 || l.descriptor.kind != Descriptor::Kind::none;
  });
}

}  // namespace

std::optional<double> similarity(const Descriptor& a, const Descriptor& b) {
  if (a.kind != Descriptor::Kind::patch_8x8_4bit || b.kind != a.kind) return std::nullopt;
  int sum_a = 0, sum_b = 0, aa = 0, bb = 0, ab = 0;
  for (std::size_t k = 0; k < a.bytes.size(); ++k) {
    const int a0 = a.bytes[k] & 15, a1 = a.bytes[k] >> 4, b0 = b.bytes[k] & 15, b1 = b.bytes[k] >> 4;
    sum_a += a0 + a1;
    sum_b += b0 + b1;
    aa += a0 * a0 + a1 * a1;
    bb += b0 * b0 + b1 * b1;
    ab += a0 * b0 + a1 * b1;
  }
  constexpr int pixels = 64;
  const double variance = static_cast<double>(pixels * aa - sum_a * sum_a) * (pixels * bb - sum_b * sum_b);
  if (variance == 0.0) return std::nullopt;
  return (pixels * ab - sum_a * sum_b) / std::sqrt(variance);
}

template <class G>
LooksAlike<G> alike_by_appearance(const Batch<G>& a, const Batch<G>& b, double min_similarity) {
  if (!says_something(a) || !says_something(b)) return {};
  return [min_similarity](const LandmarkFact<G>& i, const LandmarkFact<G>& j) {
    if (i.kind != 0 && j.kind != 0 && i.kind != j.kind) return false;
    const auto by_patch = similarity(i.descriptor, j.descriptor);
    return !by_patch || *by_patch >= min_similarity;
  };
}

#define CONVOY_INSTANTIATE(G) template LooksAlike<G> alike_by_appearance(const Batch<G>&, const Batch<G>&, double);
CONVOY_FOR_EACH_GROUP(CONVOY_INSTANTIATE)

}  // namespace convoy
