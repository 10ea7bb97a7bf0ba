// SPDX-License-Identifier: MIT
#pragma once
#include "graph/cholesky/front_view.hpp"

namespace heliograph {

// Those of the instruction set in use. Not inline: only the library's own sources know which sets it was built with.
FrontKernels front_kernels();

}  // namespace heliograph
