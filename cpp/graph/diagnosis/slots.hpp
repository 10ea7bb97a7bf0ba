// SPDX-License-Identifier: MIT
// Where the blocks H_ab of a factor stand among its normal equations.
#pragma once
#include <array>
#include <cstdint>

#include "graph/factors/factor_group.hpp"

namespace heliograph {

struct Slots {
  std::array<std::array<int32_t, kMaxArity>, kMaxArity> at{};  // of H_ab, a <= b, in a factor's block
  int32_t size = 0;
};

inline Slots slots_of(const FactorGroup& group) {
  Slots slots;
  for (size_t a = 0; a < static_cast<size_t>(group.arity); ++a)
    for (size_t b = a; b < static_cast<size_t>(group.arity); ++b) {
      slots.at[a][b] = slots.size;
      slots.size += group.dof[a] * group.dof[b];
    }
  slots.size = static_cast<int32_t>(block_size(group));
  return slots;
}

}  // namespace heliograph
