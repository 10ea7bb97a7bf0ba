// SPDX-License-Identifier: MIT
// The numeric multifrontal Cholesky (Duff, Reid 1983; Liu 1992) of a planned graph, and solves with it.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/cholesky/plan.hpp"

namespace heliograph {

// Factor and work space of one plan. Equal bits for any number of threads: a front's arithmetic does not depend on who does it.
class Multifrontal {
 public:
  explicit Multifrontal(const Plan& plan);

  // Factorises H + damping * diag(H), H the sum of the linearised blocks that the plan points to; carries the gradient along.
  // Returns the elimination-order scalar of the first pivot that is not positive, or -1.
  int64_t factorize(double damping, double damping_floor, int threads);

  // x of H x = -g in elimination order, from the last factorisation.
  void solve(std::span<double> x) const;
  // |y|^2 of L y = g: what half the model's fall without damping is.
  double gradient_energy() const;
  // x of H x = b, in elimination order, in place.
  void solve_for(std::span<double> b) const;

  std::span<const double> diagonal() const { return diagonal_; }   // of H before damping
  std::span<const double> factor() const { return factor_; }
  const Plan& plan() const { return plan_; }

 private:
  void back_substitute(const double* y, double* x) const;
  int64_t run_in_order(const Assembly& assembly);
  int64_t run_tasks(const Assembly& assembly, int threads);

  const Plan& plan_;
  PlanView view_;
  FrontKernels kernels_;
  std::vector<double> factor_;
  std::vector<double> diagonal_;
  std::vector<double> arena_[2];
  std::vector<double*> updates_;
  std::vector<double> scratch_;
  mutable std::vector<double> rows_;
};

}  // namespace heliograph
