"""The rooms import only downwards. Read from the source, so that imports for types and inside functions count too."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2] / "src" / "heliograph"

# What everybody may import; `atomic`, `chi_square`, `config` and its helpers know only the errors.
COMMON = {"atomic", "chi_square", "errors", "config", "config_checks", "config_toml", "_core"}
SENSING = {"lie", "data"}
ODOMETRY = SENSING | {"cloud", "imu", "maps", "registration"}
ENGINE = {"lie", "graph"}
FACTORS = ENGINE | {"data", "imu"}
SLAM = ODOMETRY | FACTORS | {"odometry", "factors"}

ALLOWED: dict[str, set[str]] = {
    "__init__": COMMON | SLAM | {"slam", "io", "metrics", "output", "pipeline"},
    "errors": set(),
    "atomic": {"errors"},
    "chi_square": {"errors"},
    "config_checks": {"errors"},
    "config": {"errors", "config_checks"},
    "config_toml": {"errors", "config", "config_checks"},
    "lie": {"errors", "config", "_core"},
    "testing": COMMON | SENSING | {"maps", "registration", "odometry", "graph"},
    "data": COMMON | {"lie"},
    "cloud": COMMON | SENSING,
    "imu": COMMON | SENSING,
    "maps": COMMON | SENSING,
    "registration": COMMON | SENSING | {"cloud", "imu", "maps"},
    "odometry": COMMON | ODOMETRY,
    "graph": COMMON | {"lie"},
    "factors": COMMON | FACTORS,
    "slam": COMMON | SLAM,
    "calibration": COMMON | SLAM,
    "io": COMMON | SENSING,
    "sim": COMMON | SENSING,
    "metrics": COMMON | SENSING,
    "checks": COMMON | SENSING | {"metrics"},
    "output": COMMON | SENSING | {"io"},
    "pipeline": COMMON | SLAM | {"slam", "io", "calibration", "checks", "metrics", "output"},
    "checkup": COMMON | SLAM | {"io", "checks"},
    "report": COMMON | SENSING | {"io", "output", "checks", "metrics"},
    "lab": COMMON | SLAM | {"sim", "metrics", "slam"},
    "cli": COMMON
    | SLAM
    | {"slam", "io", "sim", "metrics", "checks", "checkup", "calibration", "output", "pipeline", "report", "lab"},
}


def room_of(path: Path, source: Path) -> str:
    """Name of the room, or of the module at the top, that a file belongs to."""
    return path.relative_to(source).with_suffix("").parts[0]


def imported_rooms(tree: ast.AST, path: Path, source: Path) -> set[str]:
    """Rooms of heliograph that a module imports anywhere in its text, relative imports included."""
    package = ["heliograph", *path.relative_to(source).parts[:-1]]
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            names += [f"{module}.{alias.name}" for alias in node.names]
    return {name.split(".")[1] for name in names if name.startswith("heliograph.")}


def violations(source: Path) -> list[str]:
    """Return one line an import that the layering forbids, or a room without a rule."""
    found = []
    for path in sorted(source.rglob("*.py")):
        room = room_of(path, source)
        if room not in ALLOWED:
            found.append(f"{path.relative_to(source)}: room '{room}' has no rule in {Path(__file__).name}")
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for target in sorted(imported_rooms(tree, path, source) - ALLOWED[room] - {room}):
            if target in ALLOWED or target == "_core":  # what is neither is a name of the package itself
                found.append(f"{path.relative_to(source)}: '{room}' must not import '{target}'")
    return found


def test_rooms_import_only_what_the_layering_allows():
    assert violations(SOURCE) == []


def test_rules_have_no_cycle():
    order: list[str] = []
    while len(order) < len(ALLOWED):
        ready = [room for room in ALLOWED if room not in order and ALLOWED[room] <= {*order, "_core"}]
        assert ready, f"these rooms wait for each other: {sorted(set(ALLOWED) - set(order))}"
        order += ready


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
        ("odometry/filter.py", "def f():\n    import heliograph.report", "report"),
        ("pipeline.py", "from heliograph.cli.main import main", "cli"),
        ("errors.py", "from heliograph.config import RunConfig", "config"),
    ],
)
def test_checker_catches(tmp_path, file, text, forbidden):
    path = tmp_path / file
    path.parent.mkdir(exist_ok=True)
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
