"""The user's extrinsic file: every accepted form, and one line for every mistake."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heliograph.data import ImuClock, Rig
from heliograph.errors import ConfigError
from heliograph.io.files.extrinsic import read_extrinsic, write_extrinsic

R = Rotation.from_rotvec([0.3, -0.2, 1.4])
T = np.eye(4)
T[:3, :3], T[:3, 3] = R.as_matrix(), [0.1, -0.2, 0.3]
ROWS = R.as_matrix().tolist()
QUATERNION = R.as_quat().tolist()
TRANSLATION = "translation = [0.1, -0.2, 0.3]\n"


@pytest.mark.parametrize(
    "text",
    [
        f"[T_imu_lidar]\nrotation = {ROWS}\n{TRANSLATION}",
        f"[T_imu_lidar]\nrotation = {np.ravel(ROWS).tolist()}\n{TRANSLATION}",
        f"[T_imu_lidar]\nquaternion_xyzw = {QUATERNION}\n{TRANSLATION}",
        f"[T_imu_lidar]\nrotation = {QUATERNION}\n{TRANSLATION}",
        f"[T_imu_lidar]\nmatrix = {T.tolist()}\n",
        f"rotation = {ROWS}\n{TRANSLATION}",
    ],
    ids=["rotation", "flat rotation", "quaternion", "rotation as quaternion", "matrix", "no table"],
)
def test_extrinsic_is_read_in_every_form(tmp_path, text):
    (tmp_path / "e.toml").write_text(text)
    rig = read_extrinsic(tmp_path / "e.toml")
    np.testing.assert_allclose(rig.T_imu_lidar, T, rtol=0, atol=1e-12)
    assert rig.known
    assert rig.source.endswith("e.toml")


def test_extrinsic_rounded_in_the_file_becomes_a_rotation(tmp_path):
    (tmp_path / "e.toml").write_text(f"[T_imu_lidar]\nrotation = {np.round(R.as_matrix(), 4).tolist()}\n{TRANSLATION}")
    R_read = read_extrinsic(tmp_path / "e.toml").T_imu_lidar[:3, :3]
    np.testing.assert_allclose(R_read.T @ R_read, np.eye(3), rtol=0, atol=1e-14)
    np.testing.assert_allclose(R_read, R.as_matrix(), rtol=0, atol=2e-4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rotation = [", "is not TOML"),
        ("T_imu_lidar = 3\n", "is no table"),
        ("[T_imu_lidar]\nrotatoin = [1]\n", "unknown key 'rotatoin'; did you mean 'rotation'"),
        (f"[T_imu_lidar]\n{TRANSLATION}", "give 'matrix', or 'translation' with one of"),
        (f"[T_imu_lidar]\nmatrix = {T.tolist()}\n{TRANSLATION}", "give 'matrix', or 'translation' with one of"),
        (f"[T_imu_lidar]\nrotation = [1, 2]\n{TRANSLATION}", "'rotation' must be 3x3 finite numbers"),
        (f"[T_imu_lidar]\nrotation = ['a', 1]\n{TRANSLATION}", "'rotation' must be 3x3 finite numbers"),
        (f"[T_imu_lidar]\nquaternion_xyzw = [0, 0, 0, 2]\n{TRANSLATION}", "has length 2.000000"),
        (f"[T_imu_lidar]\nrotation = {np.diag([1.0, 1.0, -1.0]).tolist()}\n{TRANSLATION}", "is a mirror"),
        (f"[T_imu_lidar]\nrotation = {(1.01 * np.eye(3)).tolist()}\n{TRANSLATION}", "is no rotation"),
        (f"[T_imu_lidar]\nmatrix = {T.T.tolist()}\n", "last row of 'matrix' must be 0 0 0 1"),
        (
            "[T_imu_lidar]\nrotation = [0, 0, 0, 1]\ntranslation = [0, nan, 0]\n",
            "'translation' must be 3 finite numbers",
        ),
    ],
)
def test_extrinsic_mistakes_are_one_line(tmp_path, text, message):
    (tmp_path / "e.toml").write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        read_extrinsic(tmp_path / "e.toml")
    assert "e.toml" in str(caught.value)


def test_extrinsic_is_taken_from_an_earlier_runs_account(tmp_path):
    T = [[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]]
    path = tmp_path / "run.json"
    path.write_text(json.dumps({"status": "ok", "mounting": {"T_imu_lidar": T, "source": "aligned"}}))
    np.testing.assert_array_equal(read_extrinsic(path).T_imu_lidar, T)
    for text, message in (
        ("{}", "holds no mounting"),
        ("{", "is not JSON"),
        ('{"mounting": {"T_imu_lidar": 1}}', "4x4"),
    ):
        path.write_text(text)
        with pytest.raises(ConfigError, match=message):
            read_extrinsic(path)


def test_extrinsic_that_is_missing_is_a_config_error(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        read_extrinsic(tmp_path / "e.toml")


def test_written_extrinsic_is_read_back(tmp_path):
    clock = ImuClock(offset=0.0123456789, drift=-31.25e-6, reference_ns=1_750_000_000_123_456_789)
    write_extrinsic(tmp_path / "e.toml", Rig(T_imu_lidar=T, source="x", clock=clock), {"scans": 3}, header="one\ntwo")
    text = (tmp_path / "e.toml").read_text()
    assert text.startswith("# one\n# two\n")
    rig = read_extrinsic(tmp_path / "e.toml")
    np.testing.assert_allclose(rig.T_imu_lidar, T, rtol=0, atol=1e-12)
    assert rig.clock.offset == clock.offset
    assert rig.clock.drift == pytest.approx(clock.drift, rel=1e-12)
    assert rig.clock.reference_ns == clock.reference_ns


def test_extrinsic_without_a_clock_has_an_exact_one(tmp_path):
    (tmp_path / "e.toml").write_text(f"rotation = {ROWS}\n{TRANSLATION}")
    assert read_extrinsic(tmp_path / "e.toml").clock.exact


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("clock = 3\n", "'clock' is no table"),
        ("[clock]\nofset = 1.0\n", "unknown key 'ofset'; did you mean 'offset'"),
        ("[clock]\noffset = 'late'\n", "'offset' must be"),
        ("[clock]\ndrift_ppm = 3.0\n", "give 'reference_ns'"),
        ("[clock]\ndrift_ppm = 2e6\nreference_ns = 1\n", "none of a clock"),
        ("[clock]\nreference_ns = 1.5\n", "'reference_ns' must be a whole number"),
        ("[clok]\noffset = 1.0\n", "unknown key 'clok'; did you mean 'clock'"),
    ],
)
def test_extrinsic_clock_mistakes_are_one_line(tmp_path, text, message):
    before, after = (text, "") if text.startswith("clock") else ("", text)
    (tmp_path / "e.toml").write_text(f"{before}[T_imu_lidar]\nrotation = {ROWS}\n{TRANSLATION}{after}")
    with pytest.raises(ConfigError, match=message):
        read_extrinsic(tmp_path / "e.toml")
