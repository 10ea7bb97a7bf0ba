"""The report in a browser: it opens, asks for nothing, its numbers are the run's, and no caption overlaps."""

import csv
import json
import re

import pytest
from tests.browser import CHROMIUM, MISSING, Browser

from heliograph.cli.main import main
from heliograph.sim import SCENARIOS
from heliograph.sim.write import write_recording

pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason=MISSING), pytest.mark.timeout(600)]

OVERLAPS = """
[...document.querySelectorAll('figure, header')].flatMap((figure) => {
  const boxes = [...figure.querySelectorAll('figcaption > *, svg text, dt, dd')]
    .filter((e) => !e.querySelector('text, dt, dd') && e.textContent.trim() && e.getClientRects().length)
    .map((e) => [e.textContent.trim(), e.getBoundingClientRect(), e]);
  const found = [];
  for (let i = 0; i < boxes.length; i++) for (let j = i + 1; j < boxes.length; j++) {
    const [a, b] = [boxes[i][1], boxes[j][1]];
    if (boxes[i][2].contains(boxes[j][2])) continue;
    const w = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const h = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (w > 2 && h > 3) found.push(`${boxes[i][0]} / ${boxes[j][0]}`);
  }
  return found;
})
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run of six seconds with satellite fixes."""
    home = tmp_path_factory.mktemp("report_browser")
    write_recording(home / "drive", SCENARIOS["demo"].thinned(beams=16, columns=256, duration=6.0), seed=1)
    assert main(["run", str(home / "drive"), "-o", str(home / "run"), "-q"]) == 0
    return home / "run"


def hovers_with_the_runs_numbers(page, folder):
    """Point at the last scan of a chart, then walk by the arrow keys: the numbers are those of the table."""
    chart = "document.querySelector('svg[aria-label=Height]')"
    page.evaluate(f"{chart}.scrollIntoView({{block: 'center'}})")
    x, y = page.evaluate(f"(() => {{const r = {chart}.getBoundingClientRect(); return [r.right - 1, r.y + 20]}})()")
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    with (folder / "scans.csv").open() as file:
        rows = list(csv.DictReader(file))
    tip = "[...document.querySelectorAll('.tip div')].map((e) => e.textContent)"
    for place in (-1, -2):
        time, height = page.evaluate(tip)
        assert float(time.split()[1]) == pytest.approx(
            1e-9 * (int(rows[place]["end_ns"]) - int(rows[0]["end_ns"])), rel=1e-3
        )
        assert float(height.split()[-2]) == pytest.approx(float(rows[place]["position_z"]), rel=1e-3, abs=1e-6)
        page.evaluate(f"{chart}.focus()")
        page.press("ArrowLeft")
    inside = page.evaluate("(() => {const r = document.querySelector('.tip').getBoundingClientRect();"
                           "return r.left >= 0 && r.right <= innerWidth})()")  # fmt: skip
    assert inside
    page.press("Escape")
    assert not page.evaluate("!!document.querySelector('.tip').checkVisibility()")


def map_turns(page):
    """Open the view in three dimensions: points are drawn, a drag and keys move it, the way tells its poses."""
    view = "document.querySelector('#scene-view')"
    page.evaluate("document.querySelector('#scene').open = true")
    seen = [page.wait_for(f"{view}.dataset.eye")]
    page.evaluate(f"{view}.scrollIntoView({{block: 'center'}})")
    pixels = f"""(() => {{
      const c = {view}.querySelector('canvas'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
      return d.filter((value, i) => i % 4 === 3 && value > 0).length / (c.width * c.height);
    }})()"""
    assert 0.05 < page.evaluate(pixels) < 0.95, "there is a map to be seen, and something around it"
    left, top, right, bottom = page.evaluate(
        f"(() => {{const r = {view}.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]}})()"
    )
    x, y = 0.5 * (left + right), 0.5 * (top + bottom)
    page.drag(x, y, x + 60, y + 20)
    page.evaluate(f"{view}.focus()")
    for move in (None, "ArrowLeft", "+"):
        if move:
            page.press(move)
        seen.append(page.wait_for(f"{view}.dataset.eye !== '{seen[-1]}' && {view}.dataset.eye"))
    angles = [[float(value) for value in eye.split()] for eye in seen]
    assert angles[1][0] == pytest.approx(angles[0][0] - 0.36, abs=0.02), "sixty pixels are 0.36 rad"
    assert angles[1][1] == pytest.approx(angles[0][1] + 0.12, abs=0.02)
    assert angles[3][2] < angles[2][2], "plus brings it nearer"
    told = page.evaluate(f"""(() => {{
      const canvas = {view}.querySelector('canvas'), box = canvas.getBoundingClientRect();
      for (let y = 0; y < box.height; y += 10) for (let x = 0; x < box.width; x += 10) {{
        canvas.dispatchEvent(new PointerEvent('pointermove', {{clientX: box.left + x, clientY: box.top + y}}));
        const text = {view}.querySelector('p').textContent;
        if (text) return text;
      }}
    }})()""")
    assert re.fullmatch(r"\d+\.\d s: \((-?\d+\.\d\d(, )?){3}\) m", told), "the way tells its poses"


@pytest.mark.parametrize(("width", "dark"), [(1400, False), (390, True)], ids=["wide-light", "phone-dark"])
def test_report_opens_with_the_runs_numbers_and_asks_for_nothing(made, tmp_path, width, dark):
    facts = json.loads((made / "run.json").read_text())
    with Browser(tmp_path / "profile", width=width, height=900, dark=dark, patience=120.0) as page:
        page.open((made / "report.html").as_uri())
        page.wait_for("document.readyState === 'complete'")
        tiles = page.evaluate(
            "Object.fromEntries([...document.querySelectorAll('.tiles div')].map("
            "(e) => [e.querySelector('dt').textContent, e.querySelector('dd').textContent]))"
        )
        assert tiles["distance"] == f"{facts['distance_m']:.1f} m" and tiles["scans"].strip() == str(facts["scans"])
        assert tiles["a scan"] == f"{facts['timings']['wall_ms_per_scan']:.1f} ms", "one number everywhere"
        verdicts = page.evaluate("[...document.querySelectorAll('.checks li b')].map((e) => e.textContent)")
        assert verdicts == [check["verdict"] for check in facts["checks"]] and len(verdicts) == 6
        level = page.evaluate("document.querySelector('#accuracy').textContent")
        assert facts["level"]["sentence"] in level and "relative" in level and "absolute" in level
        links = page.evaluate("[...document.querySelectorAll('.files a')].map((e) => e.getAttribute('href'))")
        assert {"scans.csv", "map.png", "trajectory.tum"} <= set(links) <= {file.name for file in made.iterdir()}
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert page.evaluate(OVERLAPS) == []
        hovers_with_the_runs_numbers(page, made)
        map_turns(page)
        assert page.complaints == []
        assert [url for url in page.requests if not url.startswith(("file:", "data:", "blob:", "about:"))] == []


def test_no_caption_overlaps_another_where_the_map_is_a_strip(tmp_path):
    write_recording(tmp_path / "drive", SCENARIOS["tunnel"].thinned(beams=16, columns=90, duration=7.0), seed=1)
    assert main(["run", str(tmp_path / "drive"), "-o", str(tmp_path / "run"), "-q", "--no-graph"]) == 0
    with Browser(tmp_path / "profile", width=390, height=900, patience=120.0) as page:
        page.open((tmp_path / "run" / "report.html").as_uri())
        page.wait_for("document.readyState === 'complete'")
        for width in (390, 1400):
            page.resize(width, 900)
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
            assert page.evaluate(OVERLAPS) == []
