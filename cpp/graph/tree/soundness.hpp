// SPDX-License-Identifier: MIT
// Whether a tree that was read from bytes is one that this program could have made: a checksum says nothing about who wrote it.
#pragma once
#include "graph/tree/archive.hpp"

namespace heliograph {

// Looks at every index, shape, count and number that the tree's methods take on trust. Throws std::invalid_argument.
void check_tree(const StoredTree& tree);

}  // namespace heliograph
