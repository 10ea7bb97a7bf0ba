// SPDX-License-Identifier: MIT
// Many factors of one kind, stacked: same residual, same variable families, same form of noise and same robust kernel.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "graph/factors/manifold.hpp"

namespace heliograph {

inline constexpr int kMaxArity = 8;

enum class FactorType : int32_t {
  custom = 0,        // residuals and Jacobians are handed in
  prior = 1,         // Log(Z^-1 X), or of the leading parts of X that Z measures
  between = 2,       // Log(Z^-1 Xi^-1 Xj), likewise
  range = 3,         // |p_j - p_i| - z
  bearing = 4,       // Z.local(direction to j seen from pose i): an angle in the plane, two on the sphere
  landmark = 5,      // Ti^-1 p_j - z
  position = 6,      // p_i - z, in the world
  linear_motion = 7,  // x_j - F x_i - u, vectors
  prior_rows = 8,     // chosen rows of a prior
  bearing_range = 9,  // bearing, then range
  attitude = 10,      // Z.local(R' d): a direction d of the world, known or a variable, seen from a rotated body
  plane = 11,         // a plane n.x = d, known or variables, seen from a pose: its normal's two angles, its distance
  point_to_plane = 12 // how far a point seen from a pose lies in front of a plane: known, of variables, or of another pose
};                    // and whatever residual_kind.hpp brings

// Sqrt information S of r_white = S r.
enum class NoiseForm : int32_t { scalar = 0, diagonal = 1, full = 2 };  // 1, rows, rows*rows (upper triangular, row-major) numbers

enum class KernelType : int32_t { none = 0, huber = 1, cauchy = 2, geman_mcclure = 3, tukey = 4, dcs = 5, truncated = 6 };

struct FactorGroup {
  FactorType type = FactorType::custom;
  int arity = 0;
  int rows = 0;                                 // of the residual
  std::array<Manifold, kMaxArity> manifold{};   // of each variable
  std::array<int, kMaxArity> dof{};
  std::array<int, kMaxArity> storage{};
  size_t count = 0;
  std::vector<int32_t> variables;               // (count, arity) dense variable indices
  std::vector<int64_t> values;                  // (count, arity) offsets of those variables into the flat value array
  int measurement_size = 0;
  std::vector<double> measurement;              // (count, measurement_size), packed as Manifold says
  NoiseForm noise = NoiseForm::scalar;
  bool shared_noise = false;                    // one S for all of them
  std::vector<double> sqrt_information;
  KernelType kernel = KernelType::none;
  double kernel_width = 1.0;                    // of the whitened residual's length
  std::vector<double> weight;                   // (count) multiplies the squared residual; empty: 1
  std::vector<double> shift;                    // (count, rows) added to the whitened residual (hard constraints); empty: 0
  // Custom factors: what the caller evaluated last, before whitening.
  std::vector<double> residual;                 // (count, rows)
  std::array<std::vector<double>, kMaxArity> jacobian;  // each (count, rows, dof)
  size_t first_factor = 0;                      // number of its first factor in the whole graph
  size_t block = 0;                             // offset of its first linearised block in the graph's block array
};

// Doubles of one linearised factor: the Gauss-Newton blocks H_ab for a <= b, each row-major dof_a x dof_b, in the order
// (0,0) (0,1) ... (0,k) (1,1) ..., then the gradients g_a = J_a' W r.
inline size_t block_size(const FactorGroup& group) {
  size_t size = 0;
  for (int a = 0; a < group.arity; ++a) {
    size += static_cast<size_t>(group.dof[a]);
    for (int b = a; b < group.arity; ++b) size += static_cast<size_t>(group.dof[a]) * static_cast<size_t>(group.dof[b]);
  }
  return size;
}

struct GroupCost {
  double chi2 = 0.0;  // sum of squared whitened residuals, no kernel, no factor 1/2, without weight and shift
  double cost = 0.0;  // what is minimised: sum of weight * 2 rho(|r_white + shift|); equals chi2 without kernel, weight and shift
};

// Factors [begin, end) at the flat values x. `blocks` receives (end - begin) linearised factors; robust weights are applied.
// Sums run in the order of the factors. Every factor's arithmetic depends on nothing but its own data.
GroupCost linearize_group(const FactorGroup& group, size_t begin, size_t end, const double* x, double* blocks);
GroupCost cost_of_group(const FactorGroup& group, size_t begin, size_t end, const double* x);

// Unwhitened residuals (end - begin, rows) and whitened squared lengths (end - begin) for reports, GNC and tests.
void residuals_of_group(const FactorGroup& group, size_t begin, size_t end, const double* x, double* residual, double* squared);
// Unwhitened Jacobians, each (end - begin, rows, dof_a) for tests and diagnosis.
void jacobians_of_group(const FactorGroup& group, size_t begin, size_t end, const double* x, double* const* jacobian);

}  // namespace heliograph
