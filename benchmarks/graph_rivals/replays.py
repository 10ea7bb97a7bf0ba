"""The last line of programs that replay a graph. Needs NumPy alone."""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np


def report_replay(
    seconds: list[float], reeliminated: list[int], poses: np.ndarray | None, version: str, more: dict[str, Any]
) -> None:
    """Write the poses and print the account of a replay: one number a step of what it took."""
    ms, tenths = 1e3 * np.array(seconds), np.array_split(np.arange(len(seconds)), 10)
    if poses is not None:
        np.save(sys.argv[2], poses)
    account = {"seconds": ms.sum() / 1e3, "mean_ms": ms.mean(), "max_ms": ms.max(), "updates": len(ms)}
    account |= {f"p{q}_ms": np.percentile(ms, q) for q in (50, 99)}
    account["deciles_p50_ms"] = [np.median(ms[part]) for part in tenths]
    account["deciles_reeliminated"] = [np.median(np.array(reeliminated)[part]) for part in tenths]
    print(json.dumps({k: np.round(v, 6).tolist() for k, v in account.items()} | {"version": version, **more}))
