// SPDX-License-Identifier: MIT
// The families a variable can belong to, and how its value lies in memory.
#pragma once
#include <cstddef>
#include <cstdint>

namespace heliograph {

// Numbers double as the codes that cross the Python boundary.
enum class Manifold : int32_t { vector = 0, so2 = 1, so3 = 2, se2 = 3, se3 = 4, s2 = 5, nav = 6 };

inline constexpr int kMaxDof = 16;  // of one variable; longer vectors are split by the caller

// Packed doubles of one value: vector (d); so2 (cos, sin); so3 R row-major (9); se2 (cos, sin, x, y);
// se3 R row-major, t (12); s2 unit vector (3); nav R row-major, position, velocity (15).
constexpr int storage_of(Manifold manifold, int dof) {
  switch (manifold) {
    case Manifold::vector: return dof;
    case Manifold::so2: return 2;
    case Manifold::so3: return 9;
    case Manifold::se2: return 4;
    case Manifold::se3: return 12;
    case Manifold::s2: return 3;
    case Manifold::nav: return 15;
  }
  return 0;
}

// A family's variables in one stacked block of the flat value array: variable v of the family lies at value + v * storage
// and its tangent at tangent + v * dof.
struct FamilyBlock {
  Manifold manifold = Manifold::vector;
  int dof = 0;
  int storage = 0;
  size_t count = 0;
  size_t first = 0;    // dense index of its first variable
  size_t value = 0;    // offset into the flat value array
  size_t tangent = 0;  // offset into the flat tangent array
};

// out <- x retracted by delta (right perturbation, rotation first), for a whole block. All three are the flat arrays of all
// families, of which the block says its part; `out` may be `x`.
void retract_block(const FamilyBlock& block, const double* x, const double* delta, double* out);

}  // namespace heliograph
