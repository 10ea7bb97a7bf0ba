// SPDX-License-Identifier: MIT
#include "graph/factors/factors.inl"

namespace heliograph {

FactorKernels baseline_factor_kernels() { return {linearize_factors, cost_factors, evaluate_factors}; }

}  // namespace heliograph
