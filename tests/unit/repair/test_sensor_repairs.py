"""What is mended of an IMU that is spoilt in one way, and that nothing is of one that is sound."""

from dataclasses import replace

import numpy as np
import pytest

from heliograph.checks.arrangement import ARRANGEMENTS
from heliograph.config import RunConfig
from heliograph.data import ImuBatch, ImuClock, Rig, Scan, SensorRepair
from heliograph.repair import RepairedSource, find, point_times
from heliograph.repair.find import sensor_repairs
from heliograph.sim import SCENARIOS, simulate
from imu_records import made_records

HALF_TURN = np.diag([1.0, -1.0, -1.0])
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def sound():
    scenario = SCENARIOS["room"].varied(gait={"roll_deg": 10.0, "pitch_deg": 8.0, "yaw_deg": 12.0, "bounce": 0.05})
    return made_records(scenario.thinned(duration=15.0), seed=3)


def batch_of(imu):
    return ImuBatch(stamps_ns=imu.stamps_ns, gyro=imu.gyro, accel=imu.accel, received_ns=int(imu.stamps_ns[-1]))


def repairs_of(records, *, gyro=None, accel=None, late=0.0):
    imu, motion = records
    batch = batch_of(imu)
    batch = replace(
        batch,
        gyro=batch.gyro if gyro is None else batch.gyro @ gyro.T,
        accel=batch.accel if accel is None else batch.accel @ accel.T,
        stamps_ns=batch.stamps_ns + round(1e9 * late),
    )
    return sensor_repairs(batch, motion, RunConfig())


def test_nothing_is_mended_of_a_sound_imu(sound):
    assert repairs_of(sound) == ([], False)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("place", ["room", "tunnel", "warehouse"])
def test_nothing_is_mended_of_sound_recordings(place, seed):
    records = made_records(SCENARIOS[place].thinned(duration=12.0), seed=200 + seed)
    assert repairs_of(records) == ([], False)


@pytest.mark.parametrize(
    ("code", "spoilt"),
    [
        ("accel-axes", {"accel": -np.eye(3)}),
        ("accel-unit", {"accel": np.eye(3) / 9.80665}),
        ("gyro-unit", {"gyro": np.eye(3) * 180e3 / np.pi}),
        ("gyro-axes", {"gyro": ARRANGEMENTS[1]}),
        ("imu-axes", {"gyro": np.diag([1.0, -1.0, 1.0]), "accel": np.diag([1.0, -1.0, 1.0])}),
        ("clock-offset", {"late": 0.3}),
        ("clock-offset", {"late": -2.5}),
    ],
)
def test_one_fault_is_mended_by_what_undoes_it(sound, code, spoilt):
    found, wrong = repairs_of(sound, **spoilt)
    assert [repair.code for repair in found] == [code] and not wrong
    repair = found[0]
    for name in ("gyro", "accel"):
        np.testing.assert_allclose(getattr(repair, name) @ spoilt.get(name, np.eye(3)), np.eye(3), atol=1e-9)
    assert repair.clock.offset == pytest.approx(spoilt.get("late", 0.0), abs=0.01)
    assert len(repair.sentence) > 40


def test_a_mirrored_cloud_is_no_fault_of_both_of_the_imus_sensors(sound):
    """Both could be turned to fit it: the map would be a mirror image that nothing contradicts."""
    mirror = np.diag([1.0, -1.0, 1.0])
    found, _ = repairs_of(sound, gyro=-mirror, accel=mirror)
    assert [repair.code for repair in found] == []


def test_units_that_are_too_alike_are_both_named(sound):
    """A thousandth of g and a centimetre per second squared differ by 2 %, as an accelerometer's scale may."""
    (found,), _ = repairs_of(sound, accel=np.eye(3) / 9.80665e-3)
    assert "mg" in found.sentence and "cm/s^2" in found.sentence
    np.testing.assert_allclose(found.accel, 9.80665e-3 * np.eye(3), rtol=0.021)


def test_a_unit_that_the_reader_has_converted_wrongly_is_put_right(sound):
    (found,), _ = repairs_of(sound, gyro=np.eye(3) * 1e3 * np.pi / 180.0)  # mrad/s, taken for deg/s
    np.testing.assert_allclose(found.gyro, np.eye(3) * 0.18 / np.pi, rtol=1e-9)


@pytest.mark.parametrize("turn", [HALF_TURN, QUARTER_TURN])
def test_a_turn_that_both_sensors_show_is_the_mountings_fault(sound, turn):
    found, wrong = repairs_of(sound, gyro=turn, accel=turn)
    assert found == [] and wrong


def test_a_small_offset_is_left_to_calibration(sound):
    assert repairs_of(sound, late=0.01) == ([], False)


@pytest.mark.parametrize("channel", ["gyro", "accel"])
def test_a_dead_channel_leaves_the_imu_out(sound, channel):
    imu, motion = sound
    dead = np.diag([1.0, 0.0, 1.0])
    batch = replace(batch_of(imu), **{channel: getattr(batch_of(imu), channel) @ dead})
    lost = find._useless(find._evidence(batch, motion, RunConfig()))
    assert lost.code == "imu-channels" and lost.without_imu and " y does not change" in lost.sentence
    assert find._useless(find._evidence(batch_of(imu), motion, RunConfig())) is None


@pytest.mark.parametrize("turn", [HALF_TURN, QUARTER_TURN])
def test_a_calibration_begins_at_the_turns_that_both_saw(sound, turn):
    imu, motion = sound
    spoilt = replace(batch_of(imu), gyro=batch_of(imu).gyro @ turn.T, accel=batch_of(imu).accel @ turn.T)
    start = find._by_turns(find._evidence(spoilt, motion, RunConfig()))[:3, :3]
    off = start.T @ turn @ motion.rig.T_imu_lidar[:3, :3]
    assert np.degrees(np.arccos(np.clip((np.trace(off) - 1.0) / 2.0, -1.0, 1.0))) < 3.0


def test_a_lever_arm_that_cannot_be_is_the_mountings_fault_and_calibrated_from_where_it_was_given(sound):
    imu, motion = sound
    T = np.array(motion.rig.T_imu_lidar)
    T[:3, 3] += [0.5, 0.0, 0.0]
    off = replace(motion, rig=replace(motion.rig, T_imu_lidar=T))
    assert sensor_repairs(batch_of(imu), off, RunConfig()) == ([], True)
    np.testing.assert_array_equal(find._by_turns(find._evidence(batch_of(imu), off, RunConfig())), T)


class Live:
    """A source of one batch."""

    rig = Rig(T_imu_lidar=np.eye(4), source="test")
    sensors = frozenset({"imu", "lidar"})
    repeatable = True
    events = ()

    def stream(self):
        stamps = np.arange(0, 1_000_000_000, 10_000_000, dtype=np.int64)
        ones = np.ones((len(stamps), 3))
        yield ImuBatch(stamps_ns=stamps, gyro=ones, accel=2.0 * ones, received_ns=int(stamps[-1]))

    def close(self):
        return


def test_a_repaired_source_passes_on_what_the_repairs_leave():
    mended = RepairedSource(Live(), [
        SensorRepair(code="accel-axes", sentence="x", accel=-np.eye(3)),
        SensorRepair(code="clock-offset", sentence="y", clock=ImuClock(offset=0.25)),
    ])  # fmt: skip
    (batch,) = mended.stream()
    assert np.all(batch.accel == -2.0) and np.all(batch.gyro == 1.0) and batch.stamps_ns[0] == -250_000_000
    assert [event.code for event in mended.events] == ["repaired-accel-axes", "repaired-clock-offset"]
    assert RepairedSource(Live(), [SensorRepair(code="g", sentence="z", without_imu=True)]).sensors == {"lidar"}


class Swept(Live):
    """A source of one scan."""

    def stream(self):
        offsets = np.array([0, 30_000_000, 100_000_000], dtype=np.int32)
        points = np.ones((3, 3), np.float32)
        yield Scan(stamp_ns=7, header_stamp_ns=7, received_ns=9, end_ns=8, points=points, offsets_ns=offsets)


def test_times_of_points_are_turned_round_within_the_sweep():
    (scan,) = RepairedSource(Swept(), [SensorRepair(code="point-times", sentence="", times_reversed=True)]).stream()
    assert scan.stamp_ns == 7 and scan.offsets_ns.tolist() == [100_000_000, 70_000_000, 0]


@pytest.mark.parametrize(
    ("as_recorded", "turned", "mended"),
    [(0.8, 0.0, True), (0.8, 0.2, False), (0.1, 0.0, False), (np.nan, 0.0, False), (0.8, np.nan, False)],
)
def test_times_are_turned_round_only_where_that_alone_agrees_with_the_imu(monkeypatch, as_recorded, turned, mended):
    shares = iter([as_recorded, turned])
    monkeypatch.setattr(point_times, "_contradicted", lambda *_: next(shares))
    found = point_times.reversed_point_times(Swept(), RunConfig())
    assert (found is not None and found.times_reversed) == mended


@pytest.mark.slow
@pytest.mark.parametrize(("backwards", "mended"), [(True, True), (False, False)])
def test_points_timed_backwards_are_told_by_the_imu(backwards, mended):
    gait = {"frequency": 1.1, "bounce": 0.08, "lateral": 0.1, "roll_deg": 18.0, "pitch_deg": 14.0, "yaw_deg": 22.0}
    scenario = SCENARIOS["room"].thinned(beams=16, columns=180, duration=10.0).varied(gait=gait)
    recording = simulate(scenario, seed=5)
    messages = list(recording)

    class Recorded(Live):
        rig = recording.rig

        def stream(self):
            turn = RepairedSource(self, [SensorRepair(code="", sentence="", times_reversed=True)]).mended
            yield from map(turn, messages) if backwards else messages

    assert (point_times.reversed_point_times(Recorded(), RunConfig()) is not None) == mended
