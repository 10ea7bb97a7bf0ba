// SPDX-License-Identifier: MIT
#include "util/isa.hpp"

#include <cstdlib>
#include <stdexcept>
#include <string>
#include <string_view>

namespace heliograph {

namespace {

bool has_avx2() {
#if defined(HELIOGRAPH_HAVE_AVX2)
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#else
  return false;
#endif
}

Isa detect() {
  const char* fixed = std::getenv("HELIOGRAPH_ISA");
  const std::string_view name = fixed != nullptr ? fixed : "";
  if (name == "baseline") return Isa::baseline;
  if (!name.empty() && name != "avx2")
    throw std::invalid_argument("HELIOGRAPH_ISA is '" + std::string(name) + "'; there are baseline and avx2: set one of them, or none for the best");
  if (name == "avx2" && !has_avx2())
    throw std::invalid_argument("HELIOGRAPH_ISA is 'avx2', which this CPU or build does not have; set baseline, or none for the best");
  return has_avx2() ? Isa::avx2 : Isa::baseline;
}

}  // namespace

const char* isa_name(Isa isa) { return isa == Isa::avx2 ? "avx2" : "baseline"; }

Isa active_isa() {
  static const Isa isa = detect();
  return isa;
}

}  // namespace heliograph
