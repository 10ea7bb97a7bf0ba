// SPDX-License-Identifier: MIT
// A group of factors as plain pointers, for kernels that are compiled once an instruction set.
#pragma once
#include "graph/factors/factor_group.hpp"

namespace heliograph {

struct FactorView {
  FactorType type;
  int arity, rows;
  Manifold manifold[kMaxArity];
  int dof[kMaxArity];
  const int64_t* values;
  const double* x;  // the flat value array
  int measurement_size;
  const double* measurement;
  NoiseForm noise;
  bool shared_noise;
  const double* sqrt_information;
  KernelType kernel;
  double kernel_width;
  const double* weight;  // or null
  const double* shift;   // or null
  const double* residual;
  const double* jacobian[kMaxArity];
  double* scratch;  // of scratch_size(...) doubles, for kinds without a kernel of fixed size
};

// Columns of a stacked row [J_0 J_1 ... r], rounded up to whole vectors of four.
constexpr int row_stride(int columns) { return (columns + 1 + 3) / 4 * 4; }

constexpr size_t scratch_size(int rows, int columns) {
  return static_cast<size_t>(rows) * static_cast<size_t>(row_stride(columns) + 2) + static_cast<size_t>(row_stride(columns));
}

// One set of entry points an instruction set. Each returns false where no residual is known for the type and its families.
struct FactorKernels {
  bool (*linearize)(const FactorView&, size_t begin, size_t end, double* blocks, GroupCost*);
  bool (*cost)(const FactorView&, size_t begin, size_t end, GroupCost*);
  // Unwhitened residuals; Jacobians side by side, (end - begin, rows, all columns).
  bool (*evaluate)(const FactorView&, size_t begin, size_t end, double* residual, double* jacobian);
};

FactorKernels baseline_factor_kernels();
#if defined(HELIOGRAPH_HAVE_AVX2)
FactorKernels avx2_factor_kernels();
#endif

}  // namespace heliograph
