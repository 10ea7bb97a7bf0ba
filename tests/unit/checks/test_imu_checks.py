"""What the inertial checks say of sound recordings and of each way to spoil one."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.checks import IMU_CHECKS, CheckReport, Finding, check_imu, worst
from heliograph.checks.arrangement import ARRANGEMENTS, name_of, remap
from heliograph.data import Rig
from heliograph.errors import DataError
from heliograph.lie import so3
from heliograph.sim import SCENARIOS
from imu_records import (
    clipped,
    jumped,
    made_records,
    matrix,
    on_accel,
    on_gyro,
    picked,
    shaken,
    shifted,
    stuck,
    without,
)

GAITS = {
    "walk": {},
    "run": {"frequency": 2.6, "bounce": 0.05, "lateral": 0.03, "roll_deg": 5.0, "pitch_deg": 4.0, "yaw_deg": 6.0},
    "cart": {"bounce": 0.0, "lateral": 0.0, "roll_deg": 0.2, "pitch_deg": 0.2, "yaw_deg": 0.0},
    "slow": {"frequency": 0.7, "bounce": 0.05, "lateral": 0.05, "roll_deg": 8.0, "pitch_deg": 8.0, "yaw_deg": 15.0},
    "planar": {"bounce": 0.0, "lateral": 0.0, "roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 3.0},
}
MOUNTS = {
    "drawn": {},
    "overhead": {"imu_rpy_deg": (180.0, 0.0, 0.0)},
    "tilted": {"rig_rpy_deg": (0.0, 30.0, 0.0), "imu_rpy_deg": (90.0, 0.0, 90.0), "lever_arm": (0.2, 0.3)},
}
IMUS = {"usual": {}, "cheap": {"gyro_noise": 2e-3, "accel_noise": 2e-2, "gyro_bias": 0.03}, "100 Hz": {"rate": 100.0}}


@pytest.fixture(scope="module")
def sound():
    return made_records(SCENARIOS["room"].thinned(duration=25.0), seed=1)


def findings(records, change=lambda imu: imu):
    imu, motion = records
    return {finding.code: finding for finding in check_imu(change(imu), motion)}


def wrong(found):
    return {code for code, finding in found.items() if finding.verdict in ("warn", "fail")}


# ------------------------------------------------------------------------------------------------- no false alarm


def test_every_check_finds_a_sound_recording_ok(sound):
    found = findings(sound)
    assert [finding.verdict for finding in found.values()] == ["ok"] * len(IMU_CHECKS)
    assert all(finding.evidence and not finding.remedy for finding in found.values())


@pytest.mark.parametrize(("place", "known"), [("room", True), ("warehouse", False), ("tunnel", True)])
@pytest.mark.parametrize("gait", GAITS)
def test_sound_recordings_raise_no_alarm(gait, place, known):
    number = list(GAITS).index(gait)
    mount, imu = list(MOUNTS.values())[number % 3], list(IMUS.values())[(number + known) % 3]
    begin = 6.0 if place == "warehouse" else 0.0  # one that starts in motion
    scenario = SCENARIOS[place].varied(gait=GAITS[gait], mount=mount, imu=imu, walk={"begin": begin})
    found = findings(made_records(scenario.thinned(duration=20.0), seed=100 + number, known=known))
    assert wrong(found) == set(), {code: found[code].evidence for code in wrong(found)}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("imu", IMUS)
@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("gait", GAITS)
def test_sound_recordings_raise_no_alarm_whatever_the_seed(gait, mount, imu, seed):
    place = ("room", "warehouse", "tunnel")[seed % 3]
    scenario = SCENARIOS[place].varied(gait=GAITS[gait], mount=MOUNTS[mount], imu=IMUS[imu])
    found = findings(made_records(scenario.thinned(duration=20.0), seed=seed))
    assert wrong(found) == set(), {code: found[code].evidence for code in wrong(found)}


# ---------------------------------------------------------------------------------------------------------- units


@pytest.mark.parametrize(
    ("scale", "unit"),
    [(1 / 9.80665, "in g"), (1e3 / 9.80665, "in mg"), (1e3, "in mm/s^2"), (1671.0, "no unit")],
)
def test_accelerometer_in_another_unit_is_named(sound, scale, unit):
    found = findings(sound, on_accel(scale * np.eye(3)))
    assert found["accel-unit"].verdict == "fail" and unit in found["accel-unit"].evidence
    assert worst(tuple(found.values())).code == "accel-unit"
    assert found["accel-axes"].verdict == found["gyro-axes"].verdict == "ok"  # one mistake, not two


def test_gravity_is_read_through_an_unfinished_step():
    shaky = SCENARIOS["warehouse"].varied(gait=GAITS["run"], walk={"begin": 6.0}, imu={"accel_bias": 0.0})
    found = findings(made_records(shaky.thinned(duration=15.0), seed=0))["accel-unit"]
    assert abs(found.numbers[0].value) < 0.15  # of an up and down of 13 m/s^2


def test_accelerometer_without_gravity_is_named(sound):
    found = findings(sound, lambda imu: replace(imu, accel=imu.accel - imu.accel.mean(axis=0)))
    assert found["accel-unit"].verdict == "fail" and "gravity is missing" in found["accel-unit"].evidence


@pytest.mark.parametrize(("scale", "unit"), [(180 / np.pi, "in deg/s"), (1e3, "in mrad/s"), (np.pi / 180, "no known")])
def test_gyroscope_in_another_unit_is_named(sound, scale, unit):
    found = findings(sound, on_gyro(scale * np.eye(3)))
    assert found["gyro-unit"].verdict == "fail" and unit in found["gyro-unit"].evidence
    assert worst(tuple(found.values())).code == "gyro-unit"
    assert found["gyro-axes"].verdict == found["mounting"].verdict == "ok"


def test_what_the_reader_converted_is_told_but_not_failed(sound):
    imu, motion = sound
    recorded = replace(
        on_accel(np.eye(3) / 9.80665)(on_gyro(np.eye(3) * 180 / np.pi)(imu)),
        accel_unit="g", accel_factor=9.80665, gyro_unit="deg/s", gyro_factor=np.pi / 180,
    )  # fmt: skip
    found = findings((recorded, motion))
    assert wrong(found) == {"accel-unit", "gyro-unit"}
    for code in wrong(found):
        assert found[code].verdict == "warn" and "the reader converts it" in found[code].evidence


@pytest.mark.parametrize(("scale", "verdict"), [(1.08, "warn"), (1.02, "ok"), (0.92, "warn")])
def test_gyroscope_scale_error_is_measured(sound, scale, verdict):
    found = findings(sound, on_gyro(scale * np.eye(3)))["gyro-unit"]
    assert found.verdict == verdict
    assert found.numbers[0].value == pytest.approx(scale - 1.0, abs=0.015)


# ----------------------------------------------------------------------------------------------------------- axes

MISTAKES = {
    "-x y z": "x reversed", "x -y z": "y reversed", "x y -z": "z reversed", "-x -y -z": "all axes reversed",
    "y x z": "x and y swapped", "x z y": "y and z swapped", "-x z y": "y and z swapped, x reversed",
    "-y x z": "x and y swapped, x reversed", "x -y -z": "y and z reversed", "y z x": "x, y, z carry y, z, x",
}  # fmt: skip


@pytest.mark.parametrize(("axes", "name"), MISTAKES.items())
def test_gyroscope_axes_are_named(sound, axes, name):
    found = findings(sound, on_gyro(matrix(axes)))
    assert found["gyro-axes"].verdict == "fail" and found["gyro-axes"].evidence.startswith(name)
    assert ("left-handed" in found["gyro-axes"].evidence) == (np.linalg.det(matrix(axes)) < 0)
    assert found["accel-axes"].verdict == found["gyro-unit"].verdict == "ok"
    assert found["imu-prediction"].verdict == "fail"
    assert worst(tuple(found.values())).code == "gyro-axes"


@pytest.mark.parametrize(("axes", "name"), MISTAKES.items())
def test_accelerometer_axes_are_named(sound, axes, name):
    found = findings(sound, on_accel(matrix(axes)))
    assert found["accel-axes"].verdict == "fail" and found["accel-axes"].evidence.startswith(name)
    assert found["gyro-axes"].verdict == found["accel-unit"].verdict == "ok"
    assert worst(tuple(found.values())).code == "accel-axes"


def test_reversed_gravity_is_told_as_such(sound):
    found = findings(sound, on_accel(-np.eye(3)))["accel-axes"]
    assert "reads g downwards" in found.evidence and "specific force" in found.remedy


@pytest.mark.parametrize(("axes", "remedy"), [("-y x z", "mounting is wrong"), ("-x y z", "no mounting can mend it")])
def test_mistake_of_both_sensors_is_the_mountings_unless_left_handed(sound, axes, remedy):
    found = findings(sound, lambda imu: on_gyro(matrix(axes))(on_accel(matrix(axes))(imu)))
    for code in ("gyro-axes", "accel-axes"):
        assert found[code].verdict == "fail" and remedy in found[code].remedy


@pytest.mark.parametrize("axes", ["-x y z", "y x z", "-x -y -z"])
def test_left_handed_gyroscope_is_told_without_a_mounting(axes):
    imu, motion = made_records(SCENARIOS["room"].thinned(duration=20.0), seed=3, known=False)
    found = findings((imu, motion), on_gyro(matrix(axes)))
    assert found["gyro-axes"].verdict == "fail" and "left-handed" in found["gyro-axes"].evidence
    assert findings((imu, motion))["gyro-axes"].verdict == "ok"


def test_reversed_yaw_of_a_planar_motion_is_named_with_its_doubt():
    scenario = SCENARIOS["warehouse"].varied(gait=GAITS["planar"], mount={"rotation_deg": (0.0, 0.0)})
    found = findings(made_records(scenario.thinned(duration=30.0), seed=2), on_gyro(matrix("x y -z")))["gyro-axes"]
    assert found.verdict == "fail"
    assert "z reversed (or one of 7 that this motion cannot tell from it)" in found.evidence


@pytest.mark.parametrize(("degrees", "verdict"), [(1.0, "ok"), (8.0, "warn"), (25.0, "fail")])
def test_wrong_mounting_rotation_is_measured(sound, degrees, verdict):
    imu, motion = sound
    T = motion.rig.T_imu_lidar.copy()
    T[:3, :3] = so3.exp(np.radians(degrees) * np.array([0.6, 0.0, 0.8])) @ T[:3, :3]
    found = findings((imu, replace(motion, rig=Rig(T_imu_lidar=T, source="tf_static"))))
    assert found["mounting"].verdict == verdict
    assert found["mounting"].numbers[0].value == pytest.approx(degrees, abs=0.05 * degrees + 0.5)
    assert found["gyro-axes"].verdict == found["accel-axes"].verdict == "ok"


@pytest.mark.parametrize(
    ("shift", "verdict"), [((0.5, 0.0, 0.0), "fail"), ((0.0, 0.2, 0.0), "warn"), ((0, 0, -1), "fail")]
)
def test_wrong_lever_arm_is_measured_and_nothing_else_is_blamed(sound, shift, verdict):
    imu, motion = sound
    T = np.array(motion.rig.T_imu_lidar)
    T[:3, 3] += shift
    motion = replace(motion, rig=replace(motion.rig, T_imu_lidar=T))
    found = findings((imu, motion))
    assert found["lever-arm"].verdict == verdict
    assert found["lever-arm"].numbers[0].value == pytest.approx(np.linalg.norm(shift), abs=0.05)
    assert wrong(found) <= {"lever-arm", "imu-prediction"}
    assert worst(tuple(found.values())).code == "lever-arm"


def test_lever_arm_is_not_told_where_nothing_turns(sound):
    scenario = SCENARIOS["room"].varied(gait=GAITS["cart"]).thinned(duration=15.0)
    assert findings(made_records(scenario, seed=1))["lever-arm"].verdict == "unknown"


def test_wrong_mounting_that_is_also_off_is_named_alike_by_both_sensors(sound):
    imu, motion = sound
    T = motion.rig.T_imu_lidar.copy()
    T[:3, :3] = matrix("y -x z") @ so3.exp(np.array([0.25, -0.2, 0.1])) @ T[:3, :3]
    found = findings((imu, replace(motion, rig=Rig(T_imu_lidar=T, source="file"))))
    for code in ("gyro-axes", "accel-axes"):
        assert found[code].evidence == "x and y swapped, x reversed, like the other sensor's"
    assert found["mounting"].verdict == "unknown"  # the axes come first


def test_arrangements_are_all_the_signed_permutations_named_apart():
    assert len({P.tobytes() for P in ARRANGEMENTS}) == len({name_of(P) for P in ARRANGEMENTS}) == 48
    assert np.array_equal(ARRANGEMENTS[0], np.eye(3)) and name_of(np.eye(3)) == ""
    changed = [np.count_nonzero(np.diag(P) != 1.0) for P in ARRANGEMENTS]
    assert changed == sorted(changed)  # of several possible ones the simplest is named
    assert np.array_equal(np.abs(np.linalg.det(ARRANGEMENTS)).round(12), np.ones(48))


def test_remap_undoes_the_mistake():
    P = matrix("-y z x")
    true = np.array([1.0, 2.0, 3.0])
    recorded = dict(zip("xyz", P @ true, strict=True))
    words = remap(P).partition("= (")[2].rstrip(")").split(", ")
    undone = [(-1.0 if word[0] == "-" else 1.0) * recorded[word[-1]] for word in words]
    assert np.allclose(undone, true)


# -------------------------------------------------------------------------------------------------------- signals


def test_vibration_is_named_with_its_frequency(sound):
    found = findings(sound, shaken(47.0, 5.0))["imu-vibration"]
    numbers = {number.name: number.value for number in found.numbers}
    assert found.verdict == "warn" and "at 47 Hz" in found.evidence
    assert numbers["accelerometer RMS"] == pytest.approx(5.0 / np.sqrt(2.0), rel=0.03)
    assert numbers["accelerometer peak"] == pytest.approx(47.0, abs=0.3)
    assert findings(sound, shaken(47.0, 20.0))["imu-vibration"].verdict == "fail"


def test_vibration_near_nyquist_may_be_folded(sound):
    folded = findings(sound, shaken(108.0, 5.0))["imu-vibration"]  # shows at 92 Hz of 100
    assert folded.verdict == "warn" and "folded" in folded.evidence and "low-pass" in folded.remedy
    assert folded.numbers[1].value == pytest.approx(92.0, abs=0.5)


@pytest.mark.parametrize(("change", "where"), [
    (clipped(gyro=0.8), "gyroscope"), (clipped(accel=11.5), "accelerometer"), (clipped(0.8, 11.5), "gyroscope"),
])  # fmt: skip
def test_saturation_is_named_with_its_end(sound, change, where):
    found = findings(sound, change)["imu-saturation"]
    assert found.verdict in ("warn", "fail") and where in found.evidence and found.stamps_ns
    assert ("11.5 m/s^2" in found.evidence) == ("accelerometer" in found.evidence)


def footfalls(height):
    """Blows of one sample, two a second, each of a height of its own."""

    def change(imu):
        rng, accel = np.random.default_rng(5), imu.accel.copy()
        at = np.arange(40, len(imu), max(1, round(0.5e9 / float(np.median(np.diff(imu.stamps_ns))))))
        accel[at, 2] += height * rng.uniform(0.3, 1.0, len(at))
        return replace(imu, accel=accel)

    return change


def test_single_samples_at_the_end_of_the_range_are_saturation(sound):
    limit = 4.0 * 9.80665

    def struck(imu):
        return clipped(accel=limit)(footfalls(60.0)(imu))

    found = findings(sound, struck)["imu-saturation"]
    assert found.verdict in ("warn", "fail") and "accelerometer z at +39.23" in found.evidence
    assert findings(sound, footfalls(60.0))["imu-saturation"].verdict == "ok"


def test_footfalls_are_told_from_a_motor(sound):
    found = findings(sound, footfalls(120.0))["imu-vibration"]
    assert found.verdict in ("warn", "fail") and "footfalls" in found.evidence and "motor" not in found.remedy
    assert "motor" in findings(sound, shaken(47.0, 5.0))["imu-vibration"].remedy


@pytest.mark.parametrize("hertz", [3.1, 21.7])
def test_crest_of_a_sine_on_a_coarse_grid_is_not_saturation(sound, hertz):
    def swung(imu):
        return replace(imu, accel=np.round(shaken(hertz, 30.0, axis=0)(imu).accel / 0.5) * 0.5)

    assert findings(sound, swung)["imu-saturation"].verdict == "ok"


def test_coarse_grid_alone_is_not_saturation(sound):
    def rounded(imu):
        return replace(imu, gyro=np.round(imu.gyro / 0.002) * 0.002, accel=np.round(imu.accel / 0.04) * 0.04)

    found = findings(sound, rounded)
    assert found["imu-saturation"].verdict == found["imu-channels"].verdict == "ok"


def test_rounded_values_are_told(sound):
    found = findings(sound, lambda imu: replace(imu, gyro=np.round(imu.gyro, 1)))["imu-channels"]
    assert found.verdict == "warn" and "coarse" in found.evidence and "0.1 rad/s" in found.evidence


@pytest.mark.parametrize(("sensor", "axis"), [("gyro", 1), ("gyro", 2), ("accel", 0)])
def test_stuck_axis_is_named(sound, sensor, axis):
    found = findings(sound, stuck(sensor, axis))
    name = {"gyro": "gyroscope", "accel": "accelerometer"}[sensor]
    assert found["imu-channels"].verdict == "fail" and f"{name} {'xyz'[axis]}" in found["imu-channels"].evidence
    assert worst(tuple(found.values())).code == "imu-channels"


def test_repeated_values_are_told(sound):
    def held(imu):
        index = np.arange(len(imu)) // 2 * 2
        return replace(imu, gyro=imu.gyro[index], accel=imu.accel[index])

    found = findings(sound, held)
    assert wrong(found) == {"imu-channels"} and "50 % of the samples repeat" in found["imu-channels"].evidence


# ---------------------------------------------------------------------------------------------- agreement in time


@pytest.mark.parametrize("late", [0.04, -0.0425, 0.1185])  # on the grid of the search and between
def test_clock_offset_is_measured(sound, late):
    found = findings(sound, shifted(late))
    assert found["clock-offset"].verdict == "warn"
    assert found["clock-offset"].numbers[0].value == pytest.approx(late, abs=1e-3)
    assert found["gyro-axes"].verdict == found["mounting"].verdict == "ok"  # compared at the offset found


def test_far_clock_offset_is_found_too(sound):
    found = findings(sound, shifted(2.5))["clock-offset"]
    assert found.verdict == "fail" and found.numbers[0].value == pytest.approx(2.5, abs=0.02)


def test_clocks_that_never_meet_are_told(sound):
    found = findings(sound, shifted(1000.0))
    assert found["clock-offset"].verdict == "fail" and "never stamped alike" in found["clock-offset"].evidence
    assert found["clock-offset"].numbers[0].value == pytest.approx(1000.0 - 25.0, abs=1.0)
    assert found["gyro-axes"].verdict == "unknown"


def test_gyroscope_of_another_body_is_told(sound):
    imu, motion = sound
    other = made_records(SCENARIOS["room"].varied(gait=GAITS["slow"]).thinned(duration=25.0), seed=9)[0]
    found = findings((imu, motion), lambda imu: replace(imu, gyro=other.gyro))
    assert found["gyro-axes"].verdict == "fail" and "whichever way round" in found["gyro-axes"].evidence
    assert found["accel-axes"].verdict == found["mounting"].verdict == "unknown"


def test_prediction_shares_separate_sound_from_spoilt(sound):
    sane = {number.name: number.value for number in findings(sound)["imu-prediction"].numbers}
    assert sane["rotation"] > 0.9 and sane["translation"] > 0.6 and sane["velocity"] > 0.65
    mirrored = findings(sound, on_gyro(matrix("-x -y -z")))["imu-prediction"]
    assert mirrored.numbers[0].name == "rotation" and mirrored.numbers[0].value < 0.4
    assert "gyroscope" in mirrored.remedy
    heavy = findings(sound, on_accel(-np.eye(3)))["imu-prediction"]
    assert heavy.verdict == "warn" and "accelerometer" in heavy.remedy


def test_prediction_is_named_only_where_nothing_else_is_wrong():
    cause = Finding(code="a", title="a", verdict="warn", evidence="x", remedy="y")
    effect = Finding(code="b", title="b", verdict="fail", evidence="x", remedy="z", consequence=True)
    assert worst((cause, effect)) is cause and worst((effect,)) is effect and worst(()) is None
    assert CheckReport(recording="r", findings=(cause, effect)).verdict == "fail"


# --------------------------------------------------------------------------------------------------------- report


def test_report_takes_the_worst_verdict_and_the_first_cause(sound):
    imu, motion = sound
    spoilt = jumped(12.0, 0.2)(on_gyro(matrix("-x y z"))(imu))
    report = CheckReport(recording="r", findings=check_imu(spoilt, motion))
    assert report.verdict == "fail" and worst(report.findings).code == "imu-clock"
    assert report.as_dict()["worst"]["remedy"] == worst(report.findings).remedy
    assert CheckReport(recording="r", findings=()).verdict == "unknown"


def test_findings_without_a_remedy_are_refused():
    with pytest.raises(DataError, match="remedy"):
        Finding(code="a", title="a", verdict="fail", evidence="x")
    with pytest.raises(DataError, match="verdict"):
        Finding(code="a", title="a", verdict="bad", evidence="x")


def test_imu_alone_is_checked_as_far_as_it_can_be(sound):
    found = {finding.code: finding for finding in check_imu(sound[0], None, "the recording holds no LiDAR")}
    comparing = {
        "gyro-unit", "gyro-axes", "accel-axes", "mounting", "lever-arm", "clock-offset", "imu-prediction",
    }  # fmt: skip
    assert {code for code, finding in found.items() if finding.verdict == "unknown"} == comparing
    assert all("the recording holds no LiDAR" in found[code].evidence for code in comparing)


def test_gap_is_told_and_does_not_spoil_the_rest(sound):
    found = findings(sound, without(8.0, 8.4))
    assert wrong(found) == {"imu-gaps"} and found["imu-gaps"].numbers[0].value == pytest.approx(0.41, abs=0.006)
    assert found["imu-gaps"].stamps_ns[0] == pytest.approx(sound[0].stamps_ns[0] + 8.0e9, abs=1e7)
    assert findings(sound, without(8.0, 9.5))["imu-gaps"].verdict == "fail"


def test_samples_that_are_missing_now_and_then_are_counted(sound):
    keep = np.flatnonzero(np.random.default_rng(5).random(len(sound[0])) > 0.03)
    found = findings(sound, lambda imu: picked(imu, keep))
    assert wrong(found) == {"imu-gaps"}
    assert found["imu-gaps"].numbers[1].value == pytest.approx(0.03, abs=0.008)
