"""The viewer: the file to share, read back by Rerun's own reader, and what is said where there is nothing."""

import csv
import json
import os
import shutil
import socket
import sys
from pathlib import Path

import numpy as np
import pytest

from heliograph.cli.extra_sinks import tell_port
from heliograph.cli.main import main
from heliograph.sim import SCENARIOS
from heliograph.sim.write import write_recording
from heliograph.viewer.screen import Screen, free_port

rerun_chunk = pytest.importorskip("rerun.chunk", reason="the viewer needs the extra `view`")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run of four seconds with its live file."""
    home = tmp_path_factory.mktemp("viewer")
    write_recording(home / "drive", SCENARIOS["room"].thinned(beams=16, columns=256, duration=4.0), seed=1)
    options = ["-o", str(home / "run"), "-q", "--rrd", str(home / "live.rrd"), "--dump-scans", str(home / "scans")]
    assert main(["run", str(home / "drive"), *options]) == 0
    return home


def contents(path):
    """Return entity -> component -> list of rows."""
    found = {}
    for chunk in rerun_chunk.RrdReader(str(path)).stream().to_chunks():
        batch = chunk.to_record_batch()
        place = found.setdefault(str(chunk.entity_path), {})
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            place.setdefault(name, []).extend(column.to_pylist())
    return found


def rows_of_scans(folder):
    return (folder / "scans.csv").read_text().splitlines()[1:]


def test_view_writes_the_run_as_it_is_in_its_folder(made, tmp_path):
    file = tmp_path / "run.rrd"
    assert main(["view", str(made / "run"), "--rrd", str(file)]) == 0
    shown = contents(file)
    rows, header = rows_of_scans(made / "run"), (made / "run" / "scans.csv").read_text().splitlines()[0].split(",")
    eigenvalues = [row for row in shown["/plots/eigenvalues/translation"]["Scalars:scalars"] if row is not None]
    at = [header.index(f"eigenvalue_translation_{part}") for part in ("min", "mid", "max")]
    assert np.array(eigenvalues, dtype=float) == pytest.approx(
        np.array([[float(row.split(",")[i]) for i in at] for row in rows])
    )
    way = np.loadtxt(made / "run" / "trajectory.tum")[:, 1:4]
    strip = np.array(shown["/map/trajectory"]["LineStrips3D:strips"][0][0])
    assert strip == pytest.approx(way, abs=1e-6)
    keyframes = json.loads((made / "run" / "run.json").read_text())["graph"]["keyframes"]
    assert len(shown["/graph/factors"]["GraphNodes:node_ids"][0]) == keyframes
    assert len(shown["/graph/factors"]["GraphEdges:edges"][0]) == keyframes - 1
    assert shown["/graph/bayes_tree"]["GraphNodes:node_ids"][0], "the tree has cliques"
    colors = [row for row in shown["/map/keyframe/points"]["Points3D:colors"] if row]
    assert len(colors) == keyframes and len(set(colors[-1])) > 10, "coloured by what lies off the map"
    residuals = [row[0] for row in shown["/plots/map_residual"]["Scalars:scalars"] if row]
    assert len(residuals) == keyframes and 0.0 < max(residuals) < 0.05
    assert shown["/map/points"]["Points3D:positions"][0] and shown["/map/sigma"]["Ellipsoids3D:half_sizes"]
    assert "PASS" in shown["/account"]["TextDocument:text"][0][0]


def test_run_shows_each_scan_while_it_goes_on_and_the_whole_behind_it(made):
    shown, scans = contents(made / "live.rrd"), len(rows_of_scans(made / "run"))
    assert sum(row is not None for row in shown["/odom/imu/scan"]["Points3D:positions"]) == scans
    assert sum(row is not None for row in shown["/live/gyro_bias"]["Scalars:scalars"]) == scans
    assert "/map/points" in shown and "/graph/factors" in shown


def test_scans_show_their_matches_by_residual_while_the_run_goes_on(made):
    shown = contents(made / "live.rrd")
    rows = list(csv.DictReader((made / "run" / "scans.csv").read_text().splitlines()))
    matched = [row for row in shown["/odom/imu/matches"]["Points3D:positions"] if row]
    colors = [row for row in shown["/odom/imu/matches"]["Points3D:colors"] if row]
    assert len(rows) - 2 <= len(matched) == len(colors) < len(rows), "all scans but those that nothing came before"
    assert all(len(points) == len(color) > 500 for points, color in zip(matched, colors, strict=True))
    residuals = np.array([row[0] for row in shown["/live/median_residual"]["Scalars:scalars"] if row])
    rms = np.array([float(row["rms"]) for row in rows[-10:]])
    assert np.all((0.3 * rms < residuals[-10:]) & (residuals[-10:] < rms)), "as large as the odometry's own matches"
    assert len(set(colors[-1])) > 10


def test_view_shows_every_dumped_scan_where_the_run_has_it(made, tmp_path, capsys):
    file = tmp_path / "x.rrd"
    assert main(["view", str(made / "run"), "--rrd", str(file), "--scans", str(made / "scans")]) == 0
    shown = contents(file)
    clouds = [row for row in shown["/map/scan/points"]["Points3D:positions"] if row]
    assert len(clouds) == len(rows_of_scans(made / "run"))
    residuals = [row[0] for row in shown["/plots/scan_residual"]["Scalars:scalars"] if row]
    assert len(residuals) == len(clouds) and max(residuals[5:]) < 0.05, "they lie on the map"
    (tmp_path / "other").mkdir()
    shutil.copy(made / "scans" / "000003.ply", tmp_path / "other" / "000999.ply")
    for folder, said in ((tmp_path / "none", "holds no scans"), (tmp_path / "other", "is no scan of")):
        capsys.readouterr()
        assert main(["view", str(made / "run"), "--rrd", str(file), "--scans", str(folder)]) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1, error


def test_dumped_scans_are_a_cloud_each(made):
    from heliograph.io.files.clouds import read_cloud

    assert len(list((made / "scans").glob("*.ply"))) == len(rows_of_scans(made / "run"))
    assert len(read_cloud(made / "scans" / "000003.ply").points) > 500


def test_view_says_in_one_line_what_it_cannot_show(made, tmp_path, capsys, monkeypatch):
    capsys.readouterr()

    def refused(folder, said, *options):
        assert main(["view", str(folder), "--rrd", str(tmp_path / "x.rrd"), *options]) == 2
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1, error

    refused(tmp_path, "is no folder of a run")
    for name, change, said in (
        ("running", lambda f: (f / "run.json").write_text('{"status": "running"}'), "has not ended"),
        ("older", lambda f: (f / "scans.csv").write_text("index,end_ns\n0,1\n"), "another version wrote it"),
        ("torn", lambda f: (f / "scans.csv").unlink(), "cannot be read"),
    ):
        shutil.copytree(made / "run", tmp_path / name)
        change(tmp_path / name)
        refused(tmp_path / name, said)
    refused(made / "run", "is a folder", "--rrd", str(tmp_path))
    monkeypatch.setitem(sys.modules, "rerun", None)
    refused(made / "run", "pip install 'heliograph[view]'")


def test_view_of_a_run_without_map_or_graph_shows_the_rest_and_says_so(made, tmp_path, capsys):
    shutil.copytree(made / "run", tmp_path / "run")
    (tmp_path / "run" / "map.ply").unlink()
    (tmp_path / "run" / "loops.csv").unlink()
    assert main(["view", str(tmp_path / "run"), "--rrd", str(tmp_path / "x.rrd")]) == 0
    said = capsys.readouterr().err
    assert "holds no map" in said and "no keyframes, loops or graph" in said
    assert "/map/trajectory" in contents(tmp_path / "x.rrd")


def test_without_a_display_a_window_is_refused_in_one_line_before_the_work(made, tmp_path, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    for command in (["view", str(made / "run")], ["run", str(made / "drive"), "-o", str(tmp_path / "out"), "--view"]):
        assert main(command) == 2
        said = capsys.readouterr().err
        assert "there is no display" in said and "--rrd FILE" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_window_is_opened_on_a_free_port_by_the_packages_own_program(monkeypatch, capsys):
    import rerun

    asked = {}
    monkeypatch.setenv("DISPLAY", ":9")
    monkeypatch.setattr(rerun, "spawn", lambda **options: asked.update(options, output=os.fstat(1).st_rdev))
    monkeypatch.setattr(rerun, "GrpcSink", lambda address: asked.update(address=address) or rerun.FileSink(os.devnull))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        monkeypatch.setattr("heliograph.viewer.screen.PORT", port)
        monkeypatch.setattr("heliograph.viewer.screen.free_port", lambda: free_port(port))
        screen = Screen("x", window=True)
        tell_port(screen)
    assert asked["port"] == screen.port and port < screen.port <= port + 19
    assert f":{screen.port}/" in asked["address"] and f"port {port} is in use" in capsys.readouterr().err
    assert asked["output"] == Path(os.devnull).stat().st_rdev, "a window that outlives us holds no pipe of ours open"
    # Without its recording, Rerun takes itself for switched off and opens nothing.
    assert isinstance(asked["recording"], rerun.RecordingStream)
    screen.close()


def test_window_that_is_closed_meanwhile_costs_a_run_nothing(made, tmp_path, monkeypatch, capsys):
    def gone(*_, **__):
        raise RuntimeError("gRPC has been unable to connect")

    monkeypatch.setattr("rerun.RecordingStream.flush", gone)
    options = ["-o", str(tmp_path / "run"), "--duration", "2", "--no-graph", "--rrd", str(tmp_path / "x.rrd")]
    assert main(["run", str(made / "drive"), *options]) == 0
    out, err = capsys.readouterr()
    assert "status: " in out and "note: the viewer's window is gone" in err
    assert main(["view", str(made / "run"), "--rrd", str(tmp_path / "y.rrd"), "--no-residuals"]) == 2
    assert "window is gone" in capsys.readouterr().err
