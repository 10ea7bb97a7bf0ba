// SPDX-License-Identifier: MIT
// Which variables a linearised graph determines, found without factorising: what is held determines its neighbours, they
// theirs, and so on. What remains moves with a few "seeds"; Python decides in which of those motions nothing resists.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/problem/problem.hpp"

namespace heliograph {

enum class Freedom : uint8_t {
  determined = 0,
  follows = 1,     // its motion is a linear function of its part's seeds
  unresolved = 2,  // too many seeds would be needed
};

struct FreeSpace {
  bool determined = true;               // everything is; then what follows is left empty
  bool everywhere = true;               // what is determined is so at any values: single factors of full rank lead to it
  int32_t components = 0;               // of the graph, over free and held variables; a variable without factors is one
  std::vector<int32_t> component;       // (variables)
  std::vector<int32_t> factors;         // (variables) that touch it
  std::vector<Freedom> freedom;         // (variables)
  std::vector<int32_t> part;            // (variables) connected part of what is not determined, or -1
  std::vector<int32_t> columns;         // (parts) seed directions
  std::vector<int64_t> motion_of;       // (variables) offset into `motion`, or -1
  std::vector<double> motion;           // of each variable that follows: dof x columns of its part, row-major
};

// At most `most_columns` seed directions a part. `assumed` variables count as determined although they are not held.
// The problem must be linearised. Ranks are judged on the blocks of the normal equations, cautiously: what is called
// determined is so; what is not may still be.
FreeSpace free_space(const GraphProblem& problem, std::span<const int32_t> assumed, int most_columns);

int32_t count_components(const GraphProblem& problem);

// Least ratio of a pivot to the diagonal it came from, in the last factorisation.
double least_pivot(const GraphProblem& problem);

}  // namespace heliograph
