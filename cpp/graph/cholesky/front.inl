// SPDX-License-Identifier: MIT
// One front of the multifrontal Cholesky, dense and column-major. Compiled once for each instruction set, in a translation
// unit of its own; everything has internal linkage and no library template is instantiated (see match_kernel.inl).
//
// A front's pivot columns are `height` doubles apart, its rows ordered pivots, remainder, gradient, padding. Heights are
// multiples of four and work begins at multiples of four, so that every loop runs over whole vectors: what lies above the
// diagonal or in the padding is computed on and never read as a result.
#include <cstdint>
#include <cstring>

#include "graph/cholesky/front_view.hpp"

namespace heliograph {
namespace {

#if defined(__AVX2__)
constexpr int kLanes = 4;
constexpr int kTall = 12;  // rows of a register tile: 12 x 4 accumulators fill twelve of sixteen registers
#else
constexpr int kLanes = 2;
constexpr int kTall = 4;
#endif
constexpr int kStep = 4;  // granule of rows, and columns of a register tile
typedef double Lane __attribute__((vector_size(kLanes * 8), aligned(8), may_alias));

inline Lane load(const double* p) { return *reinterpret_cast<const Lane*>(p); }
inline void store(double* p, Lane x) { *reinterpret_cast<Lane*>(p) = x; }
inline Lane splat(double x) { return Lane{} + x; }
inline int round_up(int n) { return (n + kStep - 1) & ~(kStep - 1); }

// C (rows x W) -= A (rows x k) B (W x k)'. `a_step` and `b_step` are what one step of k moves A and B by.
template <int Rows, int W>
inline void tile(double* c, int64_t ldc, const double* a, int64_t a_step, const double* b, int64_t b_step, int k) {
  constexpr int V = Rows / kLanes;
  Lane sum[V][W];
  for (int v = 0; v < V; ++v)
    for (int w = 0; w < W; ++w) sum[v][w] = Lane{};
  for (int p = 0; p < k; ++p, a += a_step, b += b_step) {
    Lane x[V];
    for (int v = 0; v < V; ++v) x[v] = load(a + v * kLanes);
    for (int w = 0; w < W; ++w) {
      const Lane y = splat(b[w]);
      for (int v = 0; v < V; ++v) sum[v][w] += x[v] * y;
    }
  }
  for (int w = 0; w < W; ++w)
    for (int v = 0; v < V; ++v) {
      double* to = c + w * ldc + v * kLanes;
      store(to, load(to) - sum[v][w]);
    }
}

template <int W>
void tile_column(double* c, int64_t ldc, const double* a, int64_t lda, const double* b, int64_t ldb, int rows, int k) {
  int r = 0;
  for (; r + kTall <= rows; r += kTall) tile<kTall, W>(c + r, ldc, a + r, lda, b, ldb, k);
  if constexpr (kTall > 2 * kStep) {
    if (r + 2 * kStep <= rows) {
      tile<2 * kStep, W>(c + r, ldc, a + r, lda, b, ldb, k);
      r += 2 * kStep;
    }
  }
  for (; r + kStep <= rows; r += kStep) tile<kStep, W>(c + r, ldc, a + r, lda, b, ldb, k);
}

inline void tile_columns(int width, double* c, int64_t ldc, const double* a, int64_t lda, const double* b, int64_t ldb, int rows,
                         int k) {
  switch (width) {
    case 4: return tile_column<4>(c, ldc, a, lda, b, ldb, rows, k);
    case 3: return tile_column<3>(c, ldc, a, lda, b, ldb, rows, k);
    case 2: return tile_column<2>(c, ldc, a, lda, b, ldb, rows, k);
    default: return tile_column<1>(c, ldc, a, lda, b, ldb, rows, k);
  }
}

// Rows of A into panels of kTall, `depth` steps each; rows beyond the end repeat zeros.
void pack_rows(const double* a, int64_t lda, int rows, int depth, double* out) {
  for (int r = 0; r < rows; r += kTall) {
    const int full = rows - r < kTall ? rows - r : kTall;
    for (int p = 0; p < depth; ++p, out += kTall) {
      const double* from = a + p * lda + r;
      for (int i = 0; i < full; ++i) out[i] = from[i];
      for (int i = full; i < kTall; ++i) out[i] = 0.0;
    }
  }
}

void pack_columns(const double* b, int64_t ldb, int columns, int depth, double* out) {
  for (int c = 0; c < columns; c += kStep) {
    const int full = columns - c < kStep ? columns - c : kStep;
    for (int p = 0; p < depth; ++p, out += kStep) {
      const double* from = b + p * ldb + c;
      for (int i = 0; i < full; ++i) out[i] = from[i];
      for (int i = full; i < kStep; ++i) out[i] = 0.0;
    }
  }
}

// One packed row panel against all packed column panels that reach the lower triangle.
void packed_panel(double* c, int64_t ldc, int rows, int columns, int first_row, const double* a, const double* b, int depth) {
  for (int j = 0; j < columns; j += kStep) {
    if (first_row + rows <= j) break;  // this tile and all to its right lie above the diagonal
    const int width = columns - j < kStep ? columns - j : kStep;
    const double* panel = b + static_cast<int64_t>(j) * depth;
    double* to = c + j * ldc;
    if (rows == kTall && width == kStep) {
      tile<kTall, kStep>(to, ldc, a, kTall, panel, kStep, depth);
    } else {
      double edge[kTall * kStep] = {};
      tile<kTall, kStep>(edge, kTall, a, kTall, panel, kStep, depth);
      for (int w = 0; w < width; ++w)
        for (int r = 0; r < rows; ++r) to[w * ldc + r] += edge[w * kTall + r];
    }
  }
}

// C (rows x columns, its lower triangle where row and column numbers start `offset` apart) -= A B'. B are rows of the same
// matrix as A. Large products go through packed panels that stay in cache.
void product(double* c, int64_t ldc, const double* a, const double* b, int64_t ld, int rows, int columns, int offset, int k,
             double* scratch) {
  if (k < kPackDepth || rows < kPackRows) {
    for (int j = 0; j < columns; j += kStep) {
      const int width = columns - j < kStep ? columns - j : kStep;
      int first = j - offset;
      first = first > 0 ? first & ~(kStep - 1) : 0;
      if (first < rows) tile_columns(width, c + j * ldc + first, ldc, a + first, ld, b + j, ld, rows - first, k);
    }
    return;
  }
  double* packed_a = scratch;
  double* packed_b = scratch + kPackRowsMax * kPackDepthMax;
  for (int j0 = 0; j0 < columns; j0 += kPackColumnsMax) {
    const int width = columns - j0 < kPackColumnsMax ? columns - j0 : kPackColumnsMax;
    for (int p0 = 0; p0 < k; p0 += kPackDepthMax) {
      const int depth = k - p0 < kPackDepthMax ? k - p0 : kPackDepthMax;
      pack_columns(b + j0 + p0 * ld, ld, width, depth, packed_b);
      int r0 = j0 - offset;
      r0 = r0 > 0 ? r0 & ~(kStep - 1) : 0;
      for (; r0 < rows; r0 += kPackRowsMax) {
        const int tall = rows - r0 < kPackRowsMax ? rows - r0 : kPackRowsMax;
        pack_rows(a + r0 + p0 * ld, ld, tall, depth, packed_a);
        for (int r = 0; r < tall; r += kTall) {
          const int height = tall - r < kTall ? tall - r : kTall;
          packed_panel(c + j0 * ldc + r0 + r, ldc, height, width, r0 + r + offset - j0,
                       packed_a + static_cast<int64_t>(r) * depth, packed_b, depth);
        }
      }
    }
  }
}

// Cholesky of the W x W block at the diagonal; its strictly upper part is left alone. Returns the failing column or -1.
template <int W>
inline int factor_corner(double* f, int64_t ld, double* inverse) {
  for (int c = 0; c < W; ++c) {
    double d = f[c * ld + c];
    for (int p = 0; p < c; ++p) d -= f[p * ld + c] * f[p * ld + c];
    if (!(d > 0.0)) return c;
    const double root = __builtin_sqrt(d);
    f[c * ld + c] = root;
    inverse[c] = 1.0 / root;
    for (int r = c + 1; r < W; ++r) {
      double x = f[c * ld + r];
      for (int p = 0; p < c; ++p) x -= f[p * ld + r] * f[p * ld + c];
      f[c * ld + r] = x * inverse[c];
    }
  }
  return -1;
}

// Columns j .. j + W of the rows below their corner, divided by the corner's triangle.
template <int W>
inline int finish_columns(double* f, int64_t ld, int j, int height) {
  double inverse[W];
  double* corner = f + j * ld + j;
  const int failed = factor_corner<W>(corner, ld, inverse);
  if (failed >= 0) return j + failed;
  double* column = f + j * ld;
  int r = j + W;
  for (; r < height && (r & (kStep - 1)) != 0; ++r)
    for (int c = 0; c < W; ++c) {
      double x = column[c * ld + r];
      for (int p = 0; p < c; ++p) x -= column[p * ld + r] * corner[p * ld + c];
      column[c * ld + r] = x * inverse[c];
    }
  for (; r < height; r += kLanes) {
    Lane x[W];
    for (int c = 0; c < W; ++c) {
      x[c] = load(column + c * ld + r);
      for (int p = 0; p < c; ++p) x[c] -= x[p] * splat(corner[p * ld + c]);
      x[c] *= splat(inverse[c]);
      store(column + c * ld + r, x[c]);
    }
  }
  return -1;
}

// Left-looking Cholesky of `columns` columns that begin at column `begin`, all earlier than `from` already applied.
int factor_panel(double* f, int64_t ld, int from, int begin, int columns, int height) {
  for (int j = begin; j < begin + columns; j += kStep) {
    const int width = begin + columns - j < kStep ? begin + columns - j : kStep;
    const int first = j & ~(kStep - 1);
    if (j > from)
      tile_columns(width, f + j * ld + first, ld, f + from * ld + first, ld, f + from * ld + j, ld, height - first, j - from);
    int failed = -1;
    switch (width) {
      case 4: failed = finish_columns<4>(f, ld, j, height); break;
      case 3: failed = finish_columns<3>(f, ld, j, height); break;
      case 2: failed = finish_columns<2>(f, ld, j, height); break;
      default: failed = finish_columns<1>(f, ld, j, height); break;
    }
    if (failed >= 0) return failed;
  }
  return -1;
}

int factor_pivots(double* f, int64_t ld, int pivots, int height, double* scratch) {
  for (int begin = 0; begin < pivots; begin += kPanel) {
    const int width = pivots - begin < kPanel ? pivots - begin : kPanel;
    const int first = begin & ~(kStep - 1);
    if (begin > 0)
      product(f + begin * ld + first, ld, f + first, f + begin, ld, height - first, width, first - begin, begin, scratch);
    const int failed = factor_panel(f, ld, begin, begin, width, height);
    if (failed >= 0) return failed;
  }
  return -1;
}

// A front's storage by column: pivot columns, then those of the remainder, rows counted from the first pivot.
struct FrontColumns {
  double* pivots;
  double* update;
  int32_t count;  // of pivots
  int64_t height, update_height;
  int64_t distance(int32_t column) const { return column < count ? height : update_height; }
  double* operator[](int32_t column) const {
    return column < count ? pivots + column * height : update + (column - count) * update_height - count;
  }
};

// A child's remainder added to its parent. Its rows stand in the order of its own elimination, which after a reordering need
// not be the parent's: a pair that has changed sides is added transposed.
void extend_add(const FrontView& child, const double* from, const FrontColumns& parent, int32_t parent_gradient,
                const RunView* runs) {
  const int count = child.runs;
  for (int a = 0; a < count; ++a) {
    for (int i = 0; i < runs[a].count; ++i) {
      const int32_t column = runs[a].to + i;
      const double* source = from + static_cast<int64_t>(runs[a].from + i) * child.update_height;
      double* to = parent[column];
      for (int r = i; r < runs[a].count; ++r) to[runs[a].to + r] += source[runs[a].from + r];
      for (int b = a + 1; b < count; ++b) {
        const double* s = source + runs[b].from;
        const int n = runs[b].count;
        if (runs[b].to > runs[a].to) {
          double* t = to + runs[b].to;
          for (int r = 0; r < n; ++r) t[r] += s[r];
        } else {
          for (int r = 0; r < n; ++r) parent[runs[b].to + r][column] += s[r];
        }
      }
      to[parent_gradient] += source[child.rows];
    }
  }
}

template <int R, int C>
inline void add_block(double* to, int64_t ld, const double* from, bool row_major) {
  if (row_major) {
    for (int c = 0; c < C; ++c)
      for (int r = 0; r < R; ++r) to[c * ld + r] += from[r * C + c];
  } else {
    for (int c = 0; c < C; ++c)
      for (int r = 0; r < R; ++r) to[c * ld + r] += from[c * R + r];
  }
}

void add_blocks(const FrontColumns& columns, const BlockView* parts, int64_t count) {
  for (int64_t i = 0; i < count; ++i) {
    const BlockView& part = parts[i];
    const double* from = part.source;
    double* to = columns[part.column] + part.row;
    const int64_t ld = columns.distance(part.column);
    const bool row_major = part.transposed != 0;
    const int shape = 16 * part.rows + part.columns;
    if (shape == 16 * 3 + 3) {
      add_block<3, 3>(to, ld, from, row_major);
    } else if (shape == 16 * 6 + 6) {
      add_block<6, 6>(to, ld, from, row_major);
    } else if (shape == 16 * 9 + 9) {  // extended poses, and their biases
      add_block<9, 9>(to, ld, from, row_major);
    } else if (shape == 16 * 9 + 6) {
      add_block<9, 6>(to, ld, from, row_major);
    } else if (shape == 16 * 6 + 9) {
      add_block<6, 9>(to, ld, from, row_major);
    } else {
      const int R = part.rows, C = part.columns;
      for (int c = 0; c < C; ++c)
        for (int r = 0; r < R; ++r) to[c * ld + r] += row_major ? from[r * C + c] : from[c * R + r];
    }
  }
}

// Assembles and eliminates a front in f, its pivot columns. Returns the failing pivot's scalar position in the front, or -1.
int eliminate(const PlanView& plan, int32_t index, const Assembly& in, double* f, double* const* updates, double* scratch) {
  const FrontView& front = plan.fronts[index];
  const int64_t ld = front.height;
  const int gradient = front.pivots + front.rows;
  std::memset(f, 0, sizeof(double) * static_cast<size_t>(ld) * static_cast<size_t>(front.pivots));
  double* update = updates[index];
  const int update_columns = front.rows;
  if (update_columns > 0)
    std::memset(update, 0, sizeof(double) * static_cast<size_t>(front.update_height) * static_cast<size_t>(update_columns));
  const FrontColumns columns{f, update, front.pivots, front.height, front.update_height};
  add_blocks(columns, plan.blocks + front.block_begin, front.block_end - front.block_begin);
  for (int64_t i = front.gradient_begin; i < front.gradient_end; ++i) {
    const GradientView& part = plan.gradients[i];
    for (int c = 0; c < part.count; ++c) columns[part.column + c][gradient] += part.source[c];
  }
  for (int c = 0; c < front.pivots; ++c) {
    const double diagonal = f[c * ld + c];
    in.diagonal[front.first_pivot + c] = diagonal;
    const double clamped = diagonal < in.damping_floor ? in.damping_floor : diagonal;
    f[c * ld + c] = diagonal + in.damping * clamped;
  }
  for (int32_t i = front.child_begin; i < front.child_end; ++i) {
    const int32_t child = plan.children[i];
    extend_add(plan.fronts[child], updates[child], columns, gradient, plan.runs + plan.fronts[child].run_begin);
  }
  const int failed = factor_pivots(f, ld, front.pivots, front.height, scratch);
  if (failed >= 0) return failed;
  if (update_columns > 0)
    product(update, front.update_height, f + front.pivots, f + front.pivots, ld, front.update_height, update_columns, 0,
            front.pivots, scratch);
  return -1;
}

// sum[w] = the product of column w with `rows`, each over `count` entries; the columns lie ld apart and share the loads of `rows`.
template <int W>
inline void column_products(const double* f, int64_t ld, const double* rows, int count, double* sum) {
  Lane parts[W];
  for (int w = 0; w < W; ++w) parts[w] = Lane{};
  int r = 0;
  for (; r + kLanes <= count; r += kLanes) {
    const Lane x = load(rows + r);
    for (int w = 0; w < W; ++w) parts[w] += load(f + w * ld + r) * x;
  }
  for (int w = 0; w < W; ++w) {
    sum[w] = 0.0;
    for (int v = 0; v < kLanes; ++v) sum[w] += parts[w][v];
    for (int q = r; q < count; ++q) sum[w] += f[w * ld + q] * rows[q];
  }
}

// The x of W pivots, those after them being known: x holds them, so that one product runs over pivots and another over rows.
template <int W>
inline void back_columns(const double* f, int64_t ld, int pivots, int count, const double* y, const double* rows, double* x) {
  double below[W], after[W];
  column_products<W>(f + pivots, ld, rows, count, below);
  column_products<W>(f + W, ld, x + W, pivots - W, after);
  for (int c = W - 1; c >= 0; --c) {
    const double* column = f + c * ld;
    double sum = (y != nullptr ? y[c] : column[pivots + count]) + below[c] + after[c];
    for (int p = c + 1; p < W; ++p) sum += column[p] * x[p];
    x[c] = -sum / column[c];
  }
}

// x of the pivots from y and x of the remaining rows: L11' x = -(y + L21' rows). y is the carried gradient unless given.
void back_substitute(const FrontView& front, const double* f, const double* y, const double* rows, double* x) {
  constexpr int kWide = 4;
  const int64_t ld = front.height;
  int c = front.pivots;
  for (; c >= kWide; c -= kWide) {
    const int at = c - kWide;
    back_columns<kWide>(f + at * ld + at, ld, front.pivots - at, front.rows, y != nullptr ? y + at : nullptr, rows, x + at);
  }
  while (c-- > 0)
    back_columns<1>(f + c * ld + c, ld, front.pivots - c, front.rows, y != nullptr ? y + c : nullptr, rows, x + c);
}

// Rows of `width` doubles each, of a front's pivots and of what remains: L11 Y = B for the pivots, from row `from` on (those
// above are zero), then B_rows -= L21 Y; what Y'Y is of the first `dof` columns is added to `sum`.
template <int W>
inline void forward_rows(const double* f, int64_t ld, int from, int pivots, int all, int dof, double* b, double* sum) {
  constexpr int kWidth = W * kStep, V = kWidth / kLanes, kTogether = V <= 3 ? 4 : 2;
  for (int r = from; r < pivots; ++r) {
    Lane x[V];
    for (int v = 0; v < V; ++v) x[v] = load(b + r * kWidth + v * kLanes);
    for (int k = from; k < r; ++k)
      for (int v = 0; v < V; ++v) x[v] -= splat(f[k * ld + r]) * load(b + k * kWidth + v * kLanes);
    for (int v = 0; v < V; ++v) store(b + r * kWidth + v * kLanes, x[v] / splat(f[r * ld + r]));
  }
  int r = pivots;
  for (; r + kTogether <= all; r += kTogether) {
    Lane x[kTogether][V];
    for (int i = 0; i < kTogether; ++i)
      for (int v = 0; v < V; ++v) x[i][v] = load(b + (r + i) * kWidth + v * kLanes);
    for (int k = from; k < pivots; ++k) {
      const double *column = f + k * ld + r, *y = b + k * kWidth;
      for (int i = 0; i < kTogether; ++i)
        for (int v = 0; v < V; ++v) x[i][v] -= splat(column[i]) * load(y + v * kLanes);
    }
    for (int i = 0; i < kTogether; ++i)
      for (int v = 0; v < V; ++v) store(b + (r + i) * kWidth + v * kLanes, x[i][v]);
  }
  for (; r < all; ++r)
    for (int k = from; k < pivots; ++k)
      for (int v = 0; v < V; ++v) {
        double* to = b + r * kWidth + v * kLanes;
        store(to, load(to) - splat(f[k * ld + r]) * load(b + k * kWidth + v * kLanes));
      }
  for (int p = 0; p < dof; ++p) {
    Lane x[V];
    for (int v = 0; v < V; ++v) x[v] = load(sum + p * kWidth + v * kLanes);
    for (int k = from; k < pivots; ++k)
      for (int v = 0; v < V; ++v) x[v] += splat(b[k * kWidth + p]) * load(b + k * kWidth + v * kLanes);
    for (int v = 0; v < V; ++v) store(sum + p * kWidth + v * kLanes, x[v]);
  }
}

void forward_columns(const FrontView& front, const double* f, int from, int dof, double* b, double* sum) {
  const int all = front.pivots + front.rows;
  switch ((dof + kStep - 1) / kStep) {
    case 1: return forward_rows<1>(f, front.height, from, front.pivots, all, dof, b, sum);
    case 2: return forward_rows<2>(f, front.height, from, front.pivots, all, dof, b, sum);
    case 3: return forward_rows<3>(f, front.height, from, front.pivots, all, dof, b, sum);
    default: return forward_rows<4>(f, front.height, from, front.pivots, all, dof, b, sum);
  }
}

// y of the pivots and what they take from the rows after them: L11 y = b, b_rows -= L21 y, in place.
void forward_substitute(const PlanView& plan, int32_t index, const double* factor, double* b) {
  const FrontView& front = plan.fronts[index];
  const double* f = factor + front.factor;
  const int64_t ld = front.height;
  const int K = front.pivots;
  double* y = b + front.first_pivot;
  for (int c = 0; c < K; ++c) {
    const double* column = f + c * ld;
    const double value = y[c] / column[c];
    y[c] = value;
    for (int r = c + 1; r < K; ++r) y[r] -= column[r] * value;
    int at = K;
    for (int32_t i = front.node_begin + front.node_pivots; i < front.node_end; ++i) {
      const int32_t node = plan.nodes[i];
      double* to = b + plan.scalar_of[node];
      for (int32_t k = 0; k < plan.weight[node]; ++k) to[k] -= column[at++] * value;
    }
  }
}

}  // namespace
}  // namespace heliograph
