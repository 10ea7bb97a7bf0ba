"""The chordal start by dense least squares: slow, obvious, one pose after another."""

import numpy as np


def rotations(n, i, j, R_i_j, weight, first):
    """Return R (n, d, d) that minimise sum w |R_j - R_i R_ij|^2 without constraint, then the nearest rotations."""
    d = len(first)
    A, b = [], []
    for a, c, Z, w in zip(i, j, R_i_j, weight, strict=True):
        block = np.zeros((d, n * d))
        block[:, c * d : (c + 1) * d] = np.eye(d)
        block[:, a * d : (a + 1) * d] = -Z.T
        A.append(np.sqrt(w) * block)
        b.append(np.zeros((d, d)))
    A, b = np.concatenate(A), np.concatenate(b)
    X = np.zeros((n * d, d))
    X[:d] = first.T
    X[d:] = np.linalg.lstsq(A[:, d:], b - A[:, :d] @ X[:d], rcond=None)[0]
    out = []
    for k in range(n):
        U, _, Vt = np.linalg.svd(X[k * d : (k + 1) * d].T)
        out.append(U @ np.diag([1.0] * (d - 1) + [np.linalg.det(U @ Vt)]) @ Vt)
    return np.array(out)


def translations(n, i, j, T_i_j, information, R, first):
    """Return t (n, d) that minimise the whitened R_ij' R_i' (t_j - t_i - R_i t_ij), the first held."""
    d = len(first)
    A, b = [], []
    for a, c, Z, omega in zip(i, j, T_i_j, information, strict=True):
        S = np.linalg.cholesky(omega).T @ Z[:d, :d].T @ R[a].T
        block = np.zeros((d, n * d))
        block[:, c * d : (c + 1) * d] = S
        block[:, a * d : (a + 1) * d] = -S
        A.append(block)
        b.append(S @ R[a] @ Z[:d, d])
    A, b = np.concatenate(A), np.concatenate(b)
    t = np.zeros(n * d)
    t[:d] = first
    t[d:] = np.linalg.lstsq(A[:, d:], b - A[:, :d] @ t[:d], rcond=None)[0]
    return t.reshape(n, d)
