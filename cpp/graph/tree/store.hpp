// SPDX-License-Identifier: MIT
// What a Bayes tree consists of between updates.
#pragma once
#include "graph/tree/cliques.hpp"
#include "graph/tree/factors.hpp"
#include "graph/tree/variables.hpp"

namespace heliograph {

struct TreeStore {
  TreeVariables variables;
  TreeFactors factors;
  TreeCliques cliques;
};

}  // namespace heliograph
