// SPDX-License-Identifier: MIT
// One value as its matrix or vector into its packed form: what is added one by one would wait for arrays of one element.
#pragma once
#include <span>

#include "graph/factors/manifold.hpp"

namespace heliograph {

inline constexpr double kOffManifold = 1e-3;  // how far from a rotation or a unit vector a value may be, as in families.py

// `x` is element (i, j) at x[i * row + j * column]; a vector's elements lie `row` apart. Returns whether the value is finite
// and on its manifold; `out` holds storage_of(manifold, dof) doubles.
bool pack_single(Manifold manifold, int dof, const double* x, int64_t row, int64_t column, double* out);

}  // namespace heliograph
