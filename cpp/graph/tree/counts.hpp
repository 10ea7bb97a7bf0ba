// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>

namespace heliograph {

// What the last update of a Bayes tree did.
struct TreeCounts {
  size_t variables = 0;   // eliminated again
  size_t cliques = 0;     // taken down
  size_t factors = 0;     // assembled again
  size_t linearized = 0;  // factors that were evaluated
  size_t solved = 0;      // variables whose step was computed
  double work = 0.0;      // multiplications of the elimination
};

}  // namespace heliograph
