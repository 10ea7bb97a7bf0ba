import numpy as np
import pytest

from heliograph.errors import DataError
from heliograph.metrics import map_sharpness


def room(rng: np.random.Generator, noise: float, n: int = 60_000) -> np.ndarray:
    """Floor and two walls, each point off its surface by a Gaussian."""
    uv = rng.uniform(0.0, 10.0, size=(n, 2))
    w = rng.normal(size=n) * noise
    faces = [np.stack(c, axis=1) for c in ((uv[:, 0], uv[:, 1], w), (uv[:, 0], w, uv[:, 1]), (w, uv[:, 0], uv[:, 1]))]
    return np.concatenate([face[i::3] for i, face in enumerate(faces)]).astype(np.float32)


def test_sharpness_measures_the_noise_of_a_plane(rng):
    uv = rng.uniform(0.0, 20.0, size=(100_000, 2))
    points = np.column_stack([uv, rng.normal(0.25, 0.03, size=len(uv))])
    result = map_sharpness(points, 0.5, min_points=30)
    assert result.thickness == pytest.approx(0.03, rel=0.03)
    assert result.coverage > 0.99


def test_sharpness_orders_maps_by_noise(rng):
    results = [map_sharpness(room(rng, noise), 0.5) for noise in (0.01, 0.03, 0.1)]
    assert np.all(np.diff([r.entropy for r in results]) > 0.1)
    assert np.all(np.diff([r.plane_variance for r in results]) > 0.0)


def test_sharpness_sees_a_doubled_wall(rng):
    once, again = room(rng, 0.01), room(rng, 0.01)
    doubled = np.concatenate([once, again + np.float32(0.15)])
    assert map_sharpness(doubled, 0.5).entropy > map_sharpness(np.concatenate([once, again]), 0.5).entropy + 0.3


def test_sharpness_is_the_same_far_from_the_origin(rng):
    points = room(rng, 0.02).astype(np.float64)
    near, far = map_sharpness(points, 0.5), map_sharpness(points + 1000.0, 0.5)
    assert near.entropy == pytest.approx(far.entropy, abs=1e-6)


def test_sharpness_does_not_depend_on_the_order_of_points(rng):
    points = room(rng, 0.02)
    one, other = map_sharpness(points, 0.5), map_sharpness(rng.permutation(points), 0.5)
    assert one.entropy == pytest.approx(other.entropy, rel=1e-9)


def test_sharpness_matches_a_plain_loop_over_cells(rng):
    points, edge = rng.normal(size=(2000, 3)), 1.0
    entropies, smallest = [], []
    for shift in (0.0, 0.5):
        cells = np.floor(points / edge + shift)
        for cell in np.unique(cells, axis=0):
            member = points[(cells == cell).all(axis=1)]
            if len(member) >= 10:
                S = np.cov(member.T)
                entropies += [0.5 * np.log(np.linalg.det(2 * np.pi * np.e * S))] * len(member)
                smallest += [np.linalg.eigvalsh(S)[0]] * len(member)
    result = map_sharpness(points, edge / 2)
    assert result.entropy == pytest.approx(np.mean(entropies), rel=1e-9)
    assert result.plane_variance == pytest.approx(np.mean(smallest), rel=1e-9)
    assert result.coverage == pytest.approx(len(entropies) / 4000)


def test_sharpness_of_an_exact_plane_is_finite(rng):
    points = np.column_stack([rng.uniform(0.0, 5.0, size=(5000, 2)), np.full(5000, 0.3)])
    assert np.isfinite(map_sharpness(points, 0.5).entropy)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((5, 2)), "shape"),
        (np.zeros((5, 3), dtype=int), "floating"),
        (np.full((50, 3), np.nan), "not finite"),
        (np.arange(30.0).reshape(10, 3) * 100, "larger radius"),
        (np.full((50, 3), 1e9), "outliers"),
        (np.zeros((0, 3)), "larger radius"),
    ],
)
def test_sharpness_refuses_what_it_cannot_measure(points, message):
    with pytest.raises(DataError, match=message):
        map_sharpness(points, 0.5)
