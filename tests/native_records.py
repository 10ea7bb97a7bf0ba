"""The law of factors that are evaluated natively: what tests of their records share."""

import numpy as np

from heliograph.graph import family_of
from heliograph.graph.model.families import stacked


def assert_record(record, variables, twin, tolerance=1e-6, exact=1e-10):
    """Residuals are the twin's, Jacobians its derivatives at large errors, and instances do not mix.

    `variables` are batches of values, one a variable; `twin` takes an instance's number and the arrays of its values.
    """
    arrays = [stacked(value)[0] for value in variables]
    families = [family_of(value) for value in variables]
    residual, jacobians = record.evaluate(*variables)
    assert residual.shape == (len(record), record.rows)
    for k in range(len(record)):
        mine = [array[k] for array in arrays]
        expected = np.atleast_1d(twin(k, *mine))
        np.testing.assert_allclose(residual[k], expected, rtol=0, atol=exact * max(1.0, np.abs(expected).max()))
        for a, family in enumerate(families):
            slope = slope_of(twin, k, mine, a, family)
            bound = tolerance * max(1.0, np.abs(slope).max())
            np.testing.assert_allclose(
                jacobians[a][k], slope, rtol=0, atol=bound, err_msg=f"instance {k}, variable {a}"
            )
        alone = part(record, [k]).evaluate(*[family.wrap(x[None]) for x, family in zip(mine, families, strict=True)])
        np.testing.assert_allclose(alone[0][0], residual[k], rtol=0, atol=1e-13 * max(1.0, np.abs(residual[k]).max()))


def slope_of(twin, k, mine, a, family, step=1e-3):
    """The derivative by variable a, by a five-point stencil."""
    columns = []
    for direction in np.eye(family.dof):

        def at(length, direction=direction):
            moved = [*mine[:a], family.retract(mine[a][None], length * direction[None])[0], *mine[a + 1 :]]
            return np.atleast_1d(twin(k, *moved))

        columns.append((8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step))
    return np.stack(columns, axis=1)


def part(record, rows, **changes):
    """Some factors of a record, with other parts where given."""
    parts = {
        name: getattr(record, name)
        for name in ("keys", "measurement", "measured", "rows", "noise", "kernel", "allowed")
    }
    parts["keys"], parts["measurement"] = record.keys[rows], record.measurement[rows].copy()
    return type(record).restored(**{**parts, **changes})
