from dataclasses import replace

import numpy as np
import pytest

from heliograph.checks import RUN_CHECKS, Finding, RunEvidence, check_run
from heliograph.checks.inertial_watch import merged
from heliograph.checks.surfaces import Thickness
from heliograph.data import GraphAccount, StartAccount, WheelAccount

CODES = ("smeared-map", "degenerate-drift", "imu-start", "false-loop", "mounting-clock", "drift")


def wall(thick, **parts):
    seen = {"calm": thick, "turning": thick, "near": thick, "far": thick, **parts}
    return Thickness(whole=thick, cubes=100, stamp_ns=0, speed=1.0, **seen)


def finding(code, verdict):
    return Finding(code=code, title=code, verdict=verdict, evidence=f"seen of {code}", remedy=f"mend {code}")


def sound():
    return RunEvidence(
        walls=(wall(0.012),),
        inertial=(finding("clock-offset", "ok"), finding("mounting", "ok")),
        start=StartAccount(kind="static", verdict="good"),
        gyro_bias=np.full((2, 3), 0.002),
        accel_bias=np.full((2, 3), 0.05),
        level_sigma=np.radians(0.05),
        graph=GraphAccount(accepted=4, candidates=9, moved=0.1),
        distance=120.0,
        gap=0.05,
    )


def verdict(evidence, code):
    return next(found for found in check_run(evidence) if found.code == code)


def test_six_verdicts_of_a_sound_run_pass_each_with_a_number():
    found = check_run(sound())
    assert tuple(one.code for one in found) == CODES and len(RUN_CHECKS) == 6
    assert {one.verdict for one in found} == {"ok"}
    assert all(one.numbers and one.picture for one in found if one.code != "mounting-clock")


SPOILT = {
    "smeared-map": {"walls": (wall(0.2, calm=0.02),)},
    "degenerate-drift": {"blind": "scans 3 to 90 did not see x", "blind_growth": 0.4, "blind_share": 0.5},
    "imu-start": {"accel_bias": np.full((2, 3), 3.0)},
    "mounting-clock": {"inertial": (finding("gyro-axes", "fail"), finding("imu-prediction", "fail"))},
}
DOUBTFUL = {
    "smeared-map": {"walls": (wall(0.07),)},
    "imu-start": {"level_sigma": np.radians(2.0)},
    "false-loop": {"graph": GraphAccount(accepted=2, revoked=3, candidates=9)},
    "mounting-clock": {"inertial": (finding("clock-offset", "warn"),)},
    "drift": {"graph": GraphAccount(accepted=2, candidates=9, moved=4.0)},
}


@pytest.mark.parametrize(("code", "change", "expected"), [
    *((code, change, "fail") for code, change in SPOILT.items()),
    *((code, change, "warn") for code, change in DOUBTFUL.items()),
])  # fmt: skip
def test_one_fault_turns_its_own_verdict_only(code, change, expected):
    found = {one.code: one.verdict for one in check_run(replace(sound(), **change))}
    assert found.pop(code) == expected
    assert set(found.values()) == {"ok"}


def test_blind_stretch_names_the_wheels_that_hold_it_and_stays_a_fault():
    blind = replace(sound(), **SPOILT["degenerate-drift"])
    alone = verdict(blind, "degenerate-drift")
    for slips, scale, told in ((2, 1.03, True), (30, 1.03, False), (0, float("nan"), False)):
        wheels = WheelAccount(speeds=900, steps=40, slips=slips, scale=scale, scale_sigma=0.001)
        found = verdict(replace(blind, graph=replace(blind.graph, wheels=wheels)), "degenerate-drift")
        assert found.verdict == "fail"
        assert ("38 of 40 steps" in found.evidence and "follow the wheels" in found.remedy) == told
        assert told or found == alone


def test_walls_that_smear_in_turns_name_time_clock_and_mounting():
    assert "clock offset" in verdict(replace(sound(), **SPOILT["smeared-map"]), "smeared-map").remedy


def test_what_a_run_cannot_tell_is_said_not_passed():
    bare = RunEvidence(has_lidar=False, has_imu=False)
    assert {one.verdict for one in check_run(bare)} == {"unknown"}


def test_the_cause_stands_before_its_consequence():
    both = (finding("gyro-axes", "fail"), replace(finding("imu-prediction", "fail"), consequence=True))
    assert "gyro-axes" in verdict(replace(sound(), inertial=both), "mounting-clock").evidence


@pytest.mark.parametrize(("verdicts", "expected"), [
    (["fail"], "fail"), (["fail", "ok"], "fail"), (["fail", "ok", "ok"], "ok"),
    (["fail", "unknown", "unknown"], "fail"),
    (["unknown", "ok"], "ok"), (["fail", "fail", "ok", "ok"], "fail"), (["unknown"], "unknown"),
])  # fmt: skip
def test_windows_are_merged_to_what_half_of_them_bear_out(verdicts, expected):
    windows = [(finding("mounting", one),) for one in verdicts]
    assert [one.verdict for one in merged(windows)] == [expected]
