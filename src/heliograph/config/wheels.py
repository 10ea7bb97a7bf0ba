"""Defaults of wheels and legs: how they are weighed."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range

__all__ = ["WheelConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelConfig:
    """Speeds by wheels or legs in the graph.

    Parameters
    ----------
    file : str
        Speeds from a CSV beside the recording, see docs/howto/wheels.md; empty: none.
    topic : str
        Speeds from a topic of the recording: Odometry, TwistStamped, TwistWithCovarianceStamped or JointState; empty:
        none. None is taken by itself: an Odometry may be another estimator's, and hold this recording's LiDAR.
    joints : tuple of str
        Joints of a JointState whose mean rate, times `radius`, is the forward speed; a ``-`` before a name turns it.
    radius : float
        Radius of the wheels that those joints turn [m].
    clock_offset : float
        What the speeds' clock shows more than the recording's [s].
    yaw_deg : float
        Heading of the vehicle's forward axis in the imu frame [deg]; given, it goes before the recording's tf.
    lever_arm : (float, float, float)
        The point whose speed is measured, in the imu frame [m].
    speed_sigma : float
        One-sigma of a measured speed, white over a tenth of a second [m/s].
    lateral_sigma : float
        How fast a vehicle may slide or bounce across its forward axis where that is not measured, one-sigma [m/s].
    scale_sigma : float
        How far the scale may be from 1, one-sigma: worn or soft tyres, a wrong count a turn.
    slip_probability : float
        A step whose way differs from what the IMU foresaw by more than sound ones do with this probability is slip.
    """

    file: str = ""
    topic: str = ""
    joints: tuple[str, ...] = ()
    radius: float = 0.0
    clock_offset: float = 0.0
    yaw_deg: float = 0.0
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed_sigma: float = 0.05
    lateral_sigma: float = 0.3
    scale_sigma: float = 0.05
    slip_probability: float = 0.999

    def __post_init__(self) -> None:
        check_range(self, "speed_sigma", "lateral_sigma", "scale_sigma", above=0.0)
        check_range(self, "radius", low=0.0, high=10.0)
        check_range(self, "slip_probability", above=0.5, below=1.0)
