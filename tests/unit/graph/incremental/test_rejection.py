"""False loops are let go without a batch solve, and come back where that was a mistake."""

import pickle

import numpy as np
import pytest

from heliograph.errors import ConfigError, GraphError, UnderconstrainedError
from heliograph.graph import (
    ISAM2,
    Between,
    Diagonal,
    Factor,
    FactorGraph,
    FixedLagSmoother,
    GemanMcClure,
    Isotropic,
    OutlierRejection,
    Prior,
    Values,
)
from heliograph.graph.files import worlds
from heliograph.graph.incremental.rejection import Rejection
from heliograph.graph.incremental.replay import replay, replay_steps
from heliograph.graph.model.outliers import geman_mcclure_weight
from heliograph.graph.problem.problem import Problem
from heliograph.lie import SE2, SE3, ExtendedPose

STEP = Diagonal([0.02, 0.05, 0.05])
LOOP = Diagonal([0.01, 0.03, 0.03])


def smoother_of(world, kernel=None, **settings):
    file = world.file
    steps = list(replay_steps(file.graph(kernel=kernel), file.odometry_values()))
    outliers = None if kernel is not None or settings.pop("plain", False) else OutlierRejection(**settings)
    return replay(steps, ISAM2(outliers=outliers)).smoother


def let_go_of(smoother):
    return sorted(tuple(smoother.keys_of(int(number)).tolist()) for number in smoother.let_go)


def apart(world, smoother):
    """Return the largest distance of a pose from the optimum of the true factors alone [m]."""
    found = smoother.estimate().block(type(world.truth))[1].translation
    clean = smoother_of(world, plain=True)
    clean.update(iterate=1e-9)
    return np.linalg.norm(found - clean.estimate().block(type(world.truth))[1].translation, axis=1).max()


def chain(rng, n=12, outliers=None):
    """Return a smoother of a straight walk along x with noisy odometry, pose k at (k, 0)."""
    smoother = ISAM2(outliers=outliers or OutlierRejection())
    for k in range(n):
        graph, values = FactorGraph(), Values()
        if k == 0:
            graph.fix(0)
            values.insert(0, SE2.identity())
        else:
            step = SE2.exp(np.array([0.0, 1.0, 0.0]) + rng.normal(size=3) * [0.02, 0.05, 0.05])
            graph.add(Between(k - 1, k, step, STEP))
            values.insert(k, smoother.estimate(k - 1) @ step)
        smoother.update(graph, values)
    return smoother


def loop(i, j, x, y=0.0, turn=0.0):
    graph = FactorGraph()
    graph.add(Between(i, j, SE2.from_rotation_translation(SE2.exp([turn, 0.0, 0.0]).rotation, [x, y]), LOOP))
    return graph


@pytest.mark.parametrize("fraction", [0.3, 0.6])
def test_random_false_loops_are_let_go_and_true_ones_kept(rng, fraction):
    world = worlds.manhattan(250, rng)
    spoilt = worlds.with_false_loops(world, fraction, rng)
    smoother = smoother_of(spoilt)
    false = sorted(zip(spoilt.i[spoilt.false].tolist(), spoilt.j[spoilt.false].tolist(), strict=True))
    assert set(false) <= set(let_go_of(smoother))
    assert len(smoother.let_go) <= len(false) + 1
    smoother.update(iterate=1e-9)
    assert apart(world, smoother) < 0.02
    assert apart(world, smoother_of(spoilt, plain=True)) > 1.0


def test_a_plain_kernel_does_not_do_it(rng):
    world = worlds.manhattan(250, rng)
    spoilt = worlds.with_false_loops(world, 0.3, rng)
    assert apart(world, smoother_of(spoilt, GemanMcClure(1.0))) > 10.0 * apart(world, smoother_of(spoilt))


def test_in_space_and_of_extended_poses(rng):
    world = worlds.sphere(5, 20, rng, sigmas=(0.02, 0.1))
    spoilt = worlds.with_false_loops(world, 0.5, rng)
    assert len(smoother_of(spoilt).let_go) in (spoilt.false.sum(), spoilt.false.sum() + 1)
    smoother, at = ISAM2(outliers=OutlierRejection()), ExtendedPose.identity()
    for k in range(8):
        graph, values = FactorGraph(), Values()
        values.insert(k, at)
        graph.add(
            Prior(k, at, Isotropic(10.0)) if k == 0 else Between(k - 1, k, ExtendedPose.identity(), Isotropic(0.1))
        )
        smoother.update(graph, values)
    for x in (5.0, 5.0, 5.01):
        graph = FactorGraph()
        graph.add(Between(0, 7, SE3.from_rotation_translation(np.eye(3), [x, 0.0, 0.0]), Isotropic(0.05)))
        smoother.update(graph)
    assert len(smoother.let_go) in (0, 3)  # decided together: they agree with each other


def test_an_update_says_what_it_let_go(rng):
    smoother = chain(rng)
    result = smoother.update(loop(0, 11, 5.0))
    assert result.let_go.tolist() == result.factors.tolist() == smoother.let_go.tolist()
    assert smoother.weights(result.factors).tolist() == [0.0]
    good = smoother.update(loop(0, 11, 11.0))
    assert good.let_go.size == 0 and smoother.weights(good.factors).tolist() == [1.0]
    assert smoother.keys_of(int(result.factors[0])).tolist() == [0, 11]


def test_what_is_let_go_leaves_no_trace(rng):
    one, other = chain(np.random.default_rng(3)), chain(np.random.default_rng(3))
    one.update(loop(0, 11, 5.0, turn=1.0))
    other.update(FactorGraph())
    assert one.estimate().at(11).matrix.tobytes() == other.estimate().at(11).matrix.tobytes()
    assert one.covariance(11).tobytes() == other.covariance(11).tobytes()
    assert len(one.cliques()) == len(other.cliques())


def drifting():
    """Return a smoother of forty steps along x whose odometry may be off by metres at the end, and is not."""
    smoother = ISAM2(outliers=OutlierRejection())
    for k in range(40):
        graph, values = FactorGraph(), Values()
        if k == 0:
            graph.fix(0)
        else:
            graph.add(Between(k - 1, k, SE2.exp([0.0, 1.0, 0.0]), Diagonal([0.03, 0.1, 0.1])))
        values.insert(k, SE2.exp([0.0, float(k), 0.0]))
        smoother.update(graph, values)
    return smoother


def test_what_is_trusted_overrules_a_loop_that_was_taken_in():
    smoother = drifting()
    false = smoother.update(loop(0, 39, 38.5, 2.5, 0.1))
    assert false.let_go.size == 0
    survey = FactorGraph()
    survey.add(Prior([20, 39], SE2.exp([[0.0, 20.0, 0.0], [0.0, 39.0, 0.0]]), Isotropic(0.02)))
    result = smoother.update(survey)
    assert result.let_go.tolist() == false.factors.tolist() and result.taken_back.size == 0
    smoother.update(remove=result.factors)  # the survey was wrong: what it contradicted fits again
    smoother.update()
    assert smoother.let_go.size == 0


def test_two_that_agree_overrule_one_that_came_first():
    smoother = drifting()
    false = smoother.update(loop(0, 39, 38.5, 2.5, 0.1))  # within what odometry allows
    assert false.let_go.size == 0
    first = smoother.update(loop(0, 38, 38.0))
    assert first.let_go.tolist() == first.factors.tolist()  # one against one: what came first stays
    second = smoother.update(loop(1, 39, 38.0))
    assert second.let_go.tolist() == false.factors.tolist()
    assert second.taken_back.tolist() == first.factors.tolist()
    assert smoother.let_go.tolist() == false.factors.tolist()
    assert abs(smoother.estimate(39).translation[1]) < 0.1


def test_squared_innovations_are_those_of_the_dense_normal_equations(rng):
    world = worlds.with_false_loops(worlds.manhattan(60, rng), 0.5, rng)
    smoother = smoother_of(world)
    smoother.update(iterate=1e-10)
    tree, values = smoother._state.native, smoother.estimate()
    for number in smoother._rejection.numbers.tolist():
        taken = smoother.weights([number])[0] == 1.0
        keys = smoother.keys_of(number)
        squared, left = tree.innovations(np.array([number], dtype=np.int32))
        r, J = whitened(world, keys, values)
        P = smoother.joint(keys) if keys[0] else np.pad(smoother.covariance(int(keys[1])), ((3, 0), (3, 0)))
        if taken:  # take its information out of what the tree knows
            S = np.eye(3) - J @ P @ J.T
            expected, rest = r @ np.linalg.solve(S, r), r @ r
        else:
            S = np.eye(3) + J @ P @ J.T
            expected, rest = r @ np.linalg.solve(S, r), np.sum(np.linalg.solve(S, r) ** 2)
        assert squared == pytest.approx(expected, rel=1e-6)
        assert left == pytest.approx(rest, rel=1e-6)


def whitened(world, keys, values):
    """Return residual (3,) and Jacobian (3, 6) of the loop between two keys in units of its noise."""
    row = next(
        k for k in range(len(world.i)) if (world.i[k], world.j[k]) == tuple(keys.tolist()) and k >= len(world.truth) - 1
    )
    one = Between(keys[:1], keys[1:], world.T_i_j[[row]], Isotropic(1.0))
    residual, jacobians = one.evaluate(*(values.at(keys[k : k + 1]) for k in (0, 1)))
    S = np.linalg.cholesky(world.information if world.information.ndim == 2 else world.information[row]).T
    return S @ residual[0], S @ np.concatenate([J[0] for J in jacobians], axis=1)


def test_taking_one_out_costs_its_squared_innovation(rng):
    """On a linear graph, the cost of the optimum falls by exactly that."""
    smoother = ISAM2(outliers=OutlierRejection(probability=0.999999))
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(5), np.zeros((5, 1)))
    graph.add(Prior(0, [0.0], Isotropic(1.0)))
    graph.add(Between(np.arange(4), np.arange(1, 5), rng.normal(size=(4, 1)), Isotropic(1.0)))
    graph.add(Between([0, 1], [4, 3], rng.normal(size=(2, 1)), Isotropic(0.5)))
    smoother.update(graph, values)
    before = smoother.update(costs=True).cost_after
    squared = smoother._state.native.innovations(np.array([5], dtype=np.int32))[0]
    smoother.update(remove=[5])
    assert before - smoother.update(costs=True).cost_after == pytest.approx(squared, rel=1e-9)


@pytest.mark.parametrize("mu", [1.0, 3.0, 1e4])
def test_the_surrogate_is_a_wider_geman_mcclure_kernel(mu):
    squared = np.linspace(0.0, 50.0, 30)
    weight = GemanMcClure(np.sqrt(mu)).weight(np.sqrt(squared))
    np.testing.assert_allclose(geman_mcclure_weight(squared, mu), weight, rtol=1e-12)


def test_state_goes_on_to_the_bit_when_saved(rng, tmp_path):
    world = worlds.with_false_loops(worlds.manhattan(150, rng), 0.4, rng)
    file = world.file
    steps = list(replay_steps(file.graph(), file.odometry_values()))
    first = replay(steps[:80], ISAM2(outliers=OutlierRejection(probability=0.99))).smoother
    first.save(tmp_path / "state.npz")
    others = [ISAM2.load(tmp_path / "state.npz"), pickle.loads(pickle.dumps(first))]
    ends = [replay(steps[80:], smoother).smoother for smoother in (first, *others)]
    for other in ends[1:]:
        assert other.let_go.tolist() == ends[0].let_go.tolist()
        assert [p.tobytes() for p in other.estimate().packed()] == [p.tobytes() for p in ends[0].estimate().packed()]
    assert len(ends[0].let_go) > 10


@pytest.mark.parametrize(("scale", "share"), [(0.0, 0.0), (1e-3, 9e-6), (5.0, 1.0), (1e300, 1.0)])
def test_thresholds_follow_the_scale_up_to_what_the_noise_says(scale, share):
    rejection = Rejection(OutlierRejection(scale_margin=3.0))
    rejection.widest = np.array([7.0, 9.0])
    rejection.scale = scale
    np.testing.assert_allclose(rejection.bounds, share * rejection.widest, rtol=1e-12)


def test_a_refused_update_leaves_no_trace(rng):
    smoother = chain(rng)
    smoother.update(loop(0, 11, 5.0))

    def state():
        tree = smoother._state.native
        packed = [part.tobytes() for part in smoother.estimate().packed()]
        return packed, tree.factors, tree.delta().tobytes(), smoother.cliques(), smoother.let_go.tolist()

    before = state()
    free, values = loop(2, 9, 3.0), Values()
    values.insert([110, 111], np.zeros((2, 2)))
    free.add(Between(110, 111, [1.0, 1.0], Isotropic(1.0)))
    with pytest.raises(UnderconstrainedError):
        smoother.update(free, values)
    assert state() == before
    after = smoother.update(loop(2, 9, 3.0))
    assert smoother.let_go.tolist() == [*before[-1], *after.factors.tolist()]


def test_what_leaves_is_forgotten(rng):
    smoother = chain(rng)
    wrong = smoother.update(loop(3, 11, 2.0))
    other = smoother.update(loop(4, 10, 20.0))
    smoother.update(remove=wrong.factors)
    assert smoother.let_go.tolist() == other.factors.tolist()
    smoother.marginalize([4])
    assert smoother.let_go.size == 0
    fresh = smoother.update(loop(5, 11, 20.0))  # takes one of the numbers
    assert smoother.let_go.tolist() == fresh.factors.tolist()


def test_fixed_lag_lets_go_too(rng):
    smoother = FixedLagSmoother(6.0, outliers=OutlierRejection())
    for k in range(20):
        graph, values = FactorGraph(), Values()
        graph.add(Prior(0, SE2.identity(), STEP) if k == 0 else Between(k - 1, k, SE2.exp([0.0, 1.0, 0.0]), STEP))
        if k % 3 == 2 and k > 4:
            graph.add(Between(k - 4, k, SE2.exp([0.5, 9.0, 0.0]), LOOP))
        values.insert(k, SE2.exp([0.0, float(k), 0.0]))
        smoother.update(graph, values, {k: float(k)})
    assert np.allclose(smoother.estimate(19).translation, [19.0, 0.0], atol=1e-6)
    keys = [smoother.smoother.keys_of(int(number)).tolist() for number in smoother.smoother.let_go]
    assert keys and all(key in smoother.smoother for pair in keys for key in pair)


def test_what_joins_a_new_variable_is_trusted(rng):
    smoother = chain(rng)
    graph, values = FactorGraph(), Values()
    graph.add(Between([11, 2], [20, 20], SE2.exp([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]), LOOP))
    values.insert(20, SE2.exp([0.0, 12.0, 0.0]))
    result = smoother.update(graph, values)
    assert smoother.weights(result.factors).tolist() == [1.0, 0.0]  # that with the nearest key


def test_whom_to_trust_can_be_said(rng):
    smoother = chain(rng)
    graph = loop(0, 11, 5.0)
    assert smoother.update(graph, trusted=[0]).let_go.size == 0
    prior = FactorGraph()
    prior.add(Prior(6, SE2.exp([0.0, 90.0, 0.0]), LOOP))
    assert smoother.update(prior, trusted=[]).let_go.size == 1


class Height(Factor):
    variables = (SE2,)
    rows = 1

    @staticmethod
    def residual(T, y):
        return T[:, 1, 2:] - y


def test_doubt_is_carried_however_factors_come():
    """Alone, in one record, in two, and beside a factor of one's own: the same are let go."""
    T = SE2.exp([[0.0, 1.0, 0.0], [0.0, 5.0, 0.0], [0.0, 11.0, 0.0]])
    i, j = np.array([10, 0, 0]), np.array([11, 11, 11])
    known = FactorGraph()
    known.add(Height(3, data=(np.zeros(1),), noise=Isotropic(0.01)))
    points = []
    for parts in ([0, 1, 2], [[0, 1, 2]], [0, [1, 2]]):
        for own in (False, True):
            smoother, graph = chain(np.random.default_rng(3)), FactorGraph()
            if own:
                smoother.update(known)
            for part in parts:
                graph.add(Between(i[part], j[part], T[part], LOOP))
            result = smoother.update(graph)
            assert smoother.weights(result.factors).tolist() == [1.0, 0.0, 1.0]
            assert {"add", "eliminate", "outliers"} <= result.seconds.keys() and min(result.seconds.values()) >= 0.0
            points.append(smoother.estimate(11).matrix.tobytes())
    assert len(set(points[0::2])) == len(set(points[1::2])) == 1  # to the bit


def test_mistakes_are_named(rng):
    graph, values = FactorGraph(), Values()
    graph.add(Prior(0, SE2.identity(), STEP))
    values.insert(0, SE2.identity())
    with pytest.raises(GraphError, match="outliers=OutlierRejection"):
        ISAM2().update(graph, values, trusted=[0])
    with pytest.raises(GraphError, match="trusted: factors 7 to 7"):
        ISAM2(outliers=OutlierRejection()).update(graph, values, trusted=[7])
    own = FactorGraph()
    own.add(Height(3, data=(np.ones(1),), noise=Isotropic(1.0)))
    with pytest.raises(GraphError, match=r"factor 0 \(key 3\): a factor of one's own cannot be doubtful"):
        chain(rng).update(own, trusted=[])
    with pytest.raises(ConfigError, match="probability"):
        OutlierRejection(probability=1.0)
    with pytest.raises(GraphError, match="factor 99: not in the smoother"):
        chain(rng).keys_of(99)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 103))
@pytest.mark.parametrize("name", ["manhattan", "sphere", "torus", "drive"])
def test_worlds_with_a_third_of_false_loops_are_as_the_clean_ones(name, seed):
    rng = np.random.default_rng(seed)
    world = {
        "manhattan": lambda: worlds.manhattan(3500, rng),
        "sphere": lambda: worlds.sphere(20, 50, rng),
        "torus": lambda: worlds.torus(25, 40, rng),
        "drive": lambda: worlds.drive(2000, rng),
    }[name]()
    spoilt = worlds.with_false_loops(world, 0.3, rng)
    clean, smoother = smoother_of(world, plain=True), smoother_of(spoilt)
    assert not set(zip(spoilt.i[spoilt.false], spoilt.j[spoilt.false], strict=True)) - set(let_go_of(smoother))
    clean.update(iterate=1e-9)
    smoother.update(iterate=1e-9)
    chi2 = [Problem(world.file.graph(), s.estimate()).cost().chi2 for s in (clean, smoother)]
    assert chi2[1] < 1.05 * chi2[0]
    error = [
        np.sqrt(
            np.mean(
                np.sum((s.estimate().block(type(world.truth))[1].translation - world.truth.translation) ** 2, axis=1)
            )
        )
        for s in (clean, smoother)
    ]
    assert error[1] < 1.05 * error[0] + 0.02
