"""Defaults of the back-end: which scans become keyframes, and what the graph makes of them."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range

__all__ = ["SlamConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamConfig:
    """Keyframes, and the graph of them.

    Parameters
    ----------
    graph : bool
        Whether a run has a back-end: keyframes, graph, loops.
    loops : bool
        Whether places that were seen before are looked for.
    keyframe_distance, keyframe_angle_deg : float
        How far [m] and how much [deg] until the next keyframe.
    keyframe_interval : float
        How long until the next keyframe at rest [s].
    keyframe_overlap : float
        A scan is a keyframe when less than this share of what it sees near by was seen by the last keyframe's, such as
        behind a door; 0: never for that.
    cloud_voxel : float
        One point a cube of this edge is kept of a keyframe's scan [m].
    step_rotation_sigma_deg, step_position_sigma : float
        Least standard deviation of the odometry's step between two keyframes [deg], [m]: slack of the gates for slips
        that it does not know of. In a graph with an IMU the factor of a step has a tenth of it.
    level_sigma_deg : float
        What the first pose's level may be off where the odometry does not tell [deg].
    loop_every : int
        Loops are looked for at every n-th keyframe, n being this.
    loop_pieces : int
        Pieces of the search for loops, such as one registration, that are done at a keyframe; what is left goes on at
        the next ones.
    loop_worth : float
        Loops are looked for where odometry, and the loops that stand, leave the position open by at least this,
        one-sigma [m].
    window : int
        Keyframes whose velocities and biases the graph keeps; what IMU and LiDAR said of a step before those is
        summarised as a step of poses; 0: all are kept. A keyframe takes less memory then, and longer.
    level_window : float
        Where no preintegrated factor holds the level, with poses of a file or behind `window`, the mean specific force
        of this long does [s]; 0: nothing.
    pose_rotation_sigma_deg, pose_position_sigma : float
        What poses read from a file may drift over a metre; it grows with the root of the way [deg], [m].
    """

    graph: bool = True
    loops: bool = True
    keyframe_distance: float = 1.0
    keyframe_angle_deg: float = 10.0
    keyframe_interval: float = 20.0
    keyframe_overlap: float = 0.3
    cloud_voxel: float = 0.2
    step_rotation_sigma_deg: float = 0.01
    step_position_sigma: float = 0.001
    level_sigma_deg: float = 1.0
    loop_every: int = 2
    loop_pieces: int = 4
    loop_worth: float = 0.03
    window: int = 0
    level_window: float = 20.0
    pose_rotation_sigma_deg: float = 0.5
    pose_position_sigma: float = 0.05

    def __post_init__(self) -> None:
        check_range(self, "keyframe_distance", "keyframe_angle_deg", "keyframe_interval", "cloud_voxel", above=0.0)
        check_range(self, "step_rotation_sigma_deg", "step_position_sigma", "level_sigma_deg", above=0.0)
        check_range(self, "keyframe_overlap", low=0.0, high=1.0)
        check_range(self, "loop_worth", "window", "level_window", low=0)
        check_range(self, "loop_every", "loop_pieces", low=1)
        check_range(self, "pose_rotation_sigma_deg", "pose_position_sigma", above=0.0)
