"""Runs are linked where they saw the same place, never where places look alike, and solved in one graph."""

from dataclasses import replace

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.config import RunConfig
from heliograph.errors import DataError
from heliograph.lie import se3, so3
from heliograph.merging import RunSession, find_links, merge_runs
from heliograph.revision import RunGraph
from heliograph.slam import KeyframeStore
from heliograph.slam.loops import Ledger

AWAY = se3.from_rotation_translation(so3.from_rpy(0.0, 0.0, 2.0), [30.0, -5.0, 1.0])


@pytest.fixture(scope="module")
def walk():
    return drifting_walk(position=0.003, rotation_deg=0.03)


def session(folder, keyframes, away=None, name="run"):
    """Return keyframes as a run that was never closed, in a frame of its own."""
    away = np.eye(4) if away is None else away
    store = KeyframeStore.create(folder / name)
    for index, keyframe in enumerate(keyframes):
        store.append(replace(keyframe, index=index, T_odom_imu=np.ascontiguousarray(away @ keyframe.T_odom_imu)))
    store.close()
    T = np.stack([store.T_odom_imu(k) for k in range(len(store))])
    run = RunGraph(
        folder=folder / name, config=RunConfig(), facts={}, store=store, ledger=Ledger(RunConfig().loops), T_map_imu=T
    )
    return RunSession(run, name)


def test_merge_links_runs_of_one_place_and_solves_them_together(walk, tmp_path):
    first = session(tmp_path, walk.keyframes[:30], name="first")
    second = session(tmp_path, walk.keyframes[41:61], AWAY, name="second")  # the same way, a lap later
    merged = merge_runs([first, second], tmp_path / "store")
    assert merged.apart == () and merged.revoked == 0
    assert [s.first for s in merged.sessions] == [0, 30] and merged.sessions[1].links >= 4
    T = merged.back_end.T_map_imu
    errors = [
        se3.log(se3.inverse(se3.inverse(walk.T_true[k]) @ walk.T_true[41 + k]) @ se3.inverse(T[k]) @ T[30 + k])
        for k in range(0, 20, 4)
    ]
    assert max(np.linalg.norm(e[3:]) for e in errors) < 0.03
    stamps = merged.back_end.chain.stamps_ns
    assert np.all(np.diff(stamps) > 0)


def test_merge_does_not_link_to_one_of_two_equal_places(walk, tmp_path):
    there = list(walk.keyframes[:12])
    away = np.eye(4)
    away[0, 3] = 200.0
    twin = [
        replace(k, T_odom_imu=np.ascontiguousarray(away @ k.T_odom_imu), stamp_ns=k.stamp_ns + 10**12) for k in there
    ]
    both = session(tmp_path, there + twin, name="both")
    here = session(tmp_path, walk.keyframes[41:51], AWAY, name="here")
    assert not [link for link in find_links(both, here) if link.decision.verdict == "accepted"]
    with pytest.raises(DataError, match="nothing links here to both for sure"):
        merge_runs([both, here], tmp_path / "store")


def test_merge_needs_two_runs(walk, tmp_path):
    with pytest.raises(DataError, match="name two at least"):
        merge_runs([session(tmp_path, walk.keyframes[:5])], tmp_path / "store")
