"""What programs really write into g2o files: sensor offsets, partial priors, planes, odd spellings."""

import numpy as np
import pytest

from heliograph.errors import ConfigError, FormatError
from heliograph.graph import (
    Attitude,
    Between,
    FactorGraph,
    Information,
    Plane,
    Prior,
    Values,
    load_graph,
    save_graph,
    solve,
)
from heliograph.graph.files.file_factors import PlaneSighting
from heliograph.graph.files.g2o import read_pose_graph, write_g2o
from heliograph.graph.files.information import indefinite
from heliograph.graph.incremental.replay import replay, replay_steps
from heliograph.graph.problem.problem import Problem
from heliograph.lie import SE2, SE3, se2, se3, so3

SMALL = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
E = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
UPPER6 = " ".join(map(str, np.eye(6)[np.triu_indices(6)]))


@pytest.fixture
def read(tmp_path):
    def read(text, **options):
        path = tmp_path / "in.g2o"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_pose_graph(path, **options)

    return read


def cost(graph, values):
    return Problem(graph, values).cost().chi2


def random_information(rng, d):
    A = rng.normal(size=(d, d))
    return A @ A.T + np.eye(d)


def flat(matrix, order):
    turned = matrix[np.ix_(order, order)]
    return " ".join(repr(float(x)) for x in turned[np.triu_indices(len(order))])


@pytest.mark.parametrize("group", [SE2, SE3])
def test_relative_poses_of_sensors_cost_what_the_sensors_see(read, rng, group):
    ops, dof, d = group.ops, group.dof, group.space
    kind, params = ("SE2", "PARAMS_SE2OFFSET") if d == 2 else ("SE3", "PARAMS_SE3OFFSET")
    order = [1, 2, 0] if d == 2 else [3, 4, 5, 0, 1, 2]
    from heliograph.graph.files.row_kinds import KINDS, numbers_of

    value = KINDS["VERTEX_SE2" if d == 2 else "VERTEX_SE3:QUAT"]
    words = lambda T: " ".join(repr(float(x)) for x in numbers_of(value, T[None])[0])  # noqa: E731
    a, b, Z, X, Y = (ops.exp(rng.normal(size=dof)) for _ in range(5))
    omega = random_information(rng, dof)
    text = f"{params} 3 {words(a)}\n{params} 8 {words(b)}\n{value.tag} 0 {words(X)}\n{value.tag} 1 {words(Y)}\n"
    text += f"EDGE_{kind}_OFFSET 0 1 3 8 {words(Z)} {flat(omega, order)}\n"
    file = read(text)
    r = ops.log(ops.inverse(Z) @ ops.inverse(X @ a) @ (Y @ b))
    assert cost(file.graph(), file.values()) == pytest.approx(r @ omega @ r, rel=1e-9)
    # The start from odometry puts the sensors, not the poses, apart as measured.
    start = file.odometry_values()
    between = ops.inverse(start.at(0).matrix @ a) @ start.at(1).matrix @ b
    np.testing.assert_allclose(between, Z, atol=1e-12)


def test_points_and_priors_of_sensors_cost_what_the_sensors_see(read, rng, tmp_path):
    S, X, Z = (se3.exp(rng.normal(size=6)) for _ in range(3))
    from heliograph.graph.files.row_kinds import KINDS, numbers_of

    words = lambda T: " ".join(repr(float(x)) for x in numbers_of(KINDS["VERTEX_SE3:QUAT"], T[None])[0])  # noqa: E731
    p, z = rng.normal(size=3), rng.normal(size=3)
    omega, wide = random_information(rng, 3), random_information(rng, 6)
    text = f"PARAMS_SE3OFFSET 4 {words(S)}\nVERTEX_SE3:QUAT 0 {words(X)}\n"
    text += f"VERTEX_TRACKXYZ 9 {' '.join(map(repr, p.tolist()))}\n"
    text += f"EDGE_SE3_TRACKXYZ 0 9 4 {' '.join(map(repr, z.tolist()))} {flat(omega, [0, 1, 2])}\n"
    text += f"EDGE_SE3_PRIOR 0 4 {words(Z)} {flat(wide, [3, 4, 5, 0, 1, 2])}\n"
    file = read(text)
    T = X @ S
    e = T[:3, :3].T @ (p - T[:3, 3]) - z
    r = se3.log(se3.inverse(Z) @ T)
    assert cost(file.graph(), file.values()) == pytest.approx(e @ omega @ e + r @ wide @ r, rel=1e-9)
    write_g2o(tmp_path / "out.g2o", file)
    again = read_pose_graph(tmp_path / "out.g2o")
    assert cost(again.graph(), again.values()) == cost(file.graph(), file.values())


def test_planar_point_of_a_sensor_is_seen_from_its_offset(read):
    text = "PARAMS_SE2OFFSET 0 1 0 1.5707963267948966\nVERTEX_SE2 0 0 0 0\nVERTEX_XY 7 1 2\n"
    file = read(text + "EDGE_SE2_POINTXY_OFFSET 0 7 0 2 0 4 0 9\nFIX 0\n")
    assert cost(file.graph(), file.values()) == pytest.approx(0.0, abs=1e-25)
    np.testing.assert_allclose(file.odometry_values().at(7), [1.0, 2.0], atol=1e-12)


def test_offset_line_that_is_cut_off_is_named(read):
    with pytest.raises(FormatError, match="line 1: PARAMS_SE2OFFSET takes an id and x y theta"):
        read("PARAMS_SE2OFFSET 0 1 0\n" + E)


@pytest.mark.parametrize(
    ("line", "residual"),
    [
        ("EDGE_SE3_XYZPRIOR 0 0 1 2 3 4 0 0 9 0 16", [2 * (1.5 - 1), 3 * (2.5 - 2), 4 * (4 - 3)]),
        ("EDGE_SE3_PRIORXYZ 0 1 2 3 4 0 0 9 0 16", [2 * (1.5 - 1), 3 * (2.5 - 2), 4 * (4 - 3)]),
        ("EDGE_SE3_PRIORXY 0 1 2 4 0 9", [2 * (1.5 - 1), 3 * (2.5 - 2)]),
    ],
)
def test_positions_in_both_spellings(read, line, residual):
    file = read(f"VERTEX_SE3:QUAT 0 1.5 2.5 4 0 0 0 1\n{line}\n")
    assert cost(file.graph(), file.values()) == pytest.approx(np.square(residual).sum())
    assert len(file.gauge_ids) == 0


def test_bearings_are_read_and_place_the_landmark_where_they_meet(read):
    text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 2 0 1.5707963267948966\nFIX 0 1\n"
    text += f"EDGE_BEARING_SE2_XY 0 5 {np.pi / 4} 100\nEDGE_BEARING_SE2_XY 1 5 0 100\n"
    file = read(text)
    assert file.point_ids.tolist() == [5] and file.edge_count == 2
    np.testing.assert_allclose(file.odometry_values().at(5), [2.0, 2.0], atol=1e-12)
    solution = solve(file.graph(), file.odometry_values())
    assert solution.chi2 == pytest.approx(0.0, abs=1e-20)


def test_measured_direction_levels_a_pose(read):
    tilt = SE3.exp([0.2, -0.1, 0.0, 0.0, 0.0, 0.0])
    up = tilt.matrix[2, :3].tolist()  # of the world, seen by the body
    q = "0 0 0 0 0 0 1"
    text = f"VERTEX_SE3:QUAT 0 {q}\nEDGE_SE3_PRIORVEC 0 0 0 2 {up[0]} {up[1]} {up[2]} 100 0 0 100 0 100\n"
    text += f"EDGE_SE3_PRIOR 0 0 {q} 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1e-6 0 0 1e-6 0 1e-6\n"
    file = read(text)
    found = solve(file.graph(), file.values()).values.at(0)
    np.testing.assert_allclose(found.matrix[2, :3], up, atol=1e-6)
    assert [type(record) for record in file.graph()] == [Attitude, Prior]


def test_information_of_a_direction_is_that_of_its_angles(read, rng):
    T, world, seen = SE3.exp(rng.normal(size=6)), [0.0, 0.6, 0.8], None
    seen = T.matrix[:3, :3].T @ world
    root = rng.normal(size=(3, 3))
    omega = root.T @ root
    numbers = " ".join(repr(float(x)) for x in [*world, *seen, *omega[np.triu_indices(3)]])
    graph = read(f"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nEDGE_SE3_PRIORVEC 0 {numbers}\n").graph()
    for d in 1e-4 * rng.normal(size=(5, 6)):
        values = Values()
        values.insert(0, T.retract(d))
        e = values.at(0).matrix[:3, :3].T @ world - seen  # as hdl_graph_slam has it
        assert 2.0 * graph.error(values) == pytest.approx(e @ omega @ e, rel=1e-3)


def test_gravity_edges_without_one_meaning_are_refused(read):
    line = "EDGE_SE3_GRAVITY 0 0 0 1 0 0 -1 1 0 0 1 0 1\n"
    with pytest.raises(FormatError, match=r"line 2: unknown tag 'EDGE_SE3_GRAVITY': its numbers .* EDGE_SE3_PRIORVEC"):
        read("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n" + line)


def g2o_plane_error(T, plane_world, plane_seen):
    """What g2o's Plane3D::ominus gives: azimuth and elevation of the measured normal, seen from the estimated one."""
    n = T[:3, :3].T @ plane_world[:3]
    d = -(plane_world[3] + plane_world[:3] @ T[:3, 3])
    azimuth, elevation = np.arctan2(n[1], n[0]), np.arctan2(n[2], np.hypot(n[0], n[1]))
    R = so3.exp([0.0, 0.0, azimuth]) @ so3.exp([0.0, -elevation, 0.0])
    m = R.T @ plane_seen[:3]
    return np.array([np.arctan2(m[1], m[0]), np.arctan2(m[2], np.hypot(m[0], m[1])), d + plane_seen[3]])


@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize("normal", [[0.0, 0.3, 0.954], [0.6, 0.0, -0.8], [1.0, 0.0, 0.0]])
def test_planes_cost_what_they_cost_in_g2o(read, rng, normal, fixed):
    n = np.array(normal) / np.linalg.norm(normal)
    plane = np.append(n, -2.0)
    T = SE3.exp([0.1, -0.2, 0.3, 1.0, 2.0, 3.0])
    seen = np.append(T.matrix[:3, :3].T @ n, plane[3] + n @ T.matrix[:3, 3])
    root = rng.normal(size=(3, 3))
    omega = root.T @ root
    text = f"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_PLANE 1 {' '.join(repr(float(x)) for x in plane)}\n"
    text += "FIX 1\n" if fixed else "FIX 0\n"
    numbers = " ".join(repr(float(x)) for x in [*seen, *omega[np.triu_indices(3)]])
    graph, start = (file := read(f"{text}EDGE_SE3_PLANE 0 1 {numbers}\n")).graph(), file.values()
    assert [type(record) for record in graph] == [Plane if fixed else PlaneSighting]
    for d in [np.zeros(6), *(1e-4 * rng.normal(size=(5, 6)))]:
        start.update(0, T.retract(d))
        e = g2o_plane_error(start.at(0).matrix, plane, seen)
        assert 2.0 * graph.error(start) == pytest.approx(e @ omega @ e, rel=2e-3, abs=1e-20)


def test_floor_of_hdl_graph_slam_levels_and_lifts_a_pose(read, tmp_path):
    text = "VERTEX_PLANE 1 0 0 1 0 0.2 0.2 0.2\nFIX 1\nVERTEX_SE3:QUAT 0 1 2 3 0.1 0 0 0.995\n"
    text += "EDGE_SE3_PLANE 0 1 0 0 1 0.5 100 0 0 100 0 100\n"
    text += "EDGE_SE3_PRIORXY 0 1 2 1 0 1\nEDGE_SE3_PRIORVEC 0 1 0 0 1 0 0 1 0 0 1 0 1\n"
    file = read(text)
    assert file.plane_ids.tolist() == [1] and file.gauge_ids.tolist() == []
    solution = solve(file.graph(), file.values())
    T = solution.values.at(0).matrix
    np.testing.assert_allclose(T[2, :4], [0, 0, 1, 0.5], atol=1e-6)
    write_g2o(tmp_path / "out.g2o", file.with_values(solution.values))
    assert "VERTEX_PLANE 1 0 0 1 0 0.2 0.2 0.2" in (tmp_path / "out.g2o").read_text()
    save_graph(tmp_path / "out.npz", file.graph(), solution.values)
    graph, values = load_graph(tmp_path / "out.npz")  # whose factors only files know
    assert graph.error(values) == file.graph().error(solution.values)


def test_plane_without_fix_is_estimated(read, tmp_path):
    q = "0 0 0 1"
    text = f"VERTEX_SE3:QUAT 0 0 0 0 {q}\nVERTEX_SE3:QUAT 1 1 0 0 {q}\nVERTEX_PLANE 5 1 0.1 0 -3\nFIX 0 1\n"
    text += "EDGE_SE3_PLANE 0 5 1 0 0 -4 1 0 0 1 0 1\nEDGE_SE3_PLANE 1 5 1 0 0 -3 1 0 0 1 0 1\n"
    file = read(text)
    solution = solve(file.graph(), file.values())
    np.testing.assert_allclose(solution.values.at(5), [4.0, 0.0, 0.0], atol=1e-6)
    write_g2o(tmp_path / "out.g2o", file.with_values(solution.values))
    again = read_pose_graph(tmp_path / "out.g2o")
    assert cost(again.graph(), again.values()) == pytest.approx(0.0, abs=1e-10)


def test_same_vertex_twice_is_read_once(read):
    file = read("VERTEX_SE2 3 0 0 0\n" + E + "VERTEX_SE2 3 0 0 0\n")
    assert len(file.of_role("pose")[0]) == 1
    assert file.notes == ("passed over: vertex lines that repeat an earlier one (1)",)


def test_comments_behind_numbers_are_kept(read, tmp_path):
    file = read(SMALL.replace("0 0 0\n", "0 0 0 # start\n", 1) + E + "; x\n% y\n// z\nFIX 0 // held\n")
    assert file.fixed.tolist() == [0]
    write_g2o(tmp_path / "out.g2o", file)
    lines = (tmp_path / "out.g2o").read_text().splitlines()
    assert lines[:3] == ["VERTEX_SE2 0 0 0 0", "# start", "VERTEX_SE2 1 1 0 0"]
    assert lines[4:7] == ["; x", "% y", "// z"]


def test_word_that_is_no_comment_is_still_named(read):
    with pytest.raises(FormatError, match="line 1: '/2' is not a number"):
        read("VERTEX_SE2 0 0 /2 0\n")


@pytest.mark.parametrize("tag", ["VERTEX_SE3 : QUAT", "VERTEX_SE3: QUAT", "VERTEX_SE3 :QUAT"])
def test_tag_in_several_words_is_one(read, tag):
    file = read(f"{tag} 0 0 0 0 0 0 0 1\nEDGE_SE3 : QUAT 0 1 1 0 0 0 0 0 1 {UPPER6}\n")
    assert file.pose_ids.tolist() == [0, 1]


def test_lines_that_end_in_a_carriage_return_alone(read):
    assert read((SMALL + E).replace("\n", "\r")).pose_ids.tolist() == [0, 1]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le"])
def test_wide_characters_are_named(read, encoding):
    with pytest.raises(FormatError, match=r"UTF-16.*save it as UTF-8"):
        read((SMALL + E).encode(encoding))


def test_isam_text_gives_square_roots(read):
    text = "ODOMETRY 0 1 1 0 0.1 2 0.5 0.25 3 0.125 4\nLANDMARK 0 0 1 2 2 1 3\nLANDMARK 1 0 0 2 2 0 3\n"
    file = read(text)
    S = np.array([[2, 0.5, 0.25], [0, 3, 0.125], [0, 0, 4]])
    omega = S.T @ S
    np.testing.assert_allclose(file.of_role("between")[0].information[0], omega[np.ix_([2, 0, 1], [2, 0, 1])])
    seen = file.of_role("landmark")[0]
    np.testing.assert_allclose(seen.information[0], [[4, 2], [2, 10]])
    assert seen.ids.tolist() == [[0, 2], [1, 2]]
    assert file.notes == ("landmarks and poses share ids; landmark 0 has become 2, and so on",)
    assert file.pose_ids.tolist() == [0, 1]


def test_edge_without_information_is_read_by_request(read):
    line = "EDGE3 0 1 1 2 3 0 0 0\n"
    with pytest.raises(FormatError, match=r"line 1: EDGE3 has 8 .* no information: .*--missing-information identity"):
        read(line)
    file = read(line, missing_information="identity")
    assert (file.of_role("between")[0].information == np.eye(6)).all()
    mixed = read(line + f"EDGE3 1 2 1 2 3 0 0 0 {UPPER6.replace('1', '4')}\n", missing_information="identity")
    assert mixed.edge_count == 2


def test_unknown_tags_are_passed_over_by_request_and_counted(read, tmp_path):
    text = SMALL + "VERTEX_SWITCH 5 1\nVERTEX_SWITCH 6 1\nROBOTLASER1 0 1 2\n" + E
    with pytest.raises(FormatError, match=r"line 3: unknown tag 'VERTEX_SWITCH'; remove .* \(--skip-unknown\)"):
        read(text)
    file = read(text, skip_unknown=True)
    assert file.notes == ("passed over: lines of unknown tags, VERTEX_SWITCH (2), ROBOTLASER1 (1)",)
    write_g2o(tmp_path / "out.g2o", file)
    assert (tmp_path / "out.g2o").read_text() == text


@pytest.mark.parametrize(
    ("tag", "hint"),
    [
        ("EDGE_SE2_XX", None),
        ("VERTEX_SE3", "VERTEX_SE3:QUAT"),
        ("EDGE_SE3", "EDGE_SE3:QUAT"),
        ("VERTEXSE2", "VERTEX_SE2"),
        ("edge_se2", "EDGE_SE2"),
        ("EDGE_PROJECT_DEPTH", None),
        ("VERTEX_SWITCH", None),
        ("EDGE_SE2_SWITCHABLE", None),
        ("VERTEX_CAM", None),
    ],
)
def test_hint_is_given_only_where_it_is_near(read, tag, hint):
    with pytest.raises(FormatError) as caught:
        read(f"{tag} 0 1 2\n" + E)
    said = str(caught.value)
    assert (f"did you mean '{hint}'" in said) if hint else ("did you mean" not in said or "SE2_XY" in said)


BAD = "EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\nEDGE_SE2 2 3 1 0 0 1 2 0 1 0 1\n"


def test_matrices_that_are_no_information_are_counted_in_one_message(read):
    with pytest.raises(FormatError, match=r"line 1: .* so are 2 of the 3 .*--repair-information clamp or skip"):
        read(BAD)
    with pytest.raises(FormatError, match=r"line 1: .*--repair-information clamp"):
        read(BAD[: BAD.index("EDGE_SE2 2")])


def test_clamped_information_has_no_negative_eigenvalue_and_is_said(read):
    file = read(BAD, repair_information="clamp")
    values = np.linalg.eigvalsh(file.of_role("between")[0].information)
    np.testing.assert_allclose(values, [[0, 1, 1], [1, 1, 1], [0, 1, 3]], atol=1e-12)
    assert file.notes[0].startswith("2 of 3 information matrices are not positive semi-definite and were clamped")
    graph = FactorGraph()
    graph.add(Between([0, 1, 2], [1, 2, 3], file.edges[2], Information(file.of_role("between")[0].information)))


def test_skipped_information_leaves_its_edges_out_and_is_said(read):
    file = read(BAD + "EDGE_SE2 0 3 1 0 0 1 0 0 1 0 1\n", repair_information="skip")
    assert file.edge_count == 2
    assert "2 of 4" in file.notes[0] and "left out" in file.notes[0]


def test_unknown_repair_is_refused(read):
    with pytest.raises(ConfigError, match="repair_information='clip': it is 'clamp', 'skip'"):
        read(BAD, repair_information="clip")


def test_indefinite_matrices_are_found(rng):
    factor = rng.normal(size=(500, 6, 6)) * 10.0 ** rng.uniform(-4, 4, size=(500, 1, 1))
    matrix = factor @ factor.swapaxes(1, 2)
    assert len(indefinite(matrix)[0]) == 0
    for k in (321, 7):
        matrix[k] -= 2 * np.linalg.eigvalsh(matrix[k])[-3] * np.eye(6)
    rows, values = indefinite(matrix)
    assert rows.tolist() == [7, 321]
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrix[[7, 321]]))
    assert len(indefinite(np.zeros((3, 4, 4)))[0]) == 0


def seen_from(T, points):
    return np.einsum("ab,nb->na", T[:2, :2].T, points - T[:2, 2])


def survey(pose_line):
    """Two poses that see three surveyed points; the first pose's line may be off."""
    points = np.array([[4.0, 1.0], [3.0, -2.0], [-1.0, 3.0]])
    T = [np.eye(3), se2.exp([0.3, 1.0, 0.2])]
    text = pose_line + "VERTEX_SE2 1 1 0 0\n"
    for k, (x, y) in enumerate(points):
        text += f"VERTEX_XY {10 + k} {x} {y}\n"
    for i in range(2):
        for k, (x, y) in enumerate(seen_from(T[i], points)):
            text += f"EDGE_SE2_XY {i} {10 + k} {float(x)} {float(y)} 100 0 100\n"
    return text + "FIX 10 11 12\n"


def test_fixed_landmarks_are_an_anchor_in_files_as_in_graphs(read, tmp_path):
    file = read(survey("VERTEX_SE2 0 0.5 0.3 0.1\n"))
    assert file.gauge_ids.tolist() == [10, 11, 12]
    solution = solve(file.graph(), file.values())
    assert solution.chi2 == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(solution.values.at(0).matrix, np.eye(3), atol=1e-8)
    from heliograph.graph import pose_graph_of

    graph = file.graph()
    write_g2o(tmp_path / "out.g2o", pose_graph_of(graph, file.values()))
    again = read_pose_graph(tmp_path / "out.g2o")
    assert again.graph().fixed.tolist() == graph.fixed.tolist()
    assert solve(again.graph(), again.values()).chi2 == pytest.approx(0.0, abs=1e-15)


def test_odometry_start_is_placed_by_fixed_landmarks(read):
    file = read(survey("VERTEX_SE2 0 0.5 0.3 0.1\n"))
    start = file.odometry_values()
    np.testing.assert_allclose(start.at(0).matrix, np.eye(3), atol=1e-9)
    assert start.at(10).tolist() == [4.0, 1.0]


def test_fixed_landmarks_anchor_a_replay_too(read):
    file = read(survey("VERTEX_SE2 0 0.5 0.3 0.1\n") + "EDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n")
    smoother = replay(replay_steps(file.graph(), file.odometry_values())).smoother
    smoother.update(iterate=1e-10)
    found = smoother.estimate()
    assert found.at(10).tolist() == [4.0, 1.0]
    assert file.graph().error(found) == pytest.approx(0.0, abs=1e-15)


def test_one_pose_that_sees_four_fixed_points_is_solved(read):
    T = se3.exp([0.4, -0.3, 0.2, 1.0, 2.0, 3.0])
    points = np.array([[5.0, 0, 0], [0, 4, 1], [-3, 1, 2], [1, 1, -4]])
    text = "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n"
    for k, p in enumerate(points):
        text += f"VERTEX_TRACKXYZ {10 + k} {p[0]} {p[1]} {p[2]}\n"
        z = T[:3, :3].T @ (p - T[:3, 3])
        text += f"EDGE_SE3_TRACKXYZ 0 {10 + k} 0 {float(z[0])} {float(z[1])} {float(z[2])} 1 0 0 1 0 1\n"
    file = read(text + "FIX 10 11 12 13\n")
    assert file.gauge_ids.tolist() == [10, 11, 12, 13]
    for values in (file.values(), file.odometry_values()):
        found = solve(file.graph(), values).values.at(0).matrix
        np.testing.assert_allclose(found, T, atol=1e-7)


def test_component_that_sees_no_fixed_landmark_keeps_its_own_gauge(read):
    text = survey("VERTEX_SE2 0 0 0 0\n") + "EDGE_SE2 20 21 1 0 0 1 0 0 1 0 1\n"
    assert read(text).gauge_ids.tolist() == [10, 11, 12, 20]
