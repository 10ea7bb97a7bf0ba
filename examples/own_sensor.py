"""A sensor of one's own, a radio that ranges to a beacon: python own_sensor.py RUN RANGES.csv X Y Z.

Rows of stamp [s since 1970], range [m]; X Y Z is where the beacon stands in the map, to two metres: it is found with
the rest. Echoes are longer than the way, so the cost is a robust one.
"""

import sys
from pathlib import Path

import numpy as np

from heliograph.arrays import Array
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import Cauchy, Factor, FactorGraph, Isotropic, Marginals, Prior, Symbol, Values, load_graph, solve
from heliograph.lie import ExtendedPose
from heliograph.slam import KEYFRAMES, KeyframeStore

X, A = Symbol("X"), Symbol("A")
TAG = np.array([0.0, 0.0, 0.2])  # of the radio, in the imu frame [m]


class BeaconRange(Factor):
    """The distance from the radio to a beacon whose place is a variable; derivatives are found by themselves."""

    variables = (ExtendedPose, 3)
    rows = 1

    @staticmethod
    def residual(T_map_imu: Array, beacon: Array, distance: Array) -> Array:
        radio = T_map_imu[:, :3, :3] @ TAG + T_map_imu[:, :3, 3]
        return np.linalg.norm(radio - beacon, axis=1, keepdims=True) - distance[:, None]


def add_ranges(graph: FactorGraph, values: Values, stamps_ns: Array, table: Array, beacon: Array) -> None:
    """Add what a table (N, 2) of stamps and ranges tells at the keyframes nearest to it."""
    rows = 1e9 * table[:, 0]
    nearest = np.clip(np.searchsorted(rows, stamps_ns), 0, len(rows) - 1)
    heard = np.flatnonzero(np.abs(rows[nearest] - stamps_ns) < 5e7)
    values.insert(A(0), beacon)
    graph.add(Prior(A(0), beacon, Isotropic(2.0)))
    graph.add(BeaconRange(
        X(heard), np.full(len(heard), int(A(0))), data=(table[nearest[heard], 1],), noise=Isotropic(0.1),
        kernel=Cauchy(2.0),
    ))  # fmt: skip


if __name__ == "__main__":
    run = Path(sys.argv[1])
    graph, values = load_graph(run / "graph.npz", factors=SENSOR_FACTORS)
    store = KeyframeStore.open(run / KEYFRAMES)
    table, beacon = np.loadtxt(sys.argv[2], delimiter=",", skiprows=1), np.array(sys.argv[3:6], dtype=float)
    add_ranges(graph, values, np.array(store.stamps_ns), table, beacon)
    store.close()
    solution = solve(graph, values)
    place, sigma = solution.values.at(A(0)), np.sqrt(np.diag(Marginals(graph, solution.values).covariance(A(0))))
    told = " ".join(f"{p:.3f} +- {s:.3f}" for p, s in zip(place, sigma, strict=True))
    print(f"{solution.status}: the beacon stands at {told}")
