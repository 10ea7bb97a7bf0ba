"""Follow README and documents word for word: every `heliograph` line of their shell blocks, as typed.

    python .ci/follow.py HELIOGRAPH [DOCUMENT ...]

HELIOGRAPH is the program of a fresh environment. The files that the documents speak of (drive.bag, truth.tum, OUT ...)
are made once from a short simulated recording. It prints a table document x section x command x outcome, and fails if
a line fails.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = (
    "README.md", "docs/quickstart.md", "docs/lesson.md", "docs/choosing.md", "docs/tuning.md", "docs/failures.md",
    "docs/from_fast_lio2.md", "docs/from_lio_sam.md", "docs/from_kiss_icp.md",
)  # fmt: skip
# Lines that are not typed here, and why.
NOT_TYPED = {
    r"^heliograph lab": "waits for a browser; tests/system/test_lab_page.py opens it",
    r"^heliograph view \S+$|--view\b": "opens a window; tests/unit/viewer reads its file",
    r"^heliograph simulate (warehouse|long-tunnel)": "minutes long; the tests simulate parts of them",
    r"--explain \d+": "the short recording has no loop; tests/unit/cli/test_loops_command.py explains one",
    r"^heliograph demo": "has a step of its own in .ci/run",
}
PARAMS = "mapping:\n  extrinsic_T: [ 0.0, 0.0, 0.0 ]\n  extrinsic_R: [ 1, 0, 0, 0, 1, 0, 0, 0, 1 ]\n"


def lines_of(document: str) -> list[tuple[str, str]]:
    """Return section and line of each command of the program in a document's shell blocks."""
    found, section, inside = [], "", ""
    for line in (ROOT / document).read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            inside = "" if inside else line[3:] or "text"
        elif not inside and line.startswith("#"):
            section = line.lstrip("# ")
        elif inside == "sh" and line.startswith("heliograph "):
            found.append((section, shlex.join(shlex.split(line, comments=True))))
    return found


def typed(program: str, line: str, folder: Path) -> tuple[str, str]:
    """Type one line; return the outcome in a word and its first complaint."""
    words = shlex.split(line)
    began = time.monotonic()
    done = subprocess.run([program, *words[1:]], cwd=folder, capture_output=True, text=True, timeout=900, check=False)
    took = f"{time.monotonic() - began:.0f} s"
    if done.returncode == 0:
        return f"done in {took}", ""
    complaint = next((row for row in done.stderr.splitlines() if row.startswith("error")), done.stderr[-200:])
    return f"exit {done.returncode}", complaint


def prepared(program: str, folder: Path) -> None:
    """Make the files that the documents speak of."""

    def call(*words: str) -> None:
        subprocess.run([program, *words], cwd=folder, check=True, capture_output=True)

    call("simulate", "room", "--duration", "6", "-o", "made", "-q")
    for name in ("drive.bag", "drive.mcap", "drive2.bag", "still.bag", "room.bag", "today.mcap", "recording.mcap"):
        shutil.copy(folder / "made" / "recording.mcap", folder / name)
    shutil.copytree(folder / "made", folder / "DATA")
    shutil.copy(folder / "made" / "groundtruth_imu.tum", folder / "truth.tum")
    (folder / "params.yaml").write_text(PARAMS)
    for name in ("sim", "tunnel"):
        shutil.copytree(folder / "made", folder / name)
    for name in ("OUT", "OTHER"):
        call("run", "drive.mcap", "-o", name, "-q", "--map-format", "pcd")
    for name in ("target.pcd", "source.pcd"):
        shutil.copy(folder / "OUT" / "map.pcd", folder / name)
    shutil.copy(folder / "OUT" / "graph.g2o", folder / "graph.g2o")


def main() -> int:
    """Follow them all."""
    program, chosen = str(Path(sys.argv[1]).absolute()), sys.argv[2:] or DOCUMENTS
    failed = 0
    with tempfile.TemporaryDirectory() as work:
        prepared(program, Path(work))
        for document in chosen:
            folder = Path(work)
            for result in (*folder.glob("*_calibration"), *folder.glob("out")):
                shutil.rmtree(result)  # of the document before
            for section, line in lines_of(document):
                reason = next((why for pattern, why in NOT_TYPED.items() if re.search(pattern, line)), None)
                outcome, complaint = ("not typed", reason) if reason else typed(program, line, folder)
                failed += outcome.startswith("exit")
                print(f"{document} | {section} | {line} | {outcome}{f': {complaint}' if complaint else ''}", flush=True)
    print(f"{failed} lines failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
