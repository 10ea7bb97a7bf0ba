// SPDX-License-Identifier: MIT
#if defined(HELIOGRAPH_HAVE_AVX2)
#include "registration/match_kernel.inl"

namespace heliograph {

MatchKernels avx2_match_kernels() { return {planes_range, points_range, query_range}; }

}  // namespace heliograph
#endif
