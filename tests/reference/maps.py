"""Slow, obvious twins of the native maps: dictionaries of lists of points."""

import numpy as np

from reference.clouds import rank

BUCKET = 16
RANK_BITS = 10


def cube_of(point, edge):
    return tuple(int(i) for i in np.floor(np.asarray(point) / edge))


class SlowVoxelMap:
    """Keeps every point of every cube; fits planes with `numpy.linalg.eigh` when the native map would."""

    def __init__(self, config):
        self.config = config
        self.cubes = {}  # (level, cube) -> {"points": [...], "fitted": int, "plane": None or dict, "frozen": bool}
        self.point_size = config.voxel * (2.0 if config.levels > 1 else 1.0)
        self.buckets = {}
        self.insertions, self.seen, self.seen_buckets = 0, {}, {}

    def edge(self, level):
        return self.config.voxel * 2**level

    def centre(self, key):
        return (np.array(key[1]) + 0.5) * self.edge(key[0])

    def insert(self, points_body, T):
        finite = points_body[np.isfinite(points_body).all(axis=1)].astype(np.float64)
        groups, ranks = {}, {}
        for point, q in zip(finite, finite @ T[:3, :3].T + T[:3, 3], strict=True):
            cube = cube_of(q, self.config.voxel)
            groups.setdefault(cube, []).append(q)
            ranks.setdefault(cube, []).append(rank(point, RANK_BITS))
        touched = []
        self.insertions += 1
        for cube, group in sorted(groups.items()):
            for level in range(self.config.levels):
                key = (level, tuple(c // 2**level for c in cube))
                entry = self.cubes.setdefault(key, {"points": [], "fitted": 0, "plane": None, "frozen": False})
                self.seen[key] = self.insertions
                if not entry["frozen"]:
                    entry["points"] += group
                    touched.append(key)
            self._keep_raw(group[int(np.argmin(ranks[cube]))])
        for key in sorted(touched, key=lambda key: -key[0]):
            self._refit(key)

    def _keep_raw(self, q):
        bucket = self.buckets.setdefault(cube_of(q, self.point_size), [])
        self.seen_buckets[cube_of(q, self.point_size)] = self.insertions
        far = all(np.linalg.norm(q - other) >= self.config.point_spacing for other in bucket)
        if far and len(bucket) < BUCKET:
            bucket.append(q)

    def _refit(self, key):
        entry, config = self.cubes[key], self.config
        n = len(entry["points"])
        entry["frozen"] = n >= config.max_points
        if n < config.min_points or n < 1.25 * entry["fitted"]:
            return
        entry["fitted"] = n
        points = np.array(entry["points"])
        values, vectors = np.linalg.eigh(np.cov(points.T, bias=True))
        thin, spread = max(values[0], 0.0), values[1]
        good = thin <= config.max_thickness**2 and spread >= (config.min_spread * self.edge(key[0])) ** 2
        entry["plane"] = None
        if good and spread >= 9.0 * thin:
            entry["plane"] = {
                "normal": vectors[:, 0],
                "centroid": points.mean(axis=0),
                "variance": max(thin, 1e-8) / max(n - 3.0, 1.0),
                "inv_spread": spread / (spread - thin) ** 2,
            }
            self._lean_on_coarser(key, entry)

    def _lean_on_coarser(self, key, entry):
        """Average the normal with that of the cube around it, by what both know, unless they differ beyond chance."""
        around = self.cubes.get((key[0] + 1, tuple(c // 2 for c in key[1])))
        if around is None or not around["plane"]:
            return
        plane, coarse = entry["plane"], around["plane"]
        free, more = (max(e["fitted"] - 3.0, 1.0) for e in (entry, around))
        pooled = (free * free * plane["variance"] + 10.0 * more * coarse["variance"]) / (free + 10.0)
        plane["variance"] = max(free * plane["variance"], pooled) / free
        theirs_normal = coarse["normal"] * (-1.0 if plane["normal"] @ coarse["normal"] < 0.0 else 1.0)
        apart = 0.5 * np.sum((plane["normal"] - theirs_normal) ** 2)
        own, known = (p["variance"] * p["inv_spread"] for p in (plane, coarse))
        theirs = known + max(apart - 4.0 * own, 0.0)
        normal = theirs * plane["normal"] + own * theirs_normal
        plane["normal"] = normal / np.linalg.norm(normal)
        kept = theirs / (own + theirs)
        tilt = own * kept if apart > 9.0 * own else max(known + kept**2 * apart, own * kept)
        plane["inv_spread"] = tilt / plane["variance"]

    def prune(self, centre, radius, max_voxels):
        limit = radius
        distance = {key: np.linalg.norm(self.centre(key) - centre) for key in self.cubes}
        if len(distance) > max_voxels > 0:
            limit = min(limit, sorted(distance.values())[max_voxels - 1])
        self.cubes = {key: entry for key, entry in self.cubes.items() if distance[key] <= limit}
        middle = {cube: (np.array(cube) + 0.5) * self.point_size for cube in self.buckets}
        self.buckets = {c: b for c, b in self.buckets.items() if np.linalg.norm(middle[c] - centre) <= limit}

    def forget_unseen(self, insertions):
        last = self.insertions - insertions
        self.cubes = {key: entry for key, entry in self.cubes.items() if self.seen[key] > last}
        self.buckets = {cube: bucket for cube, bucket in self.buckets.items() if self.seen_buckets[cube] > last}

    def plane_at(self, q, gate):
        """Normal, point, variance at q, source, variance of the normal; None where no cube's plane is near enough."""
        for level in range(self.config.levels):
            entry = self.cubes.get((level, cube_of(q, self.edge(level))))
            plane = entry and entry["plane"]
            if not plane:
                continue
            d = q - plane["centroid"]
            r = plane["normal"] @ d
            if abs(r) <= gate:
                variance = plane["variance"] * (1.0 + (d @ d - r * r) * plane["inv_spread"])
                tilt = plane["variance"] * plane["inv_spread"]
                return plane["normal"], plane["centroid"], variance, 1 + level, tilt
        return None

    def nearest(self, q, reach):
        """Stored raw points in the 27 cubes around q, nearer than reach, by distance."""
        middle = np.array(cube_of(q, self.point_size))
        near = [p for cube, b in self.buckets.items() if np.abs(np.array(cube) - middle).max() <= 1 for p in b]
        near = [p for p in near if np.linalg.norm(p - q) < reach]
        return sorted(near, key=lambda p: np.linalg.norm(p - q))

    def neighbour_plane(self, q, gate):
        """The plane through the five nearest raw points, None where they are too few, too thick or in a line."""
        near = self.nearest(q, self.config.fallback_range)[:5]
        if len(near) < 5:
            return None
        points = np.array(near)
        mean = points.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov(points.T, bias=True))
        normal, thick = vectors[:, 0], self.config.max_thickness
        if values[0] > thick**2 or values[1] < 4.0 * values[0] or values[1] < 1e-3:
            return None
        r, d = normal @ (q - mean), q - mean
        if np.abs((points - mean) @ normal).max() > 3.0 * thick or abs(r) > gate:
            return None
        return normal, mean, thick**2 / 5.0 * (1.0 + (d @ d - r * r) / values[1]), 255, self._tilt(values)

    @staticmethod
    def _tilt(values):
        """Variance of the normal through five points, by their own spread: on average right, each time a guess."""
        return max(values[0], 0.0) / 2.0 * values[1] / (values[1] - values[0]) ** 2


class SlowGlobalMap:
    """Every point of every cube, averaged when asked."""

    def __init__(self, voxel):
        self.voxel, self.cells = voxel, {}

    def insert(self, points, intensity, T):
        for i, p in enumerate(points.astype(np.float64)):
            if np.isfinite(p).all():
                q = T[:3, :3] @ p + T[:3, 3]
                self.cells.setdefault(cube_of(q, self.voxel), []).append(
                    (*q, 0.0 if intensity is None else intensity[i])
                )

    def means(self):
        return np.array([np.mean(cell, axis=0) for cell in self.cells.values()]).reshape(-1, 4)

    def counts(self):
        return np.array([len(cell) for cell in self.cells.values()])


class SlowSurfaces:
    """Planes about every cell by `numpy.linalg.eigh` over a dictionary of cells; cell by cell, pair by pair."""

    def __init__(self, cubes, means, counts, voxel, thickness):
        self.voxel, self.thickness, self.gate = voxel, thickness, 2.5 * thickness
        self.means, self.counts = means.astype(np.float64), counts.astype(np.float64)
        index = {tuple(cube): i for i, cube in enumerate(cubes.tolist())}
        steps = [np.array(step) - 1 for step in np.ndindex(3, 3, 3)]
        around = [[index.get(tuple((cube + step).tolist())) for step in steps] for cube in cubes]
        self.around = [np.array([j for j in row if j is not None]) for row in around]
        self.rank = {i: k for k, i in enumerate(sorted(range(len(cubes)), key=lambda i: tuple(cubes[i])))}

    def weights(self, i):
        near = self.around[i]
        d2 = np.sum((self.means[near] - self.means[i]) ** 2, axis=1)
        return self.counts[near] * np.maximum(1.0 - d2 / (2.0 * self.voxel) ** 2, 0.0) ** 2

    def plane(self, i):
        """Normal, a point and the typical count of the plane about cell i, None where there is none."""
        near, weights = self.around[i], self.weights(i)
        for _ in range(2):
            points, share = self.means[near], weights / weights.sum()
            centre = share @ points
            values, vectors = np.linalg.eigh((points - centre).T @ (share[:, None] * (points - centre)))
            normal, typical = vectors[:, 0], share @ self.counts[near]
            keep = np.abs((points - centre) @ normal) <= self.gate
            if keep.all():
                break
            if keep.sum() < 5:
                return None
            weights = np.where(keep, weights, 0.0)
        flat = max(values[0], 0.0) <= self.thickness**2 and values[1] >= max((0.4 * self.voxel) ** 2, 4.0 * values[0])
        return (normal, centre, typical) if flat and len(near) >= 5 else None

    def move(self, i, planes):
        """The plane's cell and the height up to it, None where none is near enough."""
        best = None
        for j in [i, *self.around[i]]:
            if planes[j] is None:
                continue
            normal, centre, typical = planes[j]
            height = normal @ (centre - self.means[i])
            few = self.counts[i] <= 0.0062 * typical + 4.0 * np.sqrt(0.0062 * typical)
            if abs(height) <= self.gate * (1.6 if few else 1.0):
                if j == i and best is None:
                    return i, height
                best = min(best, (j, height), key=lambda move: abs(move[1])) if best else (j, height)
        return best

    def bend(self, i, moves, planes):
        normal, height = planes[moves[i][0]][0], moves[i][1]
        total = weight = 0.0
        for j, w in zip(self.around[i], self.weights(i), strict=True):
            if moves[j] is not None and abs(normal @ (self.means[j] - self.means[i]) - height) <= self.gate:
                cosine = normal @ planes[moves[j][0]][0]
                total += w * moves[j][1] * cosine * (abs(cosine) >= 0.8)
                weight += w * (abs(cosine) >= 0.8)
        return total / weight if weight else 0.0

    def heavier(self, i, points, normals):
        def key(j):
            return self.counts[j], -self.rank[j]

        found = i
        for j in self.around[i]:
            if normals[i] is None or normals[j] is None or key(j) <= key(found):
                continue
            d = points[j] - points[i]
            across = d @ normals[i]
            beside = np.sqrt(max(d @ d - across**2, 0.0))
            if abs(across) <= 0.3 * self.voxel and beside <= 0.6 * self.voxel and abs(normals[i] @ normals[j]) >= 0.8:
                found = j
        return found

    def points(self):
        every = range(len(self.means))
        planes = [self.plane(i) for i in every]
        moves = [self.move(i, planes) for i in every]
        normals = [None if move is None else planes[move[0]][0] for move in moves]
        points = self.means.copy()
        for i in every:
            points[i] += 0.0 if moves[i] is None else moves[i][1] * normals[i]
        target = [self.heavier(i, points, normals) for i in every]
        for i in every:
            points[i] -= 0.0 if moves[i] is None else self.bend(i, moves, planes) * normals[i]
        members = {}
        for i in every:
            j = i
            while target[j] != j:
                j = target[j]
            members.setdefault(j if np.linalg.norm(points[j] - points[i]) <= self.voxel else i, []).append(i)
        groups = [members[i] for i in every if i in members]
        return np.array([np.average(points[group], axis=0, weights=self.counts[group]) for group in groups])


def slow_surfaces(cubes, means, counts, voxel, thickness):
    return SlowSurfaces(cubes, means, counts, voxel, thickness).points()
