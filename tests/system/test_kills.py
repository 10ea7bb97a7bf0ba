"""A run with a graph and fixes, ended by twenty signals at random moments: its files are valid, and it goes on.

The recording is compressed, so that there is a copy in the temporary folder. The signals come while the run starts,
goes on, and closes, some of them twice. A fast sibling is `tests/unit/cli/test_resume.py`.
"""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from heliograph.config_toml import load_config
from heliograph.factors import SENSOR_FACTORS
from heliograph.graph.files.archive import load_graph
from heliograph.graph.files.g2o import read_pose_graph
from heliograph.guard.account import read_account
from heliograph.io.files.cloud_points import read_points
from heliograph.io.files.tum import read_tum
from heliograph.output.submaps import read_submaps
from heliograph.sim import SCENARIOS
from heliograph.sim.scenario import Walk
from heliograph.sim.write import write_recording
from heliograph.slam.loops.ledger_file import read_ledger
from heliograph.slam.store import KeyframeStore

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signals on Windows"),
]
PROGRAM = "import sys; from heliograph.cli.main import main; sys.exit(main(sys.argv[1:]))"
SETTINGS = ("--set", "output.checkpoint_interval=0.4", "--set", "slam.keyframe_distance=0.3", "--threads", "1", "-q")
KILLS = 20
TIMED = {"timings", "peak_memory_mb", "folder", "outputs", "resumed"}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kills")
    campus = SCENARIOS["campus"]
    fixes = replace(campus.gnss, rate=5.0, noise_horizontal=0.03, noise_vertical=0.05, solution="fixed")
    scenario = replace(campus, walk=Walk(speed=1.5, rest=1.0, ramp=1.0), gnss=fixes)
    write_recording(folder / "data", scenario.thinned(beams=16, columns=128, duration=6.0), seed=5)
    (folder / "data.mcap.zstd").write_bytes(zstd.compress((folder / "data" / "recording.mcap").read_bytes()))
    (folder / "tmp").mkdir()
    process = start(folder, "whole")
    assert (process.communicate()[1], process.returncode) == ("", 0)
    assert not list((folder / "tmp").iterdir())
    assert json.loads((folder / "whole" / "run.json").read_text())["graph"]["gnss"]["aligned"]
    return folder


def start(folder, name, *more):
    command = ["run", str(folder / "data.mcap.zstd"), "-o", str(folder / name), *SETTINGS, *more]
    environment = {**os.environ, "TMPDIR": str(folder / "tmp"), "OPENBLAS_NUM_THREADS": "1"}
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", PROGRAM, *command], stderr=pipe, text=True, env=environment)


def await_moment(run, process, rng, moment):
    """Wait for a moment of a run: as it starts, as it goes on, or as it writes what comes at the end."""

    def wait(found):
        while process.poll() is None and not found():
            time.sleep(0.003)

    if moment == "starts":
        time.sleep(rng.uniform(0.1, 3.0))
        return
    state = run / "checkpoint" / "state.npz"
    wait(state.exists)
    if moment == "goes on":
        for _ in range(rng.integers(0, 4)):
            before = state.stat().st_mtime_ns if state.exists() else 0
            wait(lambda before=before: not state.exists() or state.stat().st_mtime_ns != before)
        time.sleep(rng.uniform(0.0, 0.2))
    else:
        ends = ("graph.g2o", ".graph*", ".map*", "map.*", ".report*", ".trajectory*")
        wait(lambda: any(chain.from_iterable(run.glob(name) for name in ends)))
        time.sleep(rng.uniform(0.0, 0.6))


def check_files(run):
    """Open every file of a run's folder with its own reader; return how many there were."""
    count = 0
    for path in sorted(p for p in run.rglob("*") if p.is_file() and p.parent.name not in ("keyframes", "checkpoint")):
        count += 1
        if path.name.startswith("."):
            continue  # the lock, and what never took its place
        if path.suffix == ".tum":
            read_tum(path)
        elif path.name == "loops.csv":
            read_ledger(path)
        elif path.suffix == ".csv":
            with path.open(newline="") as file:
                assert len({len(row) for row in csv.reader(file, strict=True)}) <= 1, path.name
        elif path.suffix == ".html":
            assert path.read_text().rstrip().endswith("</html>")
        elif path.suffix == ".png":
            assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
        elif path.suffix == ".pgw":
            assert len(path.read_text().split()) == 6
        else:
            READERS[path.name](path)
    if (run / "keyframes" / "journal.jsonl").exists():
        store = KeyframeStore.open(run / "keyframes")
        count += sum(keyframe.index >= 0 for keyframe in store)
        store.close()
    return count


READERS = {
    "run.json": lambda path: read_account(path.parent),
    "config.toml": load_config,
    "graph.g2o": read_pose_graph,
    "graph.npz": lambda path: load_graph(path, factors=SENSOR_FACTORS),
    "map.ply": read_points,
    "submaps.bin": lambda path: list(read_submaps(path)),
}


def assert_same_run(whole, again):
    names = {path.name for path in whole.iterdir()}
    assert names == {path.name for path in again.iterdir()}
    for name in names - {"scans.csv", "run.json", "report.html", "graph.npz", "keyframes", "config.toml"}:
        assert (whole / name).read_bytes() == (again / name).read_bytes(), name
    untimed = []
    for run in (whole, again):
        with (run / "scans.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        untimed.append([{k: v for k, v in row.items() if not k.startswith("ms_")} for row in rows])
    assert untimed[0] == untimed[1]
    first, second = np.load(whole / "graph.npz"), np.load(again / "graph.npz")
    assert first.files == second.files and all(np.array_equal(first[n], second[n]) for n in first.files)
    told, again_told = (json.loads((run / "run.json").read_text()) for run in (whole, again))
    assert {name for name in {*told, *again_told} if told.get(name) != again_told.get(name)} <= TIMED


def test_twenty_signals_at_random_moments_leave_valid_files_and_runs_that_end_the_same(place):
    rng, done, files, seen = np.random.default_rng(1717), 0, 0, []
    for trial in range(4 * KILLS):
        if done == KILLS:
            break
        number = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGKILL)[done % 4]
        moment = ("starts", "goes on", "closes", "closes", "goes on")[trial % 5]
        name = f"run {trial}"
        process = start(place, name)
        await_moment(place / name, process, rng, moment)
        if process.poll() is None:
            process.send_signal(number)
        if trial % 3 == 0:  # impatient
            time.sleep(rng.uniform(0.02, 0.4))
            process.send_signal(number)
        said = process.communicate()[1]
        if process.returncode == 0 and moment != "closes":
            continue  # it was quicker
        done += 1
        assert "Traceback" not in said and sum(line.startswith("error:") for line in said.splitlines()) <= 1, said
        signals = (-number, 128 + number)  # the first where it came before there was Python to hear it
        assert process.returncode in (*signals, 0), (number, process.returncode, said)
        left = [path.name for path in (place / "tmp").iterdir()]
        assert not left or number == signal.SIGKILL or process.returncode == -number
        files += check_files(place / name) if (place / name).exists() else 0
        resumed = start(place, name, "--resume")
        said = resumed.communicate()[1]
        assert resumed.returncode == 0, said
        assert not list((place / "tmp").iterdir()), "the next run removes what a killed one left"
        assert_same_run(place / "whole", place / name)
        seen.append(f"{number.name} as it {moment}: {process.returncode}")
        print(seen[-1], flush=True)
    assert done == KILLS and files > 200, seen
