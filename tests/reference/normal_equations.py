"""Slow, obvious twin of the sparse solver: the normal equations of a flattened graph as one dense matrix."""

import numpy as np


def square_roots(noise, rows, count):
    """Return the square root information S (N, rows, rows) of each factor, from the native layout."""
    numbers = np.broadcast_to(noise.sqrt_information, (count, noise.sqrt_information.shape[1]))
    if noise.form == 2:
        return numbers.reshape(count, rows, rows)
    return np.broadcast_to(numbers, (count, rows))[:, :, None] * np.eye(rows)


def assemble(problem):
    """Return H (D, D) and g (D,) over all tangents, and the cost, at the values a problem was linearised at."""
    H, g, cost = np.zeros((problem.size, problem.size)), np.zeros(problem.size), 0.0
    for index, group in enumerate(problem.groups):
        S = square_roots(group.noise, group.rows, len(group.variables))
        r = np.einsum("nij,nj->ni", S, problem.native.residuals(index)[0])
        J = S @ np.concatenate(problem.native.jacobians(index), axis=2)
        length = np.linalg.norm(r, axis=1)
        weight = np.ones(len(r)) if group.kernel is None else group.kernel.weight(length)
        cost += float(np.sum(length**2 if group.kernel is None else 2.0 * group.kernel.cost(length)))
        starts = problem.tangents(group.variables.astype(np.int64).reshape(-1))[0].reshape(group.variables.shape)
        at = np.concatenate(
            [s[:, None] + np.arange(f.dof) for s, f in zip(starts.T, group.families, strict=True)], axis=1
        )
        np.add.at(H, (at[:, :, None], at[:, None, :]), np.einsum("n,nri,nrj->nij", weight, J, J))
        np.add.at(g, at, np.einsum("n,nri,nr->ni", weight, J, r))
    return H, g, cost


def free_scalars(problem):
    """Return which scalars (D,) of the tangents are estimated."""
    free = np.ones(problem.size, dtype=bool)
    for start, dof in zip(*problem.tangents(problem.held), strict=True):
        free[start : start + dof] = False
    return free


def damped(H, damping, floor):
    """Return H with its diagonal raised by Marquardt's damping."""
    return H + damping * np.diag(np.maximum(np.diag(H), floor))


def solve_slowly(H, b, free):
    """Return x of H x = b by a dense Cholesky factorisation of the free part; zero where held."""
    x = np.zeros_like(b)
    L = np.linalg.cholesky(H[np.ix_(free, free)])
    x[free] = np.linalg.solve(L.T, np.linalg.solve(L, b[free]))
    return x


def inverse_slowly(H, free):
    """Return the dense inverse over all scalars; zero where held."""
    out = np.zeros_like(H)
    out[np.ix_(free, free)] = np.linalg.inv(H[np.ix_(free, free)])
    return out
