"""Rooms, floors, arrows and circles of the source, read from its imports.

`make rooms` prints them, the layering test holds them. A room is a folder or a module directly below the place looked
at; an arrow is one room that imports another, imports for types and inside functions included; a room's floor is one
above the highest that it imports; a circle is a set of rooms that import each other.
"""

from __future__ import annotations

import ast
import sys
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src" / "heliograph"

# What everybody may import; `atomic`, `chi_square`, `plugins`, `config` and its helpers know only the errors,
# `geodesy` nothing.
COMMON = {"arrays", "atomic", "chi_square", "errors", "geodesy", "guard", "plugins", "snapshots", "_core"}
COMMON |= {"config", "config_checks", "config_registration", "config_toml"}
SENSING = {"lie", "data"}
ODOMETRY = SENSING | {"cloud", "imu", "maps", "registration"}
ENGINE = {"lie", "graph"}
FACTORS = ENGINE | {"data", "imu"}
SLAM = ODOMETRY | FACTORS | {"odometry", "factors"}

ALLOWED: dict[str, set[str]] = {
    "__init__": COMMON | SLAM | {"slam", "io", "metrics", "output", "pipeline"},
    "errors": set(),
    "arrays": {"errors"},
    "atomic": {"errors"},
    "chi_square": {"errors"},
    "geodesy": set(),
    "guard": {"errors", "config"},
    "plugins": {"errors"},
    "snapshots": {"arrays", "atomic", "errors", "guard"},
    "support": {"errors", "atomic", "guard"},
    "config_checks": {"errors"},
    "config_registration": {"errors", "config_checks"},
    "config": {"errors", "config_checks", "config_registration"},
    "config_toml": {"errors", "config", "config_checks", "guard"},
    "lie": {"arrays", "errors", "config", "_core"},
    "testing": COMMON | SENSING | {"maps", "registration", "odometry", "graph", "io", "output", "slam"},
    "data": COMMON | {"lie"},
    "cloud": COMMON | SENSING,
    "imu": COMMON | SENSING,
    "maps": COMMON | SENSING,
    "registration": COMMON | SENSING | {"cloud", "imu", "maps"},
    "odometry": COMMON | ODOMETRY,
    "graph": COMMON | {"lie"},
    "factors": COMMON | FACTORS,
    "slam": COMMON | SLAM | {"metrics"},
    "survey": COMMON | SLAM | {"slam", "io", "output", "edits", "revision"},
    "revision": COMMON | SLAM | {"edits", "slam", "io", "output"},
    "edits": {"errors", "arrays", "guard"},
    "editing": COMMON | SLAM | {"slam", "edits", "revision"},
    "localization": COMMON | SLAM | {"slam", "io", "output", "revision"},
    "merging": COMMON | SLAM | {"slam", "io", "output", "edits", "editing", "revision", "localization"},
    "calibration": COMMON | SLAM,
    "io": COMMON | SENSING,
    "sim": COMMON | SENSING,
    "metrics": COMMON | SENSING,
    "checks": COMMON | SENSING | {"metrics"},
    "output": COMMON | SENSING | {"io", "maps", "checks"},
    "comparison": COMMON | SENSING | {"io", "metrics"},
    "account": COMMON | SLAM | {"slam", "checks", "output"},
    "checkpoint": COMMON | SLAM | {"slam", "checks", "output"},
    "pipeline": COMMON
    | SLAM
    | {"slam", "io", "calibration", "checks", "metrics", "output", "repair"}
    | {"account", "checkpoint"},
    "examination": COMMON | SLAM | {"io", "checks"},
    "repair": COMMON | SLAM | {"calibration", "checks", "examination"},
    "report": COMMON | SENSING | {"imu", "io", "calibration", "output", "checks", "metrics"},
    "lab": COMMON | SLAM | {"sim", "metrics", "slam"},
    "viewer": COMMON | SLAM | {"slam", "io", "output", "revision"},
    "cli": COMMON
    | SLAM
    | {"slam", "io", "sim", "metrics", "checks", "examination", "calibration", "output", "pipeline", "report"}
    | {
        "comparison",
        "edits",
        "editing",
        "localization",
        "merging",
        "revision",
        "support",
        "survey",
        "lab",
        "viewer",
        "checkpoint",
    },
}
"""Room below `heliograph` -> the rooms that it may import."""

STOREYS: dict[str, dict[str, set[str]]] = {
    "graph": {
        "model": set(),
        "draw": {"model"},
        "files": {"model"},
        "problem": {"model"},
        "diagnosis": {"model", "problem"},
        "batch": {"model", "problem", "diagnosis"},
        "incremental": {"model", "problem", "diagnosis", "batch", "files"},
        "solver": {"model", "problem", "batch", "incremental"},
    },
    "io": {
        "raw": set(),
        "prefetch": set(),
        "tally": {"raw"},
        "registry": {"raw", "files"},
        "files": {"raw"},
        "packets": {"raw", "registry"},
        "bags": {"raw", "registry", "inference"},
        "inference": {"raw", "files"},
        "recording": {"raw", "tally", "registry", "inference", "bags"},
        "info": {"raw", "tally", "inference", "recording"},
    },
    "odometry": {
        "sequencer": set(),
        "protocol": set(),
        "live": {"protocol"},
        "pose_result": set(),
        "poses_of_file": {"pose_result", "protocol"},
        "filter": {"sequencer"},
        "follow": {"filter"},
        "loam": {"filter"},
        "registry": {"protocol", "filter", "loam"},
    },
    "slam": {
        "growing_rows": set(),
        "covariances": {"growing_rows"},
        "store": set(),
        "descriptor_file": {"places"},
        "keyframes": {"covariances"},
        "places": set(),
        "loops": {"places"},
        "loop_search": {"covariances", "descriptor_file", "loops", "places", "store"},
        "pose_factors": set(),
        "levelling": {"growing_rows"},
        "plane_refinement": set(),
        "open_query": {"loop_search"},
        "second_look": set(),
        "inertial_factors": set(),
        "gnss": {"covariances"},
        "wheels": {"inertial_factors"},
        "past_steps": {"growing_rows", "inertial_factors"},
        "step_log": {"inertial_factors", "past_steps", "pose_factors", "wheels"},
        "back_end": {
            "covariances",
            "gnss",
            "inertial_factors",
            "levelling",
            "loop_search",
            "loops",
            "open_query",
            "past_steps",
            "pose_factors",
            "second_look",
            "step_log",
            "store",
            "wheels",
        },
        "graph_files": {"back_end", "gnss", "loops", "store"},
        "given_poses": {"loops"},
        "session": {"back_end", "given_poses", "gnss", "graph_files", "keyframes", "store"},
    },
}
"""The same inside the rooms that have storeys; their ``__init__`` may import all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rooms:
    """The picture of one place: its rooms, the arrows between them, each room's floor, and the circles."""

    names: tuple[str, ...]
    arrows: frozenset[tuple[str, str]]
    floors: dict[str, int]
    circles: tuple[tuple[str, ...], ...]


def imported_modules(path: Path, source: Path = SOURCE) -> set[str]:
    """Dotted names below `heliograph` that a module imports anywhere in its text, relative imports included."""
    package = ["heliograph", *path.relative_to(source).parts[:-1]]
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            names += [f"{module}.{alias.name}" for alias in node.names]
    return {name.partition(".")[2] for name in names if name.startswith("heliograph.")}


def picture(place: str = "", source: Path = SOURCE) -> Rooms:
    """Measure one place, by its dotted name below `heliograph`; "" is the whole house."""
    below = tuple(place.split(".")) if place else ()
    folder = source.joinpath(*below)
    homes = {path: path.relative_to(folder).with_suffix("").parts[0] for path in sorted(folder.rglob("*.py"))}
    names = tuple(dict.fromkeys(home for home in homes.values() if home != "__init__"))
    arrows = set()
    for path, home in homes.items():
        for module in imported_modules(path, source):
            parts = tuple(module.split("."))
            if parts[: len(below)] == below and len(parts) > len(below) and parts[len(below)] in names:
                arrows.add((home, parts[len(below)]))
    between = frozenset((a, b) for a, b in arrows if a != b and a != "__init__")
    circles, floors = _circles(names, between), {}
    if not circles:
        for room in TopologicalSorter({name: {b for a, b in between if a == name} for name in names}).static_order():
            floors[room] = 1 + max((floors[b] for a, b in between if a == room), default=0)
    return Rooms(names=names, arrows=between, floors=floors, circles=circles)


def _circles(names: tuple[str, ...], arrows: frozenset[tuple[str, str]]) -> tuple[tuple[str, ...], ...]:
    """Return the circles, found one after another by taking the last arrow of each out."""
    left, found = set(arrows), []
    while True:
        try:
            list(TopologicalSorter({name: {b for a, b in left if a == name} for name in names}).static_order())
        except CycleError as error:
            circle = error.args[1]
            found.append(tuple(circle))
            left -= {(circle[0], circle[1]), (circle[1], circle[0])}
        else:
            return tuple(found)


def violations(source: Path = SOURCE) -> list[str]:
    """Return one line an import that a rule forbids, or a room without a rule."""
    found = _broken(source, source, ALLOWED)
    for place, rules in STOREYS.items():
        if (source / place).is_dir():
            found += _broken(source / place, source, {"__init__": set(rules), **rules})
    return found


def _broken(folder: Path, source: Path, rules: dict[str, set[str]]) -> list[str]:
    below = folder.relative_to(source).parts
    found = []
    for path in sorted(folder.rglob("*.py")):
        room = path.relative_to(folder).with_suffix("").parts[0]
        if room not in rules:
            found.append(f"{path.relative_to(source)}: room '{room}' has no rule in {Path(__file__).name}")
            continue
        modules = [tuple(module.split(".")) for module in imported_modules(path, source)]
        targets = {parts[len(below)] for parts in modules if parts[: len(below)] == below and len(parts) > len(below)}
        # What is neither a room nor the native module is a name of the package itself.
        for target in sorted((targets & {*rules, "_core"}) - rules[room] - {room}):
            found.append(f"{path.relative_to(source)}: '{room}' must not import '{target}'")
    return found


def _print(place: str) -> None:
    rooms = picture(place)
    storeys = max(rooms.floors.values(), default=0)
    print(
        f"{place or 'heliograph'}: {len(rooms.names)} rooms on {storeys} floors, {len(rooms.arrows)} arrows, "
        f"{len(rooms.circles)} circles"
    )
    for floor in range(storeys, 0, -1):
        print(f"  {floor}: {' '.join(sorted(name for name, at in rooms.floors.items() if at == floor))}")
    for circle in rooms.circles:
        print(f"  circle: {' -> '.join(circle)}")


def main() -> None:
    """Print the house, the rooms that have storeys, and what breaks a rule."""
    for place in sys.argv[1:] or ["", *STOREYS]:
        _print(place)
    broken = violations()
    print(f"{len(broken)} arrows against the rules")
    print("\n".join(broken), end="\n" if broken else "")
    sys.exit(bool(broken))


if __name__ == "__main__":
    main()
