"""What follows from a pose-graph file: factors, values, starts, and the way back."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import (
    Bearing,
    Between,
    Covariance,
    Diagonal,
    FactorGraph,
    Huber,
    Information,
    Isotropic,
    Position,
    Prior,
    Range,
    SquareRoot,
    Values,
)
from heliograph.graph.files.g2o import read_pose_graph, write_g2o
from heliograph.graph.files.posegraph import PoseGraphFile
from heliograph.graph.files.posegraph_of import pose_graph_of
from heliograph.graph.files.worlds import manhattan
from heliograph.lie import SE2, SE3, SO2

TEXT = """VERTEX_SE2 4 1 2 0.5
VERTEX_SE2 2 7 8 9
EDGE_SE2 2 4 1 0 0.25 4 1 0 9 0 16
EDGE_SE2 4 5 1 0 0 1 0 0 1 0 1
VERTEX_XY 9 3 3
EDGE_SE2_XY 4 9 1 2 4 0.5 5
EDGE_SE2_XY 5 8 0 1 4 0 4
EDGE_PRIOR_SE2_XY 5 3 4 2 0 2
"""


@pytest.fixture
def read(tmp_path):
    def read(text=TEXT):
        (tmp_path / "in.g2o").write_text(text)
        return read_pose_graph(tmp_path / "in.g2o")

    return read


def test_factors_are_those_of_the_file(read):
    graph = read().graph(kernel=Huber(1.0))
    between, landmark, position = list(graph)
    assert between.keys.tolist() == [[2, 4], [4, 5]]
    S = graph.groups()[0].whitening.sqrt_information.reshape(-1, 3, 3)
    np.testing.assert_allclose(S[0].T @ S[0], [[16, 0, 0], [0, 4, 1], [0, 1, 9]], atol=1e-14)
    assert between.kernel == landmark.kernel == Huber(1.0)
    assert position.kernel is None
    assert landmark.keys.tolist() == [[4, 9], [5, 8]]
    assert position.measurement.tolist() == [[3, 4]]
    assert graph.fixed.tolist() == []  # the prior anchors the one component


def test_values_come_in_the_order_of_the_file(read):
    values = read().values()
    keys, T_world_i = values.block(SE2)
    assert keys.tolist() == [4, 2]
    np.testing.assert_allclose(T_world_i.log()[0, 0], 0.5)
    assert values.at(9).tolist() == [3.0, 3.0]
    assert 5 not in values


def test_odometry_values_place_landmarks_from_the_first_pose_that_sees_them(read):
    values = read().odometry_values()
    np.testing.assert_allclose(values.at(2).matrix, np.eye(3))
    T_2_4 = SE2.exp([0, 0, 0]).matrix.copy()
    T_2_4[:2, :2] = [[np.cos(0.25), -np.sin(0.25)], [np.sin(0.25), np.cos(0.25)]]
    T_2_4[0, 2] = 1.0
    np.testing.assert_allclose(values.at(4).matrix, T_2_4)
    np.testing.assert_allclose(values.at(9), SE2(T_2_4) @ np.array([1.0, 2.0]))


def test_odometry_start_keeps_fixed_poses_where_they_are(read):
    text = TEXT.replace("EDGE_PRIOR_SE2_XY 5 3 4 2 0 2\n", "FIX 4\n")
    values = read(text).odometry_values()
    np.testing.assert_allclose(values.at(4).matrix, read(text).values().at(4).matrix)
    relative = values.at(4).inverse() @ values.at(5)
    np.testing.assert_allclose(relative.matrix, [[1, 0, 1], [0, 1, 0], [0, 0, 1]], atol=1e-15)


def test_odometry_start_goes_to_a_pose_prior(read):
    text = TEXT + "EDGE_PRIOR_SE2 5 10 20 1 1 0 0 1 0 1\n"
    np.testing.assert_allclose(read(text).odometry_values().at(5).translation, [10.0, 20.0])


def test_solved_values_take_the_place_of_the_lines(read, tmp_path):
    file = read()
    values = Values()
    values.insert([2, 4, 5], SE2.exp([[0, 0, 0], [0.1, 1, 0], [0.2, 2, 0]]))
    values.insert([8, 9], [[1.0, 2.0], [3.5, 4.5]])
    write_g2o(tmp_path / "out.g2o", file.with_values(values))
    lines = (tmp_path / "out.g2o").read_text().splitlines()
    assert [line.split()[:2] for line in lines[:4]] == [
        ["VERTEX_SE2", "5"],
        ["VERTEX_XY", "8"],
        ["VERTEX_SE2", "4"],
        ["VERTEX_SE2", "2"],
    ]
    assert lines[4:6] == ["EDGE_SE2 2 4 1 0 0.25 4 1 0 9 0 16", "EDGE_SE2 4 5 1 0 0 1 0 0 1 0 1"]
    again = read_pose_graph(tmp_path / "out.g2o")
    np.testing.assert_allclose(again.values().at(4).matrix, values.at(4).matrix, atol=1e-15)
    assert again.values().at(9).tolist() == [3.5, 4.5]
    assert len(again.missing_ids) == 0
    with pytest.raises(GraphError, match="key 5"):
        file.with_values(file.values())


def test_toro_gets_its_own_vertices(read):
    file = read("EDGE2 0 1 1 0 0 1 0 1 1 0 0\n")
    values = file.odometry_values()
    assert [table.kind.tag for table in file.with_values(values).tables] == ["VERTEX2", "EDGE2"]


@pytest.mark.parametrize("group", [SE2, SE3])
def test_factor_graph_goes_into_a_file_and_back(group, rng, tmp_path):
    graph, values = FactorGraph(), Values()
    values.insert(np.arange(4), group.exp(rng.normal(size=(4, group.dof))))
    values.insert(100, rng.normal(size=group.space))
    Z = group.exp(rng.normal(size=(3, group.dof)))
    graph.add(Between([0, 1, 2], [1, 2, 3], Z, Isotropic(0.5)))
    graph.add(Prior(0, group.exp(rng.normal(size=group.dof)), Isotropic(0.1)))
    graph.fix(3)
    write_g2o(tmp_path / "out.g2o", pose_graph_of(graph, values))
    file = read_pose_graph(tmp_path / "out.g2o")
    again = file.graph()
    assert again.fixed.tolist() == [3]
    for one, two in zip(graph.groups(), again.groups(), strict=True):
        np.testing.assert_allclose(two.record.measurement, one.record.measurement, atol=1e-15)
        np.testing.assert_allclose(two.whitening.sqrt_information, one.whitening.sqrt_information)
    np.testing.assert_allclose(file.values().block(group)[1].matrix, values.block(group)[1].matrix, atol=1e-15)
    assert file.values().at(100).tolist() == values.at(100).tolist()


def test_positions_and_bearings_go_into_a_file_and_back(tmp_path):
    for group in (SE2, SE3):
        graph, values = FactorGraph(), Values()
        values.insert([0, 1], group.identity((2,)))
        values.insert(9, np.arange(1.0, 1.0 + group.space))
        graph.add(Position([0, 1], np.ones((2, group.space)), Isotropic(0.5)))
        if group is SE2:
            graph.add(Bearing(0, 9, SO2.exp([0.5]), Isotropic(0.1)))
        write_g2o(tmp_path / "out.g2o", pose_graph_of(graph, values))
        file = read_pose_graph(tmp_path / "out.g2o")
        assert file.graph().error(file.values()) == pytest.approx(graph.error(values))
        if group is SE3:
            assert (tmp_path / "out.g2o").read_text().startswith("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n")


def test_noise_of_every_kind_becomes_its_information(rng):
    S = rng.normal(size=(2, 3, 3)) + 2.0 * np.eye(3)
    omega = np.swapaxes(S, 1, 2) @ S
    sigmas = rng.uniform(1.0, 2.0, 3)
    values = Values()
    values.insert([0, 1], SE2.identity((2,)))
    for noise, want in (
        (SquareRoot(S), omega),
        (Information(omega), omega),
        (Covariance(np.linalg.inv(omega)), omega),
        (Diagonal(sigmas), [np.diag(sigmas**-2)] * 2),
        (Isotropic([0.5, 0.25]), [4.0 * np.eye(3), 16.0 * np.eye(3)]),
    ):
        graph = FactorGraph()
        graph.add(Between([0, 1], [1, 0], SE2.identity((2,)), noise))
        np.testing.assert_allclose(pose_graph_of(graph, values).tables[-1].information, want, rtol=1e-9, atol=1e-9)


def test_what_a_file_has_no_word_for_is_refused(rng):
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], SE3.identity((2,)))
    graph.add(Range(0, 1, 2.0, Isotropic(0.1)))
    with pytest.raises(GraphError, match=r"no word for Range \(1 factors from factor 0 \(keys 0, 1\)\)"):
        pose_graph_of(graph, values)
    graph = FactorGraph()
    values.insert(9, [1.0, 2.0, 3.0])
    graph.add(Position(9, [0.0, 0, 0], Isotropic(0.1)))  # of a point
    with pytest.raises(GraphError, match="no word for Position"):
        pose_graph_of(graph, values)
    values.insert(7, [1.0] * 5)
    with pytest.raises(GraphError, match="vectors of dimension 5"):
        pose_graph_of(FactorGraph(), values)


def test_a_world_writes_the_file_that_it_is(rng, tmp_path):
    world = manhattan(200, rng)
    write_g2o(tmp_path / "w.g2o", world.file)
    file = read_pose_graph(tmp_path / "w.g2o")
    assert isinstance(file, PoseGraphFile)
    assert len(file.missing_ids) == 200
    np.testing.assert_allclose(file.edges[2].matrix, world.T_i_j.matrix, atol=1e-15)
    assert file.graph().groups()[0].whitening.shared
