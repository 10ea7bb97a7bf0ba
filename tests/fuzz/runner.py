"""Each case in a child with limits: what it was, what became of it, and what it cost."""

from __future__ import annotations

import contextlib
import io
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.targets import Target, place

__all__ = ["Case", "Outcome", "choose", "run_case"]

MAX_SECONDS = 5.0  # of processor time
MAX_BYTES = 1_000_000_000  # of resident memory
_HARD_SECONDS, _HARD_BYTES = 12, 4_000_000_000  # beyond, the child is ended
_MAX_WALL = 120.0
_MAX_LINE = 2_000
TAKEN, REFUSED, FOREIGN, SPOKE = 0, 2, 3, 4


@dataclass(frozen=True)
class Case:
    """A seed of chance and what it spoils."""

    number: int
    seed: str
    target: Target


@dataclass(frozen=True)
class Outcome:
    """``fault`` is empty where all was as it should be."""

    number: int
    name: str
    fault: str
    detail: str
    seconds: float
    megabytes: float
    taken: bool


def choose(targets: Sequence[Target], cases: int, seed: int, first: int = 0, step: int = 1) -> Iterator[Case]:
    """Yield every ``step``-th case; each depends on its own number alone."""
    weights = [target.weight for target in targets]
    for number in range(first, cases, step):
        chance = f"{seed}/{number}"
        yield Case(number, chance, random.Random(chance).choices(targets, weights)[0])


def run_case(case: Case, seeds: Path) -> Outcome:
    """Run one case in a child of its own."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        temporary = folder / "tmp"
        temporary.mkdir()
        path = place(case.target, seeds, folder, random.Random(case.seed + "/spoil"))
        return _in_child(case, path, folder, temporary)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _in_child(case: Case, path: Path, folder: Path, temporary: Path) -> Outcome:
    report = folder / "report.txt"
    child = os.fork()
    if child == 0:
        os._exit(_child(case, path, temporary, report))
    status, usage = _wait(child)
    seconds, megabytes = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3
    detail = report.read_text(errors="replace") if report.is_file() else ""
    code = os.waitstatus_to_exitcode(status)
    fault = ""
    if code < 0:
        fault = f"ended by {signal.Signals(-code).name}"
    elif code not in (TAKEN, REFUSED):
        fault = "a word that must not reach a terminal" if code == SPOKE else "an exception that is not ours"
    elif seconds > MAX_SECONDS:
        fault = f"took {seconds:.1f} s"
    elif megabytes * 1e6 > MAX_BYTES:
        fault = f"took {megabytes:.0f} MB"
    elif any(temporary.iterdir()):
        fault = f"left {next(temporary.iterdir()).name} in TMPDIR"
    return Outcome(case.number, case.target.name, fault, detail, seconds, megabytes, code == TAKEN)


def _wait(child: int) -> tuple[int, resource.struct_rusage]:
    end = time.monotonic() + _MAX_WALL
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return status, usage
        if time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            end += 1e9
        time.sleep(0.002)


def _child(case: Case, path: Path, temporary: Path, report: Path) -> int:
    resource.setrlimit(resource.RLIMIT_CPU, (_HARD_SECONDS, _HARD_SECONDS + 1))
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + _HARD_BYTES, held + _HARD_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.environ["TMPDIR"] = str(temporary)
    tempfile.tempdir = None
    os.chdir(path.parent)
    said = _Console(io.BytesIO(), write_through=True, encoding="utf-8")
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            taken = case.target.read(path)
    except BaseException:
        text = said.buffer.getvalue().decode(errors="replace")  # type: ignore[attr-defined]
        report.write_text(traceback.format_exc() + "\n" + text[-4000:], errors="replace")
        return FOREIGN
    raw = said.buffer.getvalue().decode(errors="replace")  # type: ignore[attr-defined]
    bad = [
        c for c in raw if (ord(c) < 32 and c not in "\n\r\t") or c in "\x7f\u202a\u202b\u202d\u202e\u2066\u2067\u2068"
    ]
    longest = max((line for line in raw.splitlines() if not line.startswith(("{", "["))), key=len, default="")
    if bad or len(longest) > _MAX_LINE:
        report.write_text(f"{bad[:3]!r} in, or {len(longest)} characters: {longest[:300]!r}")
        return SPOKE
    return TAKEN if taken else REFUSED


class _Console(io.TextIOWrapper):
    """What a command would print to."""

    def isatty(self) -> bool:
        return False


if sys.platform == "win32":  # pragma: no cover
    raise SystemExit("the fuzzer needs fork and resource limits; run it on Linux or macOS")
