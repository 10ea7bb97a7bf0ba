// SPDX-License-Identifier: MIT
#include "factors/sensors.inl"

namespace heliograph {

FactorKernels baseline_sensor_kernels() { return kernels_of<Sensors>(); }

}  // namespace heliograph
