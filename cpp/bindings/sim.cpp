// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"

namespace heliograph {

void bind_sim(nb::module_& m) { m.attr("sim") = true; }

}  // namespace heliograph
