"""`heliograph run --resume`: a run that was cut off ends with the bits of one that was not; what cannot, says so."""

import csv
import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from heliograph.checkpoint import Checkpoints
from heliograph.cli.main import main
from heliograph.sim import SCENARIOS
from heliograph.sim.scenario import Walk
from heliograph.sim.wheels import WheelModel
from heliograph.sim.write import write_recording
from heliograph.snapshots import read_snapshot

SETTINGS = (
    "--set", "output.checkpoint_interval=0.5", "--set", "slam.keyframe_distance=0.3", "--threads", "1", "-q",
    "--wheels", "/wheels/odometry",
)  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Return a folder with a recording, a run of it, and what a kill would have left at every checkpoint."""
    folder = tmp_path_factory.mktemp("resume")
    wheels = WheelModel(rate=50.0, scale=1.02)
    soon = replace(SCENARIOS["room"], walk=Walk(speed=0.8, rest=1.0, ramp=1.0), wheels=wheels)
    write_recording(folder / "data", soon.thinned(beams=16, columns=96, duration=4.5), seed=1)
    save = Checkpoints.save

    def copied(self, snapshot, stamp_ns):
        save(self, snapshot, stamp_ns)
        shutil.copytree(self.folder, folder / f"cut {len(list(folder.glob('cut *')))}")
        self._not_before = 0.0  # also where a slow machine makes them rare

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Checkpoints, "save", copied)
        assert main(run_of(folder, "whole")) == 0
    return folder


def run_of(folder, name, *more):
    return ["run", str(folder / "data" / "recording.mcap"), "-o", str(folder / name), *SETTINGS, *more]


def cuts(folder):
    return sorted(folder.glob("cut [0-9]*"), key=lambda path: int(path.name[4:]))


def untimed(path):
    with path.open(newline="") as file:
        return [{k: v for k, v in row.items() if not k.startswith("ms_")} for row in csv.DictReader(file)]


def assert_same_run(whole, again, *, resumed=True):
    names = {path.name for path in whole.iterdir()}
    assert names == {path.name for path in again.iterdir()}
    for name in names - {"scans.csv", "run.json", "report.html", "graph.npz", "keyframes", "config.toml"}:
        assert (whole / name).read_bytes() == (again / name).read_bytes(), name
    assert untimed(whole / "scans.csv") == untimed(again / "scans.csv")
    first, second = np.load(whole / "graph.npz"), np.load(again / "graph.npz")
    assert first.files == second.files and all(np.array_equal(first[n], second[n]) for n in first.files)
    told, again_told = (json.loads((run / "run.json").read_text()) for run in (whole, again))
    apart = {name for name in {*told, *again_told} if told.get(name) != again_told.get(name)}
    assert apart <= {"timings", "peak_memory_mb", "folder", "outputs", "resumed"}
    assert "resumed" not in told and ("resumed" in again_told or not resumed)


def test_run_that_was_killed_ends_with_the_same_bits(place):
    assert len(cuts(place)) >= 3
    assert '"code": "wheel-speeds"' in (place / "whole" / "run.json").read_text()
    for cut in (cuts(place)[1], cuts(place)[-1]):
        shutil.copytree(cut, place / "again")
        # What was written after the checkpoint, and torn by the kill.
        with (place / "again" / "trajectory.tum").open("ab") as file:
            file.write(b"1.0 2.0 3")
        with (place / "again" / "keyframes" / "journal.jsonl").open("ab") as file:
            file.write(b'{"index": ')
        (place / "again" / ".map.x0_9abcd.partial.png").write_bytes(b"half of it")  # and what never took its place
        (place / "again" / ".1234wxyz.partial").mkdir()
        threads = str(1 + (cut is cuts(place)[1]))  # which change no bit, and so may differ
        assert main(run_of(place, "again", "--resume", "--threads", threads)) == 0
        assert_same_run(place / "whole", place / "again")
        shutil.rmtree(place / "again")


def test_run_that_was_interrupted_goes_on_although_its_files_were_finished(place, monkeypatch):
    save, asked = Checkpoints.save, []

    def saved(self, snapshot, stamp_ns):
        save(self, snapshot, stamp_ns)
        self._not_before = 0.0
        asked.append(stamp_ns)
        if len(asked) == 3:
            signal.raise_signal(signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(Checkpoints, "save", saved)
        assert main(run_of(place, "ended")) == 128 + signal.SIGTERM
    told = json.loads((place / "ended" / "run.json").read_text())
    assert told["interrupted"] and (place / "ended" / "map.ply").is_file()
    assert main(run_of(place, "ended", "--resume")) == 0
    assert_same_run(place / "whole", place / "ended")


@pytest.mark.slow
def test_disk_that_fills_during_a_checkpoint_is_one_line_and_leaves_what_there_was(place, monkeypatch, capsys):
    """What was mapped is finished in the room that the checkpoint gives up; with room again the run begins anew."""
    name, savez, written = "full", np.savez, []

    def filling(file, **arrays):
        if not isinstance(file, io.BytesIO):  # a checkpoint, and not a keyframe on its way
            written.append(file)
            if len(written) == 3:
                file.write(b"as much as there was room for")
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        savez(file, **arrays)

    monkeypatch.setattr("heliograph.snapshots.np.savez", filling)
    monkeypatch.setattr(Checkpoints, "_not_before", property(lambda _: 0.0, lambda *_: None), raising=False)
    assert main(run_of(place, name)) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(said) == 1 and "the disk is full" in said[0]
    monkeypatch.undo()
    told = json.loads((place / name / "run.json").read_text())
    assert told["status"] == "incomplete" and "disk is full" in told["failure"] and (place / name / "map.ply").is_file()
    assert main(run_of(place, name, "--resume")) == 0
    assert "begins anew" in capsys.readouterr().err
    assert_same_run(place / "whole", place / name, resumed=False)


def test_finished_run_has_nothing_to_resume(place, capsys):
    before = (place / "whole" / "run.json").read_bytes()
    assert main(run_of(place, "whole", "--resume")) == 0
    assert "has come to its end: there is nothing to resume" in capsys.readouterr().err
    assert (place / "whole" / "run.json").read_bytes() == before
    assert not (place / "whole" / "checkpoint").exists()


def test_run_without_a_checkpoint_begins_anew_and_says_so(place, capsys):
    shutil.copytree(place / "cut 0", place / "early")
    shutil.rmtree(place / "early" / "checkpoint")
    assert main(run_of(place, "early", "--resume", "--duration", "2")) == 0
    assert "holds no checkpoint to resume from: the run begins anew" in capsys.readouterr().err
    assert "resumed" not in json.loads((place / "early" / "run.json").read_text())


def _other_setting(folder, arguments):
    return [*arguments, "--set", "map.voxel=0.3"], "another setting (map.voxel: 0.25 then, 0.3 now)"


def _other_recording(folder, arguments):
    data = (folder / "data" / "recording.mcap").read_bytes()
    (folder / "other").mkdir(exist_ok=True)
    (folder / "other" / "recording.mcap").write_bytes(data + b"\0")
    return ["run", str(folder / "other" / "recording.mcap"), *arguments[2:]], "another recording (recording.mcap: "


def _other_version(folder, arguments):
    change_identity(folder / "cut off", version="0.0.1 (baseline)")
    return arguments, "another version (0.0.1 (baseline) then"


def _spoilt(folder, arguments):
    path = folder / "cut off" / "checkpoint" / "state.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    return arguments, "is no checkpoint of a run, or damaged"


def _lost_keyframes(folder, arguments):
    for file in sorted((folder / "cut off" / "keyframes").glob("0*.npz"))[1:]:
        file.write_bytes(bytes(file.stat().st_size))
    return arguments, "holds 1 keyframes whole, the run had"


def _short_rows(folder, arguments):
    with (folder / "cut off" / "odometry.tum").open("r+b") as file:
        file.truncate(100)
    return arguments, "odometry.tum: holds 100 bytes"


def _both(folder, arguments):
    return [*arguments, "--overwrite"], "give one of them"


def change_identity(run, **changes):
    path = run / "checkpoint" / "state.npz"
    arrays = dict(np.load(path))
    about = json.loads(arrays["about"].tobytes())
    about["identity"] |= changes
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    "spoil", [_other_setting, _other_recording, _other_version, _spoilt, _lost_keyframes, _short_rows, _both]
)
def test_what_cannot_be_resumed_is_refused_in_one_line_and_nothing_is_lost(place, capsys, spoil):
    shutil.rmtree(place / "cut off", ignore_errors=True)
    shutil.copytree(cuts(place)[-1], place / "cut off")
    arguments, said = spoil(place, run_of(place, "cut off", "--resume"))
    before = contents(place / "cut off")
    assert main(arguments) == 2
    error = capsys.readouterr().err.strip()
    assert (said in error and "\n" not in error.replace("Usage", "\n")) or spoil is _both
    after = contents(place / "cut off")
    assert before.keys() <= after.keys()
    assert all(after[name] == data for name, data in before.items() if name not in ("trajectory.tum", "journal.jsonl"))


def contents(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".heliograph.lock"
    }


def test_damaged_checkpoint_runs_no_program(place, tmp_path):
    """Whatever a checkpoint says, only records of ours are made of it, by their own constructors."""
    path = tmp_path / "state.npz"
    arrays = dict(np.load(place / "cut 1" / "checkpoint" / "state.npz"))
    arrays["tree"] = np.frombuffer(json.dumps({"r": "Popen", "v": {"args": "true"}}).encode(), np.uint8)
    np.savez(path, **arrays)
    with pytest.raises(Exception, match="is no checkpoint of a run, or damaged"):
        read_snapshot(path, ())


@pytest.mark.slow
def test_run_killed_at_ten_random_moments_ends_with_the_same_bits(place):
    """One run after the other is killed, now and then before its first checkpoint or when it closes, and resumed."""
    rng = np.random.default_rng(15)
    program = "import sys; from heliograph.cli.main import main; sys.exit(main(sys.argv[1:]))"
    name, kills, of_this = "killed 0", 0, 0
    while True:
        command = [sys.executable, "-c", program, *run_of(place, name, *(["--resume"] if of_this else []))]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        if kills < 10:
            before = checkpoint_of(place / name)
            while kills % 4 and process.poll() is None and checkpoint_of(place / name) == before:
                time.sleep(0.01)
            time.sleep(rng.uniform(0.0, 1.0))
            process.send_signal(signal.SIGKILL)
        error = process.communicate()[1]
        if process.returncode == 0:  # it was quicker
            assert_same_run(place / "whole", place / name, resumed=False)
            name, of_this = f"killed {kills}", 0
            if kills >= 10:
                break
            continue
        assert process.returncode == -signal.SIGKILL, error
        kills, of_this = kills + 1, of_this + 1


def checkpoint_of(run: Path):
    try:
        return (run / "checkpoint" / "state.npz").stat().st_mtime_ns
    except OSError:
        return 0
