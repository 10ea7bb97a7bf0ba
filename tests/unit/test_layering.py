"""The rooms import only downwards. Read from the source, so that imports for types and inside functions count too."""

import re

import pytest
from tests.rooms import ALLOWED, SOURCE, STOREYS, picture, violations


def test_rooms_import_only_what_the_layering_allows():
    assert violations() == []


@pytest.mark.parametrize("rules", [ALLOWED, *STOREYS.values()], ids=["heliograph", *STOREYS])
def test_rules_have_no_cycle(rules):
    order: list[str] = []
    while len(order) < len(rules):
        ready = [room for room in rules if room not in order and rules[room] <= {*order, "_core"}]
        assert ready, f"these rooms wait for each other: {sorted(set(rules) - set(order))}"
        order += ready


@pytest.mark.parametrize("place", ["", *STOREYS])
def test_places_have_no_circle(place):
    assert picture(place).circles == ()


@pytest.mark.parametrize(("place", "rooms", "floors"), [("graph", 8, 5), ("io", 10, 6)])
def test_storeys_stay_few(place, rooms, floors):
    found = picture(place)
    assert len(found.names) <= rooms
    assert max(found.floors.values()) <= floors


def test_the_engine_names_no_sensor():
    """What a factor measures is the business of the room above: the engine's text does not speak of it."""
    words, root = re.compile(r"\b(lidar|imu|scans?|gps|gnss)\b", re.IGNORECASE), SOURCE.parents[1]
    files = [path for place in ("src/heliograph/graph", "cpp/graph") for path in (root / place).rglob("*.*")]
    texts = {path: path.read_text(encoding="utf-8") for path in files if path.suffix in (".py", ".cpp", ".hpp", ".inl")}
    assert len(texts) > 100
    assert [str(path) for path, text in texts.items() if words.search(text)] == []


def test_native_rooms_below_the_factors_include_none_of_them():
    root = SOURCE.parents[1] / "cpp"
    for room in ("graph", "imu", "lie", "util"):
        for path in (root / room).rglob("*.*"):
            assert '#include "factors/' not in path.read_text(encoding="utf-8"), path


def test_picture_counts_rooms_floors_arrows_and_circles(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.py").write_text("from heliograph import b")
    (tmp_path / "b.py").write_text("from heliograph.c import f")
    (tmp_path / "c.py").write_text("")
    found = picture("", tmp_path)
    assert (found.floors, len(found.arrows), found.circles) == ({"c": 1, "b": 2, "a": 3}, 2, ())
    (tmp_path / "c.py").write_text("def f():\n    from heliograph.a import x")
    assert len(picture("", tmp_path).circles) == 1


@pytest.mark.parametrize("room", sorted(set(ALLOWED) - {"cli"}))
def test_only_the_command_line_imports_reports(room):
    assert not {"report", "lab", "cli"} & ALLOWED[room]


@pytest.mark.parametrize(
    ("file", "text", "forbidden"),
    [
        ("lie/a.py", "from heliograph.data import Scan", "data"),
        ("maps/a.py", "import heliograph.registration.linearize as x", "registration"),
        ("maps/a.py", "from heliograph import odometry", "odometry"),
        ("maps/a.py", "from ..odometry import filter", "odometry"),
        ("maps/a.py", "from .. import odometry", "odometry"),
        (
            "data/a.py",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from heliograph.io.raw import TopicInfo",
            "io",
        ),
        ("odometry/filter/core.py", "def f():\n    import heliograph.report", "report"),
        ("pipeline.py", "from heliograph.cli.main import main", "cli"),
        ("errors.py", "from heliograph.config import RunConfig", "config"),
    ],
)
def test_checker_catches(tmp_path, file, text, forbidden):
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    [line] = violations(tmp_path)
    assert f"must not import '{forbidden}'" in line


def test_checker_catches_a_room_without_a_rule(tmp_path):
    (tmp_path / "attic.py").write_text("")
    [line] = violations(tmp_path)
    assert "no rule" in line


def test_checker_allows_what_is_allowed(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "a.py").write_text(
        "from heliograph.data import Scan\nfrom . import b\nfrom .b import c\nimport numpy"
    )
    assert violations(tmp_path) == []
