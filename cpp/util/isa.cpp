// SPDX-License-Identifier: MIT
#include "util/isa.hpp"

#include <cstdlib>
#include <string_view>

namespace heliograph {

namespace {

Isa detect() {
#if defined(HELIOGRAPH_HAVE_AVX2)
  const char* fixed = std::getenv("HELIOGRAPH_ISA");
  if (fixed != nullptr && std::string_view(fixed) == "baseline") return Isa::baseline;
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return Isa::avx2;
#endif
  return Isa::baseline;
}

}  // namespace

Isa active_isa() {
  static const Isa isa = detect();
  return isa;
}

}  // namespace heliograph
