// SPDX-License-Identifier: MIT
// Entries of the inverse of a factorised matrix where the factor has entries (Takahashi, Fagan, Chin 1973), front by front.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/cholesky/multifrontal.hpp"

namespace heliograph {

// Diagonal blocks of the inverse, one a node, row-major and one after another. Only the fronts between the nodes and the roots
// are visited.
std::vector<double> inverse_blocks(const Multifrontal& factorization, std::span<const int32_t> nodes);

}  // namespace heliograph
