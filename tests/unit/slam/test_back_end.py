"""The back-end on walks whose odometry drifts: it closes what was walked twice, and nothing else."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from tests.slam_worlds import drifting_walk

from heliograph.config import RunConfig
from heliograph.lie import se3
from heliograph.slam import BackEnd, KeyframeStore
from heliograph.slam.loops import Ledger, LoopDecision


def config(**slam):
    base = RunConfig()
    return replace(base, slam=replace(base.slam, loop_every=2, **slam), loops=replace(base.loops, apart=15))


@pytest.fixture(scope="module")
def walk():
    return drifting_walk()


@pytest.fixture(scope="module")
def closed(walk, tmp_path_factory):
    back_end = BackEnd(config(), KeyframeStore.create(tmp_path_factory.mktemp("keyframes")))
    updates = [*(back_end.add(keyframe) for keyframe in walk.keyframes), back_end.finish()]
    back_end.store.close()
    return back_end, updates


def true_relative(walk, loop):
    return se3.inverse(walk.T_true[loop.match]) @ walk.T_true[loop.query]


def test_back_end_closes_the_loop(walk, closed):
    back_end, _ = closed
    T_odom = back_end.chain.T_odom_imu
    assert back_end.closed
    assert walk.rmse(back_end.T_map_imu) < 0.6 * walk.rmse(T_odom)
    assert walk.error(back_end.T_map_imu) < 0.4 * walk.error(T_odom)


def test_every_accepted_loop_is_right(walk, closed):
    back_end, _ = closed
    for entry in back_end.ledger.accepted():
        off = se3.local(true_relative(walk, entry.evidence), entry.evidence.T_match_query)
        assert np.linalg.norm(off[3:]) < 0.1
        assert np.degrees(np.linalg.norm(off[:3])) < 1.0


def test_corrected_poses_lie_within_their_covariance(walk, closed):
    back_end, _ = closed
    T, keys = back_end.T_map_imu, range(10, len(walk.keyframes), 10)
    sigmas = []
    for index in keys:
        P = back_end.covariance(index)
        d = se3.local(walk.T_true[0] @ se3.inverse(T[0]) @ T[index], walk.T_true[index])
        sigmas.append(float(d @ np.linalg.solve(P, d)))
    assert np.mean(sigmas) < 12.0  # of six degrees of freedom each, all correlated


def test_map_moves_only_when_a_loop_is_closed(closed):
    _, updates = closed
    for update in updates:
        accepted = [entry for entry in update.loops if entry.decision.verdict == "accepted"]
        assert (update.moved > 0.0) == bool(accepted)
        assert any(event.code == "loop" for event in update.events) == bool(accepted)


def test_search_in_pieces_finds_what_it_finds_at_once(walk, closed, tmp_path):
    """A keyframe does little at a time; what waits is looked at later, and comes to the same places."""
    back_end = BackEnd(config(loop_pieces=1), KeyframeStore.create(tmp_path))
    later = [back_end.add(keyframe) for keyframe in walk.keyframes[:-5]]
    waiting = {k for update in closed[1] for k in update.candidates if k < len(walk.keyframes) - 5}
    begun = {k for update in later for k in update.candidates}
    assert begun < waiting  # the work is spread
    last = back_end.finish()
    back_end.store.close()
    assert begun | set(last.candidates) == waiting
    for entry in back_end.ledger.accepted():
        off = se3.local(true_relative(walk, entry.evidence), entry.evidence.T_match_query)
        assert np.linalg.norm(off[3:]) < 0.1


class Doubting(Ledger):
    """Refuses all, as odometry knows the way too badly, before a keyframe; then it judges."""

    until = 0

    def add(self, evidence, relative):
        if evidence.query < self.until and not self.accepted():
            return (self._enter(evidence, LoopDecision(verdict="rejected", reason="twin")),)
        return super().add(evidence, relative)


def test_keyframes_refused_before_the_way_was_known_are_looked_at_once_more(walk, closed, tmp_path):
    first = min(entry.evidence.query for entry in closed[0].ledger.accepted())
    ledger = Doubting(config().loops)
    ledger.until = first + 6
    back_end = BackEnd(config(), KeyframeStore.create(tmp_path), ledger=ledger)
    updates = [*(back_end.add(keyframe) for keyframe in walk.keyframes), back_end.finish()]
    back_end.store.close()
    looks = Counter(query for update in updates for query in update.candidates)
    assert max(looks.values()) == 2  # and no keyframe a third time
    found = {entry.evidence.query for entry in back_end.ledger.accepted()}
    assert min(found) < ledger.until and min(found) in {query for query, count in looks.items() if count == 2}
    assert np.linalg.norm(walk.error(back_end.T_map_imu)) < 2.0 * walk.error(closed[0].T_map_imu) + 0.02


def test_how_far_loops_moved_is_seen_from_the_first_keyframe(closed):
    back_end, _ = closed
    T, T_odom = back_end.T_map_imu, back_end.chain.T_odom_imu
    moved = np.linalg.norm(se3.act(T[0] @ se3.inverse(T_odom[0]), T_odom[:, :3, 3]) - T[:, :3, 3], axis=1)
    assert back_end.moved == pytest.approx(moved.max())
    assert back_end.account().moved == back_end.moved > 0.05


def test_without_loops_the_graph_is_the_odometry(walk, tmp_path):
    store = KeyframeStore.create(tmp_path)
    back_end = BackEnd(config(loops=False), store)
    for keyframe in walk.keyframes[:20]:
        update = back_end.add(keyframe)
        np.testing.assert_allclose(update.T_map_odom, np.eye(4), atol=1e-9)
    store.close()
    assert not back_end.closed
    np.testing.assert_allclose(back_end.T_map_imu, back_end.chain.T_odom_imu, atol=1e-9)


def test_replay_of_the_store_gives_the_same_map(closed):
    back_end, _ = closed
    again = BackEnd.replayed(config(), back_end.store, back_end.ledger)
    np.testing.assert_allclose(again.T_map_imu, back_end.T_map_imu, atol=2e-4)


def test_false_loop_by_hand_is_taken_back_by_the_solution(walk, tmp_path):
    store = KeyframeStore.create(tmp_path)
    back_end = BackEnd(config(), store)
    for keyframe in walk.keyframes:
        back_end.add(keyframe)
    back_end.finish()
    store.close()
    before = back_end.T_map_imu
    evidence = back_end.ledger.accepted()[-1].evidence
    wrong = evidence.T_match_query @ se3.exp(np.array([0.0, 0.0, 0.2, 1.5, 0.0, 0.0]))
    entry = back_end.ledger.add_by_hand(replace(evidence, T_match_query=np.ascontiguousarray(wrong)))
    back_end._enforce()
    assert back_end.ledger[entry.number].decision.verdict == "revoked"
    assert back_end.ledger[entry.number].decision.reason == "solve"
    np.testing.assert_allclose(back_end.T_map_imu, before, atol=2e-3)
