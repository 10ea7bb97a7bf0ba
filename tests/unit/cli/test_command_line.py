"""The contract of the command line, on a recording small enough to run many times."""

import json
import os
import re
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from heliograph.cli import progress
from heliograph.cli.help import EXAMPLES
from heliograph.cli.interrupt import interruptible
from heliograph.cli.names import default_folder, unused
from heliograph.config_toml import load_config
from heliograph.io.files.clouds import read_cloud
from heliograph.io.files.tum import read_tum
from heliograph.sim import find_scenario
from heliograph.sim.write import write_recording

FILES = {
    "gnss.csv",
    "trajectory.tum", "odometry.tum", "trajectory_imu_rate.tum", "map.ply", "map.png", "map.pgw", "scans.csv",
    "run.json", "keyframes", "loops.csv", "graph.g2o", "graph.npz",
    "config.toml", "report.html",
}  # fmt: skip


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scenario = find_scenario("room").thinned(beams=16, columns=128, duration=5.0).varied(walk={"rest": 1.5})
    return write_recording(tmp_path_factory.mktemp("cli") / "room", scenario, seed=2).folder


@pytest.fixture
def no_report(monkeypatch):
    """Leave out the pictures: a second a run, and they have their own tests."""
    monkeypatch.setattr("heliograph.report.write_report", lambda _: [])


def test_run_writes_the_contract_files_into_the_default_folder(call, recording, tmp_path):
    code, out, _ = call("run", recording)
    assert code == 0
    folder = tmp_path / "room_heliograph"
    assert {path.name for path in folder.iterdir()} == FILES
    last = out.splitlines()[-10:]
    assert last[0].startswith("distance ")
    assert "ms a scan" in last[1] and last[2].startswith("level known to") and " deg: +- " in last[2]
    assert last[3].startswith("worst weak direction")
    assert "keyframes; no loop closed" in last[4]
    assert last[5].startswith("gnss: ") and last[6].startswith("checks: smeared map ")
    assert all(name in last[7] for name in FILES) and last[9] == "status: ok"
    rows = read_tum(folder / "trajectory.tum")
    assert len(rows) == json.loads((folder / "run.json").read_text())["scans"]


def test_run_json_is_one_object_and_the_same_as_the_file(call, recording, tmp_path, no_report):
    code, out, err = call("run", recording, "-o", "out", "--json")
    facts = json.loads(out)
    assert code == 0 and facts == json.loads((tmp_path / "out" / "run.json").read_text())
    assert {"status", "versions", "recording", "inferences", "timings", "peak_memory_mb", "warnings"} <= set(facts)
    assert "distance" not in err


def test_run_quiet_says_nothing_about_a_good_run(call, recording, no_report):
    assert call("run", recording, "--quiet") == (0, "", "")


def test_run_options_reach_the_resolved_configuration(call, recording, tmp_path, no_report):
    (tmp_path / "base.toml").write_text("threads = 2\n[output]\nmap_voxel = 0.5\nmap_format = 'pcd'\n")
    call("run", recording, "-o", "out", "-q", "--config", "base.toml", "--set", "output.map_voxel=0.3", "--threads", 1)
    config = load_config(tmp_path / "out" / "config.toml")
    assert (config.threads, config.output.map_voxel, config.output.map_format) == (1, 0.3, "pcd")
    assert (tmp_path / "out" / "map.pcd").exists() and not (tmp_path / "out" / "map.ply").exists()


def test_run_same_bits_with_one_thread_and_two(call, recording, tmp_path, no_report):
    for threads in (1, 2):
        assert call("run", recording, "-o", f"out{threads}", "-q", "--threads", threads)[0] == 0
    for name in ("trajectory.tum", "trajectory_imu_rate.tum", "map.ply"):
        assert (tmp_path / "out1" / name).read_bytes() == (tmp_path / "out2" / name).read_bytes(), name


def test_run_frame_lidar_moves_the_rows_by_the_mounting(call, recording, tmp_path, no_report):
    call("run", recording, "-o", "imu", "-q")
    call("run", recording, "-o", "lidar", "-q", "--frame", "lidar")
    imu, lidar = (read_tum(tmp_path / body / "trajectory.tum").T_frame_body for body in ("imu", "lidar"))
    facts = json.loads((tmp_path / "lidar" / "run.json").read_text())
    T_imu_lidar = np.array(facts["recording"]["T_imu_lidar"])
    np.testing.assert_allclose(lidar, imu @ T_imu_lidar, atol=1e-7)


def test_run_start_and_duration_use_a_part(call, recording, tmp_path, no_report):
    _, out, _ = call("run", recording, "-o", "part", "--json", "--start", 1, "--duration", 2)
    assert json.loads(out)["duration_s"] == pytest.approx(2.0, abs=0.25)


@pytest.mark.parametrize(("sensors", "files"), [("lidar", FILES - {"trajectory_imu_rate.tum"}), ("imu", None)])
def test_run_on_one_sensor_says_so(call, recording, tmp_path, sensors, files):
    code, out, _ = call("run", recording, "-o", "out", "--json", "--sensors", sensors)
    facts = json.loads(out)
    assert code == 0 and facts["sensors"] == [sensors]
    written = {path.name for path in (tmp_path / "out").iterdir()}
    if sensors == "lidar":
        assert written == files
    else:
        assert facts["status"] == "degraded" and "map.ply" not in written and "report.html" in written


@pytest.fixture
def sigint():
    """Set the handler of Ctrl-C, which a suite that runs in the background finds ignored, and put it back."""
    before = signal.getsignal(signal.SIGINT)
    yield lambda handler: signal.signal(signal.SIGINT, handler)
    signal.signal(signal.SIGINT, before)


def test_run_interrupted_saves_what_is_done_and_exits_130(call, recording, tmp_path, monkeypatch, sigint):
    sigint(signal.default_int_handler)

    class Impatient(progress.ProgressSink):
        def add(self, result):
            if result.index == 20:
                signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(progress, "ProgressSink", Impatient)
    code, _, err = call("run", recording, "-o", "out")
    assert code == 130 and "interrupted" in err
    facts = json.loads((tmp_path / "out" / "run.json").read_text())
    assert facts["interrupted"] and 20 < facts["scans"] < 30
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == facts["scans"]
    assert len(read_cloud(tmp_path / "out" / "map.ply")) > 1000
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES | {"checkpoint"}
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_interrupt_that_the_process_ignores_stays_ignored(sigint):
    sigint(signal.SIG_IGN)
    with interruptible() as stop:
        signal.raise_signal(signal.SIGINT)
        assert not stop()
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_demo_interrupted_exits_130_and_asks_before_it_replaces(call, tmp_path, monkeypatch, sigint, no_report):
    sigint(signal.default_int_handler)
    short = find_scenario("demo").thinned(beams=16, columns=180, duration=4.0)
    monkeypatch.setattr("heliograph.sim.find_scenario", lambda _: short)
    monkeypatch.setattr(progress.ProgressSink, "add", lambda *_: signal.raise_signal(signal.SIGINT))
    code, out, err = call("demo", "-o", "shown")
    assert code == 130 and "interrupted" in err and "against the truth" not in out
    code, _, err = call("demo", "-o", "shown")
    assert code == 2 and "shown holds a demo already; choose another with -o or add --overwrite" in err


def test_reader_that_went_away_is_no_defect(recording):
    command = [sys.executable, "-c", "import sys; from heliograph.cli.main import main; sys.exit(main())"]
    read, write = os.pipe()
    os.close(read)
    ended = subprocess.run([*command, "info", recording], stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    os.close(write)
    assert ended.returncode == 0 and ended.stderr == ""


def test_run_on_a_full_disk_leaves_valid_files_and_one_line(call, recording, tmp_path, no_report):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, limits[1]))  # every file ends at 40 KB: the map does not fit
    try:
        code, out, err = call("run", recording, "-o", "out", "-q")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert code == 2 and out == ""
    assert err.startswith("error: cannot write") and len(err.splitlines()) == 1 and "out" in err
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert "map.ply" not in written, "a map that is cut off is worse than none"
    rows = read_tum(tmp_path / "out" / "trajectory.tum")
    assert len(rows) > 5
    assert json.loads((tmp_path / "out" / "run.json").read_text())["failure"]


OWN = """
import numpy as np
from heliograph.data import Scan
from heliograph.io.bags.rosbag import open_rosbag
from heliograph.odometry import Odometry, pose_result

class Standing(Odometry):
    def __init__(self, *_):
        self.events, self.last, self.count = [], None, 0

    def add(self, message):
        if not isinstance(message, Scan):
            return []
        self.last = pose_result(message, self.count, np.eye(4), before=self.last)
        self.count += 1
        return [self.last]

def reader(paths):
    return open_rosbag(paths)
"""


def test_run_takes_odometry_and_reader_from_a_module_in_the_current_folder(call, recording, tmp_path, no_report):
    (tmp_path / "own_parts.py").write_text(OWN)
    names = ("--odometry", "own_parts:Standing", "--reader", "own_parts:reader")
    code, out, err = call("run", recording, "-o", "out", "--json", *names)
    assert code == 0, err
    assert json.loads(out)["distance_m"] == 0.0 and json.loads(out)["scans"] > 40
    config = load_config(tmp_path / "out" / "config.toml")
    assert (config.odometry, config.input.reader) == names[1::2]


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("--odometry", "fitler", "did you mean 'filter'"),
        ("--odometry", "no_module:f", "No module named 'no_module'"),
        ("--reader", "rosbga", "did you mean 'rosbag'"),
        ("--reader", "kitti", "the reader 'kitti' knows"),
    ],
)
def test_run_wrong_part_is_one_line_and_no_folder(call, recording, option, name, words):
    code, out, err = call("run", recording, "-o", "out", option, name)
    assert code == 2 and out == "" and len(err.splitlines()) == 1 and words in err
    assert not Path("out").exists()


def test_help_lists_what_is_registered(call, monkeypatch):
    from heliograph.odometry import ODOMETRIES

    monkeypatch.setitem(ODOMETRIES, "mine", "own_parts:Standing")
    code, out, _ = call("run", "--help-all")
    assert code == 0 and "filter, loam, mine" in out and "rosbag" in out
    code, out, _ = call("info", "--help-all")
    assert code == 0 and "rosbag" in out and "loam, mine" not in out


def test_info_shows_the_evidence(call, recording):
    code, out, _ = call("info", recording)
    assert code == 0
    for word in ("/points", "/imu/data", "tf_static", "point time unit", "ns", "200"):
        assert word in out
    code, out, _ = call("info", recording, "--json")
    report = json.loads(out)
    assert code == 0 and {s["sensor"] for s in report["streams"]} >= {"lidar", "imu"}
    assert all(item["evidence"] for item in report["inferences"])


def test_evaluate_of_a_file_against_itself_is_zero(call, recording):
    truth = recording / "groundtruth_imu.tum"
    code, out, _ = call("evaluate", truth, truth, "--delta", 1, "--json")
    assert code == 0 and json.loads(out)["absolute"]["rmse"] < 1e-9
    code, out, _ = call("evaluate", truth, recording, "--delta", 1)
    assert code == 0 and "ATE" in out and "RPE" in out


def test_evaluate_reads_kitti_files(call, tmp_path):
    poses = np.tile(np.eye(4), (30, 1, 1))
    poses[:, 0, 3] = np.arange(30)
    poses[:, 1, 3] = np.sin(np.arange(30))
    np.savetxt(tmp_path / "a.txt", poses[:, :3].reshape(30, 12))
    poses[:, 2, 3] += 0.5
    np.savetxt(tmp_path / "b.txt", poses[:, :3].reshape(30, 12))
    _, out, _ = call("evaluate", "a.txt", "b.txt", "--align", "none", "--json")
    assert json.loads(out)["absolute"]["rmse"] == pytest.approx(0.5)


@pytest.mark.parametrize("arguments", [("--align", "sim3"), ("--delta", "-1"), ("--time-offset", "later")])
def test_evaluate_wrong_options_are_one_line(call, recording, arguments):
    truth = recording / "groundtruth_imu.tum"
    code, _, err = call("evaluate", truth, truth, *arguments)
    assert code == 2 and len(err.splitlines()) == 1


def test_simulate_same_seed_same_bytes(call, tmp_path):
    scenario = Path("tiny.toml")
    from heliograph.sim.scenario import to_toml

    scenario.write_text(to_toml(find_scenario("room").thinned(beams=4, columns=32, duration=1.0)))
    for name in ("a", "b"):
        code, out, _ = call("simulate", "tiny.toml", "-o", name, "--seed", 3, "--json")
        assert code == 0 and json.loads(out)["seed"] == 3
    for name in ("recording.mcap", "groundtruth_imu.tum", "groundtruth_lidar.tum", "scenario.toml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    code, _, err = call("simulate", "tiny.toml", "-o", "a")
    assert code == 2 and len(err.splitlines()) == 1


def test_commands_are_completed():
    done = subprocess.run(
        [sys.executable, "-c", "import sys; from heliograph.cli.main import app; app(prog_name='heliograph')"],
        env={**os.environ, "_HELIOGRAPH_COMPLETE": "complete_bash", "COMP_WORDS": "heliograph lo", "COMP_CWORD": "1"},
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.stdout.split() == ["localize", "loops"]


def test_help_fits_a_small_terminal_with_an_example_in_words(call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert call("--version")[1].startswith("heliograph ")
    code, front, _ = call()
    assert code == 0 and len(front.splitlines()) <= 24
    commands = re.findall(r"^  ([a-z]+)  ", front, re.MULTILINE)
    assert len(commands) >= 18 and set(EXAMPLES) == set(commands)
    for command in commands:
        code, out, _ = call(command, "--help")
        assert code == 0 and len(out.splitlines()) <= 24, command
        assert f"\n  heliograph {command}" in out, "an example"
        code, whole, _ = call(command, "--help-all")
        assert code == 0 and len(whole) >= len(out) - 200
        assert not re.search(r"<(float|int|str|list|path)|x>=", out + whole), command
        for option in {word.split("=")[0] for line in EXAMPLES[command] for word in line.split() if word[:1] == "-"}:
            assert option in whole, f"{command}: {option}"


def test_shell_completion_is_printed():
    command = [sys.executable, "-c", "import sys; from heliograph.cli.main import main; sys.exit(main())"]
    environment = {**os.environ, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    done = subprocess.run(
        [*command, "--show-completion", "bash"], env=environment, capture_output=True, text=True, check=True
    )
    assert "complete -o default" in done.stdout


def test_defect_is_told_from_bad_input(call, recording, monkeypatch):
    def broken(*arguments, **keywords):
        raise ZeroDivisionError("one over nothing")

    monkeypatch.setattr("heliograph.pipeline.make_odometry", broken)
    code, _, err = call("run", recording, "-o", "out", "-q")
    assert code == 1 and "defect of Heliograph" in err.splitlines()[-1] and "Traceback" in err
    assert not Path("out").exists()


def test_help_imports_nothing_heavy():
    code = "import sys, heliograph.cli.main as m; m.main(['--help']); print(*sorted(sys.modules), file=sys.stderr)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr.split()
    assert not {"numpy", "rosbags", "matplotlib", "heliograph._core"} & set(loaded)


@pytest.mark.parametrize("isa", ["avx512", "sse9"])
def test_an_instruction_set_that_is_not_there_is_named(isa):
    environment = {**os.environ, "HELIOGRAPH_ISA": isa}
    command = [sys.executable, "-c", "import sys; from heliograph.cli.main import main; sys.exit(main(['--version']))"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"HELIOGRAPH_ISA is '{isa}'; there are baseline and avx2" in done.stderr


def test_default_folders_do_not_collide(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    generic = default_folder([Path("monday/recording.mcap")], "heliograph")
    assert unused(generic, again=False) == generic == Path("monday_heliograph")
    for name in ("monday_heliograph", "monday_heliograph_2"):
        Path(name).mkdir()
        assert unused(generic, again=False) == Path(name), "an empty folder is nobody's"
        Path(name, "run.json").touch()
    assert unused(generic, again=False) == Path("monday_heliograph_3")
    assert unused(generic, again=True) == Path("monday_heliograph_2"), "--resume and --overwrite mean the last"


@pytest.mark.parametrize(("kind", "file"), [("mounting", "extrinsic.toml"), ("noise", "noise.toml")])
def test_calibrations_of_two_recordings_do_not_collide(kind, file, call, monkeypatch, tmp_path):
    """Both recordings have the same name; mounting and noise share a folder, until one of them is found again."""
    folders, options = [], ["--noise"] if kind == "noise" else []
    monkeypatch.setattr(
        f"heliograph.cli.calibrate_{kind}.{kind}_command", lambda _paths, _config, folder, **_: folders.append(folder)
    )
    for day in ("monday", "tuesday", "monday"):
        assert call("calibrate", tmp_path / day / "recording.mcap", *options)[0] == 0
        folders[-1].mkdir(exist_ok=True)
        (folders[-1] / file).touch()
    assert [str(folder) for folder in folders] == ["monday_calibration", "tuesday_calibration", "monday_calibration_2"]
    other = {"extrinsic.toml": "noise.toml", "noise.toml": "extrinsic.toml"}[file]
    assert not (tmp_path / "monday_calibration" / other).exists()
