import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from fakes import FakeOdometry, FakeRecording, make_result
from heliograph.config import OutputConfig, RunConfig
from heliograph.data import Event
from heliograph.output.run_folder import RunFolder
from heliograph.pipeline import run
from heliograph.report import write_report
from heliograph.report.mapview import MapPictures
from heliograph.report.svg import Line, line_chart, nice_ticks, number, round_length, thin


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
    assert "<script" not in html
    for target in re.findall(r'(?:src|href)="([^"]*)"|url\(([^)]*)\)', html):
        assert "".join(target).startswith("data:image/png;base64,")


def test_report_escapes_what_it_did_not_write(finished):
    html = (finished.path / "report.html").read_text()
    assert "a&lt;b&gt;" in html and "a<b>" not in html
    assert "x &lt; y &amp; z" in html


def test_report_drawings_are_well_formed(finished):
    html = (finished.path / "report.html").read_text()
    drawings = re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL)
    assert len(drawings) > 10
    for drawing in drawings:
        ElementTree.fromstring(drawing)
        assert "nan" not in drawing.lower().replace("nanosecond", "")


def test_report_is_the_same_for_the_same_run(finished):
    first = (finished.path / "report.html").read_bytes()
    write_report(finished.record)
    assert (finished.path / "report.html").read_bytes() == first


def roofed(share):
    """Points of a hall of 20 m by 20 m, of which a share has a roof at 6 m."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 20, 0.2), np.arange(0, 20, 0.2)))
    floor = np.stack([x, y, np.zeros_like(x)], axis=1)
    roof = np.stack([x, y, np.full_like(x, 6.0)], axis=1)[x < 20 * share]
    return np.concatenate([floor, roof]).astype(np.float32)


@pytest.mark.parametrize(("share", "covered"), [(0.0, False), (1.0, True), (0.3, True)])
def test_map_from_above_leaves_out_a_roof(finished, share, covered):
    from dataclasses import replace

    record = replace(finished.record, points_map=roofed(share), intensity=None)
    pictures = MapPictures(record)
    assert (pictures.ceiling is not None) == covered
    top = pictures.points[pictures.top_raster.nearest[pictures.top_raster.nearest >= 0], 2]
    assert top.max() < 5.0


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
