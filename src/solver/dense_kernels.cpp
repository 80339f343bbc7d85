#include <convoy/solver/dense_kernels.hpp>

#include <algorithm>
#include <atomic>
#include <cmath>

#pragma GCC diagnostic ignored "-Wpsabi"  // vectors are passed to inlined functions only

namespace convoy::dense {
namespace {

#define CONVOY_INLINE inline __attribute__((always_inline))

// Four doubles; where the processor has only two at a time, the compiler splits them.
typedef double Vector __attribute__((vector_size(32)));

CONVOY_INLINE Vector load(const double* from) {
  Vector v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}
CONVOY_INLINE void store(double* to, const Vector& v) { __builtin_memcpy(to, &v, sizeof v); }

constexpr int kTile = 4;    // columns of C computed at once
constexpr int kPanel = 64;  // columns factored before what is right of them is updated

// V vectors of rows by N columns of C, held in registers over the whole sum: hence every loop but that one is unrolled.
template <int V, int N, bool Add>
CONVOY_INLINE void tile(double* C, std::ptrdiff_t ldc, const double* A, std::ptrdiff_t lda, const Strided& B, int k) {
  Vector sum[V][N];
#pragma GCC unroll 4
  for (int v = 0; v < V; ++v)
#pragma GCC unroll 4
    for (int j = 0; j < N; ++j) sum[v][j] = Vector{};
  const double* b = B.data;
  const std::ptrdiff_t row = B.row_stride, column = B.column_stride;
  for (int p = 0; p < k; ++p, A += lda, b += column) {
    Vector a[V];
#pragma GCC unroll 4
    for (int v = 0; v < V; ++v) a[v] = load(A + 4 * v);
#pragma GCC unroll 4
    for (int j = 0; j < N; ++j) {
      const double bj = b[j * row];
#pragma GCC unroll 4
      for (int v = 0; v < V; ++v) sum[v][j] += a[v] * bj;
    }
  }
#pragma GCC unroll 4
  for (int j = 0; j < N; ++j)
#pragma GCC unroll 4
    for (int v = 0; v < V; ++v) {
      double* c = C + j * ldc + 4 * v;
      if constexpr (Add) store(c, load(c) + sum[v][j]);
      else store(c, load(c) - sum[v][j]);
    }
}

template <int N, bool Add>
CONVOY_INLINE void column_tile(double* C, std::ptrdiff_t ldc, int m, const double* A, std::ptrdiff_t lda,
                               const Strided& B, int k) {
  int i = 0;
  for (; i + 8 <= m; i += 8) tile<2, N, Add>(C + i, ldc, A + i, lda, B, k);
  for (; i < m; i += 4) tile<1, N, Add>(C + i, ldc, A + i, lda, B, k);
}

template <bool Add>
CONVOY_INLINE void any_column_tile(double* C, std::ptrdiff_t ldc, int m, int n, const double* A, std::ptrdiff_t lda,
                                   const Strided& B, int k) {
  switch (n) {
    case 1: column_tile<1, Add>(C, ldc, m, A, lda, B, k); break;
    case 2: column_tile<2, Add>(C, ldc, m, A, lda, B, k); break;
    case 3: column_tile<3, Add>(C, ldc, m, A, lda, B, k); break;
    default: column_tile<4, Add>(C, ldc, m, A, lda, B, k); break;
  }
}

template <bool Add>
CONVOY_INLINE void product(double* C, int ldc, int m, int n, const double* A, int lda, const Strided& B, int k) {
  for (int j = 0; j < n; j += kTile)
    any_column_tile<Add>(C + std::ptrdiff_t(j) * ldc, ldc, m, std::min(kTile, n - j), A, lda,
                         {B.data + j * B.row_stride, B.row_stride, B.column_stride}, k);
}

// C (m x n, lower trapezoid) -= A A_top^T, where row 0 of C and of A are the same row of the front. Row tiles start at
// multiples of kRowPad, so some of the upper triangle is overwritten.
CONVOY_INLINE void subtract_lower(double* C, int ldc, int m, int n, const double* A, int lda, int k) {
  for (int j = 0; j < n; j += kTile) {
    const int top = j / kRowPad * kRowPad;
    any_column_tile<false>(C + std::ptrdiff_t(j) * ldc + top, ldc, m - top, std::min(kTile, n - j), A + top, lda,
                           {A + j, 1, lda}, k);
  }
}

// The diagonal block (N columns from row j of the front) and everything below it.
template <int N>
CONVOY_INLINE int factor_columns(double* P, std::ptrdiff_t ld, int rows, int j, const double* smallest_pivot) {
  double* column[N];
  for (int c = 0; c < N; ++c) column[c] = P + (j + c) * ld;
  double inverse[N], l[N][N] = {};
  for (int c = 0; c < N; ++c) {
    double pivot = column[c][j + c];
    for (int p = 0; p < c; ++p) pivot -= l[c][p] * l[c][p];
    if (!(pivot > smallest_pivot[j + c]) || !std::isfinite(pivot)) return j + c;
    const double root = std::sqrt(pivot);
    column[c][j + c] = root;
    inverse[c] = 1.0 / root;
    for (int i = c + 1; i < N; ++i) {
      double x = column[c][j + i];
      for (int p = 0; p < c; ++p) x -= l[i][p] * l[c][p];
      column[c][j + i] = l[i][c] = x * inverse[c];
    }
  }
  int i = j + N;
  const int aligned = std::min(padded(i), rows);
  for (; i < aligned; ++i)
    for (int c = 0; c < N; ++c) {
      double x = column[c][i];
      for (int p = 0; p < c; ++p) x -= column[p][i] * l[c][p];
      column[c][i] = x * inverse[c];
    }
  for (; i < rows; i += kRowPad) {
    Vector x[N];
#pragma GCC unroll 4
    for (int c = 0; c < N; ++c) {
      x[c] = load(column[c] + i);
#pragma GCC unroll 4
      for (int p = 0; p < c; ++p) x[c] -= x[p] * l[c][p];
      x[c] *= inverse[c];
      store(column[c] + i, x[c]);
    }
  }
  return -1;
}

CONVOY_INLINE int front(double* P, int ld, int rows, int columns, double* U, int ld_update,
                        const double* smallest_pivot) {
  const std::ptrdiff_t stride = ld;
  for (int begin = 0; begin < columns; begin += kPanel) {
    const int end = std::min(begin + kPanel, columns);
    for (int j = begin; j < end; j += kTile) {
      const int n = std::min(kTile, end - j), top = j / kRowPad * kRowPad;
      if (j > begin)
        any_column_tile<false>(P + j * stride + top, stride, rows - top, n, P + begin * stride + top, stride,
                               {P + begin * stride + j, 1, stride}, j - begin);
      int failed = -1;
      switch (n) {
        case 1: failed = factor_columns<1>(P, stride, rows, j, smallest_pivot); break;
        case 2: failed = factor_columns<2>(P, stride, rows, j, smallest_pivot); break;
        case 3: failed = factor_columns<3>(P, stride, rows, j, smallest_pivot); break;
        default: failed = factor_columns<4>(P, stride, rows, j, smallest_pivot); break;
      }
      if (failed >= 0) return failed;
    }
    for (int j = end; j < columns; j += kTile) {
      const int n = std::min(kTile, columns - j), top = j / kRowPad * kRowPad;
      any_column_tile<false>(P + j * stride + top, stride, rows - top, n, P + begin * stride + top, stride,
                             {P + begin * stride + j, 1, stride}, end - begin);
    }
    subtract_lower(U, ld_update, rows - columns, rows - columns, P + begin * stride + columns, ld, end - begin);
  }
  return -1;
}

// N columns of X, from the right; x and l: the first of them, `diagonal`: its row of the diagonal block.
template <int N>
CONVOY_INLINE void solve_columns(double* x, std::ptrdiff_t ldx, int rows, const double* diagonal, std::ptrdiff_t ld) {
  double inverse[N];
  for (int c = 0; c < N; ++c) inverse[c] = 1.0 / diagonal[c * ld + c];
  for (int i = 0; i < rows; i += kRowPad) {
    Vector v[N];
#pragma GCC unroll 4
    for (int c = N - 1; c >= 0; --c) {
      v[c] = load(x + c * ldx + i);
#pragma GCC unroll 4
      for (int p = N - 1; p > c; --p) v[c] -= v[p] * diagonal[c * ld + p];
      v[c] *= inverse[c];
      store(x + c * ldx + i, v[c]);
    }
  }
}

CONVOY_INLINE void right_solve(double* X, int ldx, int rows, int columns, const double* L, int ld) {
  for (int end = columns; end > 0; end -= kTile) {
    const int begin = std::max(0, end - kTile), n = end - begin;
    double* x = X + std::ptrdiff_t(begin) * ldx;
    const double* l = L + std::ptrdiff_t(begin) * ld;
    if (end < columns)
      any_column_tile<false>(x, ldx, rows, n, X + std::ptrdiff_t(end) * ldx, ldx, {l + end, ld, 1}, columns - end);
    switch (n) {
      case 1: solve_columns<1>(x, ldx, rows, l + begin, ld); break;
      case 2: solve_columns<2>(x, ldx, rows, l + begin, ld); break;
      case 3: solve_columns<3>(x, ldx, rows, l + begin, ld); break;
      default: solve_columns<4>(x, ldx, rows, l + begin, ld); break;
    }
  }
}

// One set of entry points per instruction set, all of the same source.
struct Kernels {
  void (*add)(double*, int, int, int, const double*, int, const Strided&, int);
  void (*subtract)(double*, int, int, int, const double*, int, const Strided&, int);
  int (*front)(double*, int, int, int, double*, int, const double*);
  void (*solve_right)(double*, int, int, int, const double*, int);
};

#define CONVOY_KERNELS(NAME, TARGET)                                                                              \
  namespace NAME {                                                                                                \
  TARGET void add(double* C, int ldc, int m, int n, const double* A, int lda, const Strided& B, int k) {          \
    product<true>(C, ldc, m, n, A, lda, B, k);                                                                    \
  }                                                                                                               \
  TARGET void subtract(double* C, int ldc, int m, int n, const double* A, int lda, const Strided& B, int k) {     \
    product<false>(C, ldc, m, n, A, lda, B, k);                                                                   \
  }                                                                                                               \
  TARGET int factor(double* P, int ld, int rows, int columns, double* U, int ldu, const double* smallest_pivot) { \
    return front(P, ld, rows, columns, U, ldu, smallest_pivot);                                                   \
  }                                                                                                               \
  TARGET void solve(double* X, int ldx, int rows, int columns, const double* L, int ld) {                         \
    right_solve(X, ldx, rows, columns, L, ld);                                                                    \
  }                                                                                                               \
  constexpr Kernels kernels{add, subtract, factor, solve};                                                        \
  }

CONVOY_KERNELS(portable, )
#if defined(__x86_64__) && defined(__GNUC__)
CONVOY_KERNELS(avx2, __attribute__((target("avx2"))))
const Kernels* best_kernels() {
  __builtin_cpu_init();
  return __builtin_cpu_supports("avx2") ? &avx2::kernels : &portable::kernels;
}
#else
const Kernels* best_kernels() { return &portable::kernels; }
#endif

std::atomic<const Kernels*>& chosen() {
  static std::atomic<const Kernels*> kernels{best_kernels()};
  return kernels;
}

const Kernels& kernels() { return *chosen().load(std::memory_order_relaxed); }

}  // namespace

void use_portable_kernels(bool portable) { chosen() = portable ? &portable::kernels : best_kernels(); }

void add_product(double* C, int ldc, int m, int n, const double* A, int lda, const Strided& B, int k) {
  kernels().add(C, ldc, m, n, A, lda, B, k);
}

void subtract_product(double* C, int ldc, int m, int n, const double* A, int lda, const Strided& B, int k) {
  kernels().subtract(C, ldc, m, n, A, lda, B, k);
}

int factor_front(double* panel, int ld, int rows, int columns, double* update, int ld_update,
                 const double* smallest_pivot) {
  return kernels().front(panel, ld, rows, columns, update, ld_update, smallest_pivot);
}

void solve_right(double* X, int ldx, int rows, int columns, const double* L, int ld) {
  kernels().solve_right(X, ldx, rows, columns, L, ld);
}

void add_to(double* y, const double* x, int n) {
  int i = 0;
  for (; i + 4 <= n; i += 4) store(y + i, load(y + i) + load(x + i));
  for (; i < n; ++i) y[i] += x[i];
}

void add_scaled(double* y, double a, const double* x, int n) {
  int i = 0;
  for (; i + 4 <= n; i += 4) store(y + i, load(y + i) + a * load(x + i));
  for (; i < n; ++i) y[i] += a * x[i];
}

double dot(const double* x, const double* y, int n) {
  Vector sums = {};
  int i = 0;
  for (; i + 4 <= n; i += 4) sums += load(x + i) * load(y + i);
  double sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
  for (; i < n; ++i) sum += x[i] * y[i];
  return sum;
}

}  // namespace convoy::dense
