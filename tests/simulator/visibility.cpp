#include "visibility.hpp"

#include <algorithm>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

namespace convoy::simulator {
namespace {

/// Both ways give the same values: each operation is rounded on its own.
bool draw_span(float* depths, std::uint32_t* ids, std::int32_t first, std::int32_t end, float start, float step,
               std::uint32_t id) {
  bool seen = false;
  std::int32_t x = first;
#ifdef __SSE2__
  const __m128 steps = _mm_set1_ps(step), starts = _mm_set1_ps(start);
  const __m128i id4 = _mm_set1_epi32(static_cast<int>(id));
  for (; x + 4 <= end; x += 4) {
    const __m128 at = _mm_cvtepi32_ps(_mm_add_epi32(_mm_set1_epi32(x), _mm_setr_epi32(0, 1, 2, 3)));
    const __m128 depth = _mm_add_ps(starts, _mm_mul_ps(at, steps));
    const __m128 old = _mm_loadu_ps(depths + x), nearer = _mm_cmpgt_ps(depth, old);
    if (_mm_movemask_ps(nearer) == 0) continue;
    seen = true;
    auto* id_at = reinterpret_cast<__m128i*>(ids + x);
    const __m128i mask = _mm_castps_si128(nearer);
    _mm_storeu_ps(depths + x, _mm_max_ps(depth, old));
    _mm_storeu_si128(id_at, _mm_or_si128(_mm_and_si128(mask, id4), _mm_andnot_si128(mask, _mm_loadu_si128(id_at))));
  }
#endif
  for (; x < end; ++x) {
    const float depth = start + static_cast<float>(x) * step;
    if (!(depth > depths[x])) continue;
    depths[x] = depth, ids[x] = id;
    seen = true;
  }
  return seen;
}

std::int64_t floor_divided(std::int64_t a, std::int64_t b) { return a / b - (a % b < 0 ? 1 : 0); }

/// The first pixel whose middle is at or beyond a coordinate.
std::int32_t first_middle(std::int32_t subpixels) {
  constexpr std::int32_t n = VisibilityBuffer::kSubpixels;
  return (subpixels - n / 2 + n - 1) >> 4;
}

}  // namespace

VisibilityBuffer::VisibilityBuffer(const Window& window)
    : window_(window),
      stride_(static_cast<std::size_t>(window.width)),
      inverse_depths_(stride_ * static_cast<std::size_t>(window.height)),
      ids_(inverse_depths_.size()),
      first_(static_cast<std::size_t>(window.height)),
      end_(first_.size()) {
  clear();
}

void VisibilityBuffer::clear() {
  std::fill(inverse_depths_.begin(), inverse_depths_.end(), 0.0F);
  std::fill(ids_.begin(), ids_.end(), kNothing);
}

/// Column, for each row whose middle is from `upper` to before `lower`, of the first middle at or right of the edge.
void VisibilityBuffer::trace(const Corner& upper, const Corner& lower, std::vector<std::int32_t>& columns) const {
  const std::int32_t first = first_middle(upper.y()), end = first_middle(lower.y());
  if (first >= end) return;
  const std::int64_t dx = lower.x() - upper.x(), dy = lower.y() - upper.y();
  const std::int64_t divisor = kSubpixels * dy;
  const std::int64_t down = first * kSubpixels + kSubpixels / 2 - upper.y();
  // ceil(n / divisor), n the edge's distance from the row's first middle; kept as quotient and remainder.
  const std::int64_t n = (upper.x() - kSubpixels / 2) * dy + down * dx + divisor - 1;
  std::int64_t column = floor_divided(n, divisor), rest = n - column * divisor;
  const std::int64_t step = floor_divided(dx, dy), step_rest = (dx - step * dy) * kSubpixels;
  for (std::int32_t row = first; row < end; ++row) {
    columns[static_cast<std::size_t>(row)] = static_cast<std::int32_t>(column);
    column += step, rest += step_rest;
    if (rest >= divisor) rest -= divisor, ++column;
  }
}

bool VisibilityBuffer::draw(const Corner* corners, int count, const Eigen::Vector3d& inverse_depth, std::uint32_t id) {
  if (count < 3) return false;  // nothing is left of it in the window
  std::int32_t top = std::numeric_limits<std::int32_t>::max(), bottom = std::numeric_limits<std::int32_t>::min();
  for (int i = 0; i < count; ++i) {
    const Corner &a = corners[i], &b = corners[i + 1 < count ? i + 1 : 0];
    top = std::min(top, a.y()), bottom = std::max(bottom, a.y());
    if (b.y() > a.y()) trace(a, b, first_);
    if (b.y() < a.y()) trace(b, a, end_);
  }
  const Window& w = window_;
  const double unit = 1.0 / w.pixels_per_unit;
  const auto step = static_cast<float>(inverse_depth.x() * unit);
  const double corner =
      inverse_depth.x() * (w.left + 0.5 * unit) + inverse_depth.y() * (w.top + 0.5 * unit) + inverse_depth.z();
  bool seen = false;
  for (std::int32_t row = first_middle(top), rows_end = first_middle(bottom); row < rows_end; ++row) {
    const auto y = static_cast<std::size_t>(row);
    if (first_[y] >= end_[y]) continue;
    const auto start = static_cast<float>(corner + inverse_depth.y() * unit * row);
    seen |=
        draw_span(inverse_depths_.data() + y * stride_, ids_.data() + y * stride_, first_[y], end_[y], start, step, id);
  }
  return seen;
}

}  // namespace convoy::simulator
