// SPDX-License-Identifier: MIT
// Fill-reducing elimination orders of a graph whose nodes are variables (blocks), weighted by their degrees of freedom.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

// Symmetric adjacency in compressed rows, without self-loops and without repeats; neighbours ascend.
struct Adjacency {
  std::vector<int64_t> offset;      // (n + 1)
  std::vector<int32_t> neighbour;   // (offset[n])
  size_t size() const { return offset.empty() ? 0 : offset.size() - 1; }
};

// Each returns the nodes in the order of their elimination. Deterministic.
//
// Approximate minimum degree on the quotient graph (Amestoy, Davis, Duff 1996): element absorption, supervariables, mass
// elimination, approximate external degrees, aggressive absorption; degrees count weights. `group` (empty, or one number
// a node) constrains the order: lower groups are eliminated before higher ones (CCOLAMD's use in iSAM2).
std::vector<int32_t> minimum_degree(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> group = {});

// Nested dissection (George 1973; multilevel: Karypis, Kumar 1998): heavy-edge matching, a grown bisection, Fiduccia-Mattheyses
// refinement of the vertex separator; parts below a size are ordered by minimum degree with the separators around them held last.
std::vector<int32_t> nested_dissection(const Adjacency& graph, std::span<const int32_t> weight);

}  // namespace heliograph
