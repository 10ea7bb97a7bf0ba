"""A graph saved and loaded is the same to the bit."""

import json

import numpy as np
import pytest

from heliograph.errors import FormatError, GraphError
from heliograph.graph import (
    DCS,
    Bearing,
    Between,
    Cauchy,
    Constrained,
    Covariance,
    Diagonal,
    Factor,
    FactorGraph,
    GemanMcClure,
    Huber,
    Information,
    Isotropic,
    Landmark,
    LinearMotion,
    Position,
    Prior,
    Range,
    SquareRoot,
    TruncatedLeastSquares,
    Tukey,
    Values,
)
from heliograph.graph.files.archive import load_graph, save_graph
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose


class Distance(Factor):
    variables = (2, 2)
    rows = 1

    @staticmethod
    def residual(p_i, p_j, distance):
        return np.linalg.norm(p_j - p_i, axis=-1, keepdims=True) - distance[:, None]


def everything(rng):
    values, graph = Values(), FactorGraph()
    values.insert([5, 3], SE3.exp(rng.normal(size=(2, 6))))
    values.insert([10, 11], SE2.exp(rng.normal(size=(2, 3))))
    values.insert([20, 21, 22], S2(rng.normal(size=(3, 3))))
    values.insert(30, ExtendedPose.exp(rng.normal(size=9)))
    values.insert([40, 41], SO3.exp(rng.normal(size=(2, 3))))
    values.insert(50, SO2.exp([0.3]))
    values.insert([-7, 2**62], rng.normal(size=(2, 2)))
    values.insert(61, rng.normal(size=3))
    P = np.eye(6) + 0.1
    graph.add(Between(5, 3, SE3.exp(rng.normal(size=6)), Covariance(P), kernel=Huber(1.345)))
    graph.add(Prior([20, 21], S2(rng.normal(size=(2, 3))), Isotropic([0.1, 0.2]), kernel=DCS(0.1)))
    graph.add(Between([10, 11], [11, 10], SE2.exp(rng.normal(size=(2, 3))), Information(np.eye(3)), kernel=Tukey(4.7)))
    graph.add(Prior(30, ExtendedPose.exp(rng.normal(size=9)), Diagonal(rng.uniform(1, 2, 9))))
    graph.add(Between(40, 41, SO3.exp(rng.normal(size=3)), SquareRoot(np.triu(rng.normal(size=(3, 3))))))
    graph.add(Prior(50, SO2.exp([0.1]), Constrained()))
    graph.add(Range(10, -7, 1.0 / 3.0, Isotropic(0.1), kernel=Cauchy(2.0)))
    graph.add(Bearing(10, -7, SO2.exp([0.2]), Isotropic(0.1), kernel=GemanMcClure(2.0)))
    graph.add(Landmark(5, 61, rng.normal(size=3), Isotropic(0.1), kernel=TruncatedLeastSquares(3.0)))
    graph.add(Position(30, rng.normal(size=3), Isotropic(0.1)))
    graph.add(LinearMotion(-7, 61, rng.normal(size=(3, 2)), rng.normal(size=3), Isotropic(0.1)))
    graph.add(Distance((-7, 2**62), data=(1.5,), noise=Isotropic(0.2)))
    graph.fix([5, 20])
    return graph, values


def same_bits(a, b):
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def test_archive_keeps_everything_to_the_bit(tmp_path, rng):
    graph, values = everything(rng)
    save_graph(tmp_path / "graph.npz", graph, values)
    loaded, found = load_graph(tmp_path / "graph.npz", factors=[Distance])
    assert found.families() == values.families()
    assert same_bits(found.keys(), values.keys())
    assert all(same_bits(a, b) for a, b in zip(found.packed(), values.packed(), strict=True))
    assert loaded.fixed.tolist() == [5, 20]
    assert len(loaded) == len(graph)
    for one, two in zip(graph, loaded, strict=True):
        assert type(one) is type(two)
        assert same_bits(one.keys, two.keys) and same_bits(one.measurement, two.measurement)
        assert type(one.noise) is type(two.noise) and same_bits(one.noise.numbers, two.noise.numbers)
        assert (one.kernel, one.rows, one.measured, one.allowed) == (two.kernel, two.rows, two.measured, two.allowed)
        assert all(same_bits(a, b) for a, b in zip(getattr(one, "data", ()), getattr(two, "data", ()), strict=True))
    for a, b in zip(graph.groups(), loaded.groups(), strict=True):
        assert same_bits(a.whitening.sqrt_information, b.whitening.sqrt_information)


def test_own_factor_needs_its_class(tmp_path, rng):
    save_graph(tmp_path / "graph.npz", *everything(rng))
    with pytest.raises(GraphError, match=r"1 factors of Distance.*load_graph\(path, factors=\[Distance\]\)"):
        load_graph(tmp_path / "graph.npz")
    other = type("Distance", (Distance,), {"variables": (3, 3)})
    with pytest.raises(GraphError, match="Distance was saved with 1 rows"):
        load_graph(tmp_path / "graph.npz", factors=[other])


def test_empty_graph_is_kept(tmp_path):
    save_graph(tmp_path / "graph.npz", FactorGraph(), Values())
    graph, values = load_graph(tmp_path / "graph.npz")
    assert (len(graph), len(values)) == (0, 0)


def test_bad_archives_are_told(tmp_path, rng):
    path = tmp_path / "graph.npz"
    with pytest.raises(FormatError, match="No such file"):
        load_graph(path)
    path.write_text("VERTEX_SE2 0 0 0 0\n")
    with pytest.raises(FormatError, match="is no graph archive"):
        load_graph(path)
    np.savez(path, keys=np.arange(3))
    with pytest.raises(FormatError, match="is no graph archive"):
        load_graph(path)
    save_graph(path, *everything(rng))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(FormatError, match="damaged"):
        load_graph(path)
    np.savez(path, contents=np.frombuffer(json.dumps({"version": 99}).encode(), dtype=np.uint8))
    with pytest.raises(FormatError, match=r"later version \(99 > 1\)"):
        load_graph(path)


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("factors2.measurement", lambda a: a[:1]),  # of two factors one has a measurement
        ("factors0.measurement", lambda a: a[:, :7]),  # a pose of seven numbers
        ("factors0.measurement", lambda a: a[0]),
        ("factors11.data0", lambda a: np.concatenate([a, a])),
    ],
)
def test_archive_whose_factors_and_measurements_differ_is_damaged(tmp_path, rng, name, spoil):
    path = tmp_path / "graph.npz"
    save_graph(path, *everything(rng))
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **{**arrays, name: spoil(arrays[name])})
    with pytest.raises(FormatError, match="factors with a measurement of"):
        load_graph(path, factors=[Distance])
