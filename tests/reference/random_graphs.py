"""Random factor graphs of mixed families for tests of the solvers: custom factors of any arity beside built-in ones."""

from functools import cache

import numpy as np

from heliograph.graph import Between, Factor, FactorGraph, Information, Isotropic, Prior, Values
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose

FAMILIES = (SE2, SE3, SO2, SO3, S2, ExtendedPose, 1, 2, 3, 5, 7, 8, 9)
DOFS = {SE2: 3, SE3: 6, SO2: 1, SO3: 3, S2: 2, ExtendedPose: 9}


def dof_of(family):
    return DOFS.get(family, family)


def random_value(family, count, rng):
    """Return a stack of `count` values of a family."""
    if isinstance(family, int):
        return rng.normal(size=(count, family))
    if family is S2:
        v = rng.normal(size=(count, 3))
        return S2(v / np.linalg.norm(v, axis=1, keepdims=True))
    return family.exp(0.7 * rng.normal(size=(count, DOFS[family])))


@cache
def given_factor(families, row_count):
    """Return a class of factors whose residual and Jacobians are data: any block of normal equations can be made."""

    class Given(Factor):
        variables = families
        rows = row_count

        @staticmethod
        def residual(*arguments):
            return arguments[len(families)]

        @staticmethod
        def jacobians(*arguments):
            return arguments[len(families) + 1 :]

    return Given


def random_information(dof, rng, batch=()):
    A = rng.normal(size=(*batch, dof, dof))
    return A @ np.swapaxes(A, -1, -2) + 0.3 * np.eye(dof)


def add_given(graph, keys, families, rng, kernel=None, copies=1):
    """Add `copies` parallel custom factors between variables, with random residuals and Jacobians."""
    rows = int(rng.integers(1, 7))
    kind = given_factor(tuple(families), rows)
    data = (rng.normal(size=(copies, rows)), *(rng.normal(size=(copies, rows, dof_of(f))) for f in families))
    columns = tuple(np.full(copies, key) for key in keys)
    noise = Isotropic(0.7) if rng.random() < 0.5 else Information(random_information(rows, rng))
    graph.add(kind(columns, data=data, noise=noise, kernel=kernel))


def random_graph(rng, *, variables, families, factors, kernels=(None,), held=0.1, components=1):
    """Return a graph and values of mixed families, determined by weak priors; no factor joins two components."""
    graph, values = FactorGraph(), Values()
    family_of = [families[k] for k in rng.integers(0, len(families), variables)]
    key_of = rng.permutation(10 * variables)[:variables]  # not dense, not ascending
    for key, family in zip(key_of, family_of, strict=True):
        values.insert(np.array([key]), random_value(family, 1, rng))
        noise = Isotropic(rng.uniform(1.0, 3.0))
        graph.add(
            Prior(np.array([key]), random_value(family, 1, rng), noise, kernel=kernels[rng.integers(len(kernels))])
        )
    component = rng.integers(0, components, variables)
    for _ in range(factors):
        first = int(rng.integers(variables))
        near = np.flatnonzero(component == component[first])
        scope = rng.permutation(near)[: rng.integers(1, 5)]
        kernel = kernels[rng.integers(len(kernels))]
        i, j = int(scope[0]), int(scope[-1])
        if i != j and family_of[i] == family_of[j] and family_of[i] is not S2 and rng.random() < 0.7:
            omega = Information(random_information(dof_of(family_of[i]), rng))
            measured = random_value(family_of[i], 1, rng)
            graph.add(Between(key_of[[i]], key_of[[j]], measured, omega, kernel=kernel))
        else:
            add_given(graph, key_of[scope], [family_of[k] for k in scope], rng, kernel, int(rng.integers(1, 3)))
    graph.fix(key_of[rng.random(variables) < held])
    return graph, values
