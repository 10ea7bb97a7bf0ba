"""`heliograph align`: what it prints, its JSON and its picture, and one line for each bad input."""

import json

import numpy as np
import pytest
from tests import scenes

from heliograph.cli.main import main
from heliograph.io.files.clouds import write_cloud
from heliograph.lie import se3


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clouds")
    rng = np.random.default_rng(0)
    truth = scenes.random_motion(rng, 0.5, 0.1)
    target, source = scenes.corner_room(rng), scenes.moved(scenes.corner_room(rng), truth)
    for suffix in ("ply", "pcd", "las"):
        write_cloud(folder / f"a.{suffix}", target)
    write_cloud(folder / "b.pcd", source)
    np.savetxt(folder / "b.xyz", source, fmt="%.5f", header="x y z")
    np.savetxt(folder / "a.csv", target, fmt="%.5f", delimiter=",", header="x,y,z", comments="")
    np.savetxt(folder / "start.txt", truth)
    return folder, truth


def _run(capsys, *arguments):
    code = main(["align", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.mark.parametrize(("a", "b"), [("a.ply", "b.pcd"), ("a.pcd", "b.xyz"), ("a.las", "b.xyz"), ("a.csv", "b.pcd")])
def test_align_reads_every_format(pair, capsys, a, b):
    folder, truth = pair
    code, out, _ = _run(capsys, folder / a, folder / b, "--json")
    result = json.loads(out)
    assert code == 0 and result["status"] == "converged"
    assert np.linalg.norm(se3.log(se3.inverse(truth) @ np.array(result["T_target_source"]))) < 5e-3
    assert len(out.splitlines()) == 1


def test_align_says_it_in_words_and_draws_it(pair, capsys, tmp_path):
    folder, _ = pair
    picture = tmp_path / "p.png"
    code, out, err = _run(
        capsys, folder / "a.ply", folder / "b.pcd", "--method", "vgicp", "--picture", tmp_path / "p.png"
    )
    assert code == 0 and not err
    lines = out.splitlines()
    assert lines[0] == "converged" and lines[1] == "T_A_B"
    assert "sigmas about and along B's axes" in out and "overlap" in out and "least known" in out
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_align_takes_a_start_from_a_file_or_none_at_all(pair, capsys):
    folder, truth = pair
    for start in (folder / "start.txt", "global"):
        code, out, _ = _run(capsys, folder / "a.ply", folder / "b.pcd", "--start", start, "--json")
        result = json.loads(out)
        assert code == 0 and result["status"] == "converged", result
        assert np.linalg.norm(se3.log(se3.inverse(truth) @ np.array(result["T_target_source"]))) < 5e-3


def test_align_without_overlap_is_an_answer(pair, capsys, tmp_path):
    folder, _ = pair
    away = np.eye(4)
    away[0, 3] = 300.0
    np.savetxt(tmp_path / "away.txt", away)
    code, out, _ = _run(capsys, folder / "a.ply", folder / "b.pcd", "--start", tmp_path / "away.txt", "--json")
    result = json.loads(out)
    assert code == 0 and result["status"] == "no overlap" and result["T_target_source"] is None


def _bad_files(folder):
    write_cloud(folder / "empty.ply", np.zeros((0, 3), np.float32))
    write_cloud(folder / "one.ply", np.ones((1, 3), np.float32))
    write_cloud(folder / "nan.ply", np.full((20, 3), np.nan, np.float32))
    write_cloud(folder / "line.ply", np.linspace(0, 9, 90, dtype=np.float32)[:, None] * np.float32([1, 1, 0]))
    write_cloud(folder / "mm.ply", 1000 * scenes.corner_room(np.random.default_rng(1)))
    (folder / "words.xyz").write_text("1 2 3\nfour five six\n")
    (folder / "short.xyz").write_text("1 2 3\n4 5\n")
    (folder / "broken.pcd").write_bytes(b"\x00\x01\x02nothing")
    (folder / "broken.las").write_bytes(b"LASF but no more")
    (folder / "cloud.doc").write_text("hello")


BAD = {
    "empty.ply": "0 finite points",
    "one.ply": "1 finite points",
    "nan.ply": "0 finite points of 20",
    "line.ply": "one line",
    "mm.ply": "millimetres",
    "words.xyz": "line 2 is not a point",
    "short.xyz": "line 2 has 2 numbers",
    "broken.pcd": "is not a PCD file",
    "broken.las": "LAS",
    "cloud.doc": "give one of .ply",
    "missing.ply": "cannot be read",
    "missing.xyz": "cannot be read",
}


@pytest.mark.parametrize(("name", "words"), BAD.items())
def test_align_says_one_line_of_a_bad_cloud(pair, capsys, tmp_path, name, words):
    _bad_files(tmp_path)
    code, out, err = _run(capsys, pair[0] / "a.ply", tmp_path / name)
    assert code == 2 and not out
    assert len(err.splitlines()) == 1 and words in err


@pytest.mark.parametrize(("text", "words"), [
    ("1 0 0", "holds 3 numbers"),
    ("one two", "is not a pose"),
    ("2 0 0 0 0 2 0 0 0 0 2 0", "no rotation"),
    ("1 0 0 0 0 1 0 0 0 0 -1 0", "det R"),
    (None, "cannot be read"),
])  # fmt: skip
def test_align_says_one_line_of_a_bad_start(pair, capsys, tmp_path, text, words):
    if text is not None:
        (tmp_path / "start").write_text(text)
    code, out, err = _run(capsys, pair[0] / "a.ply", pair[0] / "b.pcd", "--start", tmp_path / "start")
    assert code == 2 and not out and len(err.splitlines()) == 1 and words in err


def test_align_writes_pictures_as_png_only(pair, capsys, tmp_path):
    code, _, err = _run(capsys, pair[0] / "a.ply", pair[0] / "b.pcd", "--picture", tmp_path / "p.jpg")
    assert code == 2 and ".png" in err
