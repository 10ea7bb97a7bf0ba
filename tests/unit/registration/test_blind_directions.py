"""What cannot be seen: the textbook's eigenvalues, and corridor, tunnel, plane and sphere over many draws of noise."""

import numpy as np
import pytest
from tests import scenes

from heliograph.registration import (
    analyse_information,
    analyse_planes,
    estimate_normals,
    remapped_step,
    soft_step,
)
from heliograph.registration.remapping import seen_step

SIGMA = np.radians(2.0)


def _analyse(rng, cloud, normals):
    """Analyse exact normals after noise has turned them."""
    turned = normals + SIGMA * rng.normal(size=normals.shape)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return analyse_planes(cloud, turned, np.full(len(cloud), 2500.0), np.full(len(cloud), SIGMA**2))


def _corridor(rng):
    cloud = scenes.corridor(rng, 1200, 0.0)
    normals = np.repeat([[0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], 300, axis=0).astype(float)
    return cloud, normals


def _tunnel(rng):
    cloud = scenes.tunnel(rng, 1200, 0.0)
    return cloud, cloud * [0.0, 1.0, 1.0] / 2.5


def _plane(rng):
    return scenes.plane(rng, 1200, 0.0), np.tile([0.0, 0.0, 1.0], (1200, 1))


def _sphere(rng):
    cloud = scenes.sphere(rng, 1200, 0.0)
    return cloud, (cloud - [3.0, -2.0, 1.0]) / 2.5


def _room(rng):
    cloud, normals = _corridor(rng)
    ends = np.concatenate([scenes.patch(rng, (x, 0, 0), (0, 1, 0), (0, 0, 1.2), 25) for x in (-12, 12)])
    return np.concatenate([cloud, ends]), np.concatenate([normals, np.tile([1.0, 0.0, 0.0], (50, 1))])


SCENES = {
    "corridor": (_corridor, {"translation": [[1, 0, 0]], "rotation": []}),
    "tunnel": (_tunnel, {"translation": [[1, 0, 0]], "rotation": [[1, 0, 0]]}),
    "plane": (_plane, {"translation": [[1, 0, 0], [0, 1, 0]], "rotation": [[0, 0, 1]]}),
    "sphere": (_sphere, {"translation": [], "rotation": np.eye(3).tolist()}),
    "room": (_room, {"translation": [], "rotation": []}),
}


@pytest.mark.parametrize("name", SCENES)
def test_blind_directions_over_two_hundred_draws(name):
    make, blind = SCENES[name]
    missed = false = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        analysis = _analyse(rng, *make(rng))
        for kind, wanted in blind.items():
            found = [d for d in getattr(analysis, kind) if d.blind]
            missed += len(found) < len(wanted)
            false += len(found) > len(wanted)
            if wanted:  # the span, since equal eigenvalues have no eigenvectors of their own
                space = np.array(wanted, dtype=float)
                assert all(np.linalg.norm(space @ d.direction) > 0.99 for d in found)
    assert missed == 0 and false == 0


def test_probability_falls_with_what_is_seen():
    rng = np.random.default_rng(0)
    cloud, normals = _corridor(rng)
    last = 1.0
    for count in (0, 1, 2, 4, 8, 40):
        ends = scenes.patch(rng, (12, 0, 0), (0, 1, 0), (0, 0, 1.2), count)
        both = np.concatenate([cloud, ends]), np.concatenate([normals, np.tile([1.0, 0.0, 0.0], (count, 1))])
        p = _analyse(np.random.default_rng(1), *both).translation[0].probability
        assert p <= last + 0.02
        last = p
    assert last < 0.01


def test_eigenvalues_of_the_textbook():
    # 240 and 3 at a threshold of 100: one direction is degenerate, and the ratio is 80.
    H = np.diag([1e4, 1e4, 1e4, 240.0, 240.0, 3.0])
    analysis = analyse_information(H, threshold=100.0)
    assert [d.information for d in analysis.translation] == pytest.approx([3.0, 240.0, 240.0])
    (blind,) = analysis.blind
    assert blind.kind == "translation" and abs(blind.direction[2]) == pytest.approx(1.0)
    assert analysis.condition_translation == pytest.approx(80.0)
    assert analysis.condition_rotation == pytest.approx(1.0)


def test_remapping_leaves_the_guess_along_a_weak_direction():
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(2, 2)))[0]
    H, wanted = turn @ np.diag([240.0, 3.0]) @ turn.T, np.array([0.5, -0.7])
    d, weak = remapped_step(H, -H @ wanted, threshold=100.0)
    assert weak.tolist() == [True, False]  # ascending: 3 is weak, 240 is not
    strong = turn[:, 0]
    np.testing.assert_allclose(d, strong * (strong @ wanted), atol=1e-12)
    full, none = remapped_step(H, -H @ wanted, threshold=1.0)
    np.testing.assert_allclose(full, wanted, atol=1e-12)
    assert not none.any()


def test_soft_step_shrinks_by_the_information():
    H, wanted = np.diag([240.0, 3.0]), np.array([0.5, -0.7])
    d = soft_step(H, -H @ wanted, prior=10.0)
    np.testing.assert_allclose(d, wanted * [240 / 250, 3 / 13], atol=1e-12)
    np.testing.assert_allclose(soft_step(H, -H @ wanted, prior=np.diag([0.0, 1e9])), [0.5, 0.0], atol=1e-6)


def test_seen_step_is_least_squares_in_the_complement():
    rng = np.random.default_rng(1)
    J = rng.normal(size=(40, 6))
    H, g = J.T @ J, rng.normal(size=6)
    N = np.eye(6)[:, [4]]
    d = seen_step(H, g, N)
    assert d[4] == pytest.approx(0.0, abs=1e-12)
    rest = [0, 1, 2, 3, 5]
    np.testing.assert_allclose(d[rest], -np.linalg.solve(H[np.ix_(rest, rest)], g[rest]), atol=1e-10)
    np.testing.assert_allclose(seen_step(H, g, np.zeros((6, 0))), -np.linalg.solve(H, g), atol=1e-12)


def test_sphere_turns_about_its_centre():
    rng = np.random.default_rng(0)
    cloud, normals = _sphere(rng)
    analysis = _analyse(rng, cloud, normals)
    for column in analysis.blind_basis().T:
        at_centre = column[3:] + np.cross(column[:3], [3.0, -2.0, 1.0])
        assert np.linalg.norm(at_centre) < 0.02


def test_normals_estimated_from_noise_name_a_corridor_blind():
    rng = np.random.default_rng(0)
    cloud = scenes.corridor(rng, 6000, 0.01).astype(np.float32)
    normals = estimate_normals(cloud, neighbours=20).astype(np.float64)
    tilt = np.full(len(cloud), np.radians(4.0) ** 2)
    analysis = analyse_planes(cloud.astype(np.float64), normals, np.full(len(cloud), 1e4), tilt)
    assert analysis.translation[0].blind and abs(analysis.translation[0].direction[0]) > 0.99
