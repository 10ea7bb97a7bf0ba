// SPDX-License-Identifier: MIT
// What an elimination order costs, without eliminating: the elimination tree and the column counts of the factor.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/ordering/ordering.hpp"

namespace heliograph {

// All speak of positions in the order, not of nodes: position k eliminates order[k].

// Parent of each position, -1 at a root (Liu 1990). A parent comes after its children.
std::vector<int32_t> elimination_tree(const Adjacency& graph, std::span<const int32_t> order);

// The positions such that every subtree is contiguous and children come before their parent; siblings ascend.
std::vector<int32_t> postorder(std::span<const int32_t> parent);

// Height of each block column of the factor: the weights of its rows, its own included (Gilbert, Ng, Peyton 1994). Takes
// time almost linear in the graph, not in the fill. `parent` is the order's elimination tree.
std::vector<int64_t> column_counts(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> order,
                                   std::span<const int32_t> parent);

struct Fill {
  int64_t nonzeros = 0;  // scalars on and below the diagonal of the factor
  double flops = 0;      // sum over scalar columns of the square of their height: Cholesky's multiplications and additions
};

Fill fill_of_order(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> order);

}  // namespace heliograph
