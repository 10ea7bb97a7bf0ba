from dataclasses import replace

import numpy as np
import pytest

from heliograph.io.inference.clock_steps import ClockFollower
from heliograph.io.raw import RawCloud, RawImu

IMU, LIDAR = "/imu", "/points"
START = 1_700_000_000_000_000_000
PERIODS = {IMU: 5_000_000, LIDAR: 100_000_000}


def sample(ns, received=None):
    return RawImu(topic=IMU, received_ns=START + (received if received is not None else ns), stamp_ns=START + ns,
                  frame_id="imu", gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, 9.8))  # fmt: skip


def cloud(ns, received=None):
    columns = {name: np.ones(3, np.float32) for name in "xyz"}
    return RawCloud(topic=LIDAR, received_ns=START + (received if received is not None else ns), stamp_ns=START + ns,
                    frame_id="lidar", columns=columns)  # fmt: skip


def recorded(change):
    """Two seconds of both sensors in order; ``change(topic, ns)`` gives the stamp and the time of reception."""
    found = []
    for ns in range(0, 2_000_000_000, 5_000_000):
        found.append(sample(*change(IMU, ns)))
        if ns % 100_000_000 == 0:
            found.append(cloud(*change(LIDAR, ns)))
    return found


def follow(messages):
    clocks = ClockFollower(PERIODS)
    found = list(clocks.followed(iter(messages)))
    stamps = {topic: [m.stamp_ns - START for m in found if m.topic == topic] for topic in PERIODS}
    return stamps, clocks.events()


def test_sound_stamps_pass_untouched_and_in_order():
    messages = recorded(lambda _, ns: (ns, ns))
    clocks = ClockFollower(PERIODS)
    assert list(clocks.followed(iter(messages))) == messages and clocks.events() == []


@pytest.mark.parametrize("off", [3_600_000_000_000, -3_600_000_000_000])
@pytest.mark.parametrize("topic", [IMU, LIDAR])
def test_one_message_an_hour_off_is_left_out(topic, off):
    def change(name, ns):
        return (ns + off if name == topic and ns == 1_000_000_000 else ns, ns)

    stamps, events = follow(recorded(change))
    assert [event.code for event in events] == ["stamp-outlier"] and topic in events[0].message
    assert 1_000_000_000 not in stamps[topic] and len(stamps[topic]) == len(range(0, 2_000_000_000, PERIODS[topic])) - 1
    assert all(np.diff(stamps[topic]) > 0)


@pytest.mark.parametrize("step", [-2_003_700_000, -30_000_000_000, 1_000_000_000, 60_000_000_000, 3_600_000_000_000])
def test_a_clock_that_is_set_is_followed_by_both_sensors(step):
    stamps, events = follow(recorded(lambda _, ns: (ns + step if ns >= 1_000_000_000 else ns, ns)))
    assert [event.code for event in events] == ["clock-step"] * 2
    assert {event.severity for event in events} == {"error"}
    assert f"{step * 1e-9:+.3f} s" in events[0].message
    for topic, period in PERIODS.items():
        assert stamps[topic] == list(range(0, 2_000_000_000, period))


@pytest.mark.parametrize("step", [-500_000_000, -150_000_000, 150_000_000, 500_000_000])
@pytest.mark.parametrize("topics", [(IMU,), (LIDAR,), (IMU, LIDAR)])
def test_a_small_step_shows_where_no_queue_explains_it(topics, step):
    """Delivery takes 1 to 4 ms, and the recorder is held up for 0.3 s elsewhere."""
    rng = np.random.default_rng(1)

    def change(name, ns):
        received = ns + int(rng.integers(1_000_000, 4_000_000))
        if 1_300_000_000 < ns < 1_600_000_000:  # all at once, in their order
            received = 1_600_000_000 + ns // 1000
        return (ns + step if name in topics and ns >= 1_000_000_000 else ns, received)

    quick = {**PERIODS, LIDAR: 50_000_000}
    messages = [m for m in recorded(change) if m.topic in PERIODS]
    messages += [cloud(*change(LIDAR, ns)) for ns in range(50_000_000, 2_000_000_000, 100_000_000)]
    clocks = ClockFollower(quick)
    found = list(clocks.followed(iter(sorted(messages, key=lambda m: m.received_ns))))
    events = clocks.events()
    assert [event.code for event in events] == ["clock-step"] * len(topics)
    assert {event.message.split(":")[0] for event in events} == set(topics)
    for topic, period in quick.items():
        stamps = sorted(m.stamp_ns - START for m in found if m.topic == topic)
        np.testing.assert_allclose(stamps, range(0, 2_000_000_000, period), atol=4_000_000)


def test_messages_that_came_in_another_order_are_no_step():
    """Three that were held up by 0.15 s behind all others, then twelve."""
    late = {1_000_000_000 + k * 5_000_000 for k in range(3)} | {1_400_000_000 + k * 5_000_000 for k in range(9)}
    messages = recorded(lambda name, ns: (ns, ns + (150_000_000 if name == IMU and ns in late else 0)))
    stamps, events = follow(sorted(messages, key=lambda m: m.received_ns))
    assert events == [] and len(stamps[IMU]) == len([m for m in messages if m.topic == IMU])


def test_a_recorder_whose_clock_is_set_back_too_is_followed():
    step = -2_003_700_000

    def change(_, ns):
        return (ns + step, ns + step) if ns >= 1_000_000_000 else (ns, ns)

    stamps, events = follow(recorded(change))
    assert [event.code for event in events] == ["clock-step"] * 2
    for topic, period in PERIODS.items():
        assert np.diff(stamps[topic]).tolist() == [period] * (len(stamps[topic]) - 1)


def test_a_pause_is_no_step():
    messages = [m for m in recorded(lambda _, ns: (ns, ns)) if not 0 < m.stamp_ns - START - 500_000_000 < 10**9]
    stamps, events = follow(messages)
    assert events == [] and len(stamps[LIDAR]) == len([m for m in messages if m.topic == LIDAR])


def test_messages_held_up_in_a_queue_are_no_step():
    _, events = follow(recorded(lambda _, ns: (ns, ns + (900_000_000 if 500_000_000 < ns < 1_000_000_000 else 0))))
    assert events == []


def test_messages_that_a_queue_has_lost_are_no_step_of_the_clock():
    """They come late by up to two seconds, then the queue drops some and the rest comes in time again."""
    messages = [m for m in recorded(lambda _, ns: (ns, ns)) if not 500_000_000 < m.stamp_ns - START < 1_600_000_000]
    late = [replace(m, received_ns=max(m.received_ns, START + 1_590_000_000)) if m.stamp_ns > START + 400_000_000 else m
            for m in messages]  # fmt: skip
    clocks = ClockFollower(PERIODS)
    assert list(clocks.followed(iter(late))) == late and clocks.events() == []
