"""Decisions are functions of records: each gate by itself, the set together, the ledger and its file."""

import dataclasses

import numpy as np
import pytest
from slam_loops import Chain, loop

from heliograph.config import LoopConfig
from heliograph.errors import DataError, FormatError
from heliograph.lie import se3
from heliograph.slam.loops import REASONS, Ledger, judge, read_ledger, write_ledger

SHIFT = se3.exp([0.0, 0.0, 0.0, 3.0, 0.0, 0.0])


@pytest.fixture
def chain(rng):
    return Chain(120, rng)


@pytest.mark.parametrize(
    ("changes", "verdict", "reason"),
    [
        ({}, "held", "alone"),
        ({"status": "no overlap"}, "rejected", "no-pose"),
        ({"status": "refused"}, "rejected", "no-pose"),
        ({"odom_mahalanobis": 23.0}, "rejected", "odometry"),
        ({"odom_mahalanobis": float("nan")}, "rejected", "odometry"),
        ({"shift_up": 3.6}, "rejected", "twin"),
        ({"shift_level": 9.8}, "rejected", "twin"),
        ({"doubt_up": 1.0}, "rejected", "twin"),
        ({"doubt_level": 3.0}, "rejected", "twin"),
        ({"overlap_match": 0.2}, "rejected", "overlap"),
        ({"overlap_query": 0.2}, "rejected", "overlap"),
        ({"inliers": 0.5}, "rejected", "fit"),
        ({"blind": ("translation along x",)}, "rejected", "blind"),
        ({"blur_after": 1.2}, "rejected", "blur"),
        ({"blur_after": 0.5}, "held", "alone"),  # worse than an exact match, better than where odometry has it
        ({"lead": 1.05}, "held", "ambiguous"),
    ],
)
def test_each_gate_decides_by_itself(chain, changes, verdict, reason):
    decision = judge(loop(50, 3, chain.T_true, **changes))
    assert (decision.verdict, decision.reason) == (verdict, reason)
    assert REASONS[reason] in decision.text


def test_residuals_too_large_for_the_cubes_are_no_fit(chain):
    good = loop(50, 3, chain.T_true)
    bad = dataclasses.replace(good, residuals=dataclasses.replace(good.residuals, median=0.2))
    assert judge(bad).reason == "fit"


def ledger_of(chain, loops, config=None):
    ledger = Ledger(config)
    for evidence in loops:
        ledger.add(evidence, chain)
    return ledger


def verdicts(ledger):
    return [(e.decision.verdict, e.decision.reason) for e in ledger]


def test_first_loops_wait_for_the_third_which_brings_them_in(chain):
    loops = [loop(q, q - 47, chain.T_true) for q in (50, 53, 56)]
    ledger = Ledger()
    first = ledger.add(loops[0], chain)
    assert [(e.number, e.decision.verdict) for e in first] == [(0, "held")]
    ledger.add(loops[1], chain)
    assert [e.decision.verdict for e in ledger] == ["held", "held"]
    changed = ledger.add(loops[2], chain)
    assert [(e.number, e.decision.verdict) for e in changed] == [(k, "accepted") for k in range(3)]
    assert [e.number for e in ledger.accepted()] == [0, 1, 2]


def test_three_loops_of_one_query_are_no_sequence(chain):
    ledger = ledger_of(chain, [loop(50, m, chain.T_true) for m in (2, 3, 4)])
    assert {v for v, _ in verdicts(ledger)} == {"held"}


def test_false_loop_among_right_ones_is_held_out(chain):
    loops = [loop(q, q - 47, chain.T_true, off=SHIFT if q == 55 else None) for q in range(50, 60)]
    ledger = ledger_of(chain, loops)
    assert verdicts(ledger)[5] == ("held", "inconsistent")
    assert len(ledger.accepted()) == 9


def test_two_rival_sets_of_like_size_wait(chain):
    """Twin corridors: each set is consistent in itself, and nothing says which is true."""
    right = [loop(q, q - 47, chain.T_true) for q in range(50, 60, 2)]
    twin = [loop(q, q - 47, chain.T_true, off=SHIFT) for q in range(51, 61, 2)]
    ledger = ledger_of(chain, [x for pair in zip(right, twin, strict=True) for x in pair])
    assert ledger.accepted() == ()
    assert ("held", "rivals") in verdicts(ledger)


def test_sequence_must_cover_more_way_where_odometry_knows_less(chain):
    lost = 25.0 * np.eye(6)
    near = [loop(q, q - 47, chain.T_true, odom_covariance=lost) for q in (50, 53, 56)]
    assert ledger_of(chain, near).accepted() == ()
    far = near + [loop(q, q - 47, chain.T_true, odom_covariance=lost) for q in (59, 62, 65)]
    assert len(ledger_of(chain, far).accepted()) > 0


def test_ambiguous_loops_bring_nobody_in_but_follow(chain):
    unsure = [loop(q, q - 47, chain.T_true, lead=1.01) for q in (50, 53, 56)]
    ledger = ledger_of(chain, unsure)
    assert ledger.accepted() == ()
    for q in (59, 62, 65):
        ledger.add(loop(q, q - 47, chain.T_true), chain)
    assert len(ledger.accepted()) == 6


def test_accepted_loop_that_a_larger_set_contradicts_is_revoked(chain):
    false = [loop(q, q - 47, chain.T_true, off=SHIFT) for q in (50, 51, 52)]
    ledger = ledger_of(chain, false)
    assert len(ledger.accepted()) == 3  # alone, they look like a sequence
    for q in range(60, 70):
        ledger.add(loop(q, q - 50, chain.T_true), chain)
    assert verdicts(ledger)[:3] == [("revoked", "inconsistent")] * 3
    assert len(ledger.accepted()) == 10


def test_revoked_loop_stays_revoked_and_only_what_is_in_force_can_be(chain):
    ledger = ledger_of(chain, [loop(q, q - 47, chain.T_true) for q in range(50, 56)])
    assert ledger.revoke(2).decision.verdict == "revoked"
    ledger.judge_again(chain)
    assert ledger[2].decision.reason == "revoked-by-hand"
    with pytest.raises(DataError, match="loop 2 is revoked, not accepted"):
        ledger.revoke(2)
    with pytest.raises(DataError, match="there is no loop 9; the ledger has 0 to 5"):
        ledger.revoke(9)
    with pytest.raises(DataError, match="no reason"):
        ledger.revoke(1, "whim")


def test_loop_by_hand_is_accepted_and_not_taken_back_by_itself(chain):
    ledger = Ledger()
    ledger.add_by_hand(loop(50, 3, chain.T_true, off=SHIFT))
    for q in range(60, 70):
        ledger.add(loop(q, q - 50, chain.T_true), chain)
    assert verdicts(ledger)[0] == ("accepted", "by-hand")


def test_ledger_comes_back_from_its_file_to_the_same_bits(chain, tmp_path, rng):
    loops = [loop(q, q - 47, chain.T_true, noise=rng) for q in range(50, 56)]
    loops.append(loop(57, 3, chain.T_true, status="no overlap", score=float("nan"), blind=("a", "b")))
    ledger = ledger_of(chain, loops)
    write_ledger(tmp_path / "loops.csv", ledger)
    again = read_ledger(tmp_path / "loops.csv")
    write_ledger(tmp_path / "again.csv", again)
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "loops.csv").read_bytes()
    for a, b in zip(ledger, again, strict=True):
        assert a.decision == b.decision
        np.testing.assert_array_equal(a.evidence.T_match_query, b.evidence.T_match_query)
        np.testing.assert_array_equal(a.evidence.T_match_query_odom, b.evidence.T_match_query_odom)
        assert judge(b.evidence) == judge(a.evidence)
    more = loop(58, 11, chain.T_true)
    assert again.add(more, chain)[-1].decision == ledger.add(more, chain)[-1].decision


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda text: text.replace("verdict", "word"), "no loops.csv of this version"),
        (lambda text: text.replace("accepted", "welcome"), "line 2 is no loop"),
        (lambda text: text[: len(text) // 2], "is no loop|cannot be read"),
        (lambda text: text.replace("\n0,", "\n5,"), "number 5 where 0"),
    ],
)
def test_spoilt_file_is_named_with_its_line(chain, tmp_path, spoil, words):
    path = tmp_path / "loops.csv"
    write_ledger(path, ledger_of(chain, [loop(q, q - 47, chain.T_true) for q in range(50, 54)]))
    path.write_text(spoil(path.read_text()))
    with pytest.raises(FormatError, match=words):
        read_ledger(path)


def test_missing_file_is_one_line(tmp_path):
    with pytest.raises(FormatError, match="cannot be read"):
        read_ledger(tmp_path / "loops.csv")


def test_config_of_the_ledger_rules(chain):
    config = LoopConfig(min_sequence=0, min_clique=1, min_span=0.0)
    assert len(ledger_of(chain, [loop(50, 3, chain.T_true)], config).accepted()) == 1


def test_ledger_compares_a_new_loop_with_the_latest_only(chain):
    config, asked = LoopConfig(compared=4), []

    def relative(a, b):
        asked.append((a, b))
        return chain(a, b)

    ledger = Ledger(config)
    for q in range(50, 70):
        asked.clear()
        ledger.add(loop(q, q - 47, chain.T_true), relative)
    assert len(ledger.accepted()) == 20
    assert {b for _, b in asked if b >= 50} <= {66, 67, 68, 69}
