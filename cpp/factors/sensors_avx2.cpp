// SPDX-License-Identifier: MIT
#if defined(HELIOGRAPH_HAVE_AVX2)
#include "factors/sensors.inl"

namespace heliograph {

FactorKernels avx2_sensor_kernels() { return kernels_of<Sensors>(); }

}  // namespace heliograph
#endif
