"""`heliograph compare` and `heliograph support`, on short runs of a simulated recording."""

import getpass
import json
import platform
import re
import shutil
import zipfile

import pytest

from heliograph.cli.main import main
from heliograph.sim import SCENARIOS
from heliograph.sim.write import write_recording


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    home = tmp_path_factory.mktemp("runs") / "somebody_private"
    made = write_recording(home / "made", SCENARIOS["room"].thinned(beams=16, columns=256, duration=4.0), seed=1)
    bag = home / "secret_site.mcap"
    shutil.copy(made.recording, bag)
    for name, options in (("one", []), ("two", ["--set", "output.map_voxel=0.2", "--threads", "1"])):
        assert main(["run", str(bag), "-o", str(home / name), "-q", *options]) == 0
    return home


def test_compare_tells_distances_and_the_settings_that_differ(runs, capsys):
    assert main(["compare", str(runs / "one"), str(runs / "two"), str(runs / "one")]) == 0
    shown = capsys.readouterr().out
    assert "output.map_voxel: 0.1, 0.2, 0.1" in shown and "threads: 0, 1, 0" in shown
    assert re.search(r"^ATE to the first +- +0\.0000 m +0\.0000 m$", shown, re.MULTILINE)
    for row in ("status", "start-end gap", "map points", "loops accepted", "wall a scan", "peak memory"):
        assert re.search(rf"^{row}", shown, re.MULTILINE), row
    assert main(["compare", str(runs / "one"), str(runs / "two"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["runs"][1]["ate"] == pytest.approx(0.0, abs=1e-6) and found["runs"][1]["same_recording"] is True
    assert 0.0 < found["runs"][1]["map"]["median"] < 0.1 and found["runs"][1]["map"]["far_share"] < 0.01
    assert found["runs"][1]["settings"] == {"output.map_voxel": 0.2, "threads": 1}


def test_compare_and_evaluate_write_pages_that_need_nothing_else(runs, tmp_path, capsys):
    page = tmp_path / "compare.html"
    assert main(["compare", str(runs / "one"), str(runs / "two"), "--html", str(page)]) == 0
    shown, html = capsys.readouterr().out, page.read_text()
    for row in ("status", "ATE to the first", "map points", "output.map_voxel: 0.1, 0.2"):
        assert row in shown and row in html
    assert html.count("data:image/png") == 2 and html.count('class="line c') == 2
    assert not re.search(r'(src|href)="(?!data:|#)', html)
    page = tmp_path / "evaluation.html"
    assert main(["evaluate", str(runs / "one"), str(runs / "made"), "--plot", str(page)]) == 0
    first = capsys.readouterr().out.splitlines()[1]
    assert first in page.read_text() and "Error of the position" in page.read_text()


def test_evaluate_holds_the_map_against_the_simulated_world(runs, tmp_path, capsys):
    made = tmp_path / "made"
    made.mkdir()
    for name in ("groundtruth_imu.tum", "scenario.toml"):
        shutil.copy(runs / "made" / name, made / name)
    assert main(["evaluate", str(runs / "one"), str(made)]) == 0
    assert "of its points are off the world's surfaces by" in capsys.readouterr().out
    assert main(["evaluate", str(runs / "one"), str(made), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["map"]
    assert found["points"] > 1000 and 0.0 < found["median"] < 0.01 and found["far_share"] < 0.01
    (made / "scenario.toml").write_text("name = 3")
    assert main(["evaluate", str(runs / "one"), str(made)]) == 0
    shown = capsys.readouterr().out
    assert "ATE" in shown and "map  not compared with the world" in shown and "scenario.toml" in shown


def test_compare_of_a_run_with_itself_differs_in_nothing(runs, capsys):
    assert main(["compare", str(runs / "one"), str(runs / "one")]) == 0
    assert "the settings are the same" in capsys.readouterr().out


def test_compare_refuses_what_is_no_pair_of_runs_in_one_line(runs, tmp_path, capsys):
    shutil.copytree(runs / "one", tmp_path / "broken")
    (tmp_path / "broken" / "run.json").write_text('{"status": "running"}')
    for arguments, said in (
        ([runs / "one"], "name two or more"),
        ([runs / "one", tmp_path], "is no folder of a run"),
        ([runs / "one", tmp_path / "broken"], "has not ended"),
    ):
        assert main(["compare", *map(str, arguments)]) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1


def test_support_packs_the_account_without_paths_names_or_positions(runs, tmp_path, capsys):
    assert main(["support", str(runs / "one"), "-o", str(tmp_path / "report.zip")]) == 0
    assert "look into it" in capsys.readouterr().out
    with zipfile.ZipFile(tmp_path / "report.zip") as archive:
        texts = {name: archive.read(name).decode() for name in archive.namelist()}
    assert set(texts) == {"run.json", "config.toml", "scans.csv", "loops.csv", "files.txt"}
    facts = json.loads(texts["run.json"])
    own = json.loads((runs / "one" / "run.json").read_text())
    assert facts["status"] == own["status"] and facts["timings"] == own["timings"]
    assert facts["recording"]["topics"] == own["recording"]["topics"] and facts["folder"] == "<path>"
    everything = "\n".join(texts.values())
    for private in ("somebody_private", "secret_site", str(runs), str(tmp_path), platform.node(), getpass.getuser()):
        assert not re.search(rf"(?<![A-Za-z0-9]){re.escape(private)}(?![A-Za-z0-9])", everything), private
    topics = [topic for topic in own["recording"]["topics"].values() if topic]
    for line in everything.splitlines():
        for topic in topics:
            line = line.replace(topic, "")
        assert not re.search(r"(?<![\w/:.<])/\w+/\w+", line), line
    columns = texts["scans.csv"].partition("\n")[0].split(",")
    assert not {"position_x", "velocity_z"} & set(columns) and {"sigma_position_x", "weak_share"} <= set(columns)
    assert len(texts["scans.csv"].splitlines()) == own["scans"] + 1
    assert "map.ply" in texts["files.txt"]


def test_support_hides_paths_of_every_kind(tmp_path):
    from heliograph.support import _clean

    for text in (
        "cannot read /home/ann/a b.bag",
        "C:\\Users\\ann\\x.mcap failed",
        "'/mnt/disk 1/site/run'",
        "see /data/x.",
    ):
        cleaned = _clean(text, {"ann": "<user>"}, {"/points"})
        assert "<path>" in cleaned and "ann" not in cleaned.split() and "site" not in cleaned and "home" not in cleaned
    kept = "/points at 10 Hz, 0.2 m/s^2, 3/4, 1 / 2, rad/s/sqrt(Hz)"
    assert _clean(kept, {}, {"/points"}) == kept


def test_support_refuses_a_folder_of_something_else_and_an_archive_that_is_there(runs, tmp_path, capsys):
    assert main(["support", str(tmp_path)]) == 2
    assert "is no folder of a run" in capsys.readouterr().err
    (tmp_path / "there.zip").write_text("mine")
    assert main(["support", str(runs / "one"), "-o", str(tmp_path / "there.zip")]) == 2
    assert (tmp_path / "there.zip").read_text() == "mine"
