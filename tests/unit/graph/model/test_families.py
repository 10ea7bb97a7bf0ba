"""Families: packing, and the steps that agree with the Lie classes."""

import numpy as np
import pytest

from heliograph import lie
from heliograph.errors import GraphError
from heliograph.graph.model.families import FAMILIES, family_named, family_of, stacked, vectors
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose

GROUPS = [SO2, SO3, SE2, SE3, ExtendedPose]


def some(name, rng, count=5):
    if name is S2:
        return S2(rng.normal(size=(count, 3)))
    return rng.normal(size=(count, name)) if isinstance(name, int) else name.exp(rng.normal(size=(count, name.dof)))


def arrays_of(value):
    return value.vector if isinstance(value, S2) else getattr(value, "matrix", value)


@pytest.mark.parametrize("name", [*FAMILIES, 1, 3, 16])
def test_family_packs_and_unpacks_without_loss(name, rng):
    value, family = some(name, rng), family_named(name)
    packed = family.pack(value)
    assert packed.shape == (5, family.storage) and packed.flags.c_contiguous
    np.testing.assert_array_equal(arrays_of(family.unpack(packed)), arrays_of(value))
    assert family_of(value) == family and family.dof <= family.storage


def test_packed_layout_is_rotation_by_rows_then_vectors(rng):
    pose = ExtendedPose.exp(rng.normal(size=9))
    packed = family_named(ExtendedPose).pack(pose)[0]
    np.testing.assert_array_equal(packed[:9], pose.rotation.ravel())
    np.testing.assert_array_equal(packed[9:], [*pose.position, *pose.velocity])
    planar = family_named(SE2).pack(SE2.exp([0.5, 0.0, 0.0]))[0]
    np.testing.assert_allclose(planar, [np.cos(0.5), np.sin(0.5), 0.0, 0.0], atol=1e-16)


@pytest.mark.parametrize("name", [*FAMILIES, 3])
def test_family_local_inverts_retract(name, rng):
    family = family_named(name)
    elements, delta = stacked(some(name, rng))[0], 0.5 * rng.normal(size=(5, family.dof))
    np.testing.assert_allclose(family.local(elements, family.retract(elements, delta)), delta, atol=1e-13)


@pytest.mark.parametrize("group", GROUPS)
def test_family_retract_is_that_of_the_group(group, rng):
    family, X, d = family_named(group), some(group, rng), rng.normal(size=(5, group.dof))
    np.testing.assert_allclose(family.retract(X.matrix, d), X.retract(d).matrix, atol=1e-14)


@pytest.mark.parametrize("name", [*FAMILIES, 2])
def test_family_tells_what_is_off_the_manifold(name, rng):
    family = family_named(name)
    elements = np.array(stacked(some(name, rng))[0])
    assert not family.off_manifold(elements).any()
    flat = elements.reshape(5, -1)
    flat[1, 0] = np.nan
    flat[2, -1 if name == 2 else 0] = np.inf
    expected = [False, True, True, False, False]
    if name != 2:
        flat[4, 0] += 0.5
        expected[4] = True
    np.testing.assert_array_equal(family.off_manifold(elements), expected)


def test_a_reflection_is_no_rotation():
    mirror = np.diag([1.0, 1.0, -1.0])[None]
    assert family_named(SO3).off_manifold(mirror).all()
    assert family_named(SO2).off_manifold(np.diag([1.0, -1.0])[None]).all()


@pytest.mark.parametrize("bad", [0, 17, "SE3", 2.0, True, lie, float])
def test_unknown_family_is_refused(bad):
    with pytest.raises(GraphError, match=r"1 to 16|no family"):
        family_named(bad)


@pytest.mark.parametrize("bad", [np.zeros((2, 2, 3)), "text", [[1.0], [1.0, 2.0]], SE2.identity((2, 2))])
def test_what_is_no_batch_of_values_is_refused(bad):
    with pytest.raises(GraphError):
        family_of(bad)


def test_families_can_be_compared_and_hashed():
    assert vectors(3) == vectors(3) != vectors(2)
    assert len({family_named(SE2), family_named(SE2), vectors(3)}) == 2
