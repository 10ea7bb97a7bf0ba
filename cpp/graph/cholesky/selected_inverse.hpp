// SPDX-License-Identifier: MIT
// Entries of the inverse of a factorised matrix where the factor has entries (Takahashi, Fagan, Chin 1973), front by front.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "graph/cholesky/multifrontal.hpp"

namespace heliograph {

// Diagonal blocks of the inverse. Only the fronts between what is asked for and the roots are visited, and what is found of
// them is kept for later calls, up to a bound: those near the roots, which many nodes share, come first. The factorisation
// must stay as it is; the bits do not depend on what was asked before.
class SelectedInverse {
 public:
  explicit SelectedInverse(const Multifrontal& factorization, size_t most_doubles = size_t{1} << 24);
  ~SelectedInverse();
  SelectedInverse(const SelectedInverse&) = delete;
  SelectedInverse& operator=(const SelectedInverse&) = delete;

  // One block a node, row-major and one after another.
  std::vector<double> blocks(std::span<const int32_t> nodes);

 private:
  class Fronts;
  std::unique_ptr<Fronts> fronts_;
};

}  // namespace heliograph
