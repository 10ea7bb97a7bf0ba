"""The double-logarithmic chart is a whole, well-formed SVG that shows what it was given."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from heliograph.report.loglog import Curve, Guide, loglog_svg

SVG = "{http://www.w3.org/2000/svg}"
X = np.geomspace(0.01, 1000.0, 40)


def drawn(curves, guides=()):
    text = loglog_svg(curves, guides, title="A <title>", note="note", x_label="τ [s]", y_label="σ [rad/s]")
    return ElementTree.fromstring(text)


def texts(root):
    return [element.text for element in root.iter(f"{SVG}text")]


def points(path):
    return np.array([pair.split() for pair in path.get("d").replace("M", "L").strip("LZ").split("L")], dtype=float)


def test_curves_of_a_power_law_are_straight_with_their_slope():
    root = drawn([Curve(x=X, y=X**-0.5, color=1, label="x")])
    [line] = [p for p in root.iter(f"{SVG}path") if p.get("class") == "line c1" and "L" in p.get("d")]
    xy = points(line)
    np.testing.assert_allclose(xy[:, 1], np.interp(xy[:, 0], xy[[0, -1], 0], xy[[0, -1], 1]), atol=0.2)
    assert xy[-1, 1] > xy[0, 1]  # falls, in pixels


def test_guide_passes_its_point_and_carries_its_name():
    root = drawn([Curve(x=X, y=X**-0.5, color=1)], [Guide(x=1.0, y=1.0, slope=-0.5, name="N 1")])
    [dot] = root.iter(f"{SVG}circle")
    [line] = [p for p in root.iter(f"{SVG}path") if p.get("class") == "guide"]
    xy = points(line)
    at = np.interp(float(dot.get("cx")), xy[:, 0], xy[:, 1])
    assert at == pytest.approx(float(dot.get("cy")), abs=0.3)
    assert "N 1" in texts(root)


def test_labels_ticks_and_escapes_are_there():
    shown = texts(drawn([Curve(x=X, y=X, color=2, label="measured"), Curve(x=X, y=X, color=2, dashed=True)]))
    assert {"A <title>", "note", "τ [s]", "σ [rad/s]", "measured", "0.01", "1000"} <= set(shown)


@pytest.mark.parametrize(
    ("x", "y"), [(X, np.zeros(40)), (X[:1], np.array([3e-7])), (X, np.where(X > 1.0, np.nan, X)), (X, np.full(40, 5.0))]
)
def test_odd_curves_still_make_a_chart(x, y):
    root = drawn([Curve(x=x, y=y, color=1, low=0.5 * y, high=2.0 * y, label="odd")])
    assert "nan" not in ElementTree.tostring(root, encoding="unicode")
