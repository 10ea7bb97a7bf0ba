"""Laws that parts of Heliograph obey, for the tests of the library and of whoever plugs something in.

Each raises `AssertionError` with the case that breaks the law. Nothing here needs a test framework.
"""

from heliograph.testing.alignments import assert_alignment
from heliograph.testing.factors import assert_factor
from heliograph.testing.groups import MAGNITUDES, assert_lie_group
from heliograph.testing.jacobians import assert_jacobian, numeric_jacobian
from heliograph.testing.kernels import RobustKernel, assert_robust_kernel
from heliograph.testing.local_maps import assert_local_map
from heliograph.testing.loop_detectors import assert_loop_detector
from heliograph.testing.odometries import assert_odometry
from heliograph.testing.parts import assert_goes_on
from heliograph.testing.sinks import assert_sink
from heliograph.testing.sources import assert_source

__all__ = [
    "MAGNITUDES",
    "RobustKernel",
    "assert_alignment",
    "assert_factor",
    "assert_goes_on",
    "assert_jacobian",
    "assert_lie_group",
    "assert_local_map",
    "assert_loop_detector",
    "assert_odometry",
    "assert_robust_kernel",
    "assert_sink",
    "assert_source",
    "numeric_jacobian",
]
