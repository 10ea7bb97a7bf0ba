"""Fit the weights of `global_evidence.log_odds`: python -m benchmarks.global_evidence_fit KEYFRAMES WORK."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.global_pairs import keyframe_pairs, simulated_pairs, write_global_pairs
from benchmarks.registration_pairs import pose_error
from heliograph.config import AlignConfig, GlobalAlignConfig
from heliograph.registration import prepare_cloud
from heliograph.registration.align_globally import find_start
from heliograph.registration.global_evidence import features

__all__ = ["evidence_of", "fit_evidence"]

Array = NDArray[np.float64]
_RIGHT, _RIGHT_DEG = 0.5, 5.0
_DOUBTFUL = 1.0  # keyframes' own poses are 0.3 m off at times: an answer up to this far is neither right nor wrong [m]


def fit_evidence(terms: Array, right: NDArray[np.bool_], *, ridge: float = 0.1) -> tuple[Array, float]:
    """Fit weights and an offset by logistic regression, no weight below zero.

    Each term speaks for a pose by its making; a negative weight would only be the chance of a set.
    """
    x = np.hstack([terms, np.ones((len(terms), 1))])
    scale = np.append(terms.std(axis=0) + 1e-9, 1.0)

    def cost(w: Array) -> tuple[float, Array]:
        z = (x / scale) @ w
        p = 1.0 / (1.0 + np.exp(-np.clip(z, -50.0, 50.0)))
        value = float(np.logaddexp(0.0, -np.where(right, z, -z)).sum() + 0.5 * ridge * (w[:-1] @ w[:-1]))
        return value, (x / scale).T @ (p - right) + ridge * np.append(w[:-1], 0.0)

    bounds = [(0.0, None)] * terms.shape[1] + [(None, None)]
    w = minimize(cost, np.zeros(x.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x / scale
    return w[:-1], float(w[-1])


def evidence_of(files: list[Path]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the terms of the best pose of each pair, and whether it is right; doubtful ones are left out."""
    config, settings, rows, right = AlignConfig(), GlobalAlignConfig(), [], []
    for file in files:
        with np.load(file) as pair:
            target, source = (prepare_cloud(pair[name], config) for name in ("target", "source"))
            truth, kept = pair["T"], str(pair["name"]).startswith("hku")
        found = find_start(target, source, config, settings, 1)
        if found.evidence is None:
            continue
        distance, angle = pose_error(found.T, truth) if np.isfinite(truth).all() else (np.inf, np.inf)
        turned = np.degrees(angle) >= _RIGHT_DEG
        if kept and not turned and _RIGHT <= distance < _DOUBTFUL:
            continue
        rows.append(features(found.evidence))
        right.append(distance < _RIGHT and not turned)
    return np.array(rows), np.array(right)


def main() -> None:
    """Print the weights and the highest odds of a wrong answer among those fitted to."""
    keyframes, work = (Path(argument) for argument in sys.argv[1:3])
    files = write_global_pairs(work, simulated_pairs(160, 11), "fit_simulated")
    files += write_global_pairs(work, keyframe_pairs(keyframes / "hku_1", 160, 1), "fit_hku_1")
    terms, right = evidence_of(files)
    weights, offset = fit_evidence(terms, right)
    z = terms @ weights + offset
    print(f"{len(z)} answers; weights {np.round(weights, 3).tolist()}, offset {offset:.3f}")
    print(f"right: {np.quantile(z[right], (0.1, 0.5)).round(2)} at 10 % and 50 %; wrong: {z[~right].max():.2f} at most")


if __name__ == "__main__":
    main()
