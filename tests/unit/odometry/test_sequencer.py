"""When a scan is ready: CONVENTIONS.md, Time."""

import numpy as np
import pytest

from heliograph.config import ImuConfig
from heliograph.data import GnssFix, ImuBatch, Scan
from heliograph.odometry.sequencer import ImuBuffer, Sequencer

MS = 1_000_000
BOTH, LIDAR, IMU = frozenset({"lidar", "imu"}), frozenset({"lidar"}), frozenset({"imu"})


def scan(start_ms, *, length_ms=100, received_ms=None):
    end = (start_ms + length_ms) * MS
    return Scan(
        stamp_ns=start_ms * MS,
        header_stamp_ns=start_ms * MS,
        received_ns=end if received_ms is None else received_ms * MS,
        end_ns=end,
        points=np.ones((2, 3), np.float32),
        offsets_ns=np.array([0, length_ms * MS], np.int32),
    )


def imu(*times_ms, received_ms=None):
    n = len(times_ms)
    return ImuBatch(
        stamps_ns=np.array(times_ms, np.int64) * MS,
        gyro=np.zeros((n, 3)),
        accel=np.zeros((n, 3)),
        received_ns=(times_ms[-1] if received_ms is None else received_ms) * MS,
    )


def fix(ms):
    return GnssFix(stamp_ns=ms * MS, received_ns=ms * MS, latitude_deg=0.0, longitude_deg=0.0, altitude=0.0)


def ends(packets):
    return [packet.end_ns // MS for packet in packets]


def test_scan_waits_for_a_sample_at_or_after_its_end():
    sequencer = Sequencer(BOTH)
    assert sequencer.add(imu(0, 50, 99)) == []
    assert sequencer.add(scan(0)) == []
    assert ends(sequencer.add(imu(100))) == [100]
    assert sequencer.finish() == []


def test_scan_that_comes_after_its_samples_is_ready_at_once():
    sequencer = Sequencer(BOTH)
    sequencer.add(imu(*range(0, 121, 10)))
    assert ends(sequencer.add(scan(0))) == [100]


def test_late_imu_is_waited_for_one_period_and_50_ms():
    sequencer = Sequencer(BOTH)
    sequencer.add(imu(0, 10, 20))
    sequencer.add(imu(30))  # the period is known now: 10 ms
    sequencer.add(scan(0))
    patience = round(1e3 * ImuConfig().patience) + 10
    assert patience == 60
    assert sequencer.add(fix(100 + patience)) == []
    assert ends(sequencer.add(fix(100 + patience + 1))) == [100]


def test_patience_is_a_setting():
    sequencer = Sequencer(BOTH, patience_ns=0)
    sequencer.add(imu(0, 10, 20))
    sequencer.add(imu(30))
    sequencer.add(scan(0))
    assert sequencer.add(fix(110)) == []
    assert ends(sequencer.add(fix(111))) == [100]


def test_patience_counts_from_the_reception_of_a_scan_that_comes_late():
    sequencer = Sequencer(BOTH)
    sequencer.add(imu(0, 10, 20))
    assert sequencer.add(scan(0, received_ms=5000)) == []
    assert sequencer.add(fix(5060)) == []
    assert ends(sequencer.add(fix(5061))) == [100]


def test_slow_imu_is_given_its_own_period():
    sequencer = Sequencer(BOTH)
    sequencer.add(imu(0))
    sequencer.add(imu(100))
    sequencer.add(scan(10, length_ms=95))
    assert sequencer.add(fix(105 + 150)) == []
    assert ends(sequencer.add(imu(200))) == [105]


def test_imu_that_never_comes_delays_scans_but_drops_none():
    sequencer = Sequencer(BOTH)
    packets = [packet for k in range(10) for packet in sequencer.add(scan(100 * k))]
    packets += sequencer.finish()
    assert ends(packets) == [100 * (k + 1) for k in range(10)]


def test_imu_that_starts_late_keeps_the_order():
    sequencer = Sequencer(BOTH)
    packets = [packet for k in range(3) for packet in sequencer.add(scan(100 * k))]
    packets += sequencer.add(imu(250, 260, 270))
    packets += sequencer.add(imu(310))
    assert ends(packets) == [100, 200, 300]


def test_first_scan_holds_back_the_second():
    sequencer = Sequencer(BOTH)
    sequencer.add(imu(0, 10))
    assert sequencer.add(scan(0)) == []
    assert sequencer.add(scan(100, received_ms=120)) == []
    assert ends(sequencer.add(imu(150))) == [100]
    assert ends(sequencer.add(imu(200))) == [200]


def test_without_imu_every_scan_is_ready_at_once_and_samples_are_ignored():
    sequencer = Sequencer(LIDAR)
    assert sequencer.add(imu(0, 10)) == []
    assert ends(sequencer.add(scan(0))) == [100]
    assert len(sequencer.imu) == 0


def test_stream_that_ends_releases_all():
    sequencer = Sequencer(BOTH)
    sequencer.add(imu(0))
    sequencer.add(scan(0, received_ms=10))
    sequencer.add(scan(100, received_ms=20))
    assert ends(sequencer.finish()) == [100, 200]
    assert sequencer.finish() == []


@pytest.mark.parametrize("again", [0, -500])
def test_scan_that_runs_backwards_is_left_out_with_one_event(again):
    sequencer = Sequencer(LIDAR)
    sequencer.add(scan(0))
    assert sequencer.add(scan(again)) == []
    (event,) = sequencer.events
    assert event.code == "scan-rewind"
    assert f"{-again / 1000:.3f} s before" in event.message
    assert ends(sequencer.add(scan(100))) == [200]


def test_imu_alone_is_cut_every_tenth_of_a_second():
    sequencer = Sequencer(IMU)
    assert sequencer.add(scan(0)) == []
    assert sequencer.add(imu(1000, 1050)) == []
    packets = sequencer.add(imu(1060, 1210, 1399))
    assert ends(packets) == [1100, 1200, 1300]
    assert all(packet.scan is None for packet in packets)
    assert ends(sequencer.add(imu(1400))) == [1400]


def test_buffer_gives_one_sample_on_either_side():
    buffer = ImuBuffer()
    buffer.append(imu(0, 10, 20))
    buffer.append(imu(30, 40))
    np.testing.assert_array_equal(buffer.between(12 * MS, 25 * MS).stamps_ns // MS, [10, 20, 30])
    np.testing.assert_array_equal(buffer.between(10 * MS, 20 * MS).stamps_ns // MS, [10, 20])
    np.testing.assert_array_equal(buffer.between(90 * MS, 95 * MS).stamps_ns // MS, [40])
    np.testing.assert_array_equal(buffer.between(-9 * MS, -5 * MS).stamps_ns // MS, [0])


def test_buffer_forgets_what_no_later_interval_needs():
    buffer = ImuBuffer()
    buffer.append(imu(*range(0, 1000, 10)))
    buffer.forget_before(555 * MS)
    assert buffer.everything().stamps_ns[0] == 550 * MS
    assert len(buffer) == 45
    np.testing.assert_array_equal(buffer.between(560 * MS, 565 * MS).stamps_ns // MS, [560, 570])


def test_buffer_takes_an_empty_batch():
    buffer = ImuBuffer()
    buffer.append(
        ImuBatch(stamps_ns=np.zeros(0, np.int64), gyro=np.zeros((0, 3)), accel=np.zeros((0, 3)), received_ns=0)
    )
    assert buffer.last_ns is None
    assert len(buffer.between(0, 10)) == 0
