// SPDX-License-Identifier: MIT
// The state of a Bayes tree between updates as bytes: little-endian counts and raw arrays, then a checksum.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/tree/counts.hpp"
#include "graph/tree/journal.hpp"
#include "graph/tree/steps.hpp"
#include "graph/tree/store.hpp"
#include "graph/tree/top.hpp"

namespace heliograph {

// All that a file holds, by its owners.
struct StoredTree {
  TreeVariables::Stored variables;
  TreeFactors::Stored factors;
  TreeCliques::Stored cliques;
  TreeJournal::Stored journal;
  TreeTop::Stored top;
  std::vector<int32_t>& kept_order;
  TreeSteps::Stored steps;
  TreeCounts& counts;
};

std::vector<uint8_t> write_tree(StoredTree tree);  // changes nothing
// Into an empty tree. Throws std::invalid_argument where the bytes are damaged or cut short.
void read_tree(StoredTree tree, std::span<const uint8_t> bytes);

}  // namespace heliograph
