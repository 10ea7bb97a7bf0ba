"""A run that is to be merged: its keyframes, where its own graph has them, and how well the way between is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from heliograph.arrays import Array, Points
from heliograph.config import RunConfig
from heliograph.errors import FormatError
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import Symbol, load_graph
from heliograph.lie import se3
from heliograph.localization import SavedMap, map_of_keyframes
from heliograph.localization.recent_scans import level_frame
from heliograph.maps import transformed
from heliograph.revision import RunGraph, open_run_graph
from heliograph.slam import KEYFRAMES, KeyframeStore
from heliograph.slam.covariances import OdometryChain
from heliograph.slam.loops import read_ledger

__all__ = ["RunSession", "open_session", "session_of_keyframes"]


class RunSession:
    """A run with its poses in its own map; it is a `Submaps` of the loops' local maps too.

    Parameters
    ----------
    run : RunGraph
    name : str
        How it is called in what is written.
    """

    def __init__(self, run: RunGraph, name: str) -> None:
        self.run, self.name = run, name
        self.chain = OdometryChain()
        for keyframe in run.store:
            self.chain.append(keyframe.stamp_ns, keyframe.T_odom_imu, keyframe.step_covariance)
        self._saved: SavedMap | None = None

    def __len__(self) -> int:
        return len(self.run.store)

    @property
    def T_map_imu(self) -> Array:
        """Poses of the keyframes as the run's own graph has them, (K, 4, 4)."""
        return self.run.T_map_imu

    def points(self, index: int) -> Points:
        """Return a keyframe's cloud (N, 3) float32, imu frame [m]."""
        return self.run.points(index)

    def T_odom_imu(self, index: int) -> Array:
        """Return a keyframe's pose (4, 4) as the run's own graph has it."""
        return np.asarray(self.T_map_imu[index])

    def relative(self, a: int, b: int) -> tuple[Array, Array]:
        """Return ``T_a_b`` of two keyframes by the run's own graph, and its covariance by odometry (6, 6)."""
        T = np.ascontiguousarray(se3.inverse(self.T_map_imu[a]) @ self.T_map_imu[b])
        return T, self.chain.relative(a, b)[1]

    def saved(self) -> SavedMap:
        """Return the run's map to search in."""
        if self._saved is None:
            config = self.run.config
            clouds = [self.points(k) for k in range(len(self))]
            self._saved = map_of_keyframes(
                clouds, self.T_map_imu, config=config.localization, places=config.places, maps=config.map
            )
        return self._saved

    def around(self, index: int, way: float) -> tuple[Array, Points]:
        """Return the levelled frame of a keyframe in the run's map (4, 4), and the last metres' clouds in it."""
        T_map_level = level_frame(self.T_map_imu[index])
        first = index
        while first > 0 and index - first < _MEMBERS and self._apart(first - 1, index) < way:
            first -= 1
        T_level_map = se3.inverse(T_map_level)
        parts = [transformed(self.points(k), T_level_map @ self.T_map_imu[k]) for k in range(first, index + 1)]
        return T_map_level, np.ascontiguousarray(np.concatenate(parts), dtype=np.float32)

    def _apart(self, a: int, b: int) -> float:
        return float(np.linalg.norm(self.T_map_imu[a, :3, 3] - self.T_map_imu[b, :3, 3]))


_MEMBERS = 12  # keyframes that make a query at most


def open_session(folder: Path | str) -> RunSession:
    """Open a run to merge it.

    Raises
    ------
    FormatError
        It is no folder of a run, the run had no graph, or a file of it is missing, damaged, or of another version.
    """
    folder = Path(folder)
    return RunSession(open_run_graph(folder), folder.name or str(folder))


def session_of_keyframes(folder: Path, name: str, config: RunConfig) -> RunSession:
    """Open what a back-end left in a folder that is not one of a run: keyframes, ledger and graph.

    Parameters
    ----------
    folder : Path
    name : str
        How the session is called.
    config : RunConfig

    Raises
    ------
    FormatError
        A file of it is missing or damaged, or there is no keyframe.
    """
    store = KeyframeStore.open(folder / KEYFRAMES)
    if not len(store):
        raise FormatError(folder / KEYFRAMES, "holds no keyframe: no scan was matched, so there is nothing to add")
    ledger = read_ledger(folder / "loops.csv", config.loops)
    _, values = load_graph(folder / "graph.npz", factors=SENSOR_FACTORS)
    T = np.ascontiguousarray(values.at(Symbol("X")(np.arange(len(store)))).matrix[:, :4, :4])
    run = RunGraph(folder=folder, config=config, facts={}, store=store, ledger=ledger, T_map_imu=T)
    return RunSession(run, name)
