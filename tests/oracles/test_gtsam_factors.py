"""Residuals, Jacobians and robust costs of the common factors are those of GTSAM's Python wheel.

Its conventions differ: half the squared error, Pose2 tangents (x, y, theta), and an S(2) basis of its own.
"""

import numpy as np
import pytest

from native_factors import element, evaluate
from reference import factors as twin

gtsam = pytest.importorskip("gtsam", reason="needs GTSAM: pip install 'heliograph[oracles]'")

# Columns of our SE(2) tangent (theta, x, y) in GTSAM's order (x, y, theta).
ORDER = {twin.SE2: [1, 2, 0]}


def to_gtsam(manifold, x):
    if manifold == twin.SE2:
        return gtsam.Pose2(x[0, 2], x[1, 2], np.arctan2(x[1, 0], x[0, 0]))
    if manifold == twin.SE3:
        return gtsam.Pose3(x)
    if manifold == twin.SO3:
        return gtsam.Rot3(x)
    if manifold == twin.NAV:
        return gtsam.ExtendedPose3d(gtsam.Rot3(x[:3, :3]), x[:3, 3:])
    if manifold == twin.SO2:
        return gtsam.Rot2(np.arctan2(x[1, 0], x[0, 0]))
    return np.asarray(x, dtype=np.float64)


def values_of(families, x):
    values = gtsam.Values()
    for key, ((manifold, _), one) in enumerate(zip(families, x, strict=True)):
        values.insert(key, to_gtsam(manifold, one))
    return values


def jacobians_of(factor, families, values):
    """Whitened Jacobians and right-hand side of GTSAM, its columns in our order."""
    A, b = factor.linearize(values).jacobian()
    keys = list(factor.keys())
    starts = np.cumsum([0] + [families[k][1] for k in keys])
    out = {}
    for n, key in enumerate(keys):
        block = A[:, starts[n] : starts[n + 1]]
        order = ORDER.get(families[key][0], list(range(block.shape[1])))
        out[key] = block[:, np.argsort(order)]
    return [out[k] for k in range(len(families))], b


def compare(kind, families, x, z, factor, sigma, rows_order=None):
    """One factor of isotropic noise: same error, residual up to GTSAM's row order, and Jacobians."""
    values = values_of(families, x)
    residual, _, jacobians, _, chi2, *_ = evaluate(kind, families, [x], [z], S=1.0 / sigma)
    np.testing.assert_allclose(chi2, 2.0 * factor.error(values), rtol=1e-9, atol=1e-9)
    theirs, b = jacobians_of(factor, families, values)
    rows = rows_order or list(range(len(b)))
    np.testing.assert_allclose(residual[0][rows] / sigma, -b, rtol=1e-9, atol=1e-8)
    for ours, their in zip(jacobians, theirs, strict=True):
        np.testing.assert_allclose(ours[0][rows] / sigma, their, rtol=1e-7, atol=1e-7 * (1 + np.abs(their).max()))


GROUPS = {
    twin.SE2: ("PriorFactorPose2", "BetweenFactorPose2", [1, 2, 0]),
    twin.SE3: ("PriorFactorPose3", "BetweenFactorPose3", None),
    twin.SO3: ("PriorFactorRot3", "BetweenFactorRot3", None),
    twin.NAV: ("PriorFactorExtendedPose3d", "BetweenFactorExtendedPose3d", None),
    twin.SO2: ("PriorFactorRot2", "BetweenFactorRot2", None),
}


@pytest.mark.parametrize("manifold", GROUPS)
def test_prior_and_between_on_groups_agree(manifold, rng):
    prior, between, rows = GROUPS[manifold]
    family = (manifold, twin.DOF[manifold])
    noise = gtsam.noiseModel.Isotropic.Sigma(family[1], 0.5)
    for _ in range(20):
        x = [element(*family, rng, 3.0) for _ in range(2)]
        z = element(*family, rng, 3.0)
        compare(twin.PRIOR, (family,), x[:1], z, getattr(gtsam, prior)(0, to_gtsam(manifold, z), noise), 0.5, rows)
        factor = getattr(gtsam, between)(0, 1, to_gtsam(manifold, z), noise)
        compare(twin.BETWEEN, (family, family), x, z, factor, 0.5, rows)


@pytest.mark.parametrize("dimension", [2, 3])
def test_prior_and_between_on_points_agree(dimension, rng):
    family = (twin.VECTOR, dimension)
    noise = gtsam.noiseModel.Isotropic.Sigma(dimension, 0.5)
    x, z = [rng.normal(size=dimension) for _ in range(2)], rng.normal(size=dimension)
    name = f"Point{dimension}"
    compare(twin.PRIOR, (family,), x[:1], z, getattr(gtsam, f"PriorFactor{name}")(0, z, noise), 0.5)
    compare(twin.BETWEEN, (family, family), x, z, getattr(gtsam, f"BetweenFactor{name}")(0, 1, z, noise), 0.5)


RANGES = [
    ("RangeFactorPose2", (twin.SE2, 3), (twin.SE2, 3)),
    ("RangeFactor2D", (twin.SE2, 3), (twin.VECTOR, 2)),
    ("RangeFactorPose3", (twin.SE3, 6), (twin.SE3, 6)),
    ("RangeFactor3D", (twin.SE3, 6), (twin.VECTOR, 3)),
    ("RangeFactor3", (twin.VECTOR, 3), (twin.VECTOR, 3)),
    ("RangeFactor2", (twin.VECTOR, 2), (twin.VECTOR, 2)),
]


@pytest.mark.parametrize(("name", "first", "second"), RANGES)
def test_range_agrees(name, first, second, rng):
    if not hasattr(gtsam, name):
        pytest.skip(f"this GTSAM has no {name}")
    factor = getattr(gtsam, name)(0, 1, 2.5, gtsam.noiseModel.Isotropic.Sigma(1, 0.3))
    for _ in range(10):
        x = [element(*first, rng, 3.0), element(*second, rng, 3.0)]
        compare(twin.RANGE, (first, second), x, 2.5, factor, 0.3)


@pytest.mark.parametrize("target", [(twin.VECTOR, 2), (twin.SE2, 3)])
def test_bearing_in_the_plane_agrees(target, rng):
    name = "BearingFactor2D" if target[0] == twin.VECTOR else "BearingFactorPose2"
    if not hasattr(gtsam, name):
        pytest.skip(f"this GTSAM has no {name}")
    for angle in (0.3, -2.8):
        z = np.array([np.cos(angle), np.sin(angle)])
        factor = getattr(gtsam, name)(0, 1, gtsam.Rot2(angle), gtsam.noiseModel.Isotropic.Sigma(1, 0.2))
        for _ in range(10):
            x = [element(twin.SE2, 3, rng, 3.0), element(*target, rng, 3.0)]
            compare(twin.BEARING, ((twin.SE2, 3), target), x, z, factor, 0.2)


def test_bearing_range_in_the_plane_is_the_sum_of_both(rng):
    families = ((twin.SE2, 3), (twin.VECTOR, 2))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.1, 0.4]))
    for angle in (0.3, -2.8):
        factor = gtsam.BearingRangeFactor2D(0, 1, gtsam.Rot2(angle), 2.5, noise)
        x = [element(twin.SE2, 3, rng, 3.0), rng.normal(size=2) * 3.0]
        values = values_of(families, x)
        z = np.array([np.cos(angle), np.sin(angle)])
        both = [(twin.BEARING, z, 0.1), (twin.RANGE, 2.5, 0.4)]
        parts = [evaluate(kind, families, [x], [value], S=1.0 / sigma) for kind, value, sigma in both]
        np.testing.assert_allclose(sum(p[4] for p in parts), 2.0 * factor.error(values), rtol=1e-9)
        theirs, _ = jacobians_of(factor, families, values)
        for a in range(2):
            ours = np.concatenate([p[2][a][0] / sigma for p, (*_, sigma) in zip(parts, both, strict=True)])
            np.testing.assert_allclose(ours, theirs[a], rtol=1e-8, atol=1e-8)


def test_position_is_gtsams_position_factor_of_poses(rng):
    """Its name there is of one sensor; the residual is the translation less the measured one."""
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.7)
    name = "".join(["G", "P", "S", "Factor"])
    for _ in range(5):
        z = rng.normal(size=3)
        factor = getattr(gtsam, name)(0, z, noise)
        compare(twin.POSITION, ((twin.SE3, 6),), [element(twin.SE3, 6, rng, 3.0)], z, factor, 0.7)


def test_bearing_in_space_has_gtsams_information_at_the_measured_direction(rng):
    families, noise = ((twin.SE3, 6), (twin.VECTOR, 3)), gtsam.noiseModel.Isotropic.Sigma(2, 0.2)
    for _ in range(10):
        x = [element(*families[0], rng, 3.0), rng.normal(size=3) * 3.0]
        z = twin.s2.project(x[0][:3, :3].T @ (x[1] - x[0][:3, 3]))
        theirs, _ = jacobians_of(gtsam.BearingFactor3D(0, 1, gtsam.Unit3(z), noise), families, values_of(families, x))
        *_, blocks, _, _, _, _ = evaluate(twin.BEARING, families, [x], [z], S=5.0)
        # The two bases of the tangent plane differ, what they span does not.
        np.testing.assert_allclose(blocks[0][:36].reshape(6, 6), theirs[0].T @ theirs[0], rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(blocks[0][36:54].reshape(6, 3), theirs[0].T @ theirs[1], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(("pose", "point"), [((twin.SE3, 6), (twin.VECTOR, 3)), ((twin.SE2, 3), (twin.VECTOR, 2))])
def test_landmark_is_gtsams_point_seen_from_a_pose(pose, point, rng):
    n, columns = point[1], ORDER.get(pose[0], list(range(pose[1])))
    for _ in range(5):
        x, z = [element(*pose, rng, 3.0), rng.normal(size=n)], rng.normal(size=n)
        H_pose, H_point = (np.zeros((n, d), order="F") for d in (pose[1], n))
        seen = to_gtsam(pose[0], x[0]).transformTo(x[1], H_pose, H_point)
        residual, _, jacobians, *_ = evaluate(twin.LANDMARK, (pose, point), [x], [z])
        np.testing.assert_allclose(residual[0], seen - z, atol=1e-12)
        np.testing.assert_allclose(jacobians[0][0], H_pose[:, np.argsort(columns)], atol=1e-12)
        np.testing.assert_allclose(jacobians[1][0], H_point, atol=1e-12)


def test_direction_on_the_sphere_has_gtsams_angle_for_small_errors(rng):
    """GTSAM's error of directions is the chord's projection and ours the angle: equal to third order."""
    z = twin.s2.project(rng.normal(size=3))
    x = twin.s2.retract(z, 1e-3 * rng.normal(size=2))
    residual, *_ = evaluate(twin.PRIOR, ((twin.S2, 2),), [[x]], [z])
    theirs = np.linalg.norm(gtsam.Unit3(z).errorVector(gtsam.Unit3(x)))
    np.testing.assert_allclose(np.linalg.norm(residual[0]), theirs, rtol=1e-5)


KERNELS = [
    (twin.HUBER, "Huber", 1.345, 1.345),
    (twin.CAUCHY, "Cauchy", 0.8, 0.8),
    (twin.TUKEY, "Tukey", 4.0, 4.0),
    (twin.DCS, "DCS", 1.7, 1.7),
]


@pytest.mark.parametrize(("kernel", "name", "width", "theirs"), KERNELS)
def test_robust_costs_agree(kernel, name, width, theirs, rng):
    family = ((twin.SE3, 6),) * 2
    base = gtsam.noiseModel.Isotropic.Sigma(6, 1.0)
    estimator = getattr(gtsam.noiseModel.mEstimator, name).Create(theirs)
    robust = gtsam.noiseModel.Robust.Create(estimator, base)
    z = np.eye(4)
    for scale in (0.05, 0.3, 1.0, 3.0):
        x = [element(twin.SE3, 6, rng, 1.0)]
        x.append(x[0] @ twin.se3.exp(scale * rng.normal(size=6) / 2.0))
        factor = gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(z), robust)
        values = values_of(family, x)
        *_, blocks, _, cost, _, alone = evaluate(twin.BETWEEN, family, [x], [z], kernel=kernel, width=width)
        np.testing.assert_allclose([cost, alone], 2.0 * factor.error(values), rtol=1e-9)
        A, b = factor.linearize(values).jacobian()
        information, gradient = A.T @ A, A.T @ b
        np.testing.assert_allclose(blocks[0][:36].reshape(6, 6), information[:6, :6], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(blocks[0][36:72].reshape(6, 6), information[:6, 6:], rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(blocks[0][108:], -gradient, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("length", [0.1, 0.9, 1.1, 4.0])
def test_geman_mcclure_is_gtsams_up_to_its_parameter(length):
    """GTSAM's weight is c^4 / (c^2 + r^2)^2 as ours; its cost is the same function."""
    estimator = gtsam.noiseModel.mEstimator.GemanMcClure.Create(1.2)
    x, z = np.array([length]), np.zeros(1)
    *_, blocks, _, cost, _, _ = evaluate(
        twin.PRIOR, ((twin.VECTOR, 1),), [[x]], [z], kernel=twin.GEMAN_MCCLURE, width=1.2
    )
    np.testing.assert_allclose(blocks[0][0], estimator.weight(length), rtol=1e-12)
    np.testing.assert_allclose(cost, 2.0 * estimator.loss(length), rtol=1e-12)
