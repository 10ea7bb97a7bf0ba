"""The error state's layout: without gaps, and used by name wherever it is used."""

import ast
from itertools import pairwise
from pathlib import Path

import pytest

from heliograph.data import error_layout

SOURCE = Path(error_layout.__file__).resolve().parents[1]
HOME = SOURCE / "data" / "error_layout.py"
# Rooms that handle the filter's errors.
ROOMS = ["data", "imu", "maps", "registration", "odometry", "calibration/mounting.py", "examination.py"]
# Their vectors and matrices have layouts of their own.
OTHER_LAYOUTS = {
    "imu/motion_chain.py",
    "imu/motion_start.py",
    "imu/preintegration.py",
    "data/online_calibration.py",
    *(f"registration/{name}.py" for name in ("align", "align_globally", "align_levels", "blind_directions")),
    *(f"registration/{name}.py" for name in ("global_alignment", "remapping", "surfaces")),
}  # two clouds know a pose and no filter
# What is indexed by the layout is called so; whatever its name, an index beyond the velocity is the layout's.
OF_THE_LAYOUT = {"covariance", "delta", "step", "shift", "total", "information", "P", "J", "F", "G", "M", "f"}

BEYOND = {9, 12, 15, 17, 20, 23, 24, 25}


def test_blocks_follow_one_another_without_gaps():
    blocks = [
        error_layout.ROTATION, error_layout.POSITION, error_layout.VELOCITY, error_layout.GYRO_BIAS,
        error_layout.ACCEL_BIAS, error_layout.GRAVITY, error_layout.MOUNTING_ROTATION, error_layout.LEVER_ARM,
    ]  # fmt: skip
    assert blocks[0].start == 0
    assert all(a.stop == b.start for a, b in pairwise(blocks))
    assert (blocks[-1].stop, error_layout.FULL_DIM - 1) == (error_layout.CLOCK, error_layout.DRIFT)
    assert (error_layout.FULL_DIM, error_layout.WHEELED_DIM - 1) == (error_layout.WHEEL_SCALE,) * 2
    assert (blocks[5].stop, blocks[-1].stop) == (error_layout.NAV_DIM, error_layout.MOUNTED_DIM)
    assert slice(blocks[0].start, blocks[1].stop) == error_layout.POSE
    assert slice(blocks[3].start, blocks[4].stop) == error_layout.BIASES
    assert slice(blocks[6].start, blocks[7].stop) == error_layout.MOUNTING


def raw_indices(text):
    """Lines that index errors by number: a slice with number ends of a matrix of errors, or any beyond the velocity."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Subscript):
            continue
        named = {part.id for part in ast.walk(node.value) if isinstance(part, ast.Name)}
        named |= {part.attr for part in ast.walk(node.value) if isinstance(part, ast.Attribute)}
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for part in parts:
            sliced = isinstance(part, ast.Slice)
            ends = [part.lower, part.upper] if sliced else [part]
            numbers = {end.value for end in ends if isinstance(end, ast.Constant) and isinstance(end.value, int)}
            if (sliced and numbers and named & OF_THE_LAYOUT) or numbers & BEYOND:
                found.append(f"{node.lineno}: {ast.unparse(node)}")
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_layout_is_used_by_name(room):
    paths = [SOURCE / room] if room.endswith(".py") else sorted((SOURCE / room).rglob("*.py"))
    assert paths
    for path in paths:
        if path != HOME and path.relative_to(SOURCE).as_posix() not in OTHER_LAYOUTS:
            assert raw_indices(path.read_text(encoding="utf-8")) == [], path


@pytest.mark.parametrize(
    "line",
    [
        "state.covariance[6:9, 6:9]",
        "np.diag(state.covariance)[17:23]",
        "delta[:3]",
        "x[12:15]",
        "A[3:, 20:23]",
        "h[23]",
    ],
)
def test_reader_finds_numbers(line):
    assert raw_indices(line)


@pytest.mark.parametrize("line", ["state.covariance[POSE, POSE]", "T[:3, :3]", "path.p_odom[-1]", "delta[GRAVITY]"])
def test_reader_leaves_names_and_poses_alone(line):
    assert not raw_indices(line)
