// SPDX-License-Identifier: MIT
#include "graph/factors/manifold.hpp"
#include "lie/s2.hpp"
#include "lie/se2.hpp"
#include "lie/se3.hpp"

namespace heliograph {

namespace {

template <typename Function>
void each(const FamilyBlock& block, const double* x, const double* delta, double* out, Function&& retract) {
  const auto storage = static_cast<size_t>(block.storage), dof = static_cast<size_t>(block.dof);
  for (size_t k = 0; k < block.count; ++k) {
    const size_t value = block.value + k * storage;
    retract(x + value, delta + block.tangent + k * dof, out + value);
  }
}

}  // namespace

void retract_block(const FamilyBlock& block, const double* x, const double* delta, double* out) {
  switch (block.manifold) {
    case Manifold::vector:
      return each(block, x, delta, out, [n = block.dof](const double* v, const double* d, double* o) {
        for (int i = 0; i < n; ++i) o[i] = v[i] + d[i];
      });
    case Manifold::so2:
      return each(block, x, delta, out, [](const double* v, const double* d, double* o) { lie::so2_retract(v, d[0], o); });
    case Manifold::so3:
      return each(block, x, delta, out, [](const double* v, const double* d, double* o) { lie::so3_retract(v, d, o, nullptr); });
    case Manifold::se2: return each(block, x, delta, out, lie::se2_retract);
    case Manifold::se3: return each(block, x, delta, out, lie::motion_retract<1>);
    case Manifold::s2: return each(block, x, delta, out, lie::s2_retract);
    case Manifold::nav: return each(block, x, delta, out, lie::motion_retract<2>);
  }
}

}  // namespace heliograph
