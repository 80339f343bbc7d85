// Dense pieces of the block-sparse factorisation. All matrices are column-major doubles, all leading dimensions
// multiples of kRowPad, so that whole vectors of rows can be read and written; what lies in the padding is never used.
//
// Determinism: every element of a result has one order of summation, whatever the vector width; there is no fused
// multiply-add. The AVX2 and the portable variant give the same bits.
#pragma once

#include <cstddef>

namespace convoy::dense {

constexpr int kRowPad = 4;  ///< rows per vector

constexpr int padded(int rows) { return (rows + kRowPad - 1) / kRowPad * kRowPad; }

/// A strided view: element (row j, column p) is data[j * row_stride + p * column_stride].
struct Strided {
  const double* data;
  std::ptrdiff_t row_stride, column_stride;
};

/// C (m x n) += or -= A (m x k) B^T, B n x k. Rows are computed up to padded(m).
void add_product(double* C, int ldc, int m, int n, const double* A, int lda, const Strided& B, int k);
void subtract_product(double* C, int ldc, int m, int n, const double* A, int lda, const Strided& B, int k);

/// Partial Cholesky factorisation of a front [F11 .; F21 F22]: `panel` holds its first `columns` columns (`rows` rows,
/// lower triangle) and becomes [L11; L21]; `update`, the lower triangle of F22, becomes F22 - L21 L21^T. What is above
/// the diagonal is overwritten. Pivot c must exceed `smallest_pivot[c]` (>= 0). At least kRowPad doubles must follow
/// the panel. Returns the first column whose pivot does not, or -1.
[[nodiscard]] int factor_front(double* panel, int ld, int rows, int columns, double* update, int ld_update,
                               const double* smallest_pivot);

/// X (rows x columns) <- X L^-1, L the lower triangular top of a panel with leading dimension ld.
void solve_right(double* X, int ldx, int rows, int columns, const double* L, int ld);

/// y[0..n) += x[0..n)
void add_to(double* y, const double* x, int n);
/// y[0..n) += a x[0..n)
void add_scaled(double* y, double a, const double* x, int n);
/// Sum of x[i] y[i], in four interleaved partial sums.
double dot(const double* x, const double* y, int n);

/// For tests: the variant for every processor even if this one could do more.
void use_portable_kernels(bool portable);

}  // namespace convoy::dense
