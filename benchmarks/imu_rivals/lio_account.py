"""What a run of `lio` says of itself, one line of JSON."""

import json

import numpy as np

__all__ = ["report"]


def report(total: float, updates: list[float], covariances: list[float], error: np.ndarray, **more: str) -> None:
    """Print CPU seconds of the whole run, of updates and of covariances, and the error of the positions (N, 3)."""
    ms = 1e3 * np.array(updates)
    account = {"total_s": total, "median_ms": np.median(ms), "p99_ms": np.quantile(ms, 0.99), "max_ms": ms.max()}
    account |= {"covariance_ms": 1e3 * np.median(covariances), "rmse_m": np.sqrt((error**2).sum(axis=1).mean())}
    print(json.dumps({**{name: float(value) for name, value in account.items()}, **more}))
