"""A mounting that no source gives: calibrated from the recording, or else what the turns tell."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from heliograph.calibration import align_mounting, mounting
from heliograph.calibration.observability import AXES, CalibratedAxis
from heliograph.config import RunConfig
from heliograph.data import Rig
from heliograph.errors import CalibrationError
from heliograph.lie import so3
from heliograph.sim import SCENARIOS, simulate


@pytest.fixture(scope="module")
def drive():
    simulation = simulate(SCENARIOS["room"].thinned(beams=16, columns=180, duration=6.0), 4)
    return list(simulation), simulation.rig.T_imu_lidar


def errors(rig, T):
    """Rotation's [rad] and lever arm's [m]."""
    turn = np.linalg.norm(so3.log(rig.T_imu_lidar[:3, :3].T @ T[:3, :3]))
    return float(turn), float(np.linalg.norm(rig.T_imu_lidar[:3, 3] - T[:3, 3]))


@pytest.mark.slow
def test_unknown_mounting_is_calibrated_within_its_sigma(drive):
    messages, T = drive
    alignment = align_mounting(lambda: iter(messages), RunConfig())
    turn, shift = errors(alignment.rig, T)
    assert alignment.rig.known and alignment.rig.source == "calibrated from the recording"
    assert turn < min(np.radians(0.1), 3.0 * alignment.rig.sigma_rotation)
    assert shift < min(0.02, 3.0 * alignment.rig.sigma_translation)
    (event,) = alignment.events
    assert event.code == "mounting-aligned" and "clock" not in event.message and "run.json" in event.message


ROUGH = Rig(T_imu_lidar=np.eye(4), source="turns", known=False, sigma_rotation=0.01, sigma_translation=0.3)


def answer(*, converged=True, sigma=1e-3, turn=0.01, offset=0.0):
    """What a calibration says, as far as it is asked."""
    T = np.eye(4)
    T[:3, :3] = so3.exp([turn, 0.0, 0.0])
    values = [turn, 0.0, 0.0, 0.0, 0.0, 0.0, offset, 0.0]
    axes = tuple(
        CalibratedAxis(name=name, value=value, sigma=sigma, prior_sigma=1.0, verdict="observed", remedy="")
        for name, value in zip(AXES, values, strict=True)
    )
    return Answer(converged=converged, axes=axes, rig=replace(ROUGH, T_imu_lidar=T), duration=12.0)


@dataclass(frozen=True)
class Answer:
    converged: bool
    axes: tuple
    rig: Rig
    duration: float


def told(monkeypatch, found):
    """Return the rig and the event where the calibration says ``found``, else what the turns' estimate would be."""
    turns = np.random.default_rng(1).uniform(-0.3, 0.3, (40, 3))
    monkeypatch.setattr(mounting, "_turns", lambda *_: (turns, turns, np.full(40, 0.5), 10**10, 0))
    monkeypatch.setattr(mounting, "_settled", lambda *_: replace(ROUGH, source="filter", known=True))

    def calibrate(stream, rig, config, *, threads):
        assert not rig.known and config.calibration.longest <= 30.0
        if isinstance(found, Exception):
            raise found
        return found

    monkeypatch.setattr(mounting, "calibrate", calibrate)
    alignment = align_mounting(lambda: iter(()), RunConfig())
    return alignment.rig, alignment.events[0].message


def test_what_a_calibration_finds_is_used_with_its_sigmas(monkeypatch):
    rig, message = told(monkeypatch, answer())
    assert rig.known and rig.source == "calibrated from the recording"
    assert rig.sigma_rotation == 1e-3 and rig.sigma_translation == 0.005
    assert "from 12 s" in message and "run.json" in message and "clock" not in message


def test_clock_that_is_off_is_told(monkeypatch):
    _, message = told(monkeypatch, answer(offset=-0.02))
    assert "clock 20.0 +- 1.0 ms early" in message and "heliograph calibrate" in message


@pytest.mark.parametrize("found", [
    answer(converged=False), answer(sigma=0.1), answer(turn=0.2), CalibrationError("they do not fit each other"),
])  # fmt: skip
def test_calibration_that_does_not_settle_leaves_what_the_filter_finds(monkeypatch, found):
    rig, _ = told(monkeypatch, found)
    assert rig.source == "filter"
    if not isinstance(found, Exception):  # the filter's answer turns by nothing: surer than that it is not
        assert rig.sigma_rotation == pytest.approx(max(float(np.linalg.norm(found.axes[0].value)), 0.01))
