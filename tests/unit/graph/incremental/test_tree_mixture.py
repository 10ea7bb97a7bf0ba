"""Everything at once: additions, removals, refusals, slices and marginalisation leave what the full smoother has."""

import numpy as np
import pytest

from heliograph.errors import UnderconstrainedError
from heliograph.graph import ISAM2, FactorGraph, ISAM2Settings, Isotropic, LinearMotion, Prior, Values

EXACT = ISAM2Settings(relinearize_threshold=0.0, wildfire=0.0)
F = np.array([[1.0, 0.1], [0.0, 0.98]])


def graph_of(*records):
    graph = FactorGraph()
    for record in records:
        graph.add(record)
    return graph


class Pair:
    """A smoother that is treated roughly, and one that keeps everything."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.full, self.kept = ISAM2(EXACT), ISAM2(EXACT)
        self.alive, self.factors, self.next = [], [], 0

    def motion(self, i, j):
        return LinearMotion(int(i), int(j), F[None], self.rng.normal(size=(1, 2)), Isotropic(0.3))

    def most(self):
        return [None, 3, 6, 15][self.rng.integers(4)]

    def update(self, scopes, graph, values=None):
        of_full = self.full.update(graph, values).factors
        of_kept = self.kept.update(graph, values, max_variables=self.most()).factors
        self.factors += [(f, k, s) for f, k, s in zip(of_full, of_kept, scopes, strict=True) if len(s) > 1]

    def grow(self):
        key, values = self.next, Values()
        self.next += 1
        values.insert(key, self.rng.normal(size=2))
        others = [int(self.rng.choice(self.alive)) for _ in range(min(len(self.alive), 2))]
        prior = Prior(key, self.rng.normal(size=(1, 2)), Isotropic(2.0))
        graph = graph_of(prior, *(self.motion(other, key) for other in others))
        self.update([(key,), *((other, key) for other in others)], graph, values)
        self.alive.append(key)

    def join(self):
        i, j = self.rng.choice(self.alive, 2, replace=False)
        self.update([(i, j)], graph_of(self.motion(i, j)))

    def remove(self):
        if self.factors:
            of_full, of_kept, _ = self.factors.pop(self.rng.integers(len(self.factors)))
            self.full.update(remove=[of_full])
            self.kept.update(remove=[of_kept], max_variables=self.most())

    def marginalize(self):
        out = set(self.rng.choice(self.alive, self.rng.integers(1, 4), replace=False).tolist())
        self.kept.marginalize(np.array(sorted(out)))
        self.alive = [key for key in self.alive if key not in out]
        self.factors = [factor for factor in self.factors if not out.intersection(factor[2])]

    def refuse(self):
        values = Values()
        values.insert(np.array([-1, -2]), np.zeros((2, 2)))
        with pytest.raises(UnderconstrainedError):
            self.kept.update(
                graph_of(self.motion(-1, -2), self.motion(self.alive[0], self.alive[-1])),
                values,
                max_variables=self.most(),
            )

    def check(self):
        self.kept.update()
        self.kept.update()
        keys = np.array(self.alive)
        np.testing.assert_allclose(self.kept.estimate(keys), self.full.estimate(keys), atol=1e-9, rtol=0)
        np.testing.assert_allclose(self.kept.joint(keys), self.full.joint(keys), atol=1e-9, rtol=0)


@pytest.mark.parametrize("seed", range(12))
def test_any_mixture_is_the_full_smoother(seed):
    pair = Pair(seed)
    for _ in range(100):
        if len(pair.alive) < 6:
            pair.grow()
            continue
        steps = (pair.grow, pair.join, pair.remove, pair.marginalize, pair.refuse, pair.check)
        steps[pair.rng.choice(6, p=[0.46, 0.17, 0.1, 0.12, 0.07, 0.08])]()
    pair.check()
