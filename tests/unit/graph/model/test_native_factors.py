"""The native factors agree with their slow twin, at errors up to a half turn, in both instruction sets."""

import itertools
import os
import subprocess
import sys

import numpy as np
import pytest

from heliograph import _core
from heliograph.lie import s2, so3
from heliograph.testing import assert_robust_kernel
from native_factors import element, evaluate, turn
from reference import factors as twin

ANGLES = (0.0, 1e-9, 1e-4, 0.3, np.pi / 4 - 1e-9, np.pi / 4 + 1e-9, 1.2, 2.0, 3.0, np.pi - 1e-3, np.pi - 1e-6)
GROUPS = (twin.SO2, twin.SO3, twin.SE2, twin.SE3, twin.NAV)
POSES = {2: ((twin.SE2, 3),), 3: ((twin.SE3, 6), (twin.NAV, 9))}
POINTS = {2: ((twin.VECTOR, 2),), 3: ((twin.VECTOR, 3),)}


def pairs(poses, targets):
    return [(i, j) for space in (2, 3) for i in poses[space] for j in targets[space]]


EVERYWHERE = {space: POSES[space] + POINTS[space] for space in (2, 3)}
CASES = [
    *((twin.PRIOR, ((m, twin.DOF[m]),)) for m in (*GROUPS, twin.S2)),
    *((twin.PRIOR, ((twin.VECTOR, d),)) for d in (1, 2, 3, 16)),
    *((twin.BETWEEN, ((m, twin.DOF[m]),) * 2) for m in GROUPS),
    *((twin.BETWEEN, ((twin.VECTOR, d),) * 2) for d in (1, 2, 3, 4, 6, 7)),
    *((twin.RANGE, pair) for pair in pairs(EVERYWHERE, EVERYWHERE)),
    *((kind, pair) for kind in (twin.BEARING, twin.LANDMARK) for pair in pairs(POSES, EVERYWHERE)),
    *((twin.POSITION, ((m, d),)) for m, d in ((twin.SE2, 3), (twin.SE3, 6), (twin.NAV, 9), (twin.VECTOR, 4))),
    *((twin.LINEAR_MOTION, ((twin.VECTOR, i), (twin.VECTOR, j))) for i, j in ((1, 1), (3, 3), (6, 6), (4, 2), (3, 5))),
]


def measurement(kind, families, rng):
    space = 2 if families[0][0] == twin.SE2 or families[0] == (twin.VECTOR, 2) else 3
    if kind in (twin.PRIOR, twin.BETWEEN):
        return element(*families[0], rng)
    if kind == twin.RANGE:
        return rng.uniform(0, 5)
    if kind == twin.BEARING:
        direction = rng.normal(size=space)
        return direction / np.linalg.norm(direction)
    if kind == twin.LINEAR_MOTION:
        n, m = families[0][1], families[1][1]
        return rng.normal(size=m * n + m)
    return rng.normal(size=families[0][1] if families[0][0] == twin.VECTOR else space)


def folded(kind, manifolds, x, z):
    """Whether an error is so near a half turn that steps of a derivative would wrap."""
    if kind not in (twin.PRIOR, twin.BETWEEN, twin.BEARING) or manifolds[0] == twin.VECTOR:
        return False
    r = twin.residual(kind, manifolds, x, z)
    angle = r if manifolds[0] == twin.S2 or kind == twin.BEARING else r[: 1 if manifolds[0] in (1, 3) else 3]
    return np.linalg.norm(angle) > 3.0


def instances(kind, families, rng, count=20):
    xs, zs = [], []
    while len(xs) < count:
        x, z = [element(m, d, rng) for m, d in families], measurement(kind, families, rng)
        if not folded(kind, [m for m, _ in families], x, z):
            xs.append(x)
            zs.append(z)
    return xs, zs


@pytest.mark.parametrize(("kind", "families"), CASES)
def test_factor_has_the_twins_residual_and_numeric_jacobians(kind, families, rng):
    xs, zs = instances(kind, families, rng)
    manifolds = [m for m, _ in families]
    residual, squared, jacobians, *_ = evaluate(kind, families, xs, zs)
    for k, (x, z) in enumerate(zip(xs, zs, strict=True)):
        expected = np.atleast_1d(twin.residual(kind, manifolds, x, z))
        np.testing.assert_allclose(residual[k], expected, rtol=1e-12, atol=1e-12 * (1 + np.abs(expected).max()))
        np.testing.assert_allclose(squared[k], expected @ expected, rtol=1e-12)
        for a, numeric in enumerate(twin.numeric_jacobians(kind, manifolds, x, z)):
            np.testing.assert_allclose(jacobians[a][k], numeric, rtol=1e-7, atol=1e-7 * (1 + np.abs(numeric).max()))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("manifold", GROUPS)
@pytest.mark.parametrize("kind", [twin.PRIOR, twin.BETWEEN])
def test_pose_factors_are_exact_at_every_error(kind, manifold, scale, rng):
    group, families = twin.GROUPS[manifold], ((manifold, twin.DOF[manifold]),) * (1 if kind == twin.PRIOR else 2)
    xs, zs, wanted = [], [], []
    for angle, _ in itertools.product(ANGLES, range(5)):
        r, z = turn(manifold, angle, rng, scale), element(manifold, None, rng, scale)
        target = z @ group.exp(r)
        first = element(manifold, None, rng, scale)
        xs.append([target] if kind == twin.PRIOR else [first, first @ target])
        zs.append(z)
        wanted.append(r)
    residual, _, jacobians, *_ = evaluate(kind, families, xs, zs)
    # What lies between the elements was rounded by the matrices themselves, at the size of their coordinates.
    np.testing.assert_allclose(residual, wanted, rtol=0, atol=3e-14 * (1 + 10 * scale) * 3)
    for k, (x, z) in enumerate(zip(xs, zs, strict=True)):
        expected = twin.residual(kind, [manifold], x, z)
        # A half turn less 1e-6 magnifies rounding where the twin divides; 1e-12 of the largest number holds throughout.
        np.testing.assert_allclose(residual[k], expected, rtol=0, atol=1e-12 * max(1.0, np.abs(expected).max(), scale))
        for a, J in enumerate(twin.jacobians(kind, [manifold], x, z)):
            np.testing.assert_allclose(jacobians[a][k], J, rtol=0, atol=1e-12 * max(1.0, np.abs(J).max(), scale))


@pytest.mark.parametrize("manifold", GROUPS)
def test_tiny_error_keeps_its_digits(manifold, rng):
    """A residual of 1e-9 is known to 1e-16 of the elements, and a zero one is zero."""
    d = turn(manifold, 1e-9, rng, 1e-9)
    z = np.eye(*twin.GROUPS[manifold].exp(d).shape)
    residual, *_ = evaluate(
        twin.PRIOR, ((manifold, twin.DOF[manifold]),), [[twin.GROUPS[manifold].exp(d)], [z]], [z, z]
    )
    np.testing.assert_allclose(residual[0], d, rtol=1e-14)
    assert not residual[1].any()


NOISES = [(form, shared) for form in (twin.SCALAR, twin.DIAGONAL, twin.FULL) for shared in (True, False)]


def root_information(form, rows, rng):
    if form == twin.SCALAR:
        return rng.uniform(0.5, 2.0, size=1)
    if form == twin.DIAGONAL:
        return rng.uniform(0.5, 2.0, size=rows)
    return np.triu(rng.normal(size=(rows, rows))).ravel()


@pytest.mark.parametrize("kernel", range(7))
@pytest.mark.parametrize(("form", "shared"), NOISES)
@pytest.mark.parametrize(
    ("kind", "families"),
    [
        (twin.BETWEEN, ((twin.SE2, 3),) * 2),
        (twin.BETWEEN, ((twin.SE3, 6),) * 2),
        (twin.BETWEEN, ((twin.VECTOR, 5),) * 2),
        (twin.BETWEEN, ((twin.NAV, 9),) * 2),
        (twin.PRIOR, ((twin.SE3, 6),)),
        (twin.PRIOR, ((twin.S2, 2),)),
        (twin.RANGE, ((twin.SE2, 3), (twin.VECTOR, 2))),
        (twin.LANDMARK, ((twin.SE3, 6), (twin.VECTOR, 3))),
        (twin.BEARING, ((twin.SE3, 6), (twin.VECTOR, 3))),
        (twin.LINEAR_MOTION, ((twin.VECTOR, 4), (twin.VECTOR, 2))),
    ],
)
def test_blocks_and_cost_are_the_twins(kind, families, form, shared, kernel, rng):
    xs, zs = instances(kind, families, rng, 12)
    residual, _, jacobians, *_ = evaluate(kind, families, xs, zs)
    rows, n = residual.shape[1], len(xs)
    S = [root_information(form, rows, rng) for _ in range(1 if shared else n)]
    weight, shift = rng.uniform(0, 2, size=n), rng.normal(size=(n, rows))
    lengths = [np.linalg.norm(twin.whiten(form, S[0 if shared else k], residual[k]) + shift[k]) for k in range(n)]
    width = float(np.median(lengths)) ** (2 if kernel == twin.DCS else 1)  # half of them on either side
    noise = {"form": form, "S": np.concatenate(S), "shared": shared, "kernel": kernel, "width": width}
    for given in ({}, {"weight": weight}, {"shift": shift.ravel()}, {"weight": weight, "shift": shift.ravel()}):
        *_, blocks, chi2, cost, chi2_alone, cost_alone = evaluate(kind, families, xs, zs, **noise, **given)
        expected = [
            twin.linearized(
                residual[k],
                [J[k] for J in jacobians],
                form=form,
                S=S[0 if shared else k],
                kernel=kernel,
                width=width,
                weight=weight[k] if "weight" in given else 1.0,
                shift=shift[k] if "shift" in given else 0.0,
            )
            for k in range(n)
        ]
        for k, (block, _, _) in enumerate(expected):
            np.testing.assert_allclose(blocks[k], block, rtol=1e-12, atol=1e-12 * np.abs(block).max())
        np.testing.assert_allclose([chi2, chi2_alone], sum(e[1] for e in expected), rtol=1e-12)
        np.testing.assert_allclose([cost, cost_alone], sum(e[2] for e in expected), rtol=1e-12)


CUSTOM_KINDS = [
    (((twin.SE2, 3), (twin.VECTOR, 5), (twin.S2, 2)), 4),
    (((twin.SE2, 3), (twin.SO3, 3)), 3),
    (((twin.SE3, 6), (twin.SE3, 6)), 6),
    (((twin.SE3, 6), (twin.SE3, 6)), 5),
    (((twin.VECTOR, 1), (twin.VECTOR, 1)), 1),
    (((twin.VECTOR, 16),) * 8, 20),
]


@pytest.mark.parametrize(("families", "rows"), CUSTOM_KINDS)
def test_custom_factor_passes_on_what_was_handed_in(families, rows, rng):
    n = 7
    xs = [[element(m, d, rng) for m, d in families] for _ in range(n)]
    r, J = rng.normal(size=(n, rows)), [rng.normal(size=(n, rows, d)) for _, d in families]
    S = np.triu(rng.normal(size=(rows, rows)))
    custom = np.concatenate([r[..., None], *J], axis=-1).ravel()
    residual, _, jacobians, blocks, _, cost, *_ = evaluate(
        twin.CUSTOM, families, xs, [], form=twin.FULL, S=S, kernel=twin.HUBER, width=2.0, rows=rows, custom=custom
    )
    np.testing.assert_array_equal(residual, r)
    total = 0.0
    for k in range(n):
        block, _, part = twin.linearized(
            r[k], [j[k] for j in J], form=twin.FULL, S=S.ravel(), kernel=twin.HUBER, width=2.0
        )
        total += part
        np.testing.assert_allclose(blocks[k], block, rtol=1e-12, atol=1e-12 * np.abs(block).max())
    np.testing.assert_allclose(cost, total, rtol=1e-12)
    for ours, given in zip(jacobians, J, strict=True):
        np.testing.assert_array_equal(ours, given)


class NativeKernel:
    """A native robust kernel on plain numbers."""

    def __init__(self, code, width):
        self.given = {"kernel": code, "width": width}

    def _each(self, r):
        for one in np.ravel(r):
            yield evaluate(twin.PRIOR, ((twin.VECTOR, 1),), [[np.array([one])]], [np.zeros(1)], **self.given)

    def cost(self, r):
        return np.reshape([0.5 * out[5] for out in self._each(r)], np.shape(r))

    def weight(self, r):
        return np.reshape([out[3][0, 0] for out in self._each(r)], np.shape(r))


@pytest.mark.parametrize("code", range(6))
@pytest.mark.parametrize("width", [0.7, 1.1, 2.5])
def test_robust_kernels_obey_the_law(code, width):
    assert_robust_kernel(NativeKernel(code, width))


def test_truncated_kernel_is_least_squares_until_it_ends():
    kernel, r = NativeKernel(twin.TRUNCATED, 2.0), np.array([0.0, 1.0, 1.999, 2.001, 50.0])
    np.testing.assert_allclose(kernel.cost(r), np.minimum(r, 2.0) ** 2 / 2)
    np.testing.assert_array_equal(kernel.weight(r), [1, 1, 1, 0, 0])


@pytest.mark.parametrize("target", [(twin.VECTOR, 3), (twin.SE3, 6)])
@pytest.mark.parametrize("kind", [twin.RANGE, twin.BEARING])
def test_point_at_the_pose_has_no_direction_and_gives_no_nan(kind, target, rng):
    pose = element(twin.SE3, 6, rng)
    other = pose[:3, 3] if target[0] == twin.VECTOR else pose
    z = 1.0 if kind == twin.RANGE else np.array([1.0, 0, 0])
    residual, _, jacobians, blocks, *_ = evaluate(kind, ((twin.SE3, 6), target), [[pose, other]], [z])
    assert np.isfinite(residual).all()
    assert not any(J.any() for J in jacobians)
    assert not blocks.any()


def test_opposite_direction_is_finite():
    z = np.array([0.0, 0.6, 0.8])
    residual, _, jacobians, *_ = evaluate(twin.PRIOR, ((twin.S2, 2),), [[-z]], [z])
    np.testing.assert_allclose(residual, [s2.local(z, -z)], atol=1e-15)
    assert np.isfinite(jacobians[0]).all()


@pytest.mark.parametrize("step", [0.0, 1e-9, 1e-3, 0.4, 1.49, 1.51, 3.1, 7.0])
@pytest.mark.parametrize("manifold", [*GROUPS, twin.S2, twin.VECTOR])
def test_retract_is_the_twins(manifold, step, rng):
    dof = twin.DOF.get(manifold, 5)
    xs = [element(manifold, dof, rng) for _ in range(30)]
    d = rng.normal(size=(30, dof))
    d *= step / np.linalg.norm(d, axis=1, keepdims=True)
    out = _core.testing.retract_values(manifold, np.stack([twin.pack(manifold, x) for x in xs]), d)
    for k, x in enumerate(xs):
        expected = twin.pack(manifold, twin.retract(manifold, x, d[k]))
        np.testing.assert_allclose(out[k], expected, rtol=1e-14, atol=2e-14)


@pytest.mark.parametrize("manifold", [*GROUPS, twin.S2])
def test_thousands_of_steps_keep_rotations_orthonormal(manifold, rng):
    x = twin.pack(manifold, element(manifold, None, rng))[None]
    for d in rng.normal(size=(5000, 1, twin.DOF[manifold])):
        x = _core.testing.retract_values(manifold, x, 0.3 * d)
    element_now = twin.unpack(manifold, x[0])
    if manifold == twin.S2:
        assert abs(np.linalg.norm(element_now) - 1.0) < 1e-15
        return
    R = element_now[:2, :2] if manifold in (twin.SO2, twin.SE2) else element_now[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(len(R)), atol=1e-15)


def digest():
    """All factors' numbers in one vector, for the comparison of two instruction sets."""
    rng, parts = np.random.default_rng(5), []
    for kind, families in CASES:
        xs, zs = instances(kind, families, rng, 6)
        rows = evaluate(kind, families, xs, zs)[0].shape[1]
        S = root_information(twin.FULL, rows, rng)
        out = evaluate(kind, families, xs, zs, form=twin.FULL, S=S, kernel=twin.CAUCHY, width=3.0)
        for array in (out[0], *out[2], out[3], np.array(out[4:])):
            parts.append((np.abs(array).max(), array.ravel()))
    return parts


def test_both_instruction_sets_give_the_same_numbers(tmp_path):
    here, files = digest(), [tmp_path / "a.npy", tmp_path / "b.npy"]
    code = (
        "import sys, numpy as np\n"
        "from test_native_factors import digest\n"
        "np.save(sys.argv[1], np.concatenate([p for _, p in digest()]))"
    )
    for path in files:
        environment = {**os.environ, "HELIOGRAPH_ISA": "baseline", "PYTHONPATH": os.pathsep.join(sys.path)}
        subprocess.run([sys.executable, "-c", code, str(path)], env=environment, check=True)
    first, second = (np.load(path) for path in files)
    np.testing.assert_array_equal(first, second)
    at = 0
    for scale, part in here:
        np.testing.assert_allclose(first[at : at + len(part)], part, rtol=0, atol=1e-11 * scale)
        at += len(part)


def refused(match, **change):
    given = {
        "type": twin.BETWEEN,
        "families": np.array([[twin.SE2, 3, 2]], dtype=np.int64),
        "values": np.tile([1.0, 0, 0, 0], 2),
        "variables": np.array([[0, 1]], dtype=np.int32),
        "rows": 0,
        "measurement": np.array([1.0, 0, 0, 0]),
        "noise": twin.SCALAR,
        "shared_noise": True,
        "sqrt_information": np.ones(1),
        "kernel": 0,
        "kernel_width": 1.0,
        "weight": np.empty(0),
        "shift": np.empty(0),
        "custom": np.empty(0),
    }
    _core.testing.evaluate_factors(**given)
    with pytest.raises(ValueError, match=match):
        _core.testing.evaluate_factors(**{**given, **change})


def test_arrays_that_do_not_fit_are_refused():
    refused("belongs to no family", variables=np.array([[9, 1]], dtype=np.int32))
    refused("measurement needs 4", measurement=np.ones(3))
    refused("measurement needs 4", measurement=np.ones(8))
    refused("square root information needs 1", sqrt_information=np.ones(2))
    refused("square root information needs 9", noise=twin.FULL)
    refused("width must be positive", kernel=twin.HUBER, kernel_width=0.0)
    refused(
        "no residual is known", type=twin.LINEAR_MOTION, families=np.array([[twin.SO2, 1, 4]], dtype=np.int64)[:, :]
    )
    refused("no residual is known", variables=np.array([[0]], dtype=np.int32))
    refused("do not match the factors", weight=np.ones(2))
    refused("3 rows", rows=2)


def test_log_of_so3_keeps_its_axis_near_a_half_turn(rng):
    for gap in (1e-3, 1e-6, 1e-9, 1e-12, 0.0):
        phi = turn(twin.SO3, np.pi - gap, rng)
        residual, *_ = evaluate(twin.PRIOR, ((twin.SO3, 3),), [[so3.exp(phi)]], [np.eye(3)])
        sign = 1.0 if residual[0] @ phi > 0 else -1.0
        assert sign > 0 or gap < 1e-9
        np.testing.assert_allclose(sign * residual[0], phi, atol=1e-11)
