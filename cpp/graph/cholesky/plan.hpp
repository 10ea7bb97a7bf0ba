// SPDX-License-Identifier: MIT
// The plan of an elimination: which variables each front eliminates, where every block of every factor is added, and where
// children hand their remainder to. Made once for a graph's structure, used by every numeric factorisation.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/factors/factor_group.hpp"
#include "graph/cholesky/front_view.hpp"
#include "graph/ordering/ordering.hpp"

namespace heliograph {

// The free variables of a graph: node_of[variable] is -1 where a variable is held fixed.
struct Nodes {
  std::vector<int32_t> node_of;
  std::vector<int32_t> variable_of;
  std::vector<int32_t> weight;  // degrees of freedom
};

// Fronts stand in an order in which children precede their parents, each subtree in one stretch.
struct Plan {
  std::vector<int32_t> weight;       // (nodes) degrees of freedom
  std::vector<int32_t> scalar_of;    // (nodes) scalar position in elimination order
  std::vector<int32_t> front_of;     // (nodes) the front that eliminates it
  std::vector<FrontView> fronts;
  std::vector<int32_t> nodes;
  std::vector<int32_t> children;
  std::vector<RunView> runs;
  std::vector<BlockView> blocks;
  std::vector<GradientView> gradients;
  int64_t factor_size = 0;           // doubles
  int64_t arena_size[2] = {0, 0};    // doubles, when one thread runs the fronts in order
  int32_t scalars = 0;
  int32_t largest_rows = 0;
  double flops = 0.0;

  PlanView view() const {
    return {fronts.data(), nodes.data(), children.data(), runs.data(), blocks.data(), gradients.data(), scalar_of.data(),
            weight.data()};
  }
};

// Neighbours put in order, repeats taken out.
void tidy(Adjacency& graph);

Adjacency adjacency_of(std::span<const FactorGroup> groups, const Nodes& nodes);

// `blocks` is where the linearised factors will lie, as the groups' `block` offsets say.
Plan make_plan(std::span<const FactorGroup> groups, const double* blocks, const Nodes& nodes, const Adjacency& graph,
               std::span<const int32_t> order);

}  // namespace heliograph
