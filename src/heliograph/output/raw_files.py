"""The files of a run as they were written while it went on, kept beside those that its end has made of them.

A run that was ended early has finished its files: poses moved into the map's frame, submaps gone. Whoever resumes it
goes on from the rows as they came, so they stay in the folder of the checkpoint until a run has come to its end.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from heliograph.atomic import output_errors

__all__ = ["CHECKPOINT", "CHECKPOINT_STATE", "bring_back", "drop_raw", "keep_raw", "remove_checkpoint"]

CHECKPOINT, CHECKPOINT_STATE = "checkpoint", "state.npz"
"""Folder of a run that is still to be resumed, and its file."""


def keep_raw(folder: Path, names: Iterable[str]) -> None:
    """Give files a second name in the checkpoint's folder, where there is a checkpoint; nothing is copied.

    Who finishes a file puts another in its place, and leaves the one under the second name as it is.
    """
    kept = folder / CHECKPOINT
    if not (kept / CHECKPOINT_STATE).is_file():
        return
    for name in names:
        if (folder / name).is_file():
            (kept / name).unlink(missing_ok=True)
            try:
                os.link(folder / name, kept / name)
            except OSError:  # a file system without second names
                with output_errors(kept / name):
                    shutil.copyfile(folder / name, kept / name)


def bring_back(folder: Path, names: Iterable[str]) -> None:
    """Put what `keep_raw` kept in place of what the run's end has made of it."""
    for name in names:
        kept = folder / CHECKPOINT / name
        if kept.is_file():
            with output_errors(folder / name):
                kept.replace(folder / name)


def drop_raw(folder: Path, name: str) -> None:
    """Give up a kept file, whose room is needed; without it nothing can be resumed."""
    with suppress(OSError):
        (folder / CHECKPOINT / CHECKPOINT_STATE).unlink(missing_ok=True)
        (folder / CHECKPOINT / name).unlink(missing_ok=True)


def remove_checkpoint(folder: Path) -> None:
    """Remove what a run's folder holds to be resumed from; the state first, without which the rest is nothing."""
    with suppress(OSError):
        (folder / CHECKPOINT / CHECKPOINT_STATE).unlink(missing_ok=True)
    if (folder / CHECKPOINT).is_dir():
        shutil.rmtree(folder / CHECKPOINT, ignore_errors=True)
