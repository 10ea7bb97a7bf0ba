"""A run's folder opened as a survey: keyframes, where the map lies on Earth, and how well both are known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.arrays import Array, Stamps, freeze
from heliograph.errors import DataError, FormatError
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import FactorGraph, Marginals, Symbol, Values, load_graph
from heliograph.guard.account import read_account
from heliograph.output.final_poses import FinalPoses
from heliograph.slam import KEYFRAMES, KeyframeStore

__all__ = ["PlacedRun", "open_placed_run", "position_in_frame"]

X, E = Symbol("X"), Symbol("E")


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedRun:
    """The graph of a run with its place on Earth.

    Parameters
    ----------
    folder : Path
    facts : mapping
        Its ``run.json``.
    stamps_ns : (K,) int64
        Times of the keyframes [ns].
    graph : FactorGraph
    values : Values
        Solved; ``X`` keyframes, ``E`` is ``T_map_enu`` where the run is placed.
    origin_deg : (3,) float64 or None
        Origin of east-north-up: latitude, longitude [deg], height above the ellipsoid [m]; None: not placed.
    T_files_imu : (K, 4, 4) float64
        Poses of the keyframes that the run's own files were written with; `values` may have been solved anew since.
    """

    folder: Path
    facts: Mapping[str, Any]
    stamps_ns: Stamps
    graph: FactorGraph
    values: Values
    origin_deg: Array | None
    T_files_imu: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def T_map_imu(self) -> Array:
        """Poses of the keyframes, (K, 4, 4)."""
        return _poses(self.values, len(self.stamps_ns))

    @property
    def moved(self) -> FinalPoses:
        """What takes the run's files, written before it was solved anew, to where it is now."""
        return FinalPoses(stamps_ns=self.stamps_ns, T_odom_imu=self.T_files_imu, T_map_imu=self.T_map_imu)

    @property
    def T_enu_map(self) -> Array:
        """Where the map lies in east-north-up, (4, 4); the identity where the run is not placed."""
        if self.origin_deg is None:
            return np.eye(4)
        T = self.values.at(E(0)).matrix
        T_enu_map = np.eye(4)
        T_enu_map[:3, :3], T_enu_map[:3, 3] = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
        return T_enu_map

    def sigmas(self) -> tuple[Array, Array]:
        """Return one-sigmas of the keyframes' positions (K, 3) and headings (K,), in east-north-up [m], [rad].

        Where a run is not placed, they are those in the map.
        """
        marginals = Marginals(self.graph, self.values)
        K = len(self.stamps_ns)
        T, T_enu_map = self.T_map_imu, self.T_enu_map
        position, heading = np.zeros((K, 3)), np.zeros(K)
        for k in range(K):
            key = int(X(k))
            if self.origin_deg is None:
                P = marginals.covariance(key)[:6, :6]
                J = np.hstack([np.zeros((3, 3)), T[k, :3, :3]])
                H = np.concatenate([T[k, 2, :3], np.zeros(3)])
            else:
                P, J, H = position_in_frame(marginals, key, T[k], T_enu_map)
            position[k] = np.sqrt(np.maximum(np.diag(J @ P @ J.T), 0.0))
            heading[k] = np.sqrt(max(float(H @ P @ H), 0.0))
        return position, heading


def _poses(values: Values, count: int) -> Array:
    return np.ascontiguousarray(values.at(X(np.arange(count))).matrix[:, :4, :4])


def position_in_frame(marginals: Marginals, key: int, T: Array, T_enu_map: Array) -> tuple[Array, Array, Array]:
    """Return how well a pose's position and heading are known in a frame whose own pose is estimated, ``E(0)``.

    Parameters
    ----------
    marginals : Marginals
    key : int
        Key of the pose.
    T : (4, 4) float64
        The pose in the map.
    T_enu_map : (4, 4) float64

    Returns
    -------
    (12, 12), (3, 12), (12,) float64
        Joint covariance of pose and frame, and how position and heading follow from them.
    """
    R_enu = T_enu_map[:3, :3]
    joint = marginals.joint([key, int(E(0))])
    d = len(joint) - 6
    take = np.r_[0:6, d : d + 6]
    q = R_enu @ T[:3, 3] + T_enu_map[:3, 3]
    J = np.zeros((3, 12))
    J[:, 3:6], J[:, 6:9], J[:, 9:12] = R_enu @ T[:3, :3], _hat(q), -np.eye(3)
    H = np.zeros(12)
    H[:3], H[6:9] = (R_enu @ T[:3, :3])[2], [0.0, 0.0, -1.0]
    return joint[np.ix_(take, take)], J, H


def _hat(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def open_placed_run(folder: Path | str) -> PlacedRun:
    """Open the folder of a run that has ended.

    Raises
    ------
    FormatError
        It is no folder of a run, or the run had no graph.
    """
    folder = Path(folder)
    facts = read_account(folder)
    if "graph" not in facts:
        raise FormatError(folder, "is a run without a graph (--no-graph, or it has not ended); run it again")
    graph, values = load_graph(folder / "graph.npz", factors=SENSOR_FACTORS)
    store = KeyframeStore.open(folder / KEYFRAMES)
    stamps = store.stamps_ns
    store.close()
    if len(stamps) == 0:
        raise DataError(f"{folder}: the run has no keyframe")
    gnss = facts["graph"].get("gnss", {})
    origin = None
    if gnss.get("aligned") and int(E(0)) in values:
        place = gnss["origin"]
        origin = np.array([place["latitude_deg"], place["longitude_deg"], place["height_ellipsoid_m"]])
    return PlacedRun(
        folder=folder, facts=facts, stamps_ns=stamps, graph=graph, values=values, origin_deg=origin,
        T_files_imu=_poses(values, len(stamps)),
    )  # fmt: skip
