"""Each case in a child of a warm process, with limits: what it was, what became of it, and what it cost."""

from __future__ import annotations

import contextlib
import io
import os
import random
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tests.fuzz.targets import Target, place, sound

__all__ = ["Case", "Outcome", "choose", "run_case"]

MAX_SECONDS = 5.0  # of processor time
_SLOWER = 8.0  # times its sound seed: alone on a core, where no seed takes over 0.6 s, that is less than `MAX_SECONDS`
_CUT = 20.0  # seconds of processor time at which a case is ended
MAX_BYTES = 1_000_000_000  # of resident memory
_GRACE = 200_000_000  # bytes above, at which the child is ended
_MAX_IDLE = 30.0  # seconds in which a child takes no processor time: it waits for ever
_MAX_LINE = 2_000
_ON_TERMINAL = "\x7f\u061c\u200e\u200f\u2028\u2029\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
TAKEN, REFUSED, FOREIGN, SPOKE = 0, 2, 3, 4
_MEMORY = Path("/dev/shm")


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
    """Run one case in a child of its own.

    Beside other work a second of processor time may do a fifth of what it does alone. Where a case takes too long, its
    sound seed is therefore read at once as well: a case that takes a few times as long as that does not hang.
    """
    found = _run_once(case, seeds)
    if found.fault != _slowness(found.seconds):
        return found
    usual = min(_run_once(Case(case.number, case.seed, sound(case.target)), seeds).seconds for _ in range(2))
    return replace(found, fault="") if found.seconds <= _SLOWER * usual else found


def _run_once(case: Case, seeds: Path) -> Outcome:
    """Run one case in a child of its own; the file is spoilt there as well."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir=_MEMORY if _MEMORY.is_dir() else None))
    temporary, report = folder / "tmp", folder / "report.txt"
    temporary.mkdir()
    listening, held = os.pipe()
    try:
        child = os.fork()
        if child == 0:
            os.close(listening)
            os._exit(_child(case, seeds, folder, temporary, report))
        os.close(held)
        kept = _watch(child, listening)
        _, status, usage = os.wait4(child, 0)
        detail = report.read_text(errors="replace") if report.is_file() else ""
        left = next((path.name for path in temporary.iterdir()), "")
    finally:
        os.close(listening)
        shutil.rmtree(folder, ignore_errors=True)
    seconds, megabytes = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3
    code = os.waitstatus_to_exitcode(status)
    fault = kept or _fault(code, seconds, megabytes, left)
    return Outcome(case.number, case.target.name, fault, detail, seconds, megabytes, code == TAKEN)


def _fault(code: int, seconds: float, megabytes: float, left: str) -> str:
    if megabytes * 1e6 > MAX_BYTES:
        return f"took {megabytes:.0f} MB"
    if code < 0 and -code != signal.SIGXCPU:
        return f"ended by {signal.Signals(-code).name}"
    if seconds > MAX_SECONDS:
        return _slowness(seconds)
    if code not in (TAKEN, REFUSED):
        return "a word that must not reach a terminal" if code == SPOKE else "an exception that is not ours"
    return f"left {left} in TMPDIR" if left else ""


def _slowness(seconds: float) -> str:
    return f"took {seconds:.1f} s"


def _watch(child: int, listening: int) -> str:
    """Return when a child has ended, or ended it: it holds the other end of a pipe."""
    statm, page = Path(f"/proc/{child}/statm"), resource.getpagesize()
    poll, fault, spent, last = select.poll(), "", -1.0, time.monotonic()
    poll.register(listening, select.POLLIN)
    while not poll.poll(30):
        with contextlib.suppress(OSError, IndexError):  # gone by now, or no Linux
            if int(statm.read_text().split()[1]) * page > MAX_BYTES + _GRACE:
                fault = f"took over {(MAX_BYTES + _GRACE) / 1e6:.0f} MB"
        if (now := _processor_seconds(child)) > spent:  # however long a busy machine lets it wait
            spent, last = now, time.monotonic()
        elif time.monotonic() > last + _MAX_IDLE:
            fault = f"did nothing for {_MAX_IDLE:.0f} s"
        if fault:
            os.kill(child, signal.SIGKILL)
            return fault
    return ""


def _processor_seconds(child: int) -> float:
    """Return what a child has used so far [s]; 0 where the system does not tell."""
    try:
        words = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _child(case: Case, seeds: Path, folder: Path, temporary: Path, report: Path) -> int:
    before = time.process_time()
    try:
        path = place(case.target, seeds, folder, random.Random(case.seed + "/spoil"))
    except BaseException:
        report.write_text("the spoiling itself failed\n" + traceback.format_exc())
        return FOREIGN
    most = int(_CUT + time.process_time() - before) + 2
    resource.setrlimit(resource.RLIMIT_CPU, (most, most + 1))
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
    if not taken:
        report.write_text(raw[-4000:], errors="replace")
    if word := _unspeakable(raw):
        report.write_text(word, errors="replace")
        return SPOKE
    return TAKEN if taken else REFUSED


def _unspeakable(raw: str) -> str:
    """Return what must not reach a terminal of what was said."""
    bad = [c for c in raw if (ord(c) < 32 and c not in "\n\r\t") or 0x80 <= ord(c) < 0xA0 or c in _ON_TERMINAL]
    longest = max((line for line in raw.split("\n") if not line.startswith(("{", "["))), key=len, default="")
    if not bad and len(longest) <= _MAX_LINE:
        return ""
    return f"{bad[:3]!r} in, or {len(longest)} characters: {longest[:300]!r}"


class _Console(io.TextIOWrapper):
    """What a command would print to."""

    def isatty(self) -> bool:
        return False


if sys.platform == "win32":  # pragma: no cover
    raise SystemExit("the fuzzer needs fork and resource limits; run it on Linux or macOS")
