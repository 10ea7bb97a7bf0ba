"""Checkpoints of a run: all that the next message's result depends on, every so often, for `run --resume`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from heliograph.atomic import output_errors
from heliograph.checks.records import Finding, Number
from heliograph.checks.surfaces import Thickness
from heliograph.cloud import LineRule
from heliograph.data import (
    Event,
    GnssFix,
    ImuBatch,
    ImuClock,
    ImuNoise,
    Message,
    NavState,
    OnlineCalibration,
    Rig,
    Scan,
    ScanResult,
    SensorRepair,
    StartAccount,
    Trajectory,
)
from heliograph.errors import ConfigError
from heliograph.imu import ImuPath
from heliograph.maps import MapCells, Sight
from heliograph.odometry.filter.calibration_gate import CalibrationGate
from heliograph.odometry.filter.map_window import WindowMark
from heliograph.odometry.filter.matching import AdaptiveNoise
from heliograph.odometry.filter.unsteadiness import Unsteadiness
from heliograph.odometry.filter.wheels import SpeedTrust
from heliograph.odometry.sequencer import Packet
from heliograph.output.blind_spans import BlindSpan
from heliograph.output.raw_files import CHECKPOINT, CHECKPOINT_STATE, remove_checkpoint
from heliograph.registration import FeatureNoise, ResidualDistribution
from heliograph.slam.gnss.evidence import Judgement, Placement
from heliograph.slam.gnss.fixes import FixesInForce
from heliograph.slam.loop_search import Candidate
from heliograph.slam.loops import LedgerEntry, LoopDecision, LoopEvidence, LoopStart
from heliograph.snapshots import PART, Part, Snapshot, read_snapshot, require, write_snapshot

__all__ = ["RECORDS", "Checkpoints", "Keeper"]

_FORMAT = 1
_SHARE = 0.05  # of the time that writing checkpoints may take; where it takes more, they come less often

_PARTS = ("account", "odometry", "slam")
_RUN_STATE = {
    "messages": int, "rig": Rig, "found": [Event], "repairs": [SensorRepair], "watchful": bool,
    **dict.fromkeys(_PARTS, PART),
}  # fmt: skip

RECORDS: tuple[type, ...] = (
    AdaptiveNoise, BlindSpan, CalibrationGate, Candidate, Event, FeatureNoise, Finding, FixesInForce, GnssFix, ImuBatch,
    ImuClock, ImuNoise, ImuPath, Judgement, LedgerEntry, LineRule, LoopDecision, LoopEvidence, LoopStart, MapCells,
    NavState, Number, OnlineCalibration, Packet, Placement, ResidualDistribution, Rig, Scan, ScanResult, SensorRepair,
    Sight, SpeedTrust, StartAccount, Thickness, Trajectory, Unsteadiness, WindowMark,
)  # fmt: skip
"""Records that the state of a run consists of; a file that names another is none."""


class Checkpoints:
    """The checkpoint of one run: written every so often, each in place of the one before.

    Parameters
    ----------
    folder : Path
        The run's folder.
    interval : float
        Time of the recording from one to the next [s]; 0: none are written.
    identity : mapping
        What must be the same for a run to go on: recording, settings, versions; text or mappings of text by name.
    """

    def __init__(self, folder: Path, interval: float, identity: Mapping[str, Any]) -> None:
        self.folder = folder
        self.path = folder / CHECKPOINT / CHECKPOINT_STATE
        self.identity = dict(identity)
        self._interval_ns = round(1e9 * interval)
        self._last_ns: int | None = None
        self._not_before = 0.0
        self.found: Snapshot | None = None
        """State of the run to go on from."""

    def open(self) -> bool:
        """Read the folder's checkpoint into `found`; return whether there is one.

        Raises
        ------
        FormatError
            It is damaged.
        ConfigError
            The run was of another recording, with other settings, or of another version.
        """
        if not self.path.is_file():
            return False
        _, self.found = read_snapshot(self.path, RECORDS, self._check)
        return True

    def due(self, stamp_ns: int) -> bool:
        """Whether the next one is to be written, where the recording has come to ``stamp_ns``."""
        if self._interval_ns == 0:
            return False
        if self._last_ns is None:
            self._last_ns = stamp_ns
        return stamp_ns - self._last_ns >= self._interval_ns and time.monotonic() >= self._not_before

    def save(self, snapshot: Snapshot, stamp_ns: int) -> None:
        """Write a checkpoint.

        Raises
        ------
        OutputError
            It cannot be written; the one before stays.
        """
        if self._interval_ns == 0:
            return
        began = time.monotonic()
        with output_errors(self.path):
            self.path.parent.mkdir(exist_ok=True)
        about = {"format": _FORMAT, "identity": self.identity}
        write_snapshot(self.path, about, snapshot, RECORDS)
        ended = time.monotonic()
        self._last_ns, self._not_before = stamp_ns, ended + (ended - began) / _SHARE

    def forget(self) -> None:
        """Remove the checkpoint: what it goes on from is not there any more."""
        self.found, self._last_ns = None, None
        remove_checkpoint(self.folder)

    def _check(self, about: Mapping[str, Any]) -> None:
        folder = self.folder
        if about.get("format") != _FORMAT:
            raise ConfigError(
                f"{folder} was begun by another version of Heliograph and cannot be resumed; nothing was changed: "
                "resume it with that version, or run anew with --overwrite"
            )
        for name, what in (("version", "begun by"), ("recording", "of"), ("settings", "begun with"), ("files", "of")):
            then, now = about["identity"].get(name), self.identity.get(name)
            if then != now:
                raise ConfigError(
                    f"{folder} cannot be resumed: it was {what} another {_SAID[name]} ({_difference(then, now)}); "
                    "nothing was changed: resume it with what it was begun with, or run anew with --overwrite"
                )


_SAID = {"version": "version", "recording": "recording", "settings": "setting", "files": "file beside the recording"}


def _difference(then: object, now: object) -> str:
    """Return the first thing in which two identities differ."""
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        for name in (*then, *now):
            if then.get(name) != now.get(name):
                return f"{name}: {then.get(name, 'none')} then, {now.get(name, 'none')} now"
    return f"{then} then, {now} now"


class Keeper:
    """Keeps the state of one attempt at a run, and brings it back.

    Parameters
    ----------
    checkpoints : Checkpoints or None
        None: nothing is kept.
    repairs : sequence of SensorRepair
        How the recording is mended in this attempt.
    watchful : bool
        Whether the attempt ends where its data contradict each other.
    """

    def __init__(self, checkpoints: Checkpoints | None, repairs: Sequence[SensorRepair], *, watchful: bool) -> None:
        self._checkpoints, self._repairs, self.watchful = checkpoints, tuple(repairs), watchful
        self._found = None if checkpoints is None else checkpoints.found
        if self._found is not None:
            require(self, self._found, _RUN_STATE)
        self.messages: int = 0 if self._found is None else self._found["messages"]
        """Messages of the recording that are done."""
        self._begun = self._found is not None  # before the first result there is nothing worth to go on from
        self._parts: tuple[Part, ...] = ()
        self._mounting: tuple[Rig, tuple[Event, ...]] | None = None

    @property
    def mounting(self) -> tuple[Rig, tuple[Event, ...]] | None:
        """The rig of the run that is taken up, with what was said of it; None for a new one."""
        return None if self._found is None else (self._found["rig"], tuple(self._found["found"]))

    @property
    def keyframes(self) -> int | None:
        """Keyframes of the run that is taken up; None for a new one, or one that has no back-end."""
        return None if self._found is None else self._found["slam"].get("keyframes")

    def anew(self, repairs: Sequence[SensorRepair]) -> Keeper:
        """Return the keeper of the next attempt; what was kept of this one is gone."""
        if self._checkpoints is not None:
            self._checkpoints.forget()
        return Keeper(self._checkpoints, repairs, watchful=False)

    def follow(self, account: Part, odometry: object, slam: Part, rig: Rig, found: tuple[Event, ...]) -> None:
        """Take the parts of the run; those of one that is taken up are brought to where it was.

        Raises
        ------
        DataError
            The checkpoint is of other parts.
        """
        self._mounting = rig, found
        if not isinstance(odometry, Part):
            return  # one of the user's own, which cannot be taken up again
        self._parts = account, odometry, slam
        if self._found is not None:
            for name, part in zip(_PARTS, self._parts, strict=True):
                part.restore(self._found[name])

    def passed(self, message: Message, results: Sequence[ScanResult], *, interrupted: bool) -> None:
        """Take note that a message is done; write a checkpoint where one is due, or where the run is to end here."""
        self.messages += 1
        self._begun = self._begun or len(results) > 0
        if self._checkpoints is None or not self._parts or self._mounting is None:
            return
        if (
            not self._begun
            or getattr(self._parts[1], "between", False)
            or not (interrupted or self._checkpoints.due(message.received_ns))
        ):
            return
        rig, found = self._mounting
        state = {
            "messages": self.messages, "rig": rig, "found": found, "repairs": self._repairs, "watchful": self.watchful,
            **{name: part.snapshot() for name, part in zip(_PARTS, self._parts, strict=True)},
        }  # fmt: skip
        self._checkpoints.save(state, message.received_ns)
