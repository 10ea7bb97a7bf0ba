"""Local maps far from the frame's origin: keys begin anew there, and nothing may show."""

import numpy as np
import pytest

from heliograph.maps import KdTreeMap, VoxelMap
from states import random_pose, room_cloud

FAR = (60_000.0, 131_072.0, 200_000.0, -524_288.0)


def shifted(T, metres):
    out = T.copy()
    out[:3, 3] += (metres, -metres, 0.0)
    return out


def insertions(rng, metres, map_type):
    """The same three scans near the origin and far from it, pruned and thinned by age alike."""
    near, far = map_type(), map_type()
    for _ in range(3):
        T, world = random_pose(rng, 0.2), room_cloud(rng, 4000, half=4.0, sigma=0.01)
        cloud = np.ascontiguousarray((world - T[:3, 3]) @ T[:3, :3], dtype=np.float32)
        near.insert(cloud, T)
        far.insert(cloud, shifted(T, metres))
    for one, centre in ((near, (0.5, 0.0, 0.0)), (far, (metres + 0.5, -metres, 0.0))):
        one.forget_unseen(2)
        one.prune(np.array(centre))
    return near, far


@pytest.mark.parametrize(
    ("map_type", "metres", "share", "atol"),
    [
        *((VoxelMap, metres, 1e-3, 1e-4) for metres in FAR),
        # The k-d tree holds single coordinates, which are 4 and 16 mm apart there: it is coarser, and does not fold.
        *((KdTreeMap, metres, 0.01, 0.02) for metres in FAR[:2]),
    ],
)
def test_local_map_does_not_fold(metres, map_type, share, atol):
    near, far = insertions(np.random.default_rng(8), metres, map_type)
    assert abs(len(far) - len(near)) <= share * len(near) and len(near) > 500
    queries = room_cloud(np.random.default_rng(9), 300, half=4.0, sigma=0.01).astype(np.float64)
    moved_queries = queries + np.array([metres, -metres, 0.0])
    here, there = near.planes_at(queries, gate=0.3), far.planes_at(moved_queries, gate=0.3)
    found = here.source > 0
    assert found.sum() > 200
    both = found & (there.source > 0)
    assert both.sum() >= (1.0 - 5.0 * share) * found.sum()
    off = np.einsum("ni,ni->n", here.normal, queries - here.point)[both]
    moved = np.einsum("ni,ni->n", there.normal, moved_queries - there.point)[both]
    assert np.quantile(np.abs(np.abs(moved) - np.abs(off)), 0.98) <= atol


@pytest.mark.parametrize("metres", FAR)
def test_voxel_map_names_its_cubes_where_they_are(metres):
    near, far = insertions(np.random.default_rng(8), metres, VoxelMap)
    shift = np.array([metres, -metres, 0.0])
    here, there = near.table()[:, 2:5], far.table()[:, 2:5] - shift
    np.testing.assert_allclose(there[np.lexsort(there.T)], here[np.lexsort(here.T)], atol=1e-6)
