// SPDX-License-Identifier: MIT
// Whitening, robust weights and the Gauss-Newton blocks of one factor whose stacked row [J_0 J_1 ... r] lies in `W`.
#pragma once
#include "graph/factors/factor_view.hpp"
#include "graph/factors/robust_kernel.hpp"
#include "lie/series.hpp"

namespace heliograph {
namespace {

// Sizes known at compile time: the loops below unroll and become vectors.
template <int Rows, int... Dofs>
struct Fixed {
  static constexpr bool kDynamic = false;
  static constexpr int kWork = Rows * row_stride((Dofs + ...));
  static constexpr int arity() { return sizeof...(Dofs); }
  static constexpr int rows() { return Rows; }
  static constexpr int dof(int a) {
    int size = 0;
    ((size = a-- == 0 ? Dofs : size), ...);
    return size;
  }
  static constexpr int column(int a) {
    int first = 0;
    ((first += a-- > 0 ? Dofs : 0), ...);
    return first;
  }
  static constexpr int columns() { return (Dofs + ...); }
  static constexpr int stride() { return row_stride((Dofs + ...)); }
  explicit Fixed(const FactorView&) {}
};

// ... and at run time.
struct Dynamic {
  static constexpr bool kDynamic = true;
  static constexpr int kWork = 1;
  explicit Dynamic(const FactorView& v) : view(v) {
    for (int a = 0; a < v.arity; ++a) starts[a + 1] = starts[a] + v.dof[a];
  }
  int arity() const { return view.arity; }
  int rows() const { return view.rows; }
  int dof(int a) const { return view.dof[a]; }
  int column(int a) const { return starts[a]; }
  int columns() const { return starts[view.arity]; }
  int stride() const { return row_stride(starts[view.arity]); }
  const FactorView& view;
  int starts[kMaxArity + 1] = {};
};

HELIOGRAPH_INLINE size_t noise_size(NoiseForm form, int rows) {
  const auto n = static_cast<size_t>(rows);
  return form == NoiseForm::scalar ? 1 : (form == NoiseForm::diagonal ? n : n * n);
}

HELIOGRAPH_INLINE const double* noise_of(const FactorView& v, size_t k, int rows) {
  return v.sqrt_information + (v.shared_noise ? 0 : k * noise_size(v.noise, rows));
}

// W <- S W in place, `width` columns of it; S is upper triangular, so row i needs only rows that are not yet changed.
HELIOGRAPH_INLINE void whiten(NoiseForm form, const double* S, int rows, int stride, int width, double* W) {
  if (form == NoiseForm::full) {
    for (int i = 0; i < rows; ++i) {
      for (int q = 0; q < width; ++q) W[i * stride + q] *= S[i * rows + i];
      for (int k = i + 1; k < rows; ++k)
        for (int q = 0; q < width; ++q) W[i * stride + q] += S[i * rows + k] * W[k * stride + q];
    }
    return;
  }
  for (int i = 0; i < rows; ++i) {
    const double s = form == NoiseForm::scalar ? S[0] : S[i];
    for (int q = 0; q < width; ++q) W[i * stride + q] *= s;
  }
}

// Adds one factor's part to the sums and returns what its blocks are multiplied by. r is whitened and receives the shift.
HELIOGRAPH_INLINE double weigh(const FactorView& v, size_t k, int rows, int stride, double* r, GroupCost* sum) {
  double e2 = 0.0;
  for (int i = 0; i < rows; ++i) e2 += r[i * stride] * r[i * stride];
  sum->chi2 += e2;
  if (v.shift != nullptr) {
    e2 = 0.0;
    for (int i = 0; i < rows; ++i) {
      r[i * stride] += v.shift[k * static_cast<size_t>(rows) + static_cast<size_t>(i)];
      e2 += r[i * stride] * r[i * stride];
    }
  }
  const double weight = v.weight == nullptr ? 1.0 : v.weight[k];
  if (v.kernel == KernelType::none) {
    sum->cost += weight * e2;
    return weight;
  }
  const Robust robust = robust_of(v.kernel, v.kernel_width, e2);
  sum->cost += weight * robust.cost;
  return weight * robust.weight;
}

// One row of W' W: w W[:, p]' W, from column `first` on.
template <class Layout>
HELIOGRAPH_INLINE void gram_row(const Layout& layout, const double* W, double w, int p, int first, double* __restrict row) {
  const int stride = layout.stride();
  for (int q = first; q < stride; ++q) row[q] = 0.0;
  for (int k = 0; k < layout.rows(); ++k) {
    const double s = w * W[k * stride + p];
    for (int q = first; q < stride; ++q) row[q] += s * W[k * stride + q];
  }
}

#if defined(__AVX2__)
constexpr int kGramLanes = 4;
#else
constexpr int kGramLanes = 2;
#endif
typedef double GramLane __attribute__((vector_size(kGramLanes * 8), aligned(8), may_alias));
constexpr int kGramRows = 3;  // divides the degrees of freedom of all motions

// Rows p .. p + 3 of W' W in V vectors of columns: the sums of `gram_row` in the same order, kept in registers.
template <int V>
HELIOGRAPH_INLINE void gram_tile(const double* W, const double* scaled, int stride, int depth, double* out) {
  GramLane sum[kGramRows][V];
  for (int i = 0; i < kGramRows; ++i)
    for (int v = 0; v < V; ++v) sum[i][v] = GramLane{};
  for (int k = 0; k < depth; ++k, W += stride, scaled += stride)
    for (int v = 0; v < V; ++v) {
      const GramLane x = *reinterpret_cast<const GramLane*>(W + v * kGramLanes);
      for (int i = 0; i < kGramRows; ++i) sum[i][v] += (GramLane{} + scaled[i]) * x;
    }
  for (int i = 0; i < kGramRows; ++i)
    for (int v = 0; v < V; ++v) *reinterpret_cast<GramLane*>(out + i * stride + v * kGramLanes) = sum[i][v];
}

// The same from column `first` on; `scaled` is w W, `out` has rows of `stride`.
template <class Layout>
HELIOGRAPH_INLINE void gram_rows(const Layout& layout, const double* W, const double* scaled, int p, int first, double* out) {
  constexpr int kWide = 3;
  const int stride = layout.stride(), rows = layout.rows();
  int q = first;
  for (; q + kWide * kGramLanes <= stride; q += kWide * kGramLanes)
    gram_tile<kWide>(W + q, scaled + p, stride, rows, out + q);
  for (; q < stride; q += kGramLanes) gram_tile<1>(W + q, scaled + p, stride, rows, out + q);
}

// Large residuals of motions are worth the tiles; small ones unroll.
template <class Layout>
constexpr bool tiled() {
  if constexpr (Layout::kDynamic) {
    return false;
  } else {
    bool whole = Layout::rows() >= kGramRows && Layout::columns() >= 12;
    for (int a = 0; a < Layout::arity(); ++a) whole = whole && Layout::dof(a) % kGramRows == 0;
    return whole;
  }
}

// Row p of the blocks of variable a, from a row of W' W.
template <class Layout>
HELIOGRAPH_INLINE void put_row(const Layout& layout, int a, int p, const double* row, double* block) {
  for (int b = a; b < layout.arity(); ++b) {
    for (int q = 0; q < layout.dof(b); ++q) block[p * layout.dof(b) + q] = row[layout.column(b) + q];
    block += layout.dof(a) * layout.dof(b);
  }
}

// W' W by tiles, columns before a variable's own left out. All of it before any is read: what is stored as whole vectors and
// read again at once from between them would wait.
template <class Layout>
HELIOGRAPH_INLINE void gram(const Layout& layout, const double* W, double w, double* scaled, double* out) {
  for (int i = 0; i < layout.rows() * layout.stride(); ++i) scaled[i] = w * W[i];
  for (int a = 0; a < layout.arity(); ++a)
    for (int p = layout.column(a); p < layout.column(a) + layout.dof(a); p += kGramRows)
      gram_rows(layout, W, scaled, p, layout.column(a) / 4 * 4, out + p * layout.stride());
}

// Blocks H_ab, a <= b, then the gradients, as factor_group.hpp lays them out. `scaled` and `row` are room for as much as W.
template <class Layout>
HELIOGRAPH_INLINE void write_blocks(const Layout& layout, const double* W, double w, double* scaled, double* row, double* out) {
  double* gradient = out;
  for (int a = 0; a < layout.arity(); ++a)
    for (int b = a; b < layout.arity(); ++b) gradient += layout.dof(a) * layout.dof(b);
  if constexpr (tiled<Layout>()) {
    double all[Layout::columns() * Layout::stride()];
    gram(layout, W, w, scaled, all);
    for (int a = 0; a < layout.arity(); ++a) {
      for (int p = 0; p < layout.dof(a); ++p) {
        const double* mine = all + (layout.column(a) + p) * layout.stride();
        put_row(layout, a, p, mine, out);
        *gradient++ = mine[layout.columns()];
      }
      for (int b = a; b < layout.arity(); ++b) out += layout.dof(a) * layout.dof(b);
    }
  } else {
    for (int a = 0; a < layout.arity(); ++a) {
      for (int p = 0; p < layout.dof(a); ++p) {
        gram_row(layout, W, w, layout.column(a) + p, layout.column(a) / 4 * 4, row);
        put_row(layout, a, p, row, out);
        *gradient++ = row[layout.columns()];
      }
      for (int b = a; b < layout.arity(); ++b) out += layout.dof(a) * layout.dof(b);
    }
  }
}

template <class Layout>
HELIOGRAPH_INLINE size_t blocks_size(const Layout& layout) {
  int size = 0;
  for (int a = 0; a < layout.arity(); ++a) {
    size += layout.dof(a);
    for (int b = a; b < layout.arity(); ++b) size += layout.dof(a) * layout.dof(b);
  }
  return static_cast<size_t>(size);
}

HELIOGRAPH_INLINE void clear(double* W, int size) {
  for (int i = 0; i < size; ++i) W[i] = 0.0;
}

// A residual type gives Layout and evaluate<with Jacobian>(view, layout, k, r, W): the residual, and the Jacobians into the
// cleared W.
template <class Residual>
static void linearize_range(const FactorView& v, size_t begin, size_t end, double* blocks, GroupCost* sum) {
  using Layout = typename Residual::Layout;
  const Layout layout(v);
  const int rows = layout.rows(), stride = layout.stride();
  double own[Layout::kWork], own_r[Layout::kDynamic ? 1 : Layout::kWork], own_row[Layout::kDynamic ? 1 : Layout::kWork];
  double* W = Layout::kDynamic ? v.scratch : own;
  double* r = Layout::kDynamic ? W + rows * stride : own_r;
  double* row = Layout::kDynamic ? r + rows : own_row;
  const size_t size = blocks_size(layout);
  GroupCost total;
  for (size_t k = begin; k < end; ++k, blocks += size) {
    clear(W, rows * stride);
    Residual::template evaluate<true>(v, layout, k, r, W);
    for (int i = 0; i < rows; ++i) W[i * stride + layout.columns()] = r[i];
    whiten(v.noise, noise_of(v, k, rows), rows, stride, stride, W);
    const double w = weigh(v, k, rows, stride, W + layout.columns(), &total);
    write_blocks(layout, W, w, r, row, blocks);
  }
  *sum = total;
}

template <class Residual>
static void cost_range(const FactorView& v, size_t begin, size_t end, GroupCost* sum) {
  using Layout = typename Residual::Layout;
  const Layout layout(v);
  const int rows = layout.rows();
  double own_r[Layout::kWork];
  double* r = Layout::kDynamic ? v.scratch : own_r;
  GroupCost total;
  for (size_t k = begin; k < end; ++k) {
    Residual::template evaluate<false>(v, layout, k, r, nullptr);
    whiten(v.noise, noise_of(v, k, rows), rows, 1, 1, r);
    weigh(v, k, rows, 1, r, &total);
  }
  *sum = total;
}

template <class Residual>
static void evaluate_range(const FactorView& v, size_t begin, size_t end, double* residual, double* jacobian) {
  using Layout = typename Residual::Layout;
  const Layout layout(v);
  const int rows = layout.rows(), stride = layout.stride(), columns = layout.columns();
  double own[Layout::kWork];
  double* W = Layout::kDynamic ? v.scratch : own;
  for (size_t k = begin; k < end; ++k) {
    clear(W, rows * stride);
    Residual::template evaluate<true>(v, layout, k, residual, W);
    residual += rows;
    if (jacobian == nullptr) continue;
    for (int i = 0; i < rows; ++i)
      for (int q = 0; q < columns; ++q) *jacobian++ = W[i * stride + q];
  }
}

}  // namespace
}  // namespace heliograph
