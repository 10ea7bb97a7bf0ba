// SPDX-License-Identifier: MIT
#include "tests/check.hpp"
#include "util/isa.hpp"

void check_util() { CHECK(heliograph::active_isa() == heliograph::active_isa()); }
