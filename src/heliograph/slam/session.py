"""A run's back-end from the first scan to the last file: keyframes in, corrected poses and the graph's files out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.arrays import Array, Stamps
from heliograph.config import RunConfig
from heliograph.data import Event, GnssFix, GraphAccount, ImuBatch, Message, ScanResult, WheelSpeeds
from heliograph.errors import DataError
from heliograph.slam.back_end import BackEnd
from heliograph.slam.given_poses import GivenPoses
from heliograph.slam.gnss import GnssFactors
from heliograph.slam.graph_files import write_graph_files
from heliograph.slam.keyframes import KeyframeSelector
from heliograph.slam.store import KeyframeStore
from heliograph.snapshots import PART, Snapshot, require

__all__ = ["KEYFRAMES", "MovedKeyframes", "NoSlam", "SlamSession"]

KEYFRAMES = "keyframes"
_STATE = {"keyframes": int, "events": [Event], "given": PART, "selector": PART, "back_end": PART}
_ALL = 10_000  # pieces of a search: where nobody waits, nothing is deferred


class MovedKeyframes(NamedTuple):
    """Keyframes of a run that its loops or fixes have moved.

    Parameters
    ----------
    stamps_ns : (K,) int64
        [ns].
    T_odom_imu, T_map_imu : (K, 4, 4) float64
        As the odometry gave them, and as the graph has them.
    """

    stamps_ns: NDArray[np.int64]
    T_odom_imu: Array
    T_map_imu: Array


class SlamSession:
    """Picks keyframes out of a run and gives them to a back-end.

    Parameters
    ----------
    folder : Path
        Where the keyframes and the graph's files go: the run's folder.
    config : RunConfig
    poses_given : bool
        Whether the poses are another system's: clouds that come slowly are then its keyframes.
    chosen_ns : (N,) int64, optional
        Times of the clouds that the other system chose as keyframes, sorted [ns].
    kept : bool
        Whether the folder stays, and the graph's files are written into it.
    antenna_imu : (3,) float64, optional
        The satellite receiver's antenna in the imu frame, where the recording tells it [m].
    keyframes : int, optional
        Keyframes of a run that is taken up again: as many are in the folder's store already.
    """

    def __init__(
        self,
        folder: Path,
        config: RunConfig,
        *,
        poses_given: bool = False,
        chosen_ns: Stamps | None = None,
        kept: bool = True,
        antenna_imu: Array | None = None,
        keyframes: int | None = None,
    ) -> None:
        config = replace(config, slam=replace(config.slam, loop_every=1, loop_pieces=_ALL)) if poses_given else config
        self.events: list[Event] = []
        self._folder = folder if kept else None
        self._given = GivenPoses(config.loops) if poses_given else None
        self._selector = KeyframeSelector(config.slam, poses_given=poses_given, chosen_ns=chosen_ns)
        path = folder / KEYFRAMES
        self.store = KeyframeStore.create(path) if keyframes is None else KeyframeStore.cut(path, keyframes)
        self.fixes = GnssFactors(config, antenna_imu)
        self.back_end = BackEnd(config, self.store, fixes=self.fixes)

    def observe(self, message: Message) -> None:
        """Take a message of the recording, before the odometry gets it."""
        if isinstance(message, ImuBatch):
            self._selector.observe(message)
        elif isinstance(message, GnssFix):
            self.fixes.observe(message)

    def observe_speeds(self, speeds: WheelSpeeds) -> None:
        """Take all speeds of wheels or legs, before the recording begins."""
        self.back_end.wheels.observe(speeds)

    def add(self, results: Sequence[ScanResult]) -> None:
        """Take the results that a message made ready."""
        for result in results:
            if result.matched:
                self.fixes.track.append(result.end_ns, result.T_odom_imu)
            keyframe = self._selector.add(result)
            if keyframe is None:
                continue
            if self._given is not None:
                self._given.add(keyframe)
            self.events += self.back_end.add(keyframe).events

    def finish(self, results: Sequence[ScanResult]) -> None:
        """Take the last results, and look for the loops that still wait to be looked for."""
        self.add(results)
        update = self.back_end.finish()
        self.events += update.events if update is not None else ()
        self.events += (*self.fixes.events(), *self.back_end.wheels.events())

    def snapshot(self) -> Snapshot:
        """Return what the next results come to, the number of keyframes in the store with it; the store is settled."""
        self.store.settle()
        self.back_end.settle()
        return {
            "keyframes": len(self.store),
            "events": self.events,
            "given": None if self._given is None else self._given.snapshot(),
            "selector": self._selector.snapshot(),
            "back_end": self.back_end.snapshot(),
        }

    def restore(self, snapshot: Snapshot) -> None:
        """Take up the state of another one that was made with the same arguments, over its store.

        Raises
        ------
        DataError
            It is none of such a session.
        """
        require(self, snapshot, _STATE)
        self.events = snapshot["events"]
        if (self._given is None) != (snapshot["given"] is None):
            raise DataError("the state of a back-end is one of other poses")
        if self._given is not None:
            self._given.restored(snapshot["given"], self.store)
        self._selector.restore(snapshot["selector"])
        self.back_end.restore(snapshot["back_end"])

    def release(self) -> None:
        """Let go of the files; a second call changes nothing."""
        self.store.close()
        self.back_end.release()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the result is not to be trusted although nothing else says so."""
        return self._given.doubts if self._given is not None else ()

    def moved(self) -> MovedKeyframes | None:
        """Return where the keyframes lie after all; None where nothing but odometry holds them."""
        if not self.back_end.moves or len(self.store) == 0:
            return None
        return MovedKeyframes(
            stamps_ns=self.back_end.chain.stamps_ns,
            T_odom_imu=self.back_end.chain.T_odom_imu,
            T_map_imu=self.back_end.T_map_imu,
        )

    def close(self) -> GraphAccount:
        """Release the store, write the graph's files and return the account."""
        self.release()
        files = write_graph_files(self._folder, self.back_end) if self._folder is not None and len(self.store) else ()
        return self.back_end.account(files=files)


class NoSlam:
    """The back-end of a run that has none.

    Parameters
    ----------
    doubts : tuple of str
        Why the result is not to be trusted for want of it.
    """

    events: tuple[Event, ...] = ()

    def __init__(self, doubts: tuple[str, ...] = ()) -> None:
        self.doubts = doubts

    def observe(self, message: Message) -> None:
        """Take nothing."""

    def observe_speeds(self, speeds: WheelSpeeds) -> None:
        """Take nothing."""

    def snapshot(self) -> Snapshot:
        """Return nothing: nothing depends on it."""
        return {}

    def restore(self, snapshot: Snapshot) -> None:
        """Take up nothing."""
        require(self, snapshot, {})

    def add(self, results: Sequence[ScanResult]) -> None:
        """Take nothing."""

    def finish(self, results: Sequence[ScanResult]) -> None:
        """Take nothing."""

    def moved(self) -> MovedKeyframes | None:
        """Return None: odometry has the last word."""
        return None

    def close(self) -> GraphAccount | None:
        """Return None: there is no graph."""
        return None
