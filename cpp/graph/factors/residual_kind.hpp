// SPDX-License-Identifier: MIT
// The seam between the graph and the rooms above it: kinds of residuals that they bring. The graph knows a brought kind by
// its code alone, and asks for its shape and its kernels; what it measures is no business of the graph's.
#pragma once
#include <span>

#include "graph/factors/factor_view.hpp"

namespace heliograph {

// Codes from here on belong to the rooms above.
inline constexpr int32_t kFirstBrought = 64;

inline constexpr int kAnySize = -1;

// What is asked of a type: between which families, with how many rows (0: the usual number), with how many doubles a
// measurement (kAnySize: as many as it takes).
struct ShapeQuery {
  std::span<const Manifold> manifold;
  std::span<const int> dof;
  int rows = 0;
  int measurement = kAnySize;

  size_t arity() const { return manifold.size(); }
  bool is(size_t a, Manifold family) const { return manifold[a] == family; }
  bool vector(size_t a, int size) const { return manifold[a] == Manifold::vector && dof[a] == size; }
};

// Whether the type has a residual between these families; rows and the doubles of one measurement, if so.
struct FactorShape {
  bool known = false;
  int rows = 0;
  int measurement = 0;
};

struct ResidualKind {
  FactorType type;  // a code of kFirstBrought or above
  FactorShape (*shape)(const ShapeQuery&);
  FactorKernels (*baseline)();
  FactorKernels (*avx2)();  // null where the build has none
};

// The table of brought kinds, in the order of their codes. The room on top defines it (cpp/factors).
std::span<const ResidualKind> brought_residuals();

// The brought kind of a code, or null.
const ResidualKind* brought_residual(FactorType type);

}  // namespace heliograph
