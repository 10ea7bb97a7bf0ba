"""g2o and TORO files: nothing lost, and bad lines named."""

import numpy as np
import pytest

from heliograph.errors import DataError, FormatError
from heliograph.graph.files.g2o import read_pose_graph, write_g2o, write_toro
from heliograph.lie import se3

GRAPHS = [
    "M3500",
    "intel",
    "kitti_00",
    "sphere2500",
    "sphere_bignoise_vertex3",
    "torus3D",
    "parking-garage",
    "smallGrid3D",
]

PLANE = """# a comment
VERTEX_SE2 0 0 0 0

VERTEX_SE2 7 1.1 0.30000000000000004 7.5
EDGE_SE2 0 7 1 0.1 -4.5 1 0.1 0.2 2 0.3 3
VERTEX_XY 9 2 3
EDGE_SE2_XY 7 9 1 2 4 0.5 5
FIX 0 7
EDGE_SE2 7 8 1e-320 -0.0 0 1 0 0 1 0 1
EDGE_PRIOR_SE2 7 1 2 3 1 0 0 1 0 1
"""


@pytest.fixture
def read(tmp_path):
    def read(text):
        path = tmp_path / "in.g2o"
        path.write_text(text)
        return read_pose_graph(path)

    return read


def bits(array):
    return np.ascontiguousarray(array).view(np.int64)


def same(a, b):
    assert [t.kind.tag for t in a.tables] == [t.kind.tag for t in b.tables]
    for one, two in zip(a.tables, b.tables, strict=True):
        assert (one.ids == two.ids).all()
        assert (bits(one.numbers) == bits(two.numbers)).all()
        assert (bits(one.information) == bits(two.information)).all()
        assert (np.argsort(one.line) == np.argsort(two.line)).all()
    assert a.fixed.tolist() == b.fixed.tolist()
    assert [text for _, text in a.others] == [text for _, text in b.others]


@pytest.mark.real
@pytest.mark.parametrize("name", GRAPHS)
def test_public_graphs_come_back_to_the_bit(shared_data, tmp_path, name):
    graph = read_pose_graph(shared_data / "posegraphs" / f"{name}.g2o")
    write_g2o(tmp_path / "out.g2o", graph)
    same(graph, read_pose_graph(tmp_path / "out.g2o"))


def test_file_comes_back_line_by_line(read, tmp_path):
    graph = read(PLANE)
    write_g2o(tmp_path / "out.g2o", graph)
    want = [line.split() for line in PLANE.splitlines() if line]
    got = [line.split() for line in (tmp_path / "out.g2o").read_text().splitlines()]
    assert [row[0] for row in got] == [row[0] for row in want]
    for row, expected in zip(got[1:], want[1:], strict=True):
        assert bits([float(x) for x in row[1:]]).tolist() == bits([float(x) for x in expected[1:]]).tolist()


def test_random_numbers_come_back_to_the_bit(read, tmp_path, rng):
    numbers = rng.integers(0, 2**63, size=(200, 3)).view(np.float64)
    numbers = np.where(np.isfinite(numbers), numbers, 0.0)
    ids = rng.permutation(200).astype(np.int64) + 2**62
    text = "".join(f"VERTEX_SE2 {k} {x!r} {y!r} {t!r}\n" for k, (x, y, t) in zip(ids, numbers.tolist(), strict=True))
    graph = read(text)
    assert (graph.tables[0].ids[:, 0] == ids).all()
    assert (bits(graph.tables[0].numbers) == bits(numbers)).all()
    write_g2o(tmp_path / "out.g2o", graph)
    same(graph, read_pose_graph(tmp_path / "out.g2o"))


def test_what_a_file_says_is_told(read):
    graph = read(PLANE)
    assert graph.dimension == 2
    assert graph.pose_ids.tolist() == [0, 7, 8]
    assert graph.point_ids.tolist() == [9]
    assert graph.missing_ids.tolist() == [8]
    assert graph.fixed.tolist() == graph.gauge_ids.tolist() == [0, 7]
    assert graph.edge_count == 4
    i, j, T_i_j = graph.edges
    assert (i.tolist(), j.tolist()) == ([0, 7], [7, 8])
    assert T_i_j.translation[0].tolist() == [1.0, 0.1]
    # x, y, theta in the file: theta comes first with us.
    assert graph.of_role("between")[0].information[0].tolist() == [[3, 0.2, 0.3], [0.2, 1, 0.1], [0.3, 0.1, 2]]


def test_information_in_space_turns_rotation_first(read):
    upper = np.arange(1.0, 22.0)
    matrix = np.zeros((6, 6))
    matrix[np.triu_indices(6)] = upper
    matrix = matrix + np.triu(matrix, 1).T + 100 * np.eye(6)
    words = " ".join(map(str, matrix[np.triu_indices(6)]))
    graph = read(f"EDGE_SE3:QUAT 0 1 1 2 3 0 0 0 2 {words}\n")
    order = [3, 4, 5, 0, 1, 2]
    assert (graph.tables[0].information[0] == matrix[np.ix_(order, order)]).all()
    assert graph.edges[2].matrix[0, :3, 3].tolist() == [1.0, 2.0, 3.0]
    assert (graph.edges[2].matrix[0, :3, :3] == np.eye(3)).all()


def test_toro_information_has_its_own_order(read, tmp_path):
    graph = read("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 11 12 22 33 13 23\n")
    assert graph.tables[1].information[0].tolist() == [[33, 13, 23], [13, 11, 12], [23, 12, 22]]
    write_toro(tmp_path / "out.graph", graph)
    same(graph, read_pose_graph(tmp_path / "out.graph"))
    write_g2o(tmp_path / "out.g2o", graph)
    assert "EDGE_SE2 0 1 1 0 0 11 12 13 22 23 33" in (tmp_path / "out.g2o").read_text()


def test_toro_in_space_and_back(read, tmp_path):
    upper = " ".join(map(str, np.eye(6)[np.triu_indices(6)]))
    graph = read(f"VERTEX3 0 0 0 0 0.1 -0.2 0.3\nEDGE3 0 1 1 2 3 0.4 0.5 -2.6 {upper}\n")
    write_toro(tmp_path / "same.graph", graph)
    same(graph, read_pose_graph(tmp_path / "same.graph"))
    write_g2o(tmp_path / "out.g2o", graph)
    g2o = read_pose_graph(tmp_path / "out.g2o")
    np.testing.assert_allclose(g2o.edges[2].matrix, graph.edges[2].matrix, atol=1e-15)
    yaw_first = se3.exp([0, 0, -2.6, 0, 0, 0]) @ se3.exp([0, 0.5, 0, 0, 0, 0]) @ se3.exp([0.4, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(graph.edges[2].matrix[0, :3, :3], yaw_first[:3, :3], atol=1e-15)
    write_toro(tmp_path / "back.graph", g2o)
    again = read_pose_graph(tmp_path / "back.graph")
    np.testing.assert_allclose(again.tables[1].numbers, graph.tables[1].numbers, atol=1e-15)


def test_toro_refuses_what_it_has_no_word_for(read, tmp_path):
    with pytest.raises(DataError, match=r"TORO has no word for EDGE_SE2_XY \(1 lines\)"):
        write_toro(tmp_path / "x", read("EDGE_SE2_XY 7 9 1 2 4 0.5 5\n"))
    with pytest.raises(DataError, match="1 fixed poses"):
        write_toro(tmp_path / "x", read("VERTEX_SE2 1 0 0 0\nFIX 1\n"))
    assert not (tmp_path / "x").exists()


E = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            E + "EDGE_SE2 1 2 1 0 0 1 0 0 1 0\n",
            r"line 2: EDGE_SE2 has 10 numbers after its tag, expected 11 .* cut off",
        ),
        (E + "\n# x\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1 5\n", "line 4: .* 12 numbers .* too many"),
        (E + "EDGE_SE2 1 2 nan 0 0 1 0 0 1 0 1\n", "line 2: EDGE_SE2 holds NaN"),
        (E + "EDGE_SE2 1 2 1e999 0 0 1 0 0 1 0 1\n", "line 2: EDGE_SE2 holds NaN or infinity"),
        (E + "EDGE_SE2 1 2 x 0 0 1 0 0 1 0 1\n", "line 2: 'x' is not a number"),
        (E + "EDGE_SE2 1.5 2 1 0 0 1 0 0 1 0 1\n", "line 2: an id of EDGE_SE2 is not a whole number"),
        (E + "EDGE_SE2 1 99999999999999999999 1 0 0 1 0 0 1 0 1\n", "line 2: an id of EDGE_SE2"),
        (E + "EDGE_SE2 2 2 1 0 0 1 0 0 1 0 1\n", "line 2: EDGE_SE2 joins 2 with itself"),
        (
            E + "EDGE_SE2 1 2 1 0 0 1 0 0 -1 0 1\n",
            "line 2: .* not positive semi-definite: its smallest eigenvalue is -1",
        ),
        (E + "EDGE_SE2 1 2 1 0 0 1 2 0 1 0 1\n", "line 2: .* not positive semi-definite"),
        (E + "EDGE_SE2D 1 2\n", "line 2: unknown tag 'EDGE_SE2D'; did you mean 'EDGE_SE2'"),
        (E + "ROBOTLASER1 0 1 2\n", "line 2: unknown tag 'ROBOTLASER1'"),
        ("VERTEX_SE2 3 0 0 0\n" + E + "VERTEX_SE2 3 0 0 1\n", "line 3: id 3 was given another value in line 1"),
        (E + "VERTEX_XY 1 2 2\n", "line 1: id 1 is a pose in one line and a landmark in another"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n", "line 1: the quaternion of VERTEX_SE3:QUAT is zero"),
        (E + "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", "line 2: VERTEX_SE3:QUAT has 3 dimensions"),
        (E + "FIX 5\n", "line 2: FIX names id 5"),
        (E + "FIX a\n", "line 2: 'FIX a'"),
        (E + "FIX 99999999999999999999\n", "line 2: 'FIX 9+'"),
        ("EDGE_SE3_TRACKXYZ 0 1 4.5 1 2 3 1 0 0 1 0 1\n", "line 1 .* an offset's id"),
        ("\n\n# nothing\n", "holds neither a vertex nor an edge"),
        ("", "holds neither a vertex nor an edge"),
        (
            "PARAMS_SE3OFFSET 4 1 0 0 0 0 0 0\nEDGE_SE3_TRACKXYZ 0 1 4 1 2 3 1 0 0 1 0 1\n",
            "line 1: PARAMS_SE3OFFSET takes an id and x y z qx qy qz qw",
        ),
    ],
)
def test_bad_line_is_named(read, text, message):
    with pytest.raises(FormatError, match=message):
        read(text)


def test_missing_file_is_told(tmp_path):
    with pytest.raises(FormatError, match=r"cannot be read \(No such file"):
        read_pose_graph(tmp_path / "no.g2o")


def test_windows_lines_tabs_and_no_last_newline(read):
    graph = read("VERTEX_SE2\t0 +1 2. .5e1\r\n\r\n  " + E.strip())
    assert graph.tables[0].numbers.tolist() == [[1.0, 2.0, 5.0]]
    assert len(graph.edges[0]) == 1


def test_byte_order_mark_is_no_tag(read, tmp_path):
    assert len(read("\ufeff" + E).edges[0]) == 1


def test_spoilt_bytes_give_a_graph_or_a_format_error(tmp_path, rng):
    space = "VERTEX_SE3:QUAT 3 0 0 0 0 0 0 1\nPARAMS_SE3OFFSET 4 0 0 0 0 0 0 1\n"
    space += "EDGE_SE3_TRACKXYZ 3 1 4 1 2 3 1 0 0 1 0 1\n" + "VERTEX_TRACKXYZ 1 2 3 4\n"
    path, refused = tmp_path / "in.g2o", 0
    for text in (PLANE, space):
        for _ in range(300):
            data = bytearray(text.encode())
            for at in rng.integers(0, len(data), size=rng.integers(1, 4)):
                data[at] = rng.choice([rng.integers(0, 256), *b" \n-.e+#0"])
            cut = rng.integers(0, len(data)) if rng.random() < 0.3 else len(data)
            path.write_bytes(data[:cut])
            try:
                graph = read_pose_graph(path)
                graph.gauge_ids, graph.edges, graph.missing_ids  # noqa: B018
            except FormatError:
                refused += 1
    assert 100 < refused < 600


def test_identity_offset_is_taken_and_kept(read, tmp_path):
    text = "PARAMS_SE3OFFSET 4 0 0 0 0 0 0 1\nEDGE_SE3_TRACKXYZ 0 1 4 1 2 3 1 0 0 1 0 1\n"
    graph = read(text)
    write_g2o(tmp_path / "out.g2o", graph)
    assert (tmp_path / "out.g2o").read_text() == text


def test_semi_definite_information_is_taken(read):
    assert len(read("EDGE_SE2 1 2 1 0 0 0 0 0 0 0 1\n").edges[0]) == 1


def test_gauge_is_the_lowest_pose_of_each_free_component(read):
    text = E + "EDGE_SE2 5 4 1 0 0 1 0 0 1 0 1\nEDGE_SE2 8 9 1 0 0 1 0 0 1 0 1\nFIX 9\n"
    assert read(text).gauge_ids.tolist() == [0, 4, 9]
    assert read(text + "EDGE_PRIOR_SE2 5 0 0 0 1 0 0 1 0 1\n").gauge_ids.tolist() == [0, 9]


def test_components_that_see_one_landmark_are_one(read):
    text = E + "EDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\nEDGE_SE2_XY 1 20 1 2 1 0 1\nEDGE_SE2_XY 6 20 1 2 1 0 1\n"
    text += "EDGE_SE2_XY 6 21 1 2 1 0 1\nEDGE_SE2_XY 11 21 1 2 1 0 1\n"
    assert read(text).gauge_ids.tolist() == [0]
