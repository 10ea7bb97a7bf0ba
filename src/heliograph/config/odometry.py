"""Defaults of odometry: the inertial model, the scan, the local map and the filter."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_choice, check_range

__all__ = ["CloudConfig", "FilterConfig", "ImuConfig", "MapConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuConfig:
    """Start and noise of the inertial model.

    Parameters
    ----------
    gravity : float
        Length of gravity [m/s^2].
    gyro_noise, accel_noise : float
        White noise of an IMU never at rest, and the upper limit of what is estimated at rest [rad/s/sqrt(Hz)],
        [m/s^2/sqrt(Hz)].
    gyro_noise_floor, accel_noise_floor : float
        Lower limit of what is estimated at rest, which shows neither scale errors nor vibration.
    gyro_walk, accel_walk : float
        Bias random walks [rad/s^2/sqrt(Hz)], [m/s^3/sqrt(Hz)].
    gyro_bias_sigma, accel_bias_sigma : float
        What a bias may be before anything is known [rad/s], [m/s^2].
    curvature : float
        Share of the change between two samples that linear interpolation is taken to miss.
    max_step : float
        Longest integration step [s].
    max_gap : float
        A longer distance between samples counts as a gap [s].
    hold : float
        How long the nearest sample is held outside the samples and in gaps; then the body is taken to coast [s].
    patience : float
        A scan waits for samples up to its end until messages have run one sample period and this much past it [s].
    held_gyro_noise, held_accel_noise : float
        White noise added while samples are held or bridged [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    start_window : float
        Data looked at before the first pose [s].
    moving_window : float
        Data looked at where those show motion [s].
    still_duration : float
        Least rest for a static start [s].
    still_gyro_sigma, still_accel_sigma : float
        Largest standard deviation of a channel at rest [rad/s], [m/s^2].
    still_rate, still_gravity_error : float
        Largest mean rate [rad/s] and largest error of the mean force's length [m/s^2] at rest.
    biased_rate, biased_gravity_error : float
        The same where the LiDAR confirms that nothing moves or turns, so that it can only be a bias.
    still_speed, still_turn : float
        Largest speed [m/s] and rate [rad/s] of the LiDAR odometry at rest.
    still_block : float
        Vibration is separated from motion by means over this long [s].
    vibration_gyro, vibration_accel : float
        Largest standard deviation of a channel at rest on something that vibrates [rad/s], [m/s^2].
    """

    gravity: float = 9.80665
    gyro_noise: float = 2e-3
    accel_noise: float = 3e-2
    gyro_noise_floor: float = 2e-4
    accel_noise_floor: float = 2e-3
    gyro_walk: float = 1e-5
    accel_walk: float = 1e-4
    gyro_bias_sigma: float = 0.05
    accel_bias_sigma: float = 0.1
    curvature: float = 0.3
    max_step: float = 0.005
    max_gap: float = 0.25
    hold: float = 0.1
    patience: float = 0.05
    held_gyro_noise: float = 0.1
    held_accel_noise: float = 1.0
    start_window: float = 1.0
    moving_window: float = 3.0
    still_duration: float = 0.5
    still_gyro_sigma: float = 0.03
    still_accel_sigma: float = 0.3
    still_rate: float = 0.1
    still_gravity_error: float = 0.6
    biased_rate: float = 0.35
    biased_gravity_error: float = 1.5
    still_speed: float = 0.1
    still_turn: float = 0.02
    still_block: float = 0.2
    vibration_gyro: float = 0.3
    vibration_accel: float = 5.0

    def __post_init__(self) -> None:
        positive = (
            "gravity",
            "gyro_noise",
            "accel_noise",
            "gyro_noise_floor",
            "accel_noise_floor",
            "max_step",
            "max_gap",
            "still_block",
        )
        check_range(self, *positive, "gyro_bias_sigma", "accel_bias_sigma", above=0.0)
        check_range(
            self, "gyro_walk", "accel_walk", "curvature", "hold", "patience", "start_window", "moving_window", low=0.0
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudConfig:
    """What happens to a scan before it is matched.

    Parameters
    ----------
    min_range, max_range : float
        Points outside are dropped [m].
    target_points : int
        Points to match a scan with; the thinning's cube edge follows from it.
    min_leaf, max_leaf : float
        Limits of that edge [m].
    deskew : str
        ``"imu"`` (the filter's own motion model), or ``"off"`` for comparison.
    """

    min_range: float = 0.5
    max_range: float = 150.0
    target_points: int = 6000
    min_leaf: float = 0.05
    max_leaf: float = 1.0
    deskew: str = "imu"

    def __post_init__(self) -> None:
        check_range(self, "target_points", low=1)
        check_range(self, "max_range", "min_leaf", "max_leaf", above=0.0)
        check_range(self, "min_range", low=0.0)
        check_choice(self, "deskew", "imu", "off")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapConfig:
    """The local map.

    Parameters
    ----------
    voxel : float
        Edge of the finest cubes [m].
    levels : int
        Levels, each with twice the edge.
    min_points, max_points : int
        Points that a plane needs, and at which a cube is frozen.
    max_thickness : float
        Largest standard deviation of points across their plane [m].
    min_spread : float
        Least standard deviation along it, as a share of the cube's edge.
    point_spacing : float
        Distance of the raw points kept for the nearest-neighbour fallback [m].
    fallback_range : float
        How far a neighbour may be [m].
    radius : float
        What lies farther from the sensor is forgotten [m].
    max_voxels : int
        Largest number of cubes.
    window : float
        What was not seen during the last part of the way, of this length, is forgotten [m]; 0 keeps all within
        ``radius``. What comes back after that is a loop, and the back-end's to verify.
    window_drift : float
        One-sigma of the map's own drift that shortens the window: what it has moved by more is forgotten too [m].
    """

    voxel: float = 0.25
    levels: int = 3
    min_points: int = 8
    max_points: int = 200
    max_thickness: float = 0.035
    min_spread: float = 0.12
    point_spacing: float = 0.1
    fallback_range: float = 0.6
    radius: float = 150.0
    max_voxels: int = 2_000_000
    window: float = 60.0
    window_drift: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "voxel", "max_thickness", "min_spread", "point_spacing", "fallback_range", above=0.0)
        check_range(self, "radius", "window_drift", above=0.0)
        check_range(self, "window", low=0.0)
        check_range(self, "levels", low=1, high=8)
        check_range(self, "min_points", "max_points", low=3)
        check_range(self, "max_voxels", low=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterConfig:
    """The iterated error-state Kalman filter.

    Parameters
    ----------
    max_iterations : int
        Iterations of one update, once its kernel has narrowed.
    tolerance_rotation, tolerance_position : float
        An update has converged when a step is smaller [rad], [m].
    residual : str
        ``"plane"``, or ``"point"`` for comparison.
    sigma : float
        Range noise across a plane at the start [m]; afterwards it follows the residuals.
    min_sigma, max_sigma : float
        Limits of that [m].
    kernel : float
        Scale of the Geman-McClure kernel in units of sigma.
    gate : float
        Largest residual of a match in units of the kernel's scale.
    max_kernel : float
        Widest kernel that an uncertain prediction may open [m].
    correlation : float
        How many matches count as one independent one: neighbouring points share their plane's error. More do where
        residuals show that more err alike.
    systematic : float
        Share of the range noise that does not average out within a scan; the map's drift is accounted for with it.
    fallback_stride : int
        One in ``fallback_stride`` points without a plane asks for its neighbours; 0 switches the fallback off.
    min_matches : int
        Fewer matches make no update.
    vague_share : float
        After a vague prediction, a share of matched points below this part of the usual one makes no update.
    lost_sigma : float
        A scan that does not match while its position is known no better than this counts as lost [m].
    degenerate_translation : float
        A per-measurement eigenvalue below it makes the start try several speeds.
    typical_range : float
        Distance that stands for the cloud where the error of a predicted rotation opens the kernel [m].
    unknown_speed, unknown_rate : float
        One-sigma of speed and rate at the start where nothing tells them: without an IMU, and before a start in motion
        is aligned [m/s], [rad/s].
    tried_speeds : tuple of float
        Speeds tried at the start, forwards and backwards, where the LiDAR is blind along its way [m/s].
    constant_velocity_accel, constant_velocity_gyro : float
        Noise of the motion model that stands in for a missing IMU [m/s^2/sqrt(Hz)], [rad/s^2/sqrt(Hz)].
    estimate_mounting, estimate_time_offset : bool
        Whether the mounting, and offset and drift of the IMU's clock, are states of the filter; for a mounting that is
        not known well, see docs/howto/calibrate.md.
    mounting_rotation_sigma, mounting_lever_sigma, time_offset_sigma : float
        One-sigma of what they may be off at the start [rad], [m], [s].
    time_drift_sigma_ppm : float
        One-sigma of how much faster or slower the IMU's clock may run [1e-6]; 0 takes the offset for constant.
    calibration_gain : float
        A direction of mounting and clock is left alone until the motion lowers its sigma by this factor.
    """

    max_iterations: int = 6
    tolerance_rotation: float = 1e-4
    tolerance_position: float = 1e-3
    residual: str = "plane"
    sigma: float = 0.03
    min_sigma: float = 0.01
    max_sigma: float = 0.15
    kernel: float = 3.0
    gate: float = 2.5
    max_kernel: float = 1.0
    correlation: float = 4.0
    systematic: float = 0.01
    fallback_stride: int = 2
    min_matches: int = 50
    vague_share: float = 0.6
    lost_sigma: float = 3.0
    degenerate_translation: float = 0.01
    typical_range: float = 15.0
    unknown_speed: float = 5.0
    unknown_rate: float = 1.0
    tried_speeds: tuple[float, ...] = (12.0, 24.0, 36.0)
    constant_velocity_accel: float = 3.0
    constant_velocity_gyro: float = 3.0
    estimate_mounting: bool = False
    estimate_time_offset: bool = False
    mounting_rotation_sigma: float = 0.05
    mounting_lever_sigma: float = 0.1
    time_offset_sigma: float = 0.02
    time_drift_sigma_ppm: float = 50.0
    calibration_gain: float = 5.0

    def __post_init__(self) -> None:
        check_range(self, "max_iterations", "min_matches", low=1)
        check_range(self, "sigma", "min_sigma", "max_sigma", "kernel", "gate", "max_kernel", "correlation", above=0.0)
        check_range(self, "tolerance_rotation", "tolerance_position", "lost_sigma", above=0.0)
        check_range(self, "typical_range", "unknown_speed", "unknown_rate", "tried_speeds", above=0.0)
        check_range(self, "mounting_rotation_sigma", "mounting_lever_sigma", "time_offset_sigma", above=0.0)
        check_range(self, "calibration_gain", low=1.0)
        check_range(self, "systematic", "fallback_stride", "vague_share", low=0)
        check_range(self, "time_drift_sigma_ppm", low=0.0, high=1e4)  # no clock is off by more than a percent
        check_choice(self, "residual", "plane", "point")
