// SPDX-License-Identifier: MIT
// One sweep of a spinning sensor whose pose differs from firing to firing.
#pragma once
#include <cstdint>
#include <span>

#include "sim/scene.hpp"

namespace heliograph::sim {

// The fan of rays: `directions` holds rows x columns unit vectors in the sensor frame, row-major;
// `T_world_sensor` one row-major 4 x 4 pose a column (a column fires at one instant).
struct Sweep {
  std::size_t rows = 0;
  std::size_t columns = 0;
  std::span<const double> directions;
  std::span<const double> T_world_sensor;
  double min_range = 0.0;
  double max_range = 0.0;
};

// Casts every ray; outputs are rows x columns, row-major. The result does not depend on `threads`.
void cast_sweep(const Scene& scene, const Sweep& sweep, int threads, std::span<double> range,
                std::span<float> brightness, std::span<std::int32_t> id);

}  // namespace heliograph::sim
