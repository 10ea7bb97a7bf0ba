// SPDX-License-Identifier: MIT
// Codes of the sensors' residuals; src/heliograph/factors has the same.
#pragma once
#include <cstddef>

#include "graph/factors/residual_kind.hpp"

namespace heliograph {

inline constexpr int32_t kPreintegratedImu = kFirstBrought;
inline constexpr int32_t kCombinedImu = kFirstBrought + 1;
inline constexpr int32_t kLeverArmPosition = kFirstBrought + 2;
inline constexpr int32_t kVelocity = kFirstBrought + 3;
inline constexpr int32_t kLidarPose = kFirstBrought + 4;
inline constexpr int32_t kCalibrationPrior = kFirstBrought + 5;
inline constexpr int32_t kAnchoredPosition = kFirstBrought + 6;
inline constexpr int32_t kScaledMotion = kFirstBrought + 7;
inline constexpr int32_t kMeanForce = kFirstBrought + 8;

// Doubles of a measurement on gravity: the vector, or the magnitude behind a variable.
constexpr size_t gravity_numbers(bool variable) { return variable ? 1 : 3; }

// All residuals of this room, once an instruction set.
FactorKernels baseline_sensor_kernels();
#if defined(HELIOGRAPH_HAVE_AVX2)
FactorKernels avx2_sensor_kernels();
#endif

}  // namespace heliograph
