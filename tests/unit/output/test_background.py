import threading

import numpy as np
import pytest

from heliograph.maps import GlobalMap
from heliograph.output.background import BackgroundMap


class SlowMap:
    """Notes who inserts what, and holds until it may go on."""

    def __init__(self):
        self.gate, self.seen, self.threads = threading.Event(), [], set()

    def insert(self, points_imu, intensity, T_map_imu):
        self.gate.wait(10.0)
        self.threads.add(threading.current_thread().name)
        self.seen.append(float(points_imu[0, 0]))
        if points_imu[0, 0] == 99.0:
            raise MemoryError("no room")

    def points(self):
        return np.array(self.seen)

    def intensity(self):
        return None


def cloud(value):
    return np.full((1, 3), value, np.float32)


def test_background_map_inserts_in_order_in_one_other_thread_and_reads_all():
    inner = SlowMap()
    background = BackgroundMap(inner)
    background.insert(cloud(0), None, np.eye(4))
    background.insert(cloud(1), None, np.eye(4))
    assert inner.seen == []  # both calls returned although nothing was inserted
    inner.gate.set()
    for value in range(2, 40):
        background.insert(cloud(value), None, np.eye(4))
    assert background.points().tolist() == list(range(40))
    assert len(inner.threads) == 1
    assert threading.current_thread().name not in inner.threads


def test_background_map_raises_a_failure_later():
    inner = SlowMap()
    inner.gate.set()
    background = BackgroundMap(inner)
    background.insert(cloud(99), None, np.eye(4))
    with pytest.raises(MemoryError, match="no room"):
        background.points()
    background.insert(cloud(2), None, np.eye(4))
    assert background.points().tolist() == [99, 2]


def test_background_map_gives_the_same_bits(rng):
    plain, background = GlobalMap(0.1), BackgroundMap(GlobalMap(0.1))
    for k in range(6):
        points, pose = rng.normal(size=(500, 3)).astype(np.float32), np.eye(4)
        pose[0, 3] = 0.1 * k
        for target in (plain, background):
            target.insert(points, points[:, 0].copy(), pose)
    assert plain.points().tobytes() == background.points().tobytes()
    assert plain.intensity().tobytes() == background.intensity().tobytes()
