// SPDX-License-Identifier: MIT
#include "graph/tree/kernels.hpp"

#include "util/isa.hpp"

namespace heliograph {

FrontKernels front_kernels() {
#if defined(HELIOGRAPH_HAVE_AVX2)
  if (active_isa() == Isa::avx2) return avx2_front_kernels();
#endif
  return baseline_front_kernels();
}

}  // namespace heliograph
