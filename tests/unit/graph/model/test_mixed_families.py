"""Variables of several families in one graph: each moves in its own place."""

import numpy as np

from heliograph.graph import FactorGraph, Isotropic, Landmark, Prior, Values, solve
from heliograph.graph.problem.problem import Problem
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose


def _values(rng, n=3):
    values = Values()
    for first, group in enumerate((SO3, SE2, ExtendedPose, SO2, SE3)):
        values.insert(10 * first + np.arange(n), group.exp(rng.normal(size=(n, group.dof))))
    values.insert(100 + np.arange(n), rng.normal(size=(n, 2)))
    directions = rng.normal(size=(n, 3))
    values.insert(200 + np.arange(n), S2(directions / np.linalg.norm(directions, axis=1, keepdims=True)))
    values.insert(300, rng.normal(size=3))
    return values


def test_step_moves_every_family_in_its_own_place(rng):
    values, graph = _values(rng), FactorGraph()
    graph.add(Prior(300, [0.0, 0.0, 0.0], Isotropic(1.0)))
    problem = Problem(graph, values)
    step = rng.normal(size=problem.size)
    problem.native.set_step(step)
    problem.native.retract()
    problem.accept()
    moved, at = problem.values(), 0
    for family, count in zip(values.families(), values.counts(), strict=True):
        delta = step[at : at + count * family.dof].reshape(count, family.dof)
        before, after = (family.pack(v.block(family)[1]) for v in (values, moved))
        expected = family.pack_elements(family.retract(family.elements(before), delta))
        np.testing.assert_allclose(after, expected, atol=1e-12, err_msg=family.name)
        at += count * family.dof


def test_points_after_poses_are_solved(rng):
    truth = SE3.exp(rng.normal(size=(4, 6)))
    points = rng.normal(size=(6, 3))
    values, graph = Values(), FactorGraph()
    values.insert(np.arange(4), truth.retract(0.1 * rng.normal(size=(4, 6))))
    values.insert(10 + np.arange(6), np.zeros((6, 3)))
    values.insert(20, [7.0])
    i, j = (index.ravel() for index in np.meshgrid(np.arange(4), np.arange(6)))
    seen = (truth[i].inverse().matrix @ np.c_[points[j], np.ones(24)][:, :, None])[:, :3, 0]
    graph.add(Landmark(i, 10 + j, seen, Isotropic(0.1)))
    graph.add(Prior([0, 1], truth[:2], Isotropic(0.1)))
    graph.add(Prior(20, [8.0], Isotropic(0.1)))
    solution = solve(graph, values)
    np.testing.assert_allclose(solution.values.block(SE3)[1].matrix, truth.matrix, atol=1e-6)
    np.testing.assert_allclose(solution.values.block(3)[1], points, atol=1e-6)
    np.testing.assert_allclose(solution.values.at(20), [8.0], atol=1e-6)
