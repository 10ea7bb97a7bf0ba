// SPDX-License-Identifier: MIT
// Columns with one structure, gathered: fundamental supernodes of an elimination order, then relaxed amalgamation.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/ordering/ordering.hpp"

namespace heliograph {

// Supernodes in an order in which children precede parents, each subtree in one stretch. Supernode s eliminates the nodes
// pivots[pivot_begin[s] .. pivot_begin[s + 1]) and touches the later nodes rows[row_begin[s] .. row_begin[s + 1]), both in
// elimination order.
struct Supernodes {
  std::vector<int64_t> pivot_begin;
  std::vector<int32_t> pivots;
  std::vector<int64_t> row_begin;
  std::vector<int32_t> rows;
  std::vector<int32_t> parent;    // -1 at a root
  std::vector<int32_t> position;  // (nodes) in the final elimination order
  std::vector<int32_t> taker;     // (elements) the supernode that takes each
  size_t size() const { return parent.size(); }
};

// Sets of nodes that already form cliques, left by what was eliminated before; each is taken by one front.
struct Elements {
  std::vector<int32_t> begin{0};  // (elements + 1)
  std::vector<int32_t> nodes;
  size_t size() const { return begin.size() - 1; }
};

// Liu 1990 for the elimination tree; a child joins its parent where the model of the numeric work says that one larger dense
// front is cheaper than two with an extend-add between them (Ashcraft, Grimes 1989, with a cost in place of a count of zeros).
// `graph` must hold, for every element, edges that join its nodes in the order of their elimination. `apart` (empty, or one
// flag a node): nodes with and without it never share a supernode.
Supernodes find_supernodes(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> order,
                           const Elements& elements = {}, std::span<const uint8_t> apart = {});

}  // namespace heliograph
