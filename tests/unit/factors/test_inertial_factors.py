"""Factors of preintegrated motions: their law, the linear range, and graphs that hold them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.errors import GraphError
from heliograph.factors import (
    SENSOR_FACTORS,
    CombinedImu,
    GravityDirection,
    GravityVector,
    LeverArmPosition,
    PreintegratedImu,
    Velocity,
)
from heliograph.factors.motion_rows import LINEAR_SHARE, MOTION_NUMBERS
from heliograph.graph import (
    ISAM2,
    Diagonal,
    FactorGraph,
    FixedLagSmoother,
    Isotropic,
    Marginals,
    Prior,
    Values,
    load_graph,
    save_graph,
    solve,
)
from heliograph.imu import preintegrate
from heliograph.lie import S2, SE3, ExtendedPose, se23
from heliograph.testing import numeric_jacobian
from native_records import part
from reference.motion_rows import kept_samples, linear_range, motion_rows
from reference.preintegration import motion_residual
from states import GRAVITY, NOISE, START_NS, random_imu

RANGE = slice(78, 80)  # of a row: how wide the linear range is


def motions(rng, count):
    starts = START_NS + rng.integers(0, 10**9, count)
    ends = starts + rng.integers(2 * 10**8, 10**9, count)
    biases = {"gyro_bias": rng.normal(size=(count, 3)), "accel_bias": rng.normal(size=(count, 3))}
    return preintegrate(random_imu(rng, duration=3.0), starts, ends, noise=NOISE, **biases)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), angle=st.floats(0.0, 2.9), change=st.floats(0.0, 3.0))
def test_jacobians_are_exact_at_large_errors(seed, angle, change):
    """Errors of up to 2.9 rad and tens of metres; biases inside the linear range, in the passage and outside."""
    rng = np.random.default_rng(seed)
    motion, keys = motions(rng, 1), np.arange(1)
    factor = CombinedImu(keys, 1 + keys, 2 + keys, 3 + keys, motion, gravity=GravityDirection(key=9, magnitude=GRAVITY))
    measurement = factor.measurement.copy()
    measurement[:, RANGE] = 0.5
    factor = part(factor, keys, measurement=measurement)
    bias = np.hstack([motion.gyro_bias, motion.accel_bias]) + change * rng.normal(size=(1, 6)) / 3.0
    n = S2(rng.normal(size=(1, 3)))
    X_i, axis = ExtendedPose.exp(rng.normal(size=(1, 9))), rng.normal(size=3)
    exact = preintegrate(
        motion.imu, motion.start_ns, motion.end_ns, noise=NOISE, gyro_bias=bias[:, :3], accel_bias=bias[:, 3:]
    )
    X_j = exact.predict(X_i, bias[:, :3], bias[:, 3:], GRAVITY * n.vector)
    error = np.concatenate([angle * axis / np.linalg.norm(axis), rng.normal(scale=20.0, size=6)])
    arrays = [X_i.matrix, bias, X_j.retract(error).matrix, rng.normal(size=(1, 6)), n.vector]
    families = [allowed[0] for allowed in factor.allowed]

    def residual(elements):
        return factor.evaluate(*[family.wrap(x) for family, x in zip(families, elements, strict=True)])

    _, jacobians = residual(arrays)
    for k, (family, J) in enumerate(zip(families, jacobians, strict=True)):

        def moved(step, k=k, family=family):
            return residual([*arrays[:k], family.retract(arrays[k], step[None]), *arrays[k + 1 :]])[0][0]

        slope = numeric_jacobian(moved, np.zeros(family.dof), step=1e-4)
        np.testing.assert_allclose(J[0], slope, rtol=0, atol=1e-6 * max(1.0, np.abs(slope).max()))


@pytest.mark.parametrize("sharpest", [0, 1, 2])  # rotation, position, velocity: each bounds the linear range in turn
def test_measurements_are_those_of_the_twin(rng, sharpest):
    motion, keys, g = motions(rng, 7), np.arange(7), rng.normal(size=3)
    scale = np.repeat(np.where(np.arange(3) == sharpest, 1e-4, 1e2), 3)
    motion = replace(motion, covariance=scale[:, None] * motion.covariance * scale)
    for kept in (True, False):
        factor = PreintegratedImu(keys, 10 + keys, 20 + keys, motion, gravity=g, keep_samples=kept)
        rows, known, samples = np.split(factor.measurement, [MOTION_NUMBERS, MOTION_NUMBERS + 3], axis=1)
        np.testing.assert_allclose(rows, motion_rows(motion), rtol=1e-12)
        np.testing.assert_array_equal(known, np.tile(g, (7, 1)))
        np.testing.assert_array_equal(samples, kept_samples(motion).reshape(7, -1) if kept else np.zeros((7, 0)))


@pytest.mark.parametrize("seed", range(3))
def test_residual_is_that_of_its_equations(seed):
    rng = np.random.default_rng(seed)
    motion, g = motions(rng, 5), rng.normal(scale=GRAVITY, size=3)
    X = se23.exp(rng.normal(size=(2, 5, 9)))
    keys, bias = np.arange(5), np.hstack([motion.gyro_bias, motion.accel_bias])
    factor = PreintegratedImu(keys, 10 + keys, 20 + keys, motion, gravity=g)
    found = factor.evaluate(ExtendedPose(X[0]), ExtendedPose(X[1]), bias)[0]
    expected = [motion_residual(X[0, k], X[1, k], motion[k : k + 1], g) for k in range(5)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_first_order_is_within_its_share_at_the_edge_of_the_linear_range(rng):
    motion = motions(rng, 40)
    for direction in rng.normal(size=(5, 40, 6)):
        by_gyro, by_both = linear_range(motion).T
        gyro, accel = (np.linalg.norm(direction[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
        change = direction / np.sqrt(by_gyro * gyro**2 + by_both * gyro * accel)[:, None]
        biases = {"gyro_bias": motion.gyro_bias + change[:, :3], "accel_bias": motion.accel_bias + change[:, 3:]}
        exact = preintegrate(motion.imu, motion.start_ns, motion.end_ns, noise=NOISE, **biases)
        error = motion.corrected(**biases).delta.local(exact.delta)
        share = np.abs(error) / np.sqrt(np.einsum("nii->ni", motion.covariance))
        assert share.max() < 1.5 * LINEAR_SHARE
        assert np.median(share.max(axis=1)) > 0.02 * LINEAR_SHARE  # and not much smaller than needed


def test_outside_the_linear_range_the_motion_is_integrated_anew(rng):
    motion = motions(rng, 6)
    bias = np.hstack([motion.gyro_bias, motion.accel_bias]) + 0.5
    biases = {"gyro_bias": bias[:, :3], "accel_bias": bias[:, 3:]}
    exact = preintegrate(motion.imu, motion.start_ns, motion.end_ns, noise=NOISE, **biases)
    X_i = ExtendedPose.exp(rng.normal(size=(6, 9)))
    X_j = exact.predict(X_i, g_world=(0.0, 0.0, -GRAVITY), **biases)
    keys = np.arange(6)
    for kept in (True, False):
        factor = PreintegratedImu(keys, keys + 10, keys + 20, motion, keep_samples=kept)
        residual = factor.evaluate(X_i, X_j, bias)[0]
        largest = np.abs(residual).max()
        assert largest < 1e-9 if kept else largest > 1e-3


def test_padded_samples_give_the_same_motion(rng):
    motion = motions(rng, 8)
    samples, rows = kept_samples(motion), motion_rows(motion)
    assert samples.shape[1] & (samples.shape[1] - 1) == 0
    change = 0.3 * rng.normal(size=(8, 6))
    bias = np.hstack([motion.gyro_bias, motion.accel_bias]) + change
    keys = np.arange(8)
    factor = PreintegratedImu(keys, keys + 10, keys + 20, motion)
    X = ExtendedPose.identity()
    some = [PreintegratedImu(0, 1, 2, motion[k : k + 1]) for k in range(8)]
    expected = [f.evaluate(X, X, bias[k])[0][0] for k, f in enumerate(some)]
    np.testing.assert_array_equal(factor.evaluate(X, X, bias)[0], expected)
    assert rows.shape == (8, 92)


class Ride:
    """A motion of an IMU with biases, fixes of an antenna on it a quarter of a second apart, all without noise."""

    GYRO, ACCEL, ARM = np.array([0.02, -0.03, 0.01]), np.array([0.1, -0.05, 0.2]), np.array([0.5, -0.2, 1.0])

    def __init__(self, rng, count=13, down=(0.0, 0.0, -GRAVITY)):
        self.down = np.array(down)
        self.imu = random_imu(rng, duration=0.25 * count)
        self.stamps = START_NS + 250_000_000 * np.arange(count, dtype=np.int64)
        X = [se23.from_rotation_position_velocity(np.eye(3), [1.0, 2.0, 3.0], [3.0, 0.0, 0.0])]
        biases = {"gyro_bias": self.GYRO, "accel_bias": self.ACCEL}
        true = preintegrate(self.imu, self.stamps[:-1], self.stamps[1:], noise=NOISE, **biases)
        for k in range(count - 1):
            X.append(true[k : k + 1].predict(ExtendedPose(X[-1]), g_world=self.down, **biases).matrix[0])
        self.truth = np.stack(X)
        self.fixes = self.truth[:, :3, 3] + self.truth[:, :3, :3] @ self.ARM
        self.keys, self.biases = np.arange(count), 1000 + np.arange(count)
        self.motion = preintegrate(self.imu, self.stamps[:-1], self.stamps[1:], noise=NOISE)
        self.start = se23.retract(self.truth, rng.normal(scale=0.1, size=(count, 9)))

    def values(self, count=None):
        values = Values()
        values.insert(self.keys[:count], ExtendedPose(self.start[:count]))
        values.insert(self.biases[:count], np.zeros((len(self.keys[:count]), 6)))
        return values

    def graph(self, gravity=None, **arm):
        graph, keys, biases = FactorGraph(), self.keys, self.biases
        gravity = self.down if gravity is None else gravity
        graph.add(CombinedImu(keys[:-1], biases[:-1], keys[1:], biases[1:], self.motion, gravity=gravity))
        graph.add(LeverArmPosition(keys, self.fixes, Isotropic(0.05), **(arm or {"lever_arm": self.ARM})))
        graph.add(Velocity(keys[:1], self.truth[0, :3, 4], Isotropic(0.5)))
        graph.add(Prior(biases[0], np.zeros(6), Isotropic(10.0)))
        return graph


@pytest.mark.parametrize("kind", ["known", "direction", "vector"])
def test_states_biases_gravity_and_arm_are_found(rng, kind):
    down = np.array([0.5, -1.0, -9.6])
    ride = Ride(rng, 25, down)
    values, gravity = ride.values(), down
    values.insert(7000, np.zeros(3))
    if kind == "direction":
        gravity = GravityDirection(key=5000, magnitude=float(np.linalg.norm(down)))
        values.insert(5000, S2([0.0, 0.0, -1.0]))
    elif kind == "vector":
        gravity = GravityVector(key=5000)
        values.insert(5000, np.array([0.0, 0.0, -9.0]))
    graph = ride.graph(gravity, arm_key=7000)
    # What of gravity the biases can take on themselves is told by a weak prior of the first attitude.
    graph.add(Prior(0, ExtendedPose(ride.truth[0]), Diagonal([0.1] * 3 + [10.0] * 6)))
    solution = solve(graph, values)
    assert solution.chi2 < 1e-3  # what the weak prior of the biases says
    np.testing.assert_allclose(solution.values.at(7000), ride.ARM, atol=1e-3)
    np.testing.assert_allclose(solution.values.at(ride.keys).matrix, ride.truth, rtol=0, atol=1e-2)


def piece(ride, k, gravity):
    """The factors and variables that come with the k-th fix."""
    graph, values = FactorGraph(), Values()
    values.insert(k, ExtendedPose(ride.start[k]))
    values.insert(1000 + k, np.zeros(6))
    if k == 0:
        graph.add(Velocity(0, ride.truth[0, :3, 4], Isotropic(0.5)))
        graph.add(Prior(1000, np.zeros(6), Isotropic(10.0)))
        graph.add(Prior(0, ExtendedPose(ride.truth[0]), Diagonal([0.1] * 3 + [10.0] * 6)))
    else:
        graph.add(CombinedImu(k - 1, 999 + k, k, 1000 + k, ride.motion[k - 1 : k], gravity=gravity))
    graph.add(LeverArmPosition(k, ride.fixes[k], Isotropic(0.05), lever_arm=ride.ARM))
    return graph, values


def test_incremental_smoothing_finds_what_the_batch_finds(rng, tmp_path):
    ride = Ride(rng, 20)
    smoother = ISAM2()
    for k in range(20):
        smoother.update(*piece(ride, k, ride.down))
        if k == 10:  # and goes on after being written and read
            smoother.save(tmp_path / "state.npz")
            smoother = ISAM2.load(tmp_path / "state.npz", factors=SENSOR_FACTORS)
    smoother.update(iterate=1e-9)
    graph = ride.graph()
    graph.add(Prior(0, ExtendedPose(ride.truth[0]), Diagonal([0.1] * 3 + [10.0] * 6)))
    batch = solve(graph, ride.values()).values
    for keys in (ride.keys, ride.biases):
        found, expected = (getattr(v, "matrix", v) for v in (smoother.estimate(keys), batch.at(keys)))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    marginals = Marginals(graph, batch)
    np.testing.assert_allclose(smoother.covariance(19), marginals.covariance(19), rtol=1e-3, atol=1e-6)


def test_fixed_lag_smoothing_follows(rng):
    ride = Ride(rng, 20)
    smoother = FixedLagSmoother(lag=2.0)
    for k in range(20):
        graph, values = piece(ride, k, ride.down)
        smoother.update(graph, values, stamps={k: 0.25 * k, 1000 + k: 0.25 * k})
    found = smoother.estimate(19)
    np.testing.assert_allclose(found.position, ride.truth[19, :3, 3], atol=0.02)
    np.testing.assert_allclose(found.rotation, ride.truth[19, :3, :3], atol=0.02)


def test_graphs_with_sensor_factors_are_written_and_read(rng, tmp_path):
    ride = Ride(rng, 6)
    values, graph = ride.values(), ride.graph(GravityDirection(key=5000), arm_key=7000)
    values.insert(5000, S2([0.0, 0.0, -1.0]))
    values.insert(7000, np.zeros(3))
    graph.add(LeverArmPosition(0, ride.fixes[0], Isotropic(0.05), lever_arm=ride.ARM))
    save_graph(tmp_path / "graph.npz", graph, values)
    read, _ = load_graph(tmp_path / "graph.npz", factors=SENSOR_FACTORS)
    for before, after in zip(graph, read, strict=True):
        assert type(before) is type(after)
        np.testing.assert_array_equal(before.measurement, after.measurement)


def test_antenna_on_a_plain_pose_and_on_an_extended_one_see_the_same(rng):
    T, X = np.eye(4), np.eye(5)
    X[:3, :3] = se23.exp(rng.normal(size=9))[:3, :3]
    X[:3, 3] = rng.normal(size=3)
    T[:3] = X[:3, :4]
    graph, values = FactorGraph(), Values()
    values.insert(0, SE3(T))
    values.insert(1, ExtendedPose(X))
    graph.add(LeverArmPosition([0, 1], np.zeros(3), Isotropic(1.0), lever_arm=Ride.ARM))
    graph.add(Prior(0, SE3(T), Isotropic(1.0)))
    graph.add(Prior(1, ExtendedPose(X), Isotropic(1.0)))
    found = solve(graph, values).values
    np.testing.assert_allclose(found.at(0).matrix[:3, :4], found.at(1).matrix[:3, :4], atol=1e-9)


def test_what_does_not_fit_is_refused(rng):
    motion = motions(rng, 3)
    with pytest.raises(GraphError, match="3 keys a variable"):
        PreintegratedImu([0, 1], [1, 2], [7, 8], motion)
    with pytest.raises(GraphError, match="gravity is a vector"):
        CombinedImu([0, 1, 2], [7, 8, 9], [1, 2, 3], [8, 9, 10], motion, gravity=9.81)
    with pytest.raises(GraphError, match="not both"):
        LeverArmPosition(0, np.zeros(3), Isotropic(1.0))
    with pytest.raises(GraphError, match="not both"):
        LeverArmPosition(0, np.zeros(3), Isotropic(1.0), lever_arm=np.zeros(3), arm_key=4)
    with pytest.raises(GraphError, match="need vectors"):
        LeverArmPosition([0, 1], np.zeros((3, 3)), Isotropic(1.0), lever_arm=np.zeros(3))
