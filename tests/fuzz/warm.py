"""A process that has everything at hand, so that a child of it has only its case to do."""

from __future__ import annotations

import contextlib
import gc
import importlib
import io
import os
import pkgutil
import random
import shutil
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import typer.main
from tests.fuzz.containers import warm_bombs
from tests.fuzz.runner import Case, run_case
from tests.fuzz.targets import Target, place, sound

import heliograph

__all__ = ["warm_up"]


def warm_up(targets: Sequence[Target], seeds: Path) -> list[str]:
    """Import all there is and read every sound seed once; return what is wrong with a seed.

    A target that starts threads is read in a child only: a child has but one thread of its parent's, and would wait
    for the others.
    """
    for module in pkgutil.walk_packages(heliograph.__path__, "heliograph."):
        with contextlib.suppress(ImportError):  # of an extra that is not installed
            importlib.import_module(module.name)
    typer.main.get_command = lru_cache(typer.main.get_command)  # the commands, made once and not for every case
    warm_bombs()
    wrong, seen = [], set[object]()
    for target in targets:
        healthy = sound(target)
        if not target.threads and target.warms not in seen:
            seen.add(target.warms)
            _read(healthy, seeds)
        outcome = run_case(Case(0, "sound", healthy), seeds)
        if outcome.fault or not outcome.taken:
            wrong.append(f"the sound seed of '{target.name}' was not read: {outcome.fault} {outcome.detail}")
    tasks = Path("/proc/self/task")
    assert not tasks.is_dir() or len([*tasks.iterdir()]) == 1, "a target that starts threads does not say so"
    gc.collect()
    gc.freeze()  # a child's collections leave these pages shared
    return wrong


def _read(target: Target, seeds: Path) -> None:
    folder, here = Path(tempfile.mkdtemp(prefix="fuzz-")), Path.cwd()
    try:
        path = place(target, seeds, folder, random.Random(1))
        os.chdir(folder)
        said = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), contextlib.suppress(Exception):
            target.read(path)
    finally:
        os.chdir(here)
        shutil.rmtree(folder, ignore_errors=True)
