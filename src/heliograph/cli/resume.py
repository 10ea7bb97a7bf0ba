"""`heliograph run --resume`: what there is to go on from, and whether it is of this recording and these settings."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.cli.terminal import plain
from heliograph.errors import FormatError
from heliograph.guard.account import read_account

if TYPE_CHECKING:
    from heliograph.checkpoint import Checkpoints
    from heliograph.config import RunConfig

__all__ = ["checkpoints_of", "finished_run", "is_run", "taken_up"]

_NO_MATTER = ("threads", "output.checkpoint_interval")  # settings that change no bit of a result


def finished_run(folder: Path) -> dict[str, Any] | None:
    """Return the account of a folder's run where that has come to its end, and say so; else None."""
    facts = _account(folder)
    if facts is None or "scans" not in facts or facts.get("interrupted") or facts.get("failure"):
        return None
    text = f"the run in {folder} has come to its end: there is nothing to resume; --overwrite begins it anew"
    print(plain(text), file=sys.stderr)
    return facts


def is_run(folder: Path) -> bool:
    """Return whether a folder is that of a run, finished or not."""
    return _account(folder) is not None


def taken_up(checkpoints: Checkpoints) -> bool:
    """Read the checkpoint of a run; where there is none, say that the run begins anew, and return False.

    Raises
    ------
    FormatError
        It is damaged.
    ConfigError
        It is of another recording, setting or version.
    """
    if checkpoints.open():
        return True
    print(plain(f"{checkpoints.folder} holds no checkpoint to resume from: the run begins anew"), file=sys.stderr)
    return False


def checkpoints_of(folder: Path, config: RunConfig, inputs: Sequence[Mapping[str, Any]]) -> Checkpoints:
    """Return where a run keeps its checkpoints, with what must be the same for it to go on.

    Parameters
    ----------
    folder : Path
    config : RunConfig
    inputs : sequence of mappings
        Names, sizes and checksums of the recording's files, of `hashed_inputs`.
    """
    from dataclasses import asdict

    from heliograph import _core
    from heliograph.checkpoint import Checkpoints
    from heliograph.io.files.poses import is_pose_file
    from heliograph.output.facts import versions
    from heliograph.output.manifest import hashed_files

    settings = {name: repr(value) for name, value in _flat(asdict(config)).items() if name not in _NO_MATTER}
    named = (config.gnss.file, config.wheels.file, config.input.extrinsic, config.odometry)
    beside = [Path(name) for name in named if name and (name != config.odometry or is_pose_file(name))]
    identity = {
        "version": f"{versions()['heliograph']} ({_core.instruction_set()})",
        "recording": {str(file["name"]): _told(file) for file in inputs},
        "settings": settings,
        "files": {file.pop("name"): _told(file) for file in hashed_files(beside)},
    }
    return Checkpoints(folder, config.output.checkpoint_interval, identity)


def _account(folder: Path) -> dict[str, Any] | None:
    try:
        return read_account(folder)
    except FormatError:
        return None


def _flat(settings: dict[str, Any], section: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in settings.items():
        found |= _flat(value, f"{section}{name}.") if isinstance(value, dict) else {f"{section}{name}": value}
    return found


def _told(file: Mapping[str, Any]) -> str:
    """Return size and checksum of a file, short enough to be shown."""
    checksum = next((str(value)[:16] for name, value in file.items() if name.endswith("sha256")), "no checksum")
    return f"{file['bytes']} bytes, {checksum}"
