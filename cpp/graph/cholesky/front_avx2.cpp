// SPDX-License-Identifier: MIT
#if defined(HELIOGRAPH_HAVE_AVX2)
#include "graph/cholesky/front.inl"

namespace heliograph {

FrontKernels avx2_front_kernels() { return {eliminate, back_substitute, forward_substitute, forward_columns}; }

}  // namespace heliograph
#endif
