"""run.json from anybody: what commands rely on is there as they expect it, or the file is refused in one line."""

import json

import pytest

from heliograph.errors import FormatError
from heliograph.guard.account import read_account

SOUND = {
    "status": "ok",
    "reasons": [],
    "distance_m": None,
    "T_map_odom": [[1, 0.0], [0, 1]],
    "checks": [{"title": "rest", "verdict": "PASS", "evidence": "still", "remedy": ""}],
    "graph": {"keyframes": 3, "loops": {}, "gnss": {"aligned": False}},
    "outputs": [{"name": "map.ply", "bytes": 3}],
    "more": {"of": ["a", "later", "version"]},
}


def written(folder, text):
    (folder / "run.json").write_text(text)
    return folder


def test_a_sound_account_is_read_as_it_is(tmp_path):
    assert read_account(written(tmp_path, json.dumps(SOUND))) == SOUND


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"status": 3}, "status"),
        ({"scans": True}, "scans"),
        ({"reasons": "x"}, "reasons"),
        ({"distance_m": "far"}, "distance_m"),
        ({"T_map_odom": [[None]]}, "T_map_odom"),
        ({"checks": [{"title": "rest"}]}, "checks.verdict"),
        ({"graph": []}, "graph"),
        ({"graph": {"gnss": {"aligned": True, "origin": {}}}}, "graph.gnss.origin.latitude_deg"),
        ({"outputs": [{}]}, "outputs.name"),
        ({"more": json.loads("[" * 80 + "]" * 80)}, "depth"),
    ],
)
def test_an_account_of_another_shape_is_refused(change, words, tmp_path):
    with pytest.raises(FormatError, match=f"run.json.*{words} is not what `run` writes"):
        read_account(written(tmp_path, json.dumps({**SOUND, **change})))


@pytest.mark.parametrize("text", ["", "[1]", "NaN", '{"a": 1e999}', '{"a": Infinity}', '{"a": ' + "9" * 400 + "}",
                                  "[" * 100_000, '{"a": ' + "9" * 5000 + "}", "\x00"])  # fmt: skip
def test_what_is_no_json_of_finite_numbers_is_refused(text, tmp_path):
    with pytest.raises(FormatError) as caught:
        read_account(written(tmp_path, text))
    assert len(str(caught.value)) < 1000
    with pytest.raises(FormatError, match="no folder of a run"):
        read_account(tmp_path / "nowhere")


def test_account_of_another_generation_is_told_in_one_line(tmp_path):
    with pytest.raises(
        FormatError, match=r"another version of Heliograph \('heliograph run 2' where this one reads 1\)"
    ):
        read_account(written(tmp_path, json.dumps({**SOUND, "schema": "heliograph run 2"})))
    for schema in ("heliograph run 1", "heliograph merge 1"):
        assert read_account(written(tmp_path, json.dumps({**SOUND, "schema": schema})))


def test_folder_without_an_account_says_so(tmp_path):
    with pytest.raises(FormatError, match=r"it holds no run\.json"):
        read_account(tmp_path)
