"""The native ray caster against its twin and against geometry done by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import DataError
from heliograph.lie import so3
from heliograph.sim.places import PLACES
from heliograph.sim.sensors import LidarModel
from heliograph.sim.world import SimulatedWorld, Surface, box, cylinder, rectangle
from reference.raycast import cast_slowly


def random_world(rng, count):
    primitives = []
    for _ in range(count):
        center, size = rng.uniform(-8.0, 8.0, 3), rng.uniform(0.2, 4.0, 3)
        R = so3.exp(rng.normal(0.0, 2.0, 3))
        surface = Surface(
            reflectivity=rng.uniform(0.1, 1.0), contrast=rng.uniform(0.0, 1.0), period=rng.uniform(0.2, 2.0)
        )
        make = rng.integers(3)
        if make == 0:
            primitives.append(rectangle(center, size[:2], R, surface))
        elif make == 1:
            primitives.append(box(center, size, R, surface))
        else:
            primitives.append(cylinder(center, size[0] / 2.0, size[2], R, surface))
    return SimulatedWorld(primitives)


def random_poses(rng, count):
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = so3.exp(rng.normal(0.0, 1.0, (count, 3)))
    T[:, :3, 3] = rng.uniform(-9.0, 9.0, (count, 3))
    return T


def look(x=1.0, y=0.0, z=0.0):
    return np.array([[[x, y, z]]]) / np.linalg.norm([x, y, z])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 40))
def test_cast_agrees_with_its_twin(seed, count):
    rng = np.random.default_rng(seed)
    world, poses = random_world(rng, count), random_poses(rng, 16)
    directions = LidarModel(beams=12, columns=16, elevation_deg=(-80.0, 80.0)).directions()
    got = world.cast(directions, poses, min_range=0.4, max_range=9.0)
    want_range, want_brightness, want_id = cast_slowly(world, directions, poses, 0.4, 9.0)
    np.testing.assert_allclose(got.range, want_range, rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(got.primitive, want_id)
    # A point within rounding of a texture cell's border may take either shade.
    assert (np.abs(got.brightness - want_brightness) < 1e-6).mean() > 0.99


def test_cast_of_the_warehouse_agrees_with_its_twin(rng):
    place = PLACES["warehouse"](rng)
    poses = random_poses(rng, 8)
    poses[:, :3, 3] = np.array([20.0, 12.0, 1.0]) + rng.uniform(-3.0, 3.0, (8, 3)) * [6.0, 2.0, 0.2]
    directions = LidarModel(beams=24, columns=8).directions()
    got = place.world.cast(directions, poses, min_range=0.5, max_range=120.0)
    want_range, _, want_id = cast_slowly(place.world, directions, poses, 0.5, 120.0)
    np.testing.assert_allclose(got.range, want_range, rtol=1e-12, atol=1e-9)
    assert (got.primitive == want_id).mean() > 0.99  # where two surfaces coincide, rounding decides


def test_brightness_is_reflectivity_times_cosine():
    wall = rectangle((5.0, 0.0, 0.0), (4.0, 4.0), so3.from_rpy(0.0, np.pi / 2, 0.0), Surface(contrast=0.0))
    for angle in (0.0, 0.2):
        got = SimulatedWorld([wall]).cast(look(np.cos(angle), np.sin(angle)), np.eye(4)[None])
        assert got.range[0, 0] == pytest.approx(5.0 / np.cos(angle), abs=1e-12)
        assert got.brightness[0, 0] == pytest.approx(0.5 * np.cos(angle), abs=1e-6)


def test_ray_from_inside_a_box_sees_its_far_face():
    got = SimulatedWorld([box((0.0, 0.0, 0.0), (2.0, 4.0, 6.0))]).cast(look(0.0, 1.0), np.eye(4)[None])
    assert got.range[0, 0] == pytest.approx(2.0)


def test_ray_along_a_cylinder_axis_sees_its_cap():
    got = SimulatedWorld([cylinder((0.0, 0.0, 5.0), 0.5, 2.0)]).cast(look(0.0, 0.0, 1.0), np.eye(4)[None])
    assert got.range[0, 0] == pytest.approx(4.0)


def test_range_limits_hide_what_is_outside():
    world = SimulatedWorld([box((5.0, 0.0, 0.0), (2.0, 1.0, 1.0))])
    for limits, want in (((0.0, 3.9), 0.0), ((0.0, 4.1), 4.0), ((4.1, 9.0), 6.0), ((6.1, 9.0), 0.0)):
        got = world.cast(look(), np.eye(4)[None], min_range=limits[0], max_range=limits[1])
        assert got.range[0, 0] == pytest.approx(want)
        assert (got.primitive[0, 0] >= 0) == (want > 0.0)


def test_coinciding_surfaces_go_to_the_first_named():
    walls = [box((5.0, 0.0, 0.0), (2.0, s, s)) for s in (1.0, 2.0, 3.0)]
    assert SimulatedWorld(walls).cast(look(), np.eye(4)[None]).primitive[0, 0] == 0
    assert SimulatedWorld(walls[::-1]).cast(look(), np.eye(4)[None]).primitive[0, 0] == 0


def test_cast_does_not_depend_on_threads(rng):
    world, poses = random_world(rng, 60), random_poses(rng, 64)
    directions = LidarModel(beams=16, columns=64).directions()
    one, two, many = (world.cast(directions, poses, threads=n) for n in (1, 2, 5))
    for other in (two, many):
        np.testing.assert_array_equal(one.range, other.range)
        np.testing.assert_array_equal(one.brightness, other.brightness)
        np.testing.assert_array_equal(one.primitive, other.primitive)


def test_cast_refuses_a_wrong_number_of_poses():
    with pytest.raises(DataError, match="T_world_sensor"):
        SimulatedWorld([]).cast(look(), np.tile(np.eye(4), (2, 1, 1)))
