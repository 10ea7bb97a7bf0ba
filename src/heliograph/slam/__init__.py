"""Graph SLAM: keyframes, their store, and the back-end that joins odometry, inertial data and loops in one graph."""

from heliograph.slam.back_end import BackEnd, GraphUpdate
from heliograph.slam.keyframes import KeyframeSelector
from heliograph.slam.session import KEYFRAMES, MovedKeyframes, NoSlam, SlamSession
from heliograph.slam.store import KeyframeStore

__all__ = [
    "KEYFRAMES",
    "BackEnd",
    "GraphUpdate",
    "KeyframeSelector",
    "KeyframeStore",
    "MovedKeyframes",
    "NoSlam",
    "SlamSession",
]
