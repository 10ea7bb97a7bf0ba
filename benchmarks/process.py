"""One child process and what it cost."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Cost", "attempt", "measure", "version_of"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a command took: wall and processor seconds, and its largest resident memory [MB]."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def measure(command: Sequence[str], *, log: Path, environment: dict[str, str], cores: int) -> Cost:
    """Run a command on at most `cores` cores, output into `log`; a failure ends the benchmark with the tail of that."""
    cost = attempt(command, log=log, environment=environment, cores=cores)
    if cost is None:
        tail = "\n".join(log.read_text(errors="replace").splitlines()[-15:])
        raise SystemExit(f"{' '.join(command)}\nfailed:\n{tail}")
    return cost


def attempt(
    command: Sequence[str], *, log: Path, environment: dict[str, str], cores: int, limit: float | None = None
) -> Cost | None:
    """Run a command as `measure` does, at most `limit` seconds; None where it fails or takes longer."""
    allowed = sorted(os.sched_getaffinity(0))[:cores]
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w") as out:
        start = time.perf_counter()
        child = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            env={**os.environ, **environment, "OMP_NUM_THREADS": str(cores)},
            preexec_fn=lambda: os.sched_setaffinity(0, allowed),
        )
        timer = None if limit is None else threading.Timer(limit, child.kill)
        if timer is not None:
            timer.start()
        _, status, usage = os.wait4(child.pid, 0)
        wall = time.perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
        if timer is not None:
            timer.cancel()
    if child.returncode != 0:
        return None
    return Cost(wall_s=wall, cpu_s=usage.ru_utime + usage.ru_stime, peak_mb=usage.ru_maxrss / 1024.0)


def version_of(package: str, bin_folder: Path) -> str:
    """Return the version of a distribution in the environment that the programs come from."""
    ask = f"import importlib.metadata; print(importlib.metadata.version({package!r}))"
    done = subprocess.run([bin_folder / "python", "-c", ask], capture_output=True, text=True, check=True)
    return done.stdout.strip()
