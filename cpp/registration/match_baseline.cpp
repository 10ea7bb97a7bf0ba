// SPDX-License-Identifier: MIT
#include "registration/match_kernel.inl"

namespace heliograph {

MatchKernels baseline_match_kernels() { return {planes_range, points_range, query_range}; }

}  // namespace heliograph
