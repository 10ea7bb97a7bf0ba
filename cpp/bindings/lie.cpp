// SPDX-License-Identifier: MIT
// The Lie maps over batches. The caller makes the output, so the shapes are its business; sizes are checked here.
#include "lie/batch.hpp"

#include "bindings/bindings.hpp"

namespace heliograph {

namespace {

using Batch = Array<const double>;
using Output = Array<double>;

void require_sizes(bool hold) {
  if (!hold) throw std::invalid_argument("the array sizes do not match the Lie map");
}

}  // namespace

void bind_lie(nb::module_& m) {
  for (const UnaryMap& map : unary_maps) {
    m.def(
        map.name,
        [&map](Batch in, Output out) {
          const size_t count = out.size() / map.out;
          require_sizes(out.size() == count * map.out && in.size() == count * map.in);
          const nb::gil_scoped_release release;
          map.apply(in.data(), out.data(), count);
        },
        nb::arg("batch").noconvert(), nb::arg("out").noconvert());
  }
  for (const BinaryMap& map : binary_maps) {
    m.def(
        map.name,
        [&map](Batch a, Batch b, Output out) {
          const size_t count = out.size() / map.size;
          require_sizes(out.size() == count * map.size && a.size() == out.size() && b.size() == out.size());
          const nb::gil_scoped_release release;
          map.apply(a.data(), b.data(), out.data(), count);
        },
        nb::arg("a").noconvert(), nb::arg("b").noconvert(), nb::arg("out").noconvert());
  }
}

}  // namespace heliograph
