// SPDX-License-Identifier: MIT
// Which instruction set the hot kernels run on.
#pragma once

namespace heliograph {

enum class Isa { baseline, avx2 };

// The path in use: the best that this CPU and build have, unless HELIOGRAPH_ISA fixes it.
// "avx512" runs the avx2 kernels: 512-bit vectors were measured and brought nothing here.
Isa active_isa();

}  // namespace heliograph
