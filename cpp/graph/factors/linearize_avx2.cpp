// SPDX-License-Identifier: MIT
#if defined(HELIOGRAPH_HAVE_AVX2)
#include "graph/factors/factors.inl"

namespace heliograph {

FactorKernels avx2_factor_kernels() { return kernels_of<Own>(); }

}  // namespace heliograph
#endif
