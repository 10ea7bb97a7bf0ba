"""What ties a pose graph to the world, and where a start from odometry is placed by it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from heliograph.arrays import Array, Indices
from heliograph.graph.files.offsets import at_poses, points_at_poses

if TYPE_CHECKING:
    from heliograph.graph.files.odometry_start import SpanningStart
    from heliograph.graph.files.posegraph import PoseGraphFile

__all__ = ["anchored", "placed", "points_from"]


_PARALLEL = 1e-6  # determinant of bearings' normal equations, a sighting, below which they meet nowhere


def anchored(file: PoseGraphFile, ids: Indices, component: Indices) -> Indices:
    """Return the components, repeated, that hold something absolute: a fixed pose or landmark, or a prior.

    Parameters
    ----------
    file : PoseGraphFile
        The graph.
    ids : (P,) int64
        All poses, ascending.
    component : (P,) int64
        The component of each pose.
    """
    poses = [file.fixed, *(t.ids[:, 0] for t in file.of_role("pose_prior", "position_prior"))]
    out = [component[np.isin(ids, np.concatenate(poses))]]
    for table in file.of_role("landmark", "bearing"):
        lookers = table.ids[np.isin(table.ids[:, 1], file.fixed), 0]
        out.append(component[np.searchsorted(ids, lookers)])
    return np.concatenate(out)


def placed(file: PoseGraphFile, start: SpanningStart, component: Indices) -> Array:
    """Return poses T_world_i (P, k, k) with each component moved to where what is fixed or a prior says.

    Parameters
    ----------
    file : PoseGraphFile
        The graph.
    start : SpanningStart
        Its poses from odometry.
    component : (P,) int64
        The component of each pose, with those joined that see a common landmark.
    """
    ids, T = start.ids, start.matrices
    fixed, said = _said(file)
    out: Array = T.copy()
    anchors = np.array(sorted(said), dtype=np.int64)
    settled = component[np.searchsorted(ids, anchors)]
    for label in np.unique(settled).tolist():
        members = np.flatnonzero(component == label)
        inside = anchors[np.isin(anchors, ids[members])]
        preferred = inside[np.isin(inside, fixed)] if np.isin(inside, fixed).any() else inside
        anchor = int(preferred[0])
        shift = said[anchor] @ np.linalg.inv(T[np.searchsorted(ids, anchor)])
        out[members] = shift @ T[members]
    for name in fixed.tolist():
        out[np.searchsorted(ids, name)] = said[name]
    if len(file.fixed) and len(file.point_ids):
        _to_landmarks(file, start, out, anchors)
    return out


def _said(file: PoseGraphFile) -> tuple[Indices, dict[int, Array]]:
    """Return the fixed poses that have a value, and T_world_i of these and of those with a prior."""
    tables = file.of_role("pose")
    names = np.concatenate([t.ids[:, 0] for t in tables]) if tables else np.empty(0, dtype=np.int64)
    fixed = np.intersect1d(file.fixed, names)
    said: dict[int, Array] = {}
    for table in file.of_role("pose_prior"):
        said.update(zip(table.ids[::-1, 0].tolist(), at_poses(table, file.offsets)[0][::-1], strict=True))
    if len(fixed):
        stacked, order = np.concatenate([t.matrices for t in tables]), np.argsort(names)
        at = order[np.searchsorted(names, fixed, sorter=order)]
        said.update(zip(fixed.tolist(), stacked[at], strict=True))
    return fixed, said


def _known_points(file: PoseGraphFile) -> tuple[Indices, Array]:
    """Return the landmarks that are fixed and have a value, ids ascending (K,), and p_world (K, d)."""
    tables = file.of_role("point")
    if not tables or not len(file.fixed):
        return np.empty(0, dtype=np.int64), np.empty((0, file.dimension))
    ids, places = np.concatenate([t.ids[:, 0] for t in tables]), np.concatenate([t.numbers for t in tables])
    order = np.argsort(ids)
    order = order[np.isin(ids[order], file.fixed)]
    return ids[order], places[order]


def _to_landmarks(file: PoseGraphFile, start: SpanningStart, T: Array, anchors: Indices) -> None:
    """Move what hangs on no anchor pose so that fixed landmarks are seen where they are (Kabsch 1976)."""
    ids = start.ids
    names, places = _known_points(file)
    lookers, here, there = [], [], []
    for table in file.of_role("landmark"):
        mine = np.isin(table.ids[:, 1], names)
        pose = np.searchsorted(ids, table.ids[mine, 0])
        p = points_at_poses(table, file.offsets)[0][mine]
        lookers.append(pose)
        here.append(_moved(T[pose], p))
        there.append(places[np.searchsorted(names, table.ids[mine, 1])])
    if not lookers:
        return
    labels, seen, known = start.root[np.concatenate(lookers)], np.concatenate(here), np.concatenate(there)
    for label in np.setdiff1d(labels, start.root[np.searchsorted(ids, anchors)]).tolist():
        rows, members = labels == label, start.root == label
        T[members] = _fit(seen[rows], known[rows]) @ T[members]


def _fit(p_a: Array, p_b: Array) -> Array:
    """Return the motion T_b_a (k, k) that brings points (N, d) nearest to others; a shift alone where they are few."""
    d = p_a.shape[1]
    T = np.eye(d + 1)
    a, b = p_a.mean(axis=0), p_b.mean(axis=0)
    U, strength, Vt = np.linalg.svd((p_b - b).T @ (p_a - a))
    if strength[d - 2] > _PARALLEL * max(float(strength[0]), np.finfo(float).tiny):
        U[:, -1] *= np.linalg.det(U @ Vt)
        T[:d, :d] = U @ Vt
    T[:d, d] = b - T[:d, :d] @ a
    return T


def points_from(file: PoseGraphFile, ids: Indices, T: Array) -> Array:
    """Return every landmark where the first pose that sees it has it; what is fixed or unseen, where its line says.

    Parameters
    ----------
    file : PoseGraphFile
        The graph.
    ids : (P,) int64
        All poses, ascending.
    T : (P, k, k) float64
        T_world_i.

    Returns
    -------
    (Q, d) float64
        p_world in the order of `point_ids`.
    """
    points = np.zeros((len(file.point_ids), file.dimension))
    for table in file.of_role("point"):
        points[np.searchsorted(file.point_ids, table.ids[:, 0])] = table.numbers
    _from_bearings(file, ids, T, points)
    for table in reversed(file.of_role("landmark")):
        names, first = np.unique(table.ids[:, 1], return_index=True)
        pose = T[np.searchsorted(ids, table.ids[first, 0])]
        points[np.searchsorted(file.point_ids, names)] = _moved(pose, points_at_poses(table, file.offsets)[0][first])
    names, places = _known_points(file)
    points[np.searchsorted(file.point_ids, names)] = places
    return points


def _from_bearings(file: PoseGraphFile, ids: Indices, T: Array, points: Array) -> None:
    """Put landmarks that only bearings see where these meet; where they do not, 1 m along the first."""
    tables = file.of_role("bearing")
    if not tables:
        return
    names = np.concatenate([t.ids[:, 1] for t in tables])
    pose = T[np.searchsorted(ids, np.concatenate([t.ids[:, 0] for t in tables]))]
    along = (pose[:, :2, :2] @ np.concatenate([t.matrices for t in tables]))[:, :, 0]
    across = np.eye(2) - along[:, :, None] * along[:, None, :]
    found, which = np.unique(names, return_inverse=True)
    H, g = np.zeros((len(found), 2, 2)), np.zeros((len(found), 2))
    np.add.at(H, which, across)
    np.add.at(g, which, (across @ pose[:, :2, 2:])[..., 0])
    count = np.bincount(which, minlength=len(found))
    meet = np.linalg.det(H) > _PARALLEL * count**2
    first = np.unique(names, return_index=True)[1]
    ahead = pose[first, :2, 2] + along[first]
    H[~meet] = np.eye(2)
    place = np.where(meet[:, None], np.linalg.solve(H, g[:, :, None])[..., 0], ahead)
    given = np.isin(found, np.concatenate([t.ids[:, 0] for t in file.of_role("point")] or [np.zeros(0, np.int64)]))
    points[np.searchsorted(file.point_ids, found[~given])] = place[~given]


def _moved(T: Array, p: Array) -> Array:
    """Return points (N, d) seen from poses (N, k, k), in the world."""
    return np.asarray(np.einsum("nab,nb->na", T[:, :-1, :-1], p) + T[:, :-1, -1])
