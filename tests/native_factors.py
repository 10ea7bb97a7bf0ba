"""Elements of every family, and the native factors called with them: what the tests of factors share."""

import numpy as np

from heliograph import _core
from heliograph.lie import s2
from reference import factors as twin


def turn(manifold, angle, rng, scale=1.0):
    """A tangent vector of the given angle and of translations around ``scale``."""
    d = rng.normal(size=twin.DOF[manifold]) * scale
    if manifold in (twin.SO2, twin.SE2):
        d[0] = angle * rng.choice([-1, 1])
    else:
        d[:3] *= angle / np.linalg.norm(d[:3])
    return d


def element(manifold, dof, rng, scale=10.0):
    if manifold == twin.VECTOR:
        return rng.normal(size=dof) * scale
    if manifold == twin.S2:
        return s2.project(rng.normal(size=3))
    return twin.GROUPS[manifold].exp(turn(manifold, rng.uniform(0, 3.1), rng, scale))


def evaluate(kind, families, xs, zs, *, form=twin.SCALAR, S=1.0, shared=True, kernel=0, width=1.0, **more):
    """Call the native side: ``xs`` is one list of elements a factor; ``families`` (manifold, dof) a variable."""
    n = len(xs)
    packed = [np.stack([twin.pack(m, x[a]) for x in xs]) for a, (m, _) in enumerate(families)]
    variables = np.arange(n * len(families), dtype=np.int32).reshape(len(families), n).T.copy()
    z = [twin.pack(families[0][0], z) if kind in (twin.PRIOR, twin.BETWEEN) else np.atleast_1d(z) for z in zs]
    empty = np.empty(0)
    return _core.testing.evaluate_factors(
        kind,
        np.array([(m, d, n) for m, d in families], dtype=np.int64),
        np.concatenate([p.ravel() for p in packed]),
        variables,
        more.get("rows", 0),
        np.concatenate([*z, empty]).astype(np.float64),
        form,
        shared,
        np.atleast_1d(S).astype(np.float64).ravel(),
        kernel,
        width,
        more.get("weight", empty),
        more.get("shift", empty),
        more.get("custom", empty),
    )
