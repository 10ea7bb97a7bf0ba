// SPDX-License-Identifier: MIT
#include "graph/factors/factors.inl"

namespace heliograph {

FactorKernels baseline_factor_kernels() { return kernels_of<Own>(); }

}  // namespace heliograph
