// SPDX-License-Identifier: MIT
#include "graph/cholesky/front.inl"

namespace heliograph {

FrontKernels baseline_front_kernels() { return {eliminate, back_substitute, forward_substitute, forward_columns}; }

}  // namespace heliograph
