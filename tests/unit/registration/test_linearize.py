"""Normal equations against brute force, numeric differentiation, and a map of one's own."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from heliograph.cloud import deskew
from heliograph.config import MapConfig
from heliograph.errors import ConfigError
from heliograph.lie import se3, so3
from heliograph.maps import VoxelMap
from heliograph.registration import MapMounting, MatchSettings, gradient_scatter, linearize
from heliograph.testing import assert_jacobian, assert_robust_kernel, numeric_jacobian
from neighbour_map import NeighbourMap
from reference.maps import SlowVoxelMap
from reference.matching import match_planes_slowly, match_points_slowly, mounting_row
from states import START_NS, random_pose, random_rotation, room_cloud

CONFIG = MapConfig(voxel=0.5)
SETTINGS = MatchSettings(gate=0.25, kernel=0.1, sigma=0.03, fallback_stride=1)


class AnyMap:
    """Hides that a map is the native one, so that NumPy sums its planes."""

    def __init__(self, inner):
        self.inner = inner

    def insert(self, points_body, T_odom_body):
        return self.inner.insert(points_body, T_odom_body)

    def prune(self, centre_odom):
        self.inner.prune(centre_odom)

    def clear(self):
        self.inner.clear()

    def planes_at(self, points_odom, *, gate):
        return self.inner.planes_at(points_odom, gate=gate)

    def __len__(self):
        return len(self.inner)


def scene(rng, points=1500, queries=400, config=CONFIG):
    """A filled map with its twin, a pose, and points of the imu frame that lie near the walls from there."""
    fast, slow = VoxelMap(config), SlowVoxelMap(config)
    cloud = room_cloud(rng, points)
    for some in (fast, slow):
        some.insert(cloud, np.eye(4))
    T = random_pose(rng, 1.0)
    world = room_cloud(rng, queries, sigma=0.05)
    return fast, slow, T, ((world - T[:3, 3]) @ T[:3, :3]).astype(np.float32)


def assert_equal_sums(equations, slow, *, rtol=2e-3):
    A, b, weight, robust, square, cost, matches, fallbacks = slow
    scale = np.sqrt(np.diag(A))
    np.testing.assert_allclose(equations.information / np.outer(scale, scale), A / np.outer(scale, scale), atol=rtol)
    np.testing.assert_allclose(equations.gradient / scale, b / scale, atol=rtol * np.sqrt(2.0 * cost))
    for value, expected in ((equations.weight, weight), (equations.robust_weight, robust), (equations.square, square)):
        assert value == pytest.approx(expected, rel=rtol)
    assert equations.cost == pytest.approx(cost, rel=rtol)
    assert (equations.matches, equations.fallback_matches) == (matches, fallbacks)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["pose", "motion"])
@pytest.mark.parametrize("residual", ["plane", "point"])
def test_sums_equal_brute_force(seed, kind, residual):
    rng = np.random.default_rng(seed)
    fast, slow_map, T, points = scene(rng)
    before_end = rng.uniform(0.0, 0.1, len(points)).astype(np.float32) if kind == "motion" else None
    got = linearize(fast, points, T, replace(SETTINGS, residual=residual), before_end=before_end)
    twin = match_planes_slowly if residual == "plane" else match_points_slowly
    expected = twin(slow_map, points, T, gate=0.25, kernel=0.1, sigma=0.03, before_end=before_end)
    assert got.matches > 100
    assert got.queries == len(points)
    assert_equal_sums(got, expected)


@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_sums_by_the_mounting_equal_brute_force(seed, both):
    """The map was begun at another pose."""
    rng = np.random.default_rng(seed)
    fast, slow_map = VoxelMap(CONFIG), SlowVoxelMap(CONFIG)
    T_first, T_il = random_pose(rng, 1.0), random_pose(rng, 0.3)
    cloud = ((room_cloud(rng, 1500) - T_first[:3, 3]) @ T_first[:3, :3]).astype(np.float32)
    fast.insert(cloud, T_first)
    slow_map.insert(cloud, T_first)
    _, _, T, points = scene(rng, points=6)
    before_end = rng.uniform(0.0, 0.1, len(points)).astype(np.float32) if both else None
    mounted = MapMounting(T_imu_lidar=T_il, T_odom_imu_first=T_first)
    got = linearize(fast, points, T, SETTINGS, before_end=before_end, mounted=mounted)
    expected = match_planes_slowly(
        slow_map, points, T, gate=0.25, kernel=0.1, sigma=0.03, before_end=before_end, T_imu_lidar=T_il,
        T_first=T_first,
    )  # fmt: skip
    assert got.blocks == (("pose", "motion", "mounting") if both else ("pose", "mounting"))
    assert got.matches > 50
    assert got.information[got.columns_of("mounting"), got.columns_of("mounting")].any()
    assert_equal_sums(got, expected)


def test_mounting_columns_are_the_derivative_of_what_a_mounting_error_shows(rng):
    """How far the point moves here less how far it moved at the first pose, numerically, at large poses."""
    T_first, T, T_il = random_pose(rng, 5.0), random_pose(rng, 5.0), random_pose(rng, 0.5)
    for _ in range(20):
        q, n = rng.uniform(-20.0, 20.0, 3), random_rotation(rng)[:, 0]

        def shown(d, q=q, n=n):
            moved = T_il.copy()
            moved[:3, :3] = T_il[:3, :3] @ so3.exp(d[:3])
            moved[:3, 3] += d[3:]
            here, then = (X @ moved @ np.linalg.inv(X @ T_il) @ np.append(q, 1.0) for X in (T, T_first))
            return np.array([n @ (here - then)[:3]])

        assert_jacobian(shown, np.zeros(6), mounting_row(n, q, T, T_il, T_first=T_first, source=1)[None])


@pytest.mark.parametrize("kernel", [0.0, 0.05])
@pytest.mark.parametrize("kind", ["pose", "motion", "mounting", "both"])
def test_native_sums_equal_those_over_any_map(rng, kernel, kind):
    """With few points, so that some planes go through neighbours; those know nothing of the mounting."""
    fast, _, T, points = scene(rng, points=1500, queries=3000)
    blocks = {
        "before_end": rng.uniform(0.0, 0.1, len(points)).astype(np.float32) if kind in ("motion", "both") else None,
        "mounted": MapMounting(T_imu_lidar=random_pose(rng, 0.3), T_odom_imu_first=random_pose(rng, 1.0))
        if kind in ("mounting", "both")
        else None,
    }
    settings = replace(SETTINGS, kernel=kernel)
    a = linearize(fast, points, T, settings, **blocks)
    b = linearize(AnyMap(fast), points, T, settings, **blocks)
    assert a.blocks == b.blocks
    assert a.fallback_matches > 10
    assert_equal_sums(
        a,
        (b.information, b.gradient, b.weight, b.robust_weight, b.square, b.cost, b.matches, b.fallback_matches),
        rtol=1e-6,
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("moving", [0.0, 1.0])
def test_pose_and_motion_columns_are_derivatives_of_the_deskewed_residual(seed, moving):
    """The whole chain, from a raw point through mounting, de-skew and pose to the residual, at a large pose.

    Position and velocity are exact; the others to first order in the motion within the sweep, so exact in a still one.
    """
    rng = np.random.default_rng(seed)
    cloud_map = VoxelMap(CONFIG)
    cloud_map.insert(room_cloud(rng, 20_000, sigma=0.003), np.eye(4))
    T_il = random_pose(rng, 0.3)
    R, p = random_rotation(rng), rng.uniform(-1.0, 1.0, 3)
    v, rate, dt = moving * rng.normal(size=3), moving * rng.normal(size=3), 0.08
    goal = room_cloud(rng, 60, sigma=0.02).astype(np.float64)

    def swept(points_lidar, d):
        """De-skew as the constant-velocity model does and move to odom, all errors retracted by d (18,)."""
        R_d, p_d, v_d, bias_d = R @ so3.exp(d[0:3]), p + d[3:6], v + d[6:9], -rate + d[9:12]
        R_l, t_l = T_il[:3, :3] @ so3.exp(d[12:15]), T_il[:3, 3] + d[15:18]
        ends = np.array([START_NS, START_NS + int(1e9 * dt)], dtype=np.int64)
        before = np.array([[-dt], [0.0]])
        path_R, path_p = R_d @ so3.exp(-before * bias_d), p_d + before * v_d
        mount = se3.from_rotation_translation(R_l, t_l)
        body = points_lidar @ mount[:3, :3].T + mount[:3, 3]
        return body @ path_R[0].T + path_p[0], R_d, p_d, (ends, path_R, path_p, mount)

    # Raw points that end up at the goals: all measured dt before the end.
    zero = np.zeros(18)
    R_0 = R @ so3.exp(-dt * rate)
    body = (goal - (p - dt * v)) @ R_0
    raw = (body - T_il[:3, 3]) @ T_il[:3, :3]
    np.testing.assert_allclose(swept(raw, zero)[0], goal, atol=1e-9)
    _, _, _, (ends, path_R, path_p, mount) = swept(raw, zero)
    offsets = np.zeros(len(raw), np.int32)
    points_imu = deskew(raw.astype(np.float32), offsets, stamp_ns=START_NS, path_stamps_ns=ends, R_odom_body=path_R,
                        p_odom=path_p, T_body_lidar=mount)  # fmt: skip
    T = se3.from_rotation_translation(R, p)
    before_end = np.full(len(raw), dt, np.float32)
    tested = 0
    for i in range(len(raw)):
        plane = cloud_map.planes_at(goal[i : i + 1], gate=0.2)
        if plane.source[0] in (0, 255):
            continue
        n, c = plane.normal[0].astype(np.float64), plane.point[0]
        numeric = numeric_jacobian(lambda d: (swept(raw[i : i + 1], d)[0][0] - c) @ n, zero)  # noqa: B023
        r = (goal[i] - c) @ n
        point = points_imu[i : i + 1]
        motion = linearize(cloud_map, point, T, replace(SETTINGS, kernel=0.0), before_end=before_end[:1])
        assert motion.matches == 1
        J = motion.gradient / (motion.weight * r)
        slack = 2e-3 + 1e-5 / abs(r)
        bent = dt * (np.linalg.norm(rate) * np.linalg.norm(point) + np.linalg.norm(v))  # how far the sweep moved it
        np.testing.assert_allclose(J[3:9], numeric[3:9], atol=slack)
        np.testing.assert_allclose(J[:3], numeric[:3], atol=bent + slack)
        np.testing.assert_allclose(J[9:12], numeric[9:12], atol=dt * bent + slack)
        tested += abs(r) > 0.005
    assert tested > 10


def test_rotating_the_world_changes_nothing_but_the_frame(rng):
    """A k-d tree's planes know no axes; cost and information must follow the frame exactly."""
    cloud, T, turn = room_cloud(rng, 3000), random_pose(rng, 1.0), random_pose(rng, 50.0)
    world = room_cloud(rng, 500, sigma=0.05)
    points = ((world - T[:3, 3]) @ T[:3, :3]).astype(np.float32)
    here, there = NeighbourMap(spacing=1e-3), NeighbourMap(spacing=1e-3)
    here.insert(cloud, np.eye(4))
    there.insert(cloud, turn)
    a = linearize(here, points, T, SETTINGS)
    b = linearize(there, points, turn @ T, SETTINGS)
    assert a.matches == b.matches > 300
    assert b.cost == pytest.approx(a.cost, rel=1e-4)
    G = np.eye(6)
    G[3:, 3:] = turn[:3, :3]
    np.testing.assert_allclose(b.information, G @ a.information @ G.T, rtol=1e-3, atol=1e-3 * a.information.max())
    np.testing.assert_allclose(b.gradient, G @ a.gradient, rtol=1e-3, atol=1e-3 * np.abs(a.gradient).max())


def test_moving_world_and_sensor_together_by_whole_cubes_changes_nothing(rng):
    _, _, T, points = scene(rng)
    shift = np.eye(4)
    shift[:3, 3] = [800.0, -1600.0, 80.0]
    far = VoxelMap(CONFIG)
    far.insert(room_cloud(np.random.default_rng(1), 1500), shift)
    near = VoxelMap(CONFIG)
    near.insert(room_cloud(np.random.default_rng(1), 1500), np.eye(4))
    a, b = linearize(near, points, T, SETTINGS), linearize(far, points, shift @ T, SETTINGS)
    assert a.matches == b.matches > 100
    assert b.cost == pytest.approx(a.cost, rel=1e-3)


def test_gradient_is_the_derivative_of_the_cost(rng):
    """With a kernel too: the weights are its slope. Matches are held by a wide gate and a flat world."""
    local_map = NeighbourMap(spacing=1e-3, neighbours=20)
    a, b = rng.uniform(-5.0, 5.0, (2, 4000))
    local_map.insert(np.stack([a, b, 0.0 * a], axis=1).astype(np.float32), np.eye(4))
    T = se3.from_rotation_translation(so3.exp(np.array([0.01, -0.02, 2.0])), np.array([0.2, 0.1, 0.03]))
    points = np.concatenate([rng.uniform(-3.0, 3.0, (200, 2)), np.full((200, 1), 0.02)], axis=1).astype(np.float32)
    settings = replace(SETTINGS, gate=1.0)

    def cost(d):
        moved = T.copy()
        moved[:3, :3] = T[:3, :3] @ so3.exp(d[:3])
        moved[:3, 3] += d[3:]
        return np.array([linearize(local_map, points, moved, settings).cost])

    numeric = numeric_jacobian(cost, np.zeros(6), step=1e-4)[0]
    np.testing.assert_allclose(linearize(local_map, points, T, settings).gradient, numeric, rtol=1e-3, atol=2.0)


class NativeKernel:
    """The kernel inside the native sums, read back from one point at a chosen distance of a wall."""

    def __init__(self, native):
        self.map = VoxelMap(MapConfig(voxel=1000.0, levels=1, max_thickness=1.0))
        a, b = np.random.default_rng(3).uniform(100.0, 900.0, (2, 4000))
        self.map.insert(np.stack([a, b, np.full(4000, 500.0)], axis=1).astype(np.float32), np.eye(4))
        if not native:
            self.map = AnyMap(self.map)

    def sums(self, r):
        centre = np.array([[500.0, 500.0, 0.0]], np.float32)
        settings = MatchSettings(gate=1e3, kernel=1.0, sigma=1.0)
        T = np.eye(4)
        for value in r:
            T[2, 3] = 500.0 + value
            yield linearize(self.map, centre, T.copy(), settings)

    def cost(self, r):
        inverse = 1.0 / 1.0
        return np.array([s.cost * inverse * s.robust_weight / s.weight for s in self.sums(r)])

    def weight(self, r):
        return np.array([s.robust_weight for s in self.sums(r)])


@pytest.mark.parametrize("native", [True, False])
def test_kernel_obeys_the_law(native):
    assert_robust_kernel(NativeKernel(native), largest=300.0, tolerance=2e-3)


def test_sums_do_not_depend_on_threads(rng):
    fast, _, T, points = scene(rng, points=6000, queries=6000)
    for residual in ("plane", "point"):
        one, two = (
            linearize(fast, points, T, replace(SETTINGS, threads=n, residual=residual, fallback_stride=2))
            for n in (1, 2)
        )
        np.testing.assert_array_equal(one.information, two.information)
        np.testing.assert_array_equal(one.gradient, two.gradient)
        assert (one.cost, one.matches, one.fallback_matches) == (two.cost, two.matches, two.fallback_matches)


def test_fallback_stride_asks_every_nth(rng):
    fast, _, T, points = scene(rng, points=700, queries=500)
    counts = [linearize(fast, points, T, replace(SETTINGS, fallback_stride=n)).fallback_matches for n in (0, 1, 2)]
    assert counts[0] == 0
    assert 0.3 * counts[1] < counts[2] < 0.7 * counts[1]


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3), np.float32),
        np.full((3, 3), np.nan, np.float32),
        np.array([[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0]], np.float32),
    ],
)
@pytest.mark.parametrize("residual", ["plane", "point"])
def test_nothing_to_match_gives_zero_sums(rng, points, residual):
    fast = scene(rng)[0]
    floor = np.concatenate([rng.uniform(-1.0, 1.0, (900, 2)), np.zeros((900, 1))], axis=1).astype(np.float32)
    fast.insert(floor, np.eye(4))  # a plane in the cubes at the origin, where the index of NaN wraps to
    for some in (fast, VoxelMap()):
        sums = linearize(some, points, np.eye(4), replace(SETTINGS, residual=residual))
        assert sums.matches == 0
        assert sums.weight == 0.0
        assert not sums.information.any()
        assert np.isnan(sums.rms)


def test_linearize_refuses_what_it_does_not_know(rng):
    with pytest.raises(ConfigError, match="'plain' is not one of"):
        linearize(VoxelMap(), np.zeros((1, 3), np.float32), np.eye(4), replace(SETTINGS, residual="plain"))
    with pytest.raises(ConfigError, match="voxel map only"):
        linearize(NeighbourMap(), np.zeros((1, 3), np.float32), np.eye(4), replace(SETTINGS, residual="point"))


ISA_SCRIPT = """
import numpy as np, sys
sys.path.insert(0, sys.argv[1])
from states import random_pose, room_cloud
from heliograph.config import MapConfig
from heliograph.maps import VoxelMap
from heliograph.registration import MatchSettings, gradient_scatter, linearize
rng = np.random.default_rng(4)
fast = VoxelMap(MapConfig(voxel=0.5))
fast.insert(room_cloud(rng, 4000), np.eye(4))
T = random_pose(rng, 1.0)
points = ((room_cloud(rng, 2000, sigma=0.05) - T[:3, 3]) @ T[:3, :3]).astype(np.float32)
for threads in (1, 2):
    for residual in ("plane", "point"):
        s = MatchSettings(gate=0.25, kernel=0.1, sigma=0.03, threads=threads, residual=residual)
        sums = linearize(fast, points, T, s)
        print(sums.matches, *[x.hex() for x in [*sums.information.ravel(), *sums.gradient, sums.cost]])
"""


def run_isa(isa, tests):
    environment = {**os.environ, "HELIOGRAPH_ISA": isa}
    done = subprocess.run(
        [sys.executable, "-c", ISA_SCRIPT, tests], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def test_instruction_sets_agree_and_each_repeats_its_bits(pytestconfig):
    tests = str(pytestconfig.rootpath / "tests")
    lines = {isa: run_isa(isa, tests) for isa in ("baseline", "avx2")}
    for isa, rows in lines.items():
        assert rows[:2] == rows[2:], f"{isa} depends on the number of threads"
        assert rows == run_isa(isa, tests), f"{isa} does not repeat itself"
    for a, b in zip(lines["baseline"], lines["avx2"], strict=True):
        a, b = a.split(), b.split()
        assert abs(int(a[0]) - int(b[0])) <= 1
        x, y = ([float.fromhex(word) for word in words[1:]] for words in (a, b))
        np.testing.assert_allclose(x, y, rtol=1e-3, atol=1e-4 * max(np.abs(x)))


def test_scatter_is_the_gradient_s_covariance_where_the_noise_differs_from_point_to_point(rng):
    """Noise across surfaces that differs from one to the next: only the scatter gives the spread of the gradient."""
    cloud = room_cloud(rng, 60_000)
    local_map, T = VoxelMap(CONFIG), np.eye(4)
    local_map.insert(cloud, T)
    settings = replace(SETTINGS, kernel=0.0, fallback_stride=0)
    some = cloud[rng.choice(len(cloud), 3000, replace=False)].astype(np.float64)
    found = local_map.planes_at(some, gate=0.25, neighbours=False)
    some, point, normal = (x[found.source == 1] for x in (some, found.point, found.normal.astype(np.float64)))
    query = some - np.einsum("ni,ni->n", normal, some - point)[:, None] * normal  # on its plane but for the noise
    sigma = np.where(np.abs(normal @ normal[0]) > 0.9, 0.06, 0.006)  # one pair of walls
    gradients, scatters = [], []
    for _ in range(300):
        noisy = (query + (sigma * rng.standard_normal(len(query)))[:, None] * normal).astype(np.float32)
        gradients.append(linearize(local_map, noisy, T, settings).gradient)
        scatters.append(gradient_scatter(local_map, noisy, T, settings))
    true, told = np.cov(gradients, rowvar=False), np.mean(scatters, axis=0)
    scale = np.sqrt(np.diag(true))
    np.testing.assert_allclose(told / np.outer(scale, scale), true / np.outer(scale, scale), atol=0.3)
    information = linearize(local_map, query.astype(np.float32), T, settings).information
    # The one size of noise that the information knows is too small for one surface or too large for another.
    assert np.ptp(np.log(np.diag(true) / np.diag(information))) > 1.0
