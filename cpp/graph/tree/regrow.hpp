// SPDX-License-Identifier: MIT
// What an update eliminated becomes cliques again, and the orphans are hung below them.
#pragma once
#include <cstdint>
#include <vector>

#include "graph/tree/elimination.hpp"
#include "graph/tree/store.hpp"
#include "graph/tree/top.hpp"

namespace heliograph {

struct Regrown {
  std::vector<int32_t> made;      // cliques, by front
  std::vector<int32_t> attached;  // orphans that hang below them
  TreeTop::Part rest;             // what stays open
};

// Takes the cliques of the top out of the store and puts new ones in their place; the blocks are the store's from now on.
Regrown regrow(TreeStore& store, const TreeTop& top, const EliminatedFronts& eliminated);

}  // namespace heliograph
