"""A barometer in a run's graph: python barometer.py RUN PRESSURE.csv, with rows of stamp [s since 1970], pressure [Pa].

A pressure tells height but for the weather, which wanders; here it is a variable beside each keyframe.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from heliograph.arrays import Array
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph import Between, Factor, FactorGraph, Isotropic, Marginals, Symbol, Values, load_graph, solve
from heliograph.lie import ExtendedPose
from heliograph.slam import KEYFRAMES, KeyframeStore

X, W = Symbol("X"), Symbol("W")
NOISE, WEATHER = 0.1, 0.005  # of a reading [m], of the weather's walk [m/sqrt(s)]


class Barometer(Factor):
    """A height by pressure; its derivatives are found by themselves."""

    variables = (ExtendedPose, 1)
    rows = 1

    @staticmethod
    def residual(T_map_imu: Array, weather: Array, height: Array) -> Array:
        return T_map_imu[:, 2, 3:4] + weather - height[:, None]


def add_barometer(graph: FactorGraph, values: Values, stamps_ns: Array, table: Array) -> None:
    """Add heights at the keyframes that the table (N, 2) of stamps and pressures covers."""
    seconds, keys = 1e-9 * stamps_ns, np.arange(len(stamps_ns))
    heights = 44_330.8 * (1.0 - (table[:, 1] / 101_325.0) ** 0.190263)  # the standard atmosphere
    covered = keys[(seconds >= table[0, 0]) & (seconds <= table[-1, 0])]
    height = np.interp(seconds[covered], table[:, 0], heights)
    values.insert(W(covered), (height - values.at(X(covered)).matrix[:, 2, 3])[:, None])
    graph.add(Barometer(X(covered), W(covered), data=(height,), noise=Isotropic(NOISE)))
    for before, after in pairwise(covered):
        walk = WEATHER * np.sqrt(seconds[after] - seconds[before])
        graph.add(Between(W(before), W(after), np.zeros(1), Isotropic(walk)))


if __name__ == "__main__":
    run = Path(sys.argv[1])
    graph, values = load_graph(run / "graph.npz", factors=SENSOR_FACTORS)
    store = KeyframeStore.open(run / KEYFRAMES)
    last = X(len(store) - 1)
    before = np.sqrt(Marginals(graph, values).covariance(last)[5, 5])
    add_barometer(graph, values, np.array(store.stamps_ns), np.loadtxt(sys.argv[2], delimiter=",", skiprows=1))
    store.close()
    solution = solve(graph, values)
    z, sigma = solution.values.at(last).position[2], np.sqrt(Marginals(graph, solution.values).covariance(last)[5, 5])
    print(f"{solution.status}: the end is {z:.3f} m above the start; one-sigma {before:.6f} m, now {sigma:.6f} m")
