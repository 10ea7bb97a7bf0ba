import base64
import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from fakes import FakeOdometry, FakeRecording, make_result
from heliograph.config import OutputConfig, RunConfig
from heliograph.data import Event
from heliograph.output.run_folder import RunFolder
from heliograph.pipeline import run
from heliograph.report import write_report
from heliograph.report.hover import MAX_ROWS, hover_attributes
from heliograph.report.mapview import MapPictures
from heliograph.report.page import header, page, table
from heliograph.report.scene import MAX_POINTS, loop_lines
from heliograph.report.svg import Line, line_chart, nice_ticks, number, round_length, thin
from heliograph.report.tracks import fixes, loop_ledger


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run of 30 scans with a warning, a name that needs escaping, and a degenerate stretch."""

    class Corridor(FakeOdometry):
        def finish(self):
            tight = np.array([0.001, 0.3, 0.7])
            warning = Event(code="corridor", message="x < y & z")
            return [
                make_result(i, status="degenerate", eigenvalues_translation=tight, events=(warning,)) for i in (29, 30)
            ]

    folder = RunFolder(
        tmp_path_factory.mktemp("report") / "out",
        name="a<b>",
        config="threads = 1\n",
        output=OutputConfig(map_voxel=1e-3),
        T_imu_body=np.eye(4),
        facts=lambda: {"inferences": [{"name": "unit", "value": "ns", "evidence": "span 1e8", "source": "data"}]},
        finishers=(write_report,),
    )
    run(FakeRecording(30), RunConfig(threads=1), sinks=[folder], odometry=Corridor())
    return folder


def test_report_shows_map_first_and_all_that_the_contract_names(finished):
    html = (finished.path / "report.html").read_text()
    places = [
        html.index(word)
        for word in ("from above", "from the side", "Trajectory from above", "Speed", "Observability of translation",
                     "Gyroscope bias", "Time by stage", "What was inferred")
    ]  # fmt: skip
    assert places == sorted(places)
    assert "intensity" not in html or 'id="by-height" checked' in html
    assert "a direction unobservable" in html and "span 1e8" in html and "threads = 1" in html


def test_report_needs_nothing_from_outside(finished):
    html = (finished.path / "report.html").read_text()
    assert not re.search(r"<script[^>]*\bsrc\b", html)
    html = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    for target in re.findall(r'(?:src|href)="([^"]*)"|url\(([^)]*)\)', html):
        within = "".join(target).startswith("#")
        beside = "".join(target) in {path.name for path in finished.path.iterdir()}
        assert within or beside or "".join(target).startswith("data:image/png;base64,")


def test_report_escapes_what_it_did_not_write(finished):
    html = (finished.path / "report.html").read_text()
    assert "a&lt;b&gt;" in html and "a<b>" not in html
    assert "x &lt; y &amp; z" in html


def test_report_drawings_are_well_formed(finished):
    html = re.sub(r"<script.*?</script>", "", (finished.path / "report.html").read_text(), flags=re.DOTALL)
    drawings = re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL)
    assert len(drawings) > 10
    for drawing in drawings:
        ElementTree.fromstring(drawing)
        drawing = re.sub(r'data-values="[^"]*"', "", drawing)
        assert "nan" not in drawing.lower().replace("nanosecond", "")


def test_report_is_the_same_for_the_same_run(finished):
    first = (finished.path / "report.html").read_bytes()
    write_report(finished.record)
    assert (finished.path / "report.html").read_bytes() == first


def test_report_has_only_its_own_scripts_and_needs_no_other(finished):
    html = page(finished.record, MapPictures(finished.record))
    assert html.count("<script") == 3 and "three dimensions" in html and "src=" not in html.replace('src="data:', "")
    assert len(html) < 3_000_000


def test_report_carries_the_map_to_be_turned(finished):
    html = page(finished.record, MapPictures(finished.record))
    data = json.loads(re.search(r'id="scene-data">(.*?)</script>', html)[1])
    x, y, z = (np.frombuffer(base64.b64decode(column["bdata"]), "<f4") for column in data["points"])
    assert len(x) == len(y) == len(z) <= MAX_POINTS
    way = np.stack([np.frombuffer(base64.b64decode(column["bdata"]), "<f4") for column in data["path"]], axis=1)
    np.testing.assert_allclose(way, finished.record.scans.triple("position"), atol=1e-5)
    assert len(html) < 15_000_000


def test_loops_that_stand_are_lines_between_their_poses(finished, tmp_path):
    record = replace(finished.record, folder=tmp_path)
    assert len(loop_lines(record)) == 0
    ends, path = record.scans["end_ns"], record.scans.triple("position")
    (tmp_path / "keyframes").mkdir()
    lines = [json.dumps({"index": i, "stamp_ns": int(ends[10 * i])}) for i in range(3)]
    (tmp_path / "keyframes" / "journal.jsonl").write_text(
        "\n".join(['{"format": "x"}', *lines]).replace("format", "index")
    )
    (tmp_path / "loops.csv").write_text("query,match,verdict\n2,0,accepted\n1,0,rejected\n")
    found = loop_lines(record)
    assert len(found) == 3 and np.isnan(found[2]).all()
    np.testing.assert_array_equal(found[:2], path[[20, 0]])


def hovered(html, title):
    """Return the numbers that a chart of a page carries: names, and columns."""
    svg = re.search(rf'<svg[^>]*aria-label="{title}[^>]*>', html)[0]
    about = json.loads(unescape(re.search(r'data-hover="([^"]*)"', svg)[1]))
    values = np.frombuffer(base64.b64decode(re.search(r'data-values="([^"]*)"', svg)[1]), "<f4")
    return about, values.reshape(about["places"], -1)


def test_charts_carry_the_runs_numbers_for_the_pointer(finished):
    html, scans = (finished.path / "report.html").read_text(), finished.record.scans
    about, (seconds, speed) = hovered(html, "Speed")
    assert about["columns"] == ["time [s]", "speed [m/s]"]
    np.testing.assert_allclose(seconds, scans.seconds, rtol=1e-6)
    np.testing.assert_allclose(speed, np.linalg.norm(scans.triple("velocity"), axis=1), rtol=1e-6)
    about, columns = hovered(html, "Gyroscope bias")
    assert about["columns"] == ["time [s]", "x [mrad/s]±", "y [mrad/s]±", "z [mrad/s]±"] and len(columns) == 7
    np.testing.assert_allclose(columns[2], 1e3 * scans.triple("sigma_gyro_bias")[:, 0], rtol=1e-6)
    about, columns = hovered(html, "Trajectory from above")
    np.testing.assert_allclose(columns[3:6].T, scans.triple("position"), atol=1e-5)


def test_long_runs_carry_a_bounded_number_of_values():
    attributes = hover_attributes(["t", "y"], [np.arange(20_001.0)] * 2, (0, 1, 0, 1, 0, 1))
    values = base64.b64decode(re.search(r'data-values="([^"]*)"', attributes)[1])
    assert len(values) / 8 <= MAX_ROWS


def test_each_warning_leads_to_what_it_means_and_what_helps(finished):
    record = finished.record
    events = (
        Event(code="imu-gap", message="0.2 s"),
        Event(code="repaired-clock", message="x"),
        Event(code="own", message="y"),
    )
    html = page(replace(record, summary=replace(record.summary, events=events)), None)
    assert '<a href="#means-imu-gap">imu-gap</a>' in html and 'id="means-imu-gap"' in html
    assert "check the recorder&#x27;s load and disk" in html
    assert 'id="means-repaired-clock"' in html and "means-own" not in html and "<b>own</b>" in html


@pytest.mark.parametrize(
    ("distance", "gap", "told"), [(100.0, 0.4, True), (100.0, 40.0, False), (1100.0, 45.0, False), (1100.0, 2.0, True)]
)
def test_gap_is_told_of_a_lap_only(finished, distance, gap, told):
    summary = replace(finished.record.summary, distance=distance, start_end_gap=gap)
    assert ("start-end gap" in header(replace(finished.record, summary=summary))) is told


def test_value_that_stands_alone_is_a_dot():
    y = np.array([np.nan, 3.0, np.nan, 1.0, 2.0, np.nan])
    chart = line_chart(np.arange(6.0), [Line(y=y, color=2)], title="t", y_label="y")
    assert chart.count('<circle class="b2"') == 1


def test_table_of_many_columns_names_each_cell_for_a_phone():
    rows = [("a", "b", "c", "<d>")]
    assert '<td data-name="value &amp; sum">b</td>' in table(("name", "value_& sum", "x", "y"), rows)
    assert "data-name" not in table(("name", "value"), [("a", "b")])


def test_long_ledger_is_shown_when_it_is_asked_for(finished, tmp_path):
    record = replace(finished.record, folder=tmp_path)
    for count, folded in ((5, False), (50, True)):
        rows = "".join(f"{i},{i},0,rejected\n" for i in range(count))
        (tmp_path / "loops.csv").write_text(f"number,query,match,verdict\n{rows}")
        assert ("<details>" in loop_ledger(record)) is folded


def test_report_says_how_accurate_it_is_before_the_map(finished):
    html = (finished.path / "report.html").read_text()
    stated = html[html.index('id="accuracy"') : html.index("from above")]
    worst = np.linalg.norm(finished.record.scans.triple("sigma_position"), axis=1).max()
    assert f"{1e3 * worst:.1f} mm at most" in stated and "not tied to the Earth" in stated
    assert "scans.csv</a> every scan" in html and "{&#x27;" not in html, "no dictionaries of the language"


def test_loop_ledger_has_a_picture_of_each_pair(finished, tmp_path):
    record = replace(finished.record, folder=tmp_path)
    assert loop_ledger(record) == ""
    (tmp_path / "keyframes").mkdir()
    for index in (0, 7):
        points = np.random.default_rng(index).uniform(-5, 5, (500, 3)).astype(np.float32)
        np.savez(tmp_path / "keyframes" / f"{index:06d}.npz", points_imu=points)
    pose = "1 0 0 0.5 0 1 0 0 0 0 1 0"
    (tmp_path / "loops.csv").write_text(
        "number,query,match,verdict,reason,overlap_query,shift_level,T_match_query\n"
        f"0,7,0,rejected,few <overlaps>,0.1,0.2,{pose}\n1,7,0,accepted,agrees,0.8,0.3,{pose}\n2,9,0,rejected,x,,,\n"
    )
    html = loop_ledger(record)
    assert html.count("<img") == 2 and html.index("0 and 7: accepted") < html.index("0 and 7: rejected")
    assert "1 of 3 candidates stand" in html and "few &lt;overlaps&gt;" in html and "80%" in html


def test_fixes_used_and_left_out_are_charts_of_their_own(finished, tmp_path):
    record = replace(finished.record, folder=tmp_path)
    assert fixes(record) == []
    (tmp_path / "gnss.csv").write_text(
        "stamp,residual_east_m,residual_north_m,residual_up_m,weight\n"
        "10.0,0.1,0.2,0.3,1.0\n11.0,0.1,0.1,0.2,0.9\n12.0,30.0,1.0,1.0,0.0\n13.0,,,,0.0\n"
    )
    used, left_out = fixes(record)
    assert "fixes used" in used and "left out" in left_out


def roofed(share):
    """Points of a hall of 20 m by 20 m, of which a share has a roof at 6 m."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 20, 0.2), np.arange(0, 20, 0.2)))
    floor = np.stack([x, y, np.zeros_like(x)], axis=1)
    roof = np.stack([x, y, np.full_like(x, 6.0)], axis=1)[x < 20 * share]
    return np.concatenate([floor, roof]).astype(np.float32)


@pytest.mark.parametrize(("share", "covered"), [(0.0, False), (1.0, True), (0.3, True)])
def test_map_from_above_leaves_out_a_roof(finished, share, covered):
    record = replace(finished.record, points_map=roofed(share), intensity=None)
    pictures = MapPictures(record)
    assert (pictures.ceiling is not None) == covered
    top = pictures.points[pictures.top_raster.nearest[pictures.top_raster.nearest >= 0], 2]
    assert top.max() < 5.0


def test_map_that_is_nothing_but_roof_is_drawn(finished):
    """Seen of a hall from beneath: all points are higher than a way below them."""
    points = roofed(1.0)
    record = replace(finished.record, points_map=points[points[:, 2] > 5.0], intensity=None)
    assert (MapPictures(record).top_raster.nearest >= 0).any()


def test_ticks_are_round_and_inside():
    assert nice_ticks(0.0, 1.0, 4) == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    assert nice_ticks(-0.031, 0.052, 4) == pytest.approx([-0.02, 0.0, 0.02, 0.04])
    assert nice_ticks(3.0, 3.0, 4) == [3.0]
    assert (number(0.0), number(-0.5), number(12.5)) == ("0", "−0.5", "12.5")
    assert (round_length(17.0), round_length(0.9), round_length(50.0)) == (10.0, 0.5, 50.0)


def test_thinning_a_curve_keeps_its_peaks(rng):
    y = rng.normal(0, 1, 100_000)
    y[54_321] = 50.0
    x, thinned = thin(np.arange(100_000.0), y, 400)
    assert len(x) <= 800 and thinned.max() == 50.0 and (np.diff(x) > 0).all()


def test_chart_of_nothing_and_of_nan_is_still_a_chart():
    for y in (np.zeros(0), np.full(5, np.nan), np.ones(5)):
        svg = line_chart(np.arange(len(y), dtype=float), [Line(y=y)], title="t", y_label="y", log=True)
        ElementTree.fromstring(re.search(r"<svg.*</svg>", svg, flags=re.DOTALL).group())
