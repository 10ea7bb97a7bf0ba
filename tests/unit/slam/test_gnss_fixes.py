"""Satellite fixes on ways whose odometry drifts: what is believed, what is left out, and where the map comes to lie."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.gnss_worlds import absolute_error, georeferenced, survey

from heliograph.config import GnssConfig
from heliograph.data import GnssFix
from heliograph.sim.receiver import GnssSpell
from heliograph.slam.gnss.intake import FixIntake

QUIET = {"spells": ()}


def weights_of_bad(world, account):
    rows = {fix.stamp_ns: fix for fix in account.fixes}
    bad = world.log.stamps_ns[world.log.bad & world.log.valid]
    return np.array([rows[int(stamp)].weight for stamp in bad])


@pytest.fixture(scope="module")
def spoilt():
    world = survey("survey-campus", 3)
    return world, *absolute_error(world, *georeferenced(world))


def test_no_fix_of_a_bad_spell_is_believed(spoilt):
    world, _, _, account, _ = spoilt
    weights = weights_of_bad(world, account)
    assert len(weights) > 50
    assert weights.max() < 0.1


def test_sound_fixes_are_believed(spoilt):
    world, _, _, account, _ = spoilt
    sound = int((world.log.valid & (world.log.kinds == 0)).sum())
    assert account.counts["used"] > 0.98 * sound


def test_map_comes_to_lie_on_earth_within_its_sigmas(spoilt):
    _, rmse, heading, account, _ = spoilt
    assert rmse < 0.5
    assert heading < 4.0 * np.degrees(account.georeference.heading_sigma)
    assert np.degrees(account.georeference.heading_sigma) < 0.3


def test_carrier_phase_places_to_centimetres():
    world = survey("survey-campus-rtk", 4, duration=250.0)
    rmse, _, account, _ = absolute_error(world, *georeferenced(world))
    assert rmse < 0.06
    assert weights_of_bad(world, account).max(initial=0.0) < 0.1


@pytest.mark.parametrize("duration", [2.9, 5.5])
def test_without_motion_the_map_cannot_be_aligned(duration):
    world = survey("survey-campus", 5, gnss={"rate": 10.0, **QUIET}, duration=duration)
    fixes, smoother = georeferenced(world)
    account = fixes.account(smoother, world.chain.T_odom_imu)
    assert not fixes.in_use
    assert account.georeference is None
    assert "used" not in account.counts
    assert any(event.code == "gnss-cannot-align" and "CANNOT ALIGN" in event.message for event in fixes.events())


def test_majority_that_is_wrong_places_nothing():
    """Of 45 s, 20 lie in one reflection, and what is sound is the smaller part: no side is to be believed."""
    spells = (GnssSpell(kind="outage", duration=10.0), GnssSpell(kind="multipath", duration=18.0, size=15.0))
    world = survey("survey-campus", 21, gnss={"spells": spells}, duration=45.0)
    fixes, smoother = georeferenced(world)
    assert not fixes.in_use
    assert "do not (75% must)" in fixes.account(smoother, world.chain.T_odom_imu).reason


def test_what_all_fixes_speak_against_is_withdrawn():
    spells = (GnssSpell(kind="multipath", duration=18.0, size=15.0, start=25.0),)
    world = survey("survey-campus-rtk", 22, gnss={"spells": spells}, duration=45.0)
    fixes, smoother = georeferenced(world, until=24.0)
    assert fixes.in_use
    for fix in list(world.log.fixes()):
        if fix.stamp_ns > world.log.stamps_ns[0] + 24 * 10**9:
            fixes.observe(fix)
    changed = fixes.enforce(smoother, world.chain, (), inertial=True)
    assert changed
    assert not fixes.in_use
    assert fixes.account(smoother, world.chain.T_odom_imu).georeference is None


def test_receiver_that_claims_centimetres_is_weighed_by_its_noise():
    world = survey("survey-campus", 6, gnss={"reported_scale": 0.01, **QUIET}, duration=200.0)
    fixes, smoother = georeferenced(world)
    rmse, _, account, _ = absolute_error(world, fixes, smoother)
    assert 2.0 < account.noise_scale < 5.0  # of the floor, which is 0.3 m
    assert account.counts["used"] > 300
    assert rmse < 0.8
    assert any(event.code == "gnss-optimistic" for event in fixes.events())


def test_late_stamps_are_found_and_taken_out():
    world = survey("survey-campus-rtk", 7, gnss={"delay": 0.2, **QUIET}, duration=250.0)
    fixes, smoother = georeferenced(world)
    rmse, _, account, _ = absolute_error(world, fixes, smoother)
    assert account.delay == pytest.approx(0.2, abs=5.0 * account.delay_sigma)
    assert account.delay_sigma < 0.01
    assert rmse < 0.06


def test_antenna_that_nobody_gave_is_estimated():
    world = survey("survey-campus-rtk", 8, gnss=QUIET)
    _, _, account, _ = absolute_error(world, *georeferenced(world, antenna=None))
    off = np.abs(account.lever_arm - world.antenna)
    assert account.lever_arm_sigma[:2].max() < 0.1
    assert (off < 4.0 * account.lever_arm_sigma + 1e-3).all()


def test_slow_drift_of_a_receiver_widens_what_is_claimed():
    quiet = {"noise_horizontal": 0.1, "noise_vertical": 0.1, "bias_sigma": 0.5, "bias_time": 30.0, **QUIET}
    world = survey("survey-campus", 9, gnss=quiet, duration=300.0)
    _, _, account, off = absolute_error(world, *georeferenced(world))
    assert account.noise_scale > 1.5
    assert np.abs(off[-1]).max() < 3.0


def fix(k=0, **changes):
    base = {"stamp_ns": k, "received_ns": k, "latitude_deg": 52.0 + 1e-6 * k, "longitude_deg": 11.0, "altitude": 80.0}
    return GnssFix(**{**base, **changes})


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"latitude_deg": 0.0, "longitude_deg": 0.0}, "gnss-null"),
        ({"latitude_deg": float("nan")}, "gnss-bad"),
        ({"latitude_deg": 523.0}, "gnss-bad"),
        ({"latitude_deg": 48.0}, "gnss-far"),
    ],
)
def test_fixes_that_cannot_be_are_left_out_in_one_line(changes, code):
    intake = FixIntake(GnssConfig())
    intake.add(fix(0))
    intake.add(fix(1, **changes))
    assert intake.usable.tolist() == [0]
    (event,) = [event for event in intake.events() if event.code != "gnss-no-covariance"]
    assert event.code == code
    assert "\n" not in event.message


def test_frozen_receiver_is_left_out():
    intake = FixIntake(GnssConfig())
    for k in range(10):
        intake.add(fix(0, stamp_ns=k, received_ns=k))
    assert intake.usable.tolist() == [0]
    assert intake.events()[0].code == "gnss-frozen"


def test_covariance_is_never_below_the_floor():
    config, intake = GnssConfig(), FixIntake(GnssConfig())
    intake.add(fix(0, covariance_enu=np.diag([1e-6, 4.0, 1e-6]), solution="single"))
    P = intake.positions()[1][0]
    np.testing.assert_allclose(np.sqrt(np.diag(P)), [config.floor_single, 2.0, 1.5 * config.floor_single])


def test_fixes_without_covariance_are_told_once():
    intake = FixIntake(GnssConfig())
    for k in range(3):
        intake.add(fix(k))
    (event,) = intake.events()
    assert event.code == "gnss-no-covariance"
    assert "\n" not in event.message


def test_fixes_of_another_clock_place_nothing_and_the_clock_is_named():
    world = survey("survey-campus", 23, gnss=QUIET, duration=60.0)
    log = world.log
    late = replace(world, log=SimpleNamespace(stamps_ns=log.stamps_ns, fixes=lambda: map(an_hour_later, log.fixes())))
    fixes, smoother = georeferenced(late)
    assert not fixes.in_use
    reason = fixes.account(smoother, world.chain.T_odom_imu).reason
    assert "clock" in reason
    assert "\n" not in reason


def an_hour_later(fix):
    return replace(fix, stamp_ns=fix.stamp_ns + 3600 * 10**9)
