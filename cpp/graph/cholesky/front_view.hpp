// SPDX-License-Identifier: MIT
// What the front kernels see: plain structs and pointers, nothing that instantiates a template.
#pragma once
#include <cstdint>

namespace heliograph {

// A dense block of a factor's linearisation and its place in a front (column-major, lower triangle).
struct BlockView {
  const double* source = nullptr;  // row-major
  int32_t row = 0;                 // scalar place in the front
  int32_t column = 0;
  int16_t rows = 0;                // of the block in the front
  int16_t columns = 0;
  int32_t transposed = 0;          // the source is (rows, columns) when 1, (columns, rows) when 0
};

struct GradientView {
  const double* source = nullptr;
  int32_t column = 0;
  int32_t count = 0;
};

// Consecutive scalar rows of a child's remainder that stay consecutive in its parent's front.
struct RunView {
  int32_t from = 0;
  int32_t count = 0;
  int32_t to = 0;
};

// Eliminates `pivots` scalars of a dense symmetric front of pivots + rows scalars plus one row that carries the gradient.
struct FrontView {
  int32_t pivots = 0;          // scalars
  int32_t rows = 0;            // scalars that remain
  int32_t height = 0;          // distance of its pivot columns
  int32_t update_height = 0;   // distance of its remainder's columns
  int64_t factor = 0;          // offset of its pivot columns in the factor's storage
  int64_t update = 0;          // offset of its remainder in the arena of its side
  int32_t side = 0;            // parity of its depth
  int32_t parent = -1;
  int32_t first_pivot = 0;     // scalar position, in elimination order, of its first pivot
  int32_t node_begin = 0;      // its nodes in the plan's list: pivots first, then rows
  int32_t node_pivots = 0;
  int32_t node_end = 0;
  int32_t child_begin = 0;
  int32_t child_end = 0;
  int32_t runs = 0;            // how its remainder goes into its parent
  int64_t run_begin = 0;
  int64_t block_begin = 0;
  int64_t block_end = 0;
  int64_t gradient_begin = 0;
  int64_t gradient_end = 0;
};

struct PlanView {
  const FrontView* fronts;
  const int32_t* nodes;
  const int32_t* children;
  const RunView* runs;
  const BlockView* blocks;
  const GradientView* gradients;
  const int32_t* scalar_of;  // (nodes) scalar position of its first degree of freedom, in elimination order
  const int32_t* weight;     // (nodes) degrees of freedom
};

struct Assembly {
  double damping;         // of the diagonal, relative (Marquardt)
  double damping_floor;   // least diagonal that the damping takes
  double* diagonal;       // out: the undamped diagonal, in elimination order
};

// Above these sizes products are packed; scratch holds one packed panel of each side.
inline constexpr int kPackDepth = 48, kPackRows = 96;
inline constexpr int kPackDepthMax = 192, kPackRowsMax = 144, kPackColumnsMax = 480;
inline constexpr int kPanel = 96;
inline constexpr int64_t kScratch = int64_t{kPackDepthMax} * (kPackRowsMax + kPackColumnsMax);

struct FrontKernels {
  int (*eliminate)(const PlanView&, int32_t, const Assembly&, double*, double* const*, double*);
  void (*back_substitute)(const FrontView&, const double*, const double*, const double*, double*);
  void (*forward_substitute)(const PlanView&, int32_t, const double*, double*);
  void (*forward_columns)(const FrontView&, const double*, int, int, double*, double*);
};

FrontKernels baseline_front_kernels();
#if defined(HELIOGRAPH_HAVE_AVX2)
FrontKernels avx2_front_kernels();
#endif

}  // namespace heliograph
