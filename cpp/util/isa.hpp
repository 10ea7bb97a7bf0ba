// SPDX-License-Identifier: MIT
// Which instruction set the hot kernels run on.
#pragma once

namespace heliograph {

enum class Isa { baseline, avx2 };

// The path in use: the best that this CPU and build have, unless HELIOGRAPH_ISA fixes it. Throws std::invalid_argument where
// that names a path which is not there; none is left out silently. (512-bit vectors were measured and brought nothing.)
Isa active_isa();

const char* isa_name(Isa isa);

}  // namespace heliograph
