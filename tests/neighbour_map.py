"""The seam's example, a local map of one's own: keeps every point, fits a plane to the neighbours of each query."""

import numpy as np

from heliograph.maps import PlaneMatches


class NeighbourMap:
    """A `LocalMap` on a k-d tree: slow, in Python, and enough for the filter."""

    def __init__(self, spacing=0.1, radius=60.0, neighbours=8):
        self.spacing, self.radius, self.neighbours = spacing, radius, neighbours
        self.clear()

    def clear(self):
        self.points, self._tree = np.zeros((0, 3)), None

    def insert(self, points_body, T_odom_body):
        finite = points_body[np.isfinite(points_body).all(axis=1)]
        new = finite @ T_odom_body[:3, :3].T + T_odom_body[:3, 3]
        known, touched = ({*map(tuple, np.floor(some))} for some in (self.points, new))
        both = np.concatenate([self.points, new])
        _, first = np.unique(np.floor(both / self.spacing), axis=0, return_index=True)
        self.points, self._tree = both[np.sort(first)], None
        return len(touched - known) / max(len(touched), 1)

    def prune(self, centre_odom):
        near = np.linalg.norm(self.points - centre_odom, axis=1) <= self.radius
        self.points, self._tree = self.points[near], None

    def planes_at(self, points_odom, *, gate):
        from scipy.spatial import cKDTree

        if len(points_odom) == 0 or len(self.points) < self.neighbours:
            zeros = np.zeros((len(points_odom), 3))
            return self._found(zeros, zeros, zeros[:, 0], zeros[:, 0])
        self._tree = self._tree or cKDTree(self.points)
        distance, index = self._tree.query(points_odom, k=self.neighbours)
        centroid = self.points[index].mean(axis=1)
        d = self.points[index] - centroid[:, None]
        values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", d, d) / self.neighbours)
        normal = vectors[:, :, 0]
        r = np.einsum("ni,ni->n", normal, points_odom - centroid)
        flat = (values[:, 0] < 0.05**2) & (values[:, 1] > 4.0 * values[:, 0]) & (distance[:, -1] < 1.0)
        return self._found(normal, centroid, np.maximum(values[:, 0], 1e-8), flat & (np.abs(r) <= gate))

    @staticmethod
    def _found(normal, point, variance, some):
        return PlaneMatches(normal=normal.astype(np.float32), point=point, variance=variance.astype(np.float32),
                            source=some.astype(np.uint8))  # fmt: skip

    def __len__(self):
        return len(self.points)
