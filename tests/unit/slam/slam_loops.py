"""Chains of poses with true covariances, and loops on them."""

import numpy as np

from heliograph.lie import se3, so3
from heliograph.registration import ResidualDistribution
from heliograph.slam.loops import LoopEvidence

SIGMA_LOOP = np.repeat([0.005, 0.03], 3)


class Chain:
    """Odometry as a random walk about the truth; called, it gives relative pose and covariance."""

    def __init__(self, n, rng, *, sigma=1.0, turns=False, like=None):
        self.step = sigma * np.repeat([0.002, 0.01], 3)
        if like is not None:
            self.T_true = self.T = like.T_true
            return
        self.T_true, self.T = [np.eye(4)], [np.eye(4)]
        for _ in range(n - 1):
            yaw = rng.normal(0.0, 0.4) if turns else 0.1
            D = se3.from_rotation_translation(so3.from_rpy(0.02, 0.03, yaw), [1.0, 0.0, 0.05])
            self.T_true.append(self.T_true[-1] @ D)
            self.T.append(self.T[-1] @ D @ se3.exp(self.step * rng.normal(size=6)))

    def __call__(self, a, b):
        assert a < b
        S = np.zeros((6, 6))
        for k in range(a + 1, b + 1):
            J = se3.adjoint(se3.inverse(self.T[b]) @ self.T[k])
            S += J @ np.diag(self.step**2) @ J.T
        return se3.inverse(self.T[a]) @ self.T[b], S + 1e-12 * np.eye(6)


def loop(query, match, T_true, *, noise=None, sigma=SIGMA_LOOP, off=None, **changes):
    """Return good evidence for a loop, with changes; ``off`` moves the query in the world, as an alias would."""
    T = se3.inverse(T_true[match]) @ (np.eye(4) if off is None else off) @ T_true[query]
    T = T if noise is None else T @ se3.exp(sigma * noise.normal(size=6))
    fields = {
        "source": "place", "status": "converged", "covariance": np.diag(sigma**2), "overlap_query": 0.7,
        "overlap_match": 0.6, "inliers": 0.97, "blind": (), "weakest": 1e4, "T_match_query_odom": T,
        "odom_covariance": 0.01 * np.eye(6), "odom_mahalanobis": 4.0, "starts": 2, "agreeing": 2,
        "lead": float("inf"), "blur_before": 0.8, "blur_after": 0.05, "score": 0.6,
        "residuals": ResidualDistribution(rms=0.03, median=0.02, p90=0.05, p99=0.1, max=0.3, reduced_chi_square=1.2),
    }  # fmt: skip
    return LoopEvidence(query=query, match=match, T_match_query=T, **(fields | changes))
