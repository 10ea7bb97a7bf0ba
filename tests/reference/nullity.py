"""How many directions a graph leaves free: the slow way, by singular values of the whole whitened Jacobian."""

import numpy as np

from heliograph.graph.problem.problem import Problem


def dense_jacobian(graph, values):
    """Whitened Jacobian of all factors for the free variables, (rows, free scalars), rows scaled factor by factor."""
    problem = Problem(graph, values)
    problem.linearize()
    starts, dofs = problem.tangents(np.arange(len(values)))
    rows = []
    for index, group in enumerate(problem.groups):
        S = group.noise.sqrt_information
        for k in range(len(group.variables)):
            root = S[0 if group.noise.shared else k]
            if root.size == 1 or root.size == group.rows:
                root = np.diag(np.broadcast_to(root, group.rows))
            root = root.reshape(group.rows, group.rows)
            row = np.zeros((group.rows, problem.size))
            for a, v in enumerate(group.variables[k]):
                row[:, starts[v] : starts[v] + dofs[v]] = root @ problem.native.jacobians(index)[a][k]
            rows.append(row / max(np.abs(row).max(), 1e-300))
    free = np.ones(problem.size, dtype=bool)
    for v in problem.held:
        free[starts[v] : starts[v] + dofs[v]] = False
    return np.concatenate(rows)[:, free]


def nullity(graph, values, tolerance=1e-11):
    """Number of independent motions that no factor resists."""
    J = dense_jacobian(graph, values)
    strengths = np.linalg.svd(J, compute_uv=False)
    return J.shape[1] - int((strengths > tolerance * strengths[0]).sum())
