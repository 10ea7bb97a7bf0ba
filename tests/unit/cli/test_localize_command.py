"""`heliograph localize`: what it writes, and one line for each thing that is no map."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.cli.main import main
from heliograph.io.files.clouds import write_cloud
from heliograph.io.files.tum import read_tum
from heliograph.lie import se3, so3
from heliograph.slam import KeyframeStore

LAP = 40


@pytest.fixture(scope="module")
def walk():
    return drifting_walk()


def others(folder, keyframes, T):
    """Write clouds, their times and poses, as another system leaves them."""
    (folder / "Scans").mkdir(parents=True)
    for number, keyframe in enumerate(keyframes):
        write_cloud(folder / "Scans" / f"{number:06d}.pcd", keyframe.points_imu)
    np.savetxt(folder / "times.txt", 1e9 + np.arange(len(keyframes)), fmt="%.3f")
    np.savetxt(folder / "poses.txt", T[:, :3].reshape(-1, 12), fmt="%.9f")
    return folder


@pytest.fixture(scope="module")
def run(walk, tmp_path_factory):
    """Return the folder of a run over the first lap, by poses of another system."""
    top = tmp_path_factory.mktemp("first")
    first = others(top / "clouds", walk.keyframes[:LAP], walk.T_true[:LAP])
    words = ["run", str(first), "--odometry", str(first / "poses.txt"), "-o", str(top / "run"), "--quiet", "--no-loops"]
    assert main(words) == 0
    return top / "run"


@pytest.fixture(scope="module")
def second(walk, tmp_path_factory):
    """Return a recording of some of the second lap, in an odom frame of its own."""
    away = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, 2.0), [3.0, -5.0, 0.2])
    T = away @ walk.T_true[LAP + 2 : LAP + 10]
    return others(tmp_path_factory.mktemp("second") / "clouds", walk.keyframes[LAP + 2 : LAP + 10], T)


def localize(second, saved_map, *words):
    return ["localize", second, "--odometry", second / "poses.txt", "--map", saved_map, *words]


def test_localize_writes_poses_in_the_maps_frame(call, walk, run, second, tmp_path):
    code, out, _ = call(*localize(second, run, "-o", "there"))
    assert code == 0 and "localised after 2.0 s" in out and "status: ok" in out
    T = read_tum(tmp_path / "there" / "trajectory.tum").T_frame_body
    # The run's own frame begins at its first keyframe.
    T_run = read_tum(run / "trajectory.tum").T_frame_body[0]
    true = T_run @ se3.inverse(walk.T_true[0]) @ walk.T_true[LAP + 4 : LAP + 10]
    assert len(T) == 6 and np.abs(T[:, :3, 3] - true[:, :3, 3]).max() < 0.05
    facts = json.loads((tmp_path / "there" / "run.json").read_text())
    assert [span["state"] for span in facts["states"]] == ["not localised", "localised"]
    rows = (tmp_path / "there" / "localization.csv").read_text().splitlines()
    assert len(rows) == 9 and rows[1].split(",")[1] == "not localised"
    code, _, errors = call(*localize(second, run, "-o", "there"))
    assert code == 2 and "--overwrite" in errors


def test_localize_in_a_map_of_another_place_is_an_answer(call, second, tmp_path):
    rng = np.random.default_rng(3)
    walls = rng.uniform(size=(20_000, 3)) * [40.0, 30.0, 0.02]
    upright = np.column_stack(
        [rng.uniform(size=(20_000, 1)) * 40.0, np.full(20_000, 9.0), rng.uniform(size=20_000) * 3.0]
    )
    write_cloud(tmp_path / "map.ply", np.concatenate([walls, upright]).astype(np.float32))
    code, out, _ = call(*localize(second, tmp_path / "map.ply"))
    assert code == 0 and "never localised" in out
    assert "status: lost" in out


@pytest.mark.parametrize(
    ("scale", "words"), [(1e3 * 1e3, "millimetres"), (1e-3, "kilometres")], ids=["millimetres", "kilometres"]
)
def test_localize_says_that_a_map_is_of_another_unit(call, second, tmp_path, scale, words):
    points = np.random.default_rng(0).uniform(size=(2000, 3)) * [40.0, 30.0, 3.0] * scale
    write_cloud(tmp_path / "map.ply", points.astype(np.float32))
    code, _, errors = call(*localize(second, tmp_path / "map.ply"))
    assert code == 2 and words in errors and len(errors.splitlines()) == 1


def test_localize_says_that_a_store_is_of_another_version(call, run, second, tmp_path):
    copy = shutil.copytree(run, tmp_path / "copy")
    journal = copy / "keyframes" / "journal.jsonl"
    lines = journal.read_text().splitlines()
    journal.write_text("\n".join([json.dumps({**json.loads(lines[0]), "version": 99}), *lines[1:]]) + "\n")
    code, _, errors = call(*localize(second, copy))
    assert code == 2 and "version 99" in errors and len(errors.splitlines()) == 1


def test_localize_says_that_gravity_of_a_run_is_not_up(call, run, second, tmp_path):
    copy = shutil.copytree(run, tmp_path / "copy")
    old = list(KeyframeStore.open(copy / "keyframes"))
    new = KeyframeStore.create(copy / "keyframes")
    for keyframe in old:
        new.append(replace(keyframe, g_odom=np.array([9.8, 0.0, 0.0])))
    new.close()
    code, _, errors = call(*localize(second, copy))
    assert code == 2 and "gravity leans 90 deg" in errors and len(errors.splitlines()) == 1


@pytest.mark.parametrize("pose", ["1,2,3", "a,b,c,d", "1,2,nan,0", ""])
def test_localize_says_what_a_start_pose_is(call, run, second, pose):
    code, _, errors = call(*localize(second, run, "--start-pose", pose))
    assert code == 2 and "x,y,z,yaw" in errors and len(errors.splitlines()) == 1


@pytest.mark.parametrize(("name", "words"), [("none.ply", "is not there"), ("map.jpg", "is no map")])
def test_localize_says_what_a_map_is(call, second, tmp_path, name, words):
    if name == "map.jpg":
        (tmp_path / name).write_text("x")
    code, _, errors = call(*localize(second, tmp_path / name))
    assert code == 2 and words in errors and len(errors.splitlines()) == 1


def test_localize_extends_a_copy_of_the_map(call, run, second, tmp_path):
    before = {path: path.read_bytes() for path in sorted((run / "keyframes").iterdir())}
    code, out, _ = call(
        *localize(second, run, "-o", "there", "--extend", "wider", "--set", "slam.keyframe_distance=0.5")
    )
    assert code == 0 and "48 keyframes in one map" in out
    facts = json.loads((tmp_path / "wider" / "run.json").read_text())
    assert [session["linked"] for session in facts["sessions"]] == [True, True]
    assert {path: path.read_bytes() for path in sorted((run / "keyframes").iterdir())} == before


def test_localize_extends_no_cloud_and_not_the_map_itself(call, run, second, tmp_path):
    write_cloud(tmp_path / "map.ply", np.zeros((10, 3), np.float32))
    for saved_map, to in ((tmp_path / "map.ply", "wider"), (run, run)):
        code, _, errors = call(*localize(second, saved_map, "--extend", to))
        assert code == 2 and "--extend" in errors and len(errors.splitlines()) == 1
