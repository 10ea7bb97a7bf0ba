// SPDX-License-Identifier: MIT
// Motion compensation of one sweep: every point through the pose at its own time.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

// A path of body poses seen from the reference pose: T_ref_body(t_k), row-major.
struct SweepPath {
  std::span<const int64_t> times_ns;  // K, increasing, on the clock of the points' times
  const double* R_ref_body;           // (K, 3, 3)
  const double* p_ref_body;           // (K, 3)
};

// p_ref = T_ref_body(t) T_body_lidar p_lidar for each point: rotation geodesic, position linear between two poses; the
// ends are held. T_body_lidar is row-major 4x4. Returns (N, 3).
std::vector<float> deskew(std::span<const float> points, std::span<const int32_t> offsets_ns, const SweepPath& path,
                          const double* T_body_lidar, int threads);

}  // namespace heliograph
