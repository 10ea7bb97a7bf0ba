"""Generated pose graphs: their truth, their noise, their density."""

import numpy as np
import pytest

from heliograph.errors import ConfigError
from heliograph.graph.files.worlds import drive, grid_walk, manhattan, sphere, torus, uneven, with_false_loops
from heliograph.lie import SE2, SE3

WORLDS = {
    "manhattan": lambda rng: manhattan(2000, rng),
    "drive": lambda rng: drive(4541, rng),
    "grid_walk": lambda rng: grid_walk(2000, rng),
    "sphere": lambda rng: sphere(20, 30, rng, sigmas=(0.01, 0.02)),
    "torus": lambda rng: torus(20, 30, rng, sigmas=(0.01, 0.02)),
}


def errors(world):
    truth = world.truth.matrix
    true = type(world.truth)(np.linalg.inv(truth[world.i]) @ truth[world.j])
    return true.local(world.T_i_j)


@pytest.mark.parametrize("name", WORLDS)
def test_relative_poses_are_the_true_ones_with_the_stated_noise(name, rng):
    world = WORLDS[name](rng)
    n = len(world.truth)
    assert (world.i[: n - 1] == np.arange(n - 1)).all() and (world.j[: n - 1] == np.arange(1, n)).all()
    assert (world.i < world.j).all()
    assert not world.false.any()
    np.testing.assert_allclose(world.truth.matrix[0], np.eye(world.truth.size), atol=1e-12)
    chi2 = np.einsum("ei,ij,ej->e", errors(world), world.information, errors(world))
    dof = world.truth.dof
    assert chi2.mean() == pytest.approx(dof, abs=5 * np.sqrt(2 * dof / len(chi2)))


@pytest.mark.parametrize("name", WORLDS)
def test_same_seed_gives_the_same_world(name):
    one, two = (WORLDS[name](np.random.default_rng(5)) for _ in range(2))
    assert (one.T_i_j.matrix == two.T_i_j.matrix).all()
    assert (one.i == two.i).all()


@pytest.mark.parametrize("make", [manhattan, grid_walk])
def test_walk_takes_unit_steps_and_closes_near_loops(make, rng):
    world = make(5000, rng)
    p = world.truth.translation
    np.testing.assert_allclose(np.linalg.norm(np.diff(p, axis=0), axis=1), 1.0)
    loops = np.arange(len(world.truth) - 1, len(world.i))
    assert len(loops) == world.loops == round(0.56 * 5000)
    assert np.linalg.norm(p[world.i[loops]] - p[world.j[loops]], axis=1).max() <= 1.0 + 1e-9
    assert (world.j[loops] - world.i[loops]).min() > 10


def test_body_looks_where_it_goes(rng):
    for world in (manhattan(500, rng), grid_walk(500, rng)):
        step = np.diff(world.truth.translation, axis=0)
        ahead = world.truth.rotation[1:, :, 0]
        np.testing.assert_allclose(np.einsum("ni,ni->n", step, ahead), 1.0)
        assert np.linalg.det(world.truth.rotation).min() == pytest.approx(1.0)


def test_city_grows_with_the_walk_not_denser():
    def density(n):
        cells = np.round(manhattan(n, np.random.default_rng(3)).truth.translation)
        return n / len(np.unique(cells, axis=0))

    assert density(3_500) == pytest.approx(4.0, rel=0.35)
    assert density(100_000) == pytest.approx(density(3_500), rel=0.35)


def test_a_building_has_floors_and_grows_sideways(rng):
    p = np.round(grid_walk(20_000, rng, levels=4).truth.translation).astype(int)
    assert np.ptp(p, axis=0).tolist() == [35, 35, 3]
    tall = np.round(grid_walk(5000, rng, levels=400, visits=1.0).truth.translation).astype(int)
    assert np.ptp(tall, axis=0)[2] > 10 > np.ptp(tall, axis=0)[0]
    with pytest.raises(ConfigError, match="2 levels"):
        grid_walk(100, rng, levels=1)


def test_drive_has_few_loops(rng):
    world = drive(4541, rng)
    assert world.loops == 137
    assert isinstance(world.truth, SE2)


def test_ring_worlds_join_neighbouring_turns(rng):
    world = sphere(10, 20, rng)
    assert isinstance(world.truth, SE3)
    assert world.loops == 180
    assert (world.j[199:] - world.i[199:] == 20).all()
    p = world.truth.translation
    assert np.ptp(p, axis=0).max() < 101.0


@pytest.mark.parametrize("name", ["manhattan", "grid_walk"])
def test_false_loops_are_counted_and_false(name, rng):
    world = WORLDS[name](rng)
    spoilt = with_false_loops(world, 0.5, rng)
    assert spoilt.false.sum() == round(0.5 * world.loops)
    assert (spoilt.i[~spoilt.false] == world.i).all()
    assert (spoilt.i < spoilt.j).all()
    assert np.median(np.abs(errors(spoilt)[spoilt.false]).max(axis=1)) > 1.0


def test_impossible_worlds_are_refused(rng):
    with pytest.raises(ConfigError, match="at least 2"):
        manhattan(1, rng)
    with pytest.raises(ConfigError, match="positive"):
        grid_walk(100, rng, sigmas=(0.0, 0.1))


def test_false_loops_claim_the_information_of_loops(rng):
    world = uneven(rng, poses=80, every=20)
    spoilt = with_false_loops(world, 0.5, rng)
    assert spoilt.information.shape == (len(spoilt.i), 3, 3)
    known = {omega.tobytes() for omega in world.information[79:]}
    assert spoilt.false.any() and {omega.tobytes() for omega in spoilt.information[spoilt.false]} <= known
