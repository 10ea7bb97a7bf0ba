"""Optima, robust costs and covariances of whole graphs are those of GTSAM's Python wheel."""

import numpy as np
import pytest

from heliograph.graph import (
    Between,
    FactorGraph,
    Huber,
    Information,
    Isotropic,
    Marginals,
    Prior,
    SolverSettings,
    Values,
    solve,
)
from heliograph.graph.files.worlds import manhattan

gtsam = pytest.importorskip("gtsam", reason="needs GTSAM: pip install 'heliograph[oracles]'")

ORDER = [1, 2, 0]  # our (theta, x, y) in GTSAM's order (x, y, theta)
SIGMA = 0.1
WIDTH = 1.345


def pose(T):
    return gtsam.Pose2(T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0]))


@pytest.fixture(params=[None, Huber(WIDTH)], ids=["squares", "huber"])
def both(request, rng):
    world = manhattan(300, rng)
    start = world.truth.retract(0.02 * rng.normal(size=(300, 3)))
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(300), start)
    graph.add(Between(world.i, world.j, world.T_i_j, Information(world.information), kernel=request.param))
    graph.add(Prior(0, world.truth[0], Isotropic(SIGMA)))
    noise = gtsam.noiseModel.Gaussian.Information(world.information[np.ix_(ORDER, ORDER)])
    if request.param is not None:
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(WIDTH), noise)
    theirs, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, T in enumerate(start.matrix):
        initial.insert(k, pose(T))
    for i, j, T in zip(world.i.tolist(), world.j.tolist(), world.T_i_j.matrix, strict=True):
        theirs.add(gtsam.BetweenFactorPose2(i, j, pose(T), noise))
    theirs.add(gtsam.PriorFactorPose2(0, pose(world.truth.matrix[0]), gtsam.noiseModel.Isotropic.Sigma(3, SIGMA)))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    optimum = gtsam.LevenbergMarquardtOptimizer(theirs, initial, parameters).optimize()
    return graph, values, theirs, initial, optimum


def test_costs_and_optimum(both):
    graph, values, theirs, initial, optimum = both
    solution = solve(graph, values, initial="given", settings=SolverSettings(relative_decrease=1e-12))
    assert solution.initial_cost == pytest.approx(2.0 * theirs.error(initial), rel=1e-9)
    assert solution.cost == pytest.approx(2.0 * theirs.error(optimum), rel=1e-5)


def test_marginals_and_joint_marginals(both):
    graph, values, theirs, initial, _ = both
    found = gtsam.Marginals(theirs, initial)
    marginals = Marginals(graph, values)
    for key in (0, 1, 150, 299):
        ours = marginals.covariance(key)
        np.testing.assert_allclose(ours[np.ix_(ORDER, ORDER)], found.marginalCovariance(key), rtol=1e-6, atol=1e-12)
    joint = found.jointMarginalCovariance([7, 200])
    ours = marginals.joint([7, 200])
    for a, i in enumerate((7, 200)):
        for b, j in enumerate((7, 200)):
            block = ours[3 * a : 3 * a + 3, 3 * b : 3 * b + 3][np.ix_(ORDER, ORDER)]
            np.testing.assert_allclose(block, joint.at(i, j), rtol=1e-6, atol=1e-9)
