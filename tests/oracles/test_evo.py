"""Our trajectory errors against evo's, given the same poses at the same instants."""

import numpy as np
import pytest

from heliograph.data import Trajectory
from heliograph.lie import se3
from heliograph.metrics import absolute_trajectory_error, associate, relative_pose_error

evo_metrics = pytest.importorskip("evo.core.metrics", reason="evo needs Python 3.11 and is a test dependency")
evo_trajectory = pytest.importorskip("evo.core.trajectory", reason="needs evo: pip install 'heliograph[test]'")


def _pair(rng, n=250):
    t = np.arange(n) * 0.1
    # Steps of just over 1 m along an arc: ten steps are the first to exceed 10 m for every pose, evo's and ours alike.
    twist = np.array([0.0, 0.01, 0.03, 1.05, 0.0, 0.02])
    T = [se3.exp([0.2, -0.1, 0.4, 5.0, 3.0, 1.0])]
    for _ in range(n - 1):
        T.append(T[-1] @ se3.exp(twist))
    reference = Trajectory(stamps_ns=np.round(t * 1e9).astype(np.int64), T_frame_body=np.stack(T))
    drift = np.cumsum(rng.normal(size=(n, 6)) * 0.005, axis=0)
    T_estimate = se3.exp([0.3, 0.4, -1.0, 10.0, -4.0, 2.0]) @ se3.retract(reference.T_frame_body, drift)
    return associate(Trajectory(stamps_ns=reference.stamps_ns + 7_000_000, T_frame_body=T_estimate), reference)


def _evo(pair):
    paths = (pair.T_reference, pair.T_estimate)
    return tuple(
        evo_trajectory.PoseTrajectory3D(poses_se3=list(T), timestamps=pair.stamps_ns.astype(float) * 1e-9)
        for T in paths
    )


@pytest.mark.parametrize("mode", ["se3", "origin", "none"])
def test_absolute_error_agrees_with_evo(mode, rng):
    pair = _pair(rng)
    reference, estimate = _evo(pair)
    if mode == "se3":
        estimate.align(reference, correct_scale=False)
    elif mode == "origin":
        estimate.align_origin(reference)
    ours = absolute_trajectory_error(pair, mode=mode)
    for relation, values in (
        ("translation_part", {"rmse": ours.rmse, "mean": ours.mean, "median": ours.median, "max": ours.max}),
        ("rotation_angle_deg", {"rmse": ours.rotation_rmse_deg}),
    ):
        metric = evo_metrics.APE(evo_metrics.PoseRelation[relation])
        metric.process_data((reference, estimate))
        theirs = metric.get_all_statistics()
        for name, value in values.items():
            assert value == pytest.approx(theirs[name], abs=1e-6), (relation, name)


def test_relative_error_agrees_with_evo(rng):
    pair = _pair(rng)
    reference, estimate = _evo(pair)
    ours = relative_pose_error(pair, delta=10.0)
    for relation, value in (
        ("translation_part", ours.translation_rmse),
        ("rotation_angle_deg", ours.rotation_rmse_deg),
    ):
        metric = evo_metrics.RPE(
            evo_metrics.PoseRelation[relation], delta=10, delta_unit=evo_metrics.Unit.frames, all_pairs=True
        )
        metric.process_data((reference, estimate))
        assert len(metric.error) == ours.n
        assert value == pytest.approx(metric.get_all_statistics()["rmse"], abs=1e-6)
