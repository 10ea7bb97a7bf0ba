"""The report of a long run in a browser: its size, and how long until it can be read, and its map be turned."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.browser import CHROMIUM, Browser

from heliograph.sim import SCENARIOS
from heliograph.sim.write import write_recording

__all__ = ["measure_report_page", "report_page_section"]

_SECONDS, _SEED = 600.0, 200
_MAX_MB, _MAX_S = 15.0, 3.0
_EYE = "document.querySelector('#scene-view').dataset.eye"


def measure_report_page(
    work: Path, command: Path, *, runs: int, folder: Path | None = None
) -> Iterator[dict[str, Any]]:
    """Yield a row an opening of the report of a run of ten minutes with loops and fixes; none without a Chromium.

    Parameters
    ----------
    work : Path
        Scratch folder.
    command : Path
        The program `heliograph`.
    runs : int
        How often it is opened.
    folder : Path, optional
        Another run's folder.
    """
    if CHROMIUM is None:
        return
    folder = folder or _long_run(work, command)
    facts = json.loads((folder / "run.json").read_text())
    page = folder / "report.html"
    common = {
        "benchmark": "report-page",
        "scans": facts["scans"],
        "minutes": facts["duration_s"] / 60.0,
        "keyframes": facts["graph"]["keyframes"],
        "megabytes": page.stat().st_size / 1e6,
    }
    for number in range(runs):
        yield common | {"run": number} | _opened(page)


def _long_run(work: Path, command: Path) -> Path:
    """Return the folder of a drive of ten minutes round the campus, slow enough to last as long."""
    drive, folder = work / "ten_minutes", work / "ten_minutes_run"
    if not (folder / "report.html").is_file():
        campus = SCENARIOS["campus"].thinned(beams=16, columns=256, duration=_SECONDS)
        write_recording(drive, campus.varied(walk={"speed": 1.85}), seed=_SEED, overwrite=True)
        subprocess.run([str(command), "run", str(drive), "-o", str(folder), "-q", "--overwrite"], check=True)
    return folder


def _opened(page: Path) -> dict[str, float]:
    """Return seconds, of the wall and of all the browser's processors, from asking for the page on."""
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as profile, Browser(profile, webgl=False, patience=300.0) as browser:
        began, spent = time.perf_counter(), _cpu_of_tree(browser.pid)

        def note(name: str) -> None:
            found[f"{name}_wall_s"] = time.perf_counter() - began
            found[f"{name}_cpu_s"] = _cpu_of_tree(browser.pid) - spent

        browser.open(page.as_uri())
        browser.wait_for("document.readyState === 'complete'")
        note("readable")
        browser.evaluate("document.querySelector('#scene').open = true")
        browser.wait_for(_EYE)
        browser.evaluate("document.querySelector('#scene-view').scrollIntoView({block: 'center'})")
        note("drawn")
        before = browser.evaluate(_EYE)
        box = "document.querySelector('#scene-view').getBoundingClientRect()"
        x, y = browser.evaluate(f"(() => {{const r = {box}; return [r.x + r.width / 2, r.y + r.height / 2]}})()")
        browser.drag(x, y, x + 80.0, y)
        browser.wait_for(f"{_EYE} !== {before!r}")
        note("turned")
    return found


def _cpu_of_tree(root: int) -> float:
    """Return processor time of a process and all below it, those that have ended included [s]."""
    parents, spent = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                after_name = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            parents[int(entry.name)] = int(after_name[1])
            spent[int(entry.name)] = sum(map(int, after_name[11:15])) / os.sysconf("SC_CLK_TCK")
    family, size = {root}, 0
    while len(family) > size:
        size = len(family)
        family |= {child for child, parent in parents.items() if parent in family}
    return sum(spent.get(member, 0.0) for member in family)


def report_page_section(
    rows: list[dict[str, Any]], table: Callable[[Sequence[str], Sequence[Sequence[Any]]], str]
) -> str:
    """Return the section of BENCHMARKS.md: the quickest opening, which is least disturbed by others."""
    best = {
        f"{name}_{clock}_s": min(row[f"{name}_{clock}_s"] for row in rows)
        for name in ("readable", "drawn", "turned")
        for clock in ("wall", "cpu")
    }
    row = rows[0]
    head = ["", "wall s", "CPU s"]
    words = {"readable": "loaded, to be read", "drawn": "map drawn in three dimensions", "turned": "and turned"}
    body = [[text, f"{best[f'{name}_wall_s']:.2f}", f"{best[f'{name}_cpu_s']:.2f}"] for name, text in words.items()]
    kept = row["megabytes"] <= _MAX_MB and best["turned_wall_s"] <= _MAX_S
    return (
        f"## Report of a long run in a browser\n\n{table(head, body)}\n"
        f"{row['minutes']:.1f} minutes, {row['scans']} scans, {row['keyframes']} keyframes: {row['megabytes']:.2f} MB. "
        f"Headless Chromium without a graphics card, from asking for the page on; best of {len(rows)}. "
        f"Bars: {_MAX_MB:.0f} MB, interactive within {_MAX_S:.0f} s; {'kept' if kept else 'missed'}.\n"
    )
