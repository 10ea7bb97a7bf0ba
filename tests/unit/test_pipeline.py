import signal

import numpy as np
import pytest

from fakes import FakeOdometry, FakeRecording, make_result
from heliograph.cli.interrupt import EndedError
from heliograph.config import RunConfig
from heliograph.data import Event, ImuBatch, Scan
from heliograph.errors import DataError, OutputError
from heliograph.output import Sink
from heliograph.pipeline import run, sensors_in_use, thread_count


class Collector(Sink):
    def __init__(self):
        self.messages, self.results, self.summary = [], [], None

    def observe(self, message):
        self.messages.append(message)

    def add(self, result):
        self.results.append(result)

    def close(self, summary):
        self.summary = summary


class FullDisk(Collector):
    def add(self, result):
        super().add(result)
        if result.index == 3:
            raise OutputError("cannot write x: the disk is full")


@pytest.mark.parametrize("threads", [1, 2])
def test_run_hands_every_result_to_the_sinks_in_order(threads):
    sink = Collector()
    summary = run(FakeRecording(10), RunConfig(threads=threads), sinks=[sink], odometry=FakeOdometry())
    assert [result.index for result in sink.results] == list(range(10))
    assert summary.scans == 10 and summary.status == "ok" and sink.summary is summary
    assert len(sink.messages) == 20


def test_run_adds_up_distance_duration_and_gap():
    summary = run(FakeRecording(11), RunConfig(threads=1), odometry=FakeOdometry())
    assert summary.distance == pytest.approx(1.0)
    assert summary.duration == pytest.approx(1.0)
    assert summary.start_end_gap == pytest.approx(1.0)
    assert summary.stage_ms == pytest.approx({"match": 2.0, "update": 1.0})
    assert summary.weakest_eigenvalue == pytest.approx(0.2)


def test_run_leaves_out_the_sensor_that_is_not_asked_for():
    odometry = FakeOdometry()
    run(FakeRecording(3), RunConfig(threads=1, sensors="lidar"), odometry=odometry)
    assert odometry.seen and all(isinstance(message, Scan) for message in odometry.seen)
    odometry = FakeOdometry()
    with pytest.raises(DataError, match="no scan"):  # the fake gives nothing without scans
        run(FakeRecording(3), RunConfig(threads=1, sensors="imu"), odometry=odometry)
    assert all(isinstance(message, ImuBatch) for message in odometry.seen)


@pytest.mark.parametrize("threads", [1, 2])
def test_run_asked_to_stop_finishes_what_is_there(threads):
    sink, asked = Collector(), iter([False] * 9 + [True] * 100)
    recording = FakeRecording(50)
    summary = run(
        recording, RunConfig(threads=threads), sinks=[sink], odometry=FakeOdometry(), stop=lambda: next(asked)
    )
    assert summary.interrupted and recording.closed
    assert [result.index for result in sink.results] == list(range(5))
    assert "interrupted" in summary.reasons[-1]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), EndedError(signal.SIGTERM)])
def test_run_keyboard_interrupt_inside_the_odometry_still_closes_the_sinks(error):
    sink = Collector()
    odometry = FakeOdometry(fail_at=4, error=error)
    summary = run(FakeRecording(9), RunConfig(threads=1), sinks=[sink], odometry=odometry)
    assert summary.interrupted and summary.scans == 3 and sink.summary is summary


def test_run_full_disk_closes_every_sink_then_raises():
    broken, other = FullDisk(), Collector()
    with pytest.raises(OutputError, match="full"):
        run(FakeRecording(9), RunConfig(threads=1), sinks=[broken, other], odometry=FakeOdometry())
    assert broken.summary.scans == 4 and other.summary is broken.summary
    assert "full" in other.summary.failure


def test_run_defect_in_the_odometry_saves_first_and_then_raises_it():
    sink = Collector()
    with pytest.raises(ZeroDivisionError):
        run(
            FakeRecording(9),
            RunConfig(threads=1),
            sinks=[sink],
            odometry=FakeOdometry(fail_at=5, error=ZeroDivisionError("x")),
        )
    assert sink.summary.scans == 4


@pytest.mark.parametrize("field", ["covariance", "T_odom_imu", "v_odom", "points_imu"])
def test_run_stops_a_sink_that_writes_into_a_result(field):
    class Vandal(Collector):
        def add(self, result):
            getattr(result, field)[:] = 1e6

    with pytest.raises(ValueError, match="read-only"):
        run(FakeRecording(3), RunConfig(threads=1), sinks=[Vandal()], odometry=FakeOdometry())


def test_run_without_any_scan_is_an_error_that_names_info():
    with pytest.raises(DataError, match="heliograph info"):
        run(FakeRecording(0), RunConfig(threads=1), odometry=FakeOdometry())


def test_run_folds_warnings_of_recording_odometry_and_scans():
    class Noisy(FakeOdometry):
        def finish(self):
            self.events.append(Event(code="start", message="in motion"))
            return [make_result(i, events=(Event(code="gap", message="0.2 s"),)) for i in range(20, 23)]

    recording = FakeRecording(2)
    recording.events = [Event(code="late", message="3 late", count=3)]
    summary = run(recording, RunConfig(threads=1), odometry=Noisy())
    assert {event.code: event.count for event in summary.events} == {"late": 3, "start": 1, "gap": 3}


def test_run_names_the_weakest_scan_among_those_that_matched():
    class Varied(FakeOdometry):
        def finish(self):
            sets = {20: (0.3, 0.3, 0.4), 21: (0.1, 0.1, 0.8), 22: (0.2, 0.2, 0.6), 23: (0.0, 0.0, 0.0)}
            return [
                make_result(i, eigenvalues_translation=np.array(values), matches=0 if i == 23 else 40)
                for i, values in sets.items()
            ]

    summary = run(FakeRecording(2), RunConfig(threads=1), odometry=Varied())
    assert (summary.weakest_index, summary.weakest_eigenvalue) == (21, 0.1)


def test_run_turns_the_weakest_direction_with_the_map():
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    summary = run(FakeRecording(3), RunConfig(threads=1), odometry=FakeOdometry(T_leveled_odom=T))
    np.testing.assert_allclose(summary.weakest_direction, [0, 1, 0], atol=1e-12)
    np.testing.assert_array_equal(summary.T_map_odom, T)


def test_sensors_in_use_refuses_what_the_recording_lacks():
    recording = FakeRecording(1, sensors=frozenset({"lidar", "gnss"}))
    assert sensors_in_use(recording, RunConfig()) == {"lidar"}
    with pytest.raises(DataError, match="holds no imu"):
        sensors_in_use(recording, RunConfig(sensors="lidar,imu"))


def test_thread_count_zero_is_at_most_two():
    assert thread_count(RunConfig(threads=5)) == 5
    assert thread_count(RunConfig()) in (1, 2)
