"""GTSAM's iSAM2 on the graph of uneven weights: it aborts, ours does not (see `tests/unit/graph/test_replay.py`)."""

import numpy as np
import pytest

from heliograph.graph.files.worlds import uneven

gtsam = pytest.importorskip("gtsam", reason="needs GTSAM: pip install 'heliograph[oracles]'")


def odometry(world):
    """Replay the odometry alone: edge k - 1 leads to pose k."""
    theta = np.arctan2(world.T_i_j.matrix[:, 1, 0], world.T_i_j.matrix[:, 0, 0])
    smoother = gtsam.ISAM2(gtsam.ISAM2Params())
    for k in range(100):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
            values.insert(0, gtsam.Pose2())
        else:
            Z = gtsam.Pose2(*world.T_i_j.translation[k - 1], theta[k - 1])
            information = np.roll(world.information[k - 1], (-1, -1), axis=(0, 1))  # theirs has the rotation last
            graph.add(gtsam.BetweenFactorPose2(k - 1, k, Z, gtsam.noiseModel.Gaussian.Information(information)))
            values.insert(k, smoother.calculateEstimatePose2(k - 1).compose(Z))
        smoother.update(graph, values)


def test_gtsam_aborts_on_uneven_weights(rng):
    with pytest.raises(RuntimeError, match="Indeterminate"):
        odometry(uneven(rng))
