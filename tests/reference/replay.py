"""A pose graph fed to a smoother pose by pose, each with all factors to earlier ones."""

import numpy as np

from heliograph.graph import Between, FactorGraph, Information, Values


class Replay:
    """Steps of a pose graph file; pose k starts from the odometry and the smoother's estimate of the one before."""

    def __init__(self, file, kernel=None):
        self.i, self.j, self.T = file.edges
        (table,) = file.of_role("between")
        self.omega = np.broadcast_to(table.information, (len(self.i), *table.information.shape[-2:]))
        self.ids = file.pose_ids
        self.kernel = kernel
        order = np.argsort(np.maximum(self.i, self.j), kind="stable")
        self._edges = np.split(order, np.searchsorted(np.maximum(self.i, self.j)[order], self.ids[1:]))
        self.kind = type(self.T)

    def graph(self, k):
        """Return the factors that pose number k brings."""
        graph, rows = FactorGraph(), self._edges[k]
        if len(rows):
            noise = Information(self.omega[rows])
            graph.add(Between(self.i[rows], self.j[rows], self.T[rows], noise, kernel=self.kernel))
        if k == 0:
            graph.fix(int(self.ids[0]))
        return graph

    def values(self, k, smoother):
        """Return where pose number k starts."""
        values, rows, key = Values(), self._edges[k], int(self.ids[k])
        if k == 0:
            values.insert(key, self.kind.identity())
            return values
        other = np.minimum(self.i[rows], self.j[rows])
        row = rows[np.argmax(other)]
        T_other_key = self.T[int(row)] if self.j[row] == key else self.T[int(row)].inverse()
        values.insert(key, smoother.estimate(int(other.max())) @ T_other_key)
        return values

    def step(self, smoother, k, **options):
        """Feed pose number k."""
        return smoother.update(self.graph(k), self.values(k, smoother), **options)

    def whole(self, count):
        """Return the graph of the first poses."""
        graph, rows = FactorGraph(), np.flatnonzero(np.maximum(self.i, self.j) <= self.ids[count - 1])
        graph.add(Between(self.i[rows], self.j[rows], self.T[rows], Information(self.omega[rows]), kernel=self.kernel))
        graph.fix(int(self.ids[0]))
        return graph
