"""Graphs that grow: random walks with loops, landmarks and variables of other families, cut into steps."""

from dataclasses import dataclass, field

import numpy as np

from heliograph.graph import (
    Bearing,
    Between,
    Factor,
    FactorGraph,
    Isotropic,
    Landmark,
    LinearMotion,
    Position,
    Prior,
    Range,
    Values,
)
from heliograph.graph.problem.problem import Problem
from heliograph.lie import SE2, SE3, ExtendedPose

POINT, STATE, NAVIGATION = 10_000, 20_000, 30_000  # where the keys of the other families begin


class Offset2(Factor):
    """Own factor: difference of two planar poses' positions in the world, without derivatives."""

    variables = (SE2, SE2)
    rows = 2

    @staticmethod
    def residual(T_world_i, T_world_j, d_world):
        return T_world_j[:, :2, 2] - T_world_i[:, :2, 2] - d_world


class Offset3(Factor):
    """Own factor: difference of two spatial poses' positions in the world, without derivatives."""

    variables = (SE3, SE3)
    rows = 3

    @staticmethod
    def residual(T_world_i, T_world_j, d_world):
        return T_world_j[:, :3, 3] - T_world_i[:, :3, 3] - d_world


@dataclass
class Step:
    """What one update brings."""

    records: list = field(default_factory=list)
    values: Values = field(default_factory=Values)
    fixed: list = field(default_factory=list)
    spare: list = field(default_factory=list)  # which of the records can be removed again

    def graph(self):
        graph = FactorGraph()
        for record in self.records:
            graph.add(record)
        graph.fix(self.fixed)
        return graph


def growth(group, steps, rng, *, kernel=None, hold=True, others=True, sigma=0.05):
    """Return a list of steps, each with a new pose and sometimes more."""
    d, n = group.space, steps
    turn = np.zeros((n, group.dof))
    turn[:, -d] = 1.0
    turn[:, group.dof - d - 1] = rng.normal(0.0, 0.5, n)
    truth = [group.identity()]
    for k in range(1, n):
        truth.append(truth[-1] @ group.exp(turn[k]))
    Offset = Offset2 if group is SE2 else Offset3
    out = []

    def measured(i, j):
        return truth[i].inverse() @ truth[j] @ group.exp(rng.normal(0.0, sigma, group.dof))

    def relative(i, j):
        return Between(i, j, measured(i, j), Isotropic(sigma), kernel=kernel)

    def start(k):
        return truth[k] @ group.exp(rng.normal(0.0, sigma, group.dof))

    def seen(k, p):
        R = truth[k].matrix[:d, :d]
        return R.T @ (p - truth[k].matrix[:d, d]) + rng.normal(0.0, sigma, d)

    for k in range(n):
        step = Step()
        step.values.insert(k, start(k))
        if k == 0:
            step.fixed = [0] if hold else []
            step.records = [] if hold else [Prior(0, truth[0], Isotropic(0.1))]
        else:
            step.records.append(relative(k - 1, k))
        if k > 6 and k % 7 == 0:
            step.spare.append(len(step.records))
            step.records.append(relative(int(rng.integers(0, k - 3)), k))
        if others:
            _others(step, k, group, rng, truth, seen, Offset)
        out.append(step)
    return out


def _others(step, k, group, rng, truth, seen, Offset):
    d = group.space
    p = np.full(d, 2.0) * (k // 5)
    if k % 5 == 0:
        step.values.insert(POINT + k // 5, p + rng.normal(0.0, 0.1, d))
    if k % 5 in (0, 2):
        step.records.append(Landmark(k, POINT + k // 5, seen(k, p), Isotropic(0.1)))
    if k % 5 == 3:
        distance = np.linalg.norm(p - truth[k].translation) + rng.normal(0.0, 0.1)
        step.records.append(Range(k, POINT + k // 5, distance, Isotropic(0.1)))
        if np.linalg.norm(seen(k, p)) > 1.0 and group is SE2:
            from heliograph.lie import SO2

            v = seen(k, p)
            angle = np.array([np.arctan2(v[1], v[0])])
            step.records.append(Bearing(k, POINT + k // 5, SO2.exp(angle), Isotropic(0.1)))
    if k % 4 == 0:
        step.values.insert(STATE + k, rng.normal(size=4))
        step.records.append(Prior(STATE + k, rng.normal(size=4), Isotropic(1.0)))
        if k >= 4:
            F = np.eye(4) + 0.1 * rng.normal(size=(4, 4))
            step.records.append(LinearMotion(STATE + k - 4, STATE + k, F, rng.normal(size=4), Isotropic(0.5)))
    if k % 6 == 0:
        X = ExtendedPose.exp(0.1 * rng.normal(size=9))
        step.values.insert(NAVIGATION + k, X)
        step.records.append(Prior(NAVIGATION + k, X @ ExtendedPose.exp(0.05 * rng.normal(size=9)), Isotropic(0.1)))
        step.records.append(Position(NAVIGATION + k, rng.normal(size=3), Isotropic(1.0)))
        if k >= 6:
            Z = ExtendedPose.exp(0.1 * rng.normal(size=9))
            step.records.append(Between(NAVIGATION + k - 6, NAVIGATION + k, Z, Isotropic(2.0)))
    if k % 9 == 8:
        step.spare.append(len(step.records))
        offset = truth[k].translation - truth[k - 8].translation
        step.records.append(Offset(((k - 8), k), data=(offset,), noise=Isotropic(0.2)))


def whole(steps, leave_out=()):
    """Return the graph of several steps, without some of the factors by number."""
    graph, number = FactorGraph(), 0
    for step in steps:
        for record in step.records:
            assert len(record) == 1
            if number not in leave_out:
                graph.add(record)
            number += 1
        graph.fix(step.fixed)
    return graph


def starts(steps):
    """Return the starts of all variables of several steps."""
    values = Values()
    for step in steps:
        for key in step.values.keys().tolist():
            values.insert(key, step.values.at(key))
    return values


def gauss_newton_step(graph, values):
    """Return the values after one step on the whole graph."""
    problem = Problem(graph, values)
    problem.analyze()
    problem.linearize()
    assert problem.factorize(0.0, 0.0) is None
    problem.native.solve(0.0, 0.0)
    problem.native.retract()
    problem.accept()
    return problem.values()


def distance(a, b):
    """Return the largest difference between the numbers of two values with the same keys."""
    largest = 0.0
    for key in a.keys().tolist():
        x, y = a.at(key), b.at(key)
        x, y = (getattr(v, "matrix", v) for v in (x, y))
        largest = max(largest, float(np.abs(np.asarray(x) - np.asarray(y)).max()))
    return largest


def cliques_of(tree):
    """Return all that a native tree says of its cliques, as lists."""
    table = tree.clique_table()
    return [x.tolist() for x in (table.number, table.parent, table.pivots, table.sizes, table.variables, table.made)]
