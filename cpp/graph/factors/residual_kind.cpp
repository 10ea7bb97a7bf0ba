// SPDX-License-Identifier: MIT
#include "graph/factors/residual_kind.hpp"

namespace heliograph {

const ResidualKind* brought_residual(FactorType type) {
  if (static_cast<int32_t>(type) < kFirstBrought) return nullptr;
  for (const ResidualKind& kind : brought_residuals())
    if (kind.type == type) return &kind;
  return nullptr;
}

}  // namespace heliograph
