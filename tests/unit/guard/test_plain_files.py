"""Pipes, devices and holes in place of files: refused before they are opened, wherever something is read."""

import ast
import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from heliograph.cli.main import main
from heliograph.config_toml import load_config
from heliograph.errors import HeliographError
from heliograph.graph.files.archive import load_graph
from heliograph.graph.files.g2o import read_pose_graph
from heliograph.guard.account import read_account
from heliograph.guard.files import SETTINGS, TABLE, plain_file
from heliograph.io import open_recording
from heliograph.io.files.cloud_points import read_points
from heliograph.io.files.extrinsic import read_extrinsic
from heliograph.io.files.fixes import read_fixes
from heliograph.io.files.tum import read_tum
from heliograph.output.submaps import read_voxel
from heliograph.slam.loops.ledger_file import read_ledger
from heliograph.slam.store import KeyframeStore

SOURCE = Path(__file__).parents[3] / "src" / "heliograph"

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes by name on Windows")


def pipe(path):
    os.mkfifo(path)


def device(path):
    path.symlink_to("/dev/zero")


def link_to_itself(path):
    path.symlink_to(path.name)


def hole(path):
    with path.open("wb") as file:
        file.truncate(2 * TABLE)


def loaders():
    clouds = [(read_points, f"cloud{suffix}") for suffix in (".ply", ".pcd", ".xyz", ".laz")]
    recordings = [(open_recording, f"drive{suffix}") for suffix in (".mcap", ".bag", ".db3", ".pcap", ".csv")]
    return [
        *clouds, *recordings, (load_config, "config.toml"), (read_extrinsic, "extrinsic.toml"),
        (read_extrinsic, "params.yaml"), (read_fixes, "fixes.csv"), (read_tum, "poses.tum"),
        (read_pose_graph, "graph.g2o"), (load_graph, "graph.npz"), (read_ledger, "loops.csv"),
        (read_voxel, "submaps.bin"), (lambda path: read_account(path.parent), "run.json"),
        (lambda path: KeyframeStore.open(path.parent), "journal.jsonl"),
    ]  # fmt: skip


@pytest.mark.parametrize("spoil", [pipe, device, link_to_itself, hole])
def test_no_reader_waits_for_a_pipe_or_fills_the_memory_from_a_device(spoil, tmp_path):
    for number, (read, name) in enumerate(loaders()):
        folder = tmp_path / str(number)
        folder.mkdir()
        spoil(folder / name)
        with pytest.raises(HeliographError) as caught:
            read(folder / name)
        assert "\n" not in str(caught.value), name


def test_folder_with_a_pipe_is_told_in_one_line(tmp_path, capsys):
    clouds = tmp_path / "clouds"
    clouds.mkdir()
    os.mkfifo(clouds / "0.ply")
    assert main(["info", str(clouds)]) == 2
    assert main(["loops", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 2


def test_what_is_said_names_the_kind(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    hole(tmp_path / "hole")
    for name, said in (("fifo", "it is a pipe, not a file"), ("hole", "and 64 MB are read at most")):
        with pytest.raises(OSError, match=said):
            plain_file(tmp_path / name, SETTINGS)
    assert plain_file(tmp_path / "hole") == tmp_path / "hole"


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="no /dev/fd")
def test_what_a_shell_pipes_in_is_read():
    program = "import sys; from heliograph.guard.files import plain_file; print(plain_file('/dev/stdin').read_text())"
    done = subprocess.run([sys.executable, "-c", program], input="piped", capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "piped"
    read, write = os.pipe()
    threading.Thread(target=lambda: (os.write(write, b"text"), os.close(write))).start()
    assert plain_file(f"/dev/fd/{read}").read_bytes() == b"text"
    os.close(read)


OPENERS = {"open", "read_text", "read_bytes", "fromfile", "loadtxt"}
# Not by a path of the user's, behind `plain_file` already, or written by this process.
SPARED = {
    ("cli/lab.py", "webbrowser.open"),
    ("cli/resume.py", "checkpoints.open"),
    ("io/bags/bag1.py", "reader.open"),
    ("io/bags/rosbag.py", "target.open"),
    ("io/bags/unpack.py", "zstd.open"),
    ("io/files/cloud_points.py", "laspy.open"),
    ("io/files/pcd.py", "np.fromfile"),
    ("io/files/cloud_stream.py", "self._laspy.open"),
    ("io/files/las.py", "laspy.open"),
    ("io/files/ply.py", "np.fromfile"),
    ("survey/las.py", "laspy.open"),
}


def test_every_reader_asks_first():
    """What is opened to be read is a `plain_file`, a file of the package, or spared by name."""
    found = [line for path in sorted(SOURCE.rglob("*.py")) for line in unguarded(path)]
    assert not found


def unguarded(path):
    text = path.read_text(encoding="utf-8")
    if not re.search(rf"\b({'|'.join(OPENERS)})\(", text):
        return  # parsing all of them takes seconds
    for call in ast.walk(ast.parse(text)):
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Attribute | ast.Name):
            continue
        if (call.func.attr if isinstance(call.func, ast.Attribute) else call.func.id) not in OPENERS:
            continue
        name, words = ast.unparse(call.func), [a.value for a in call.args if isinstance(a, ast.Constant)]
        if any(isinstance(word, str) and set(word) & set("wax+") and len(word) < 4 for word in words):
            continue
        whole, spared = ast.unparse(call), {n for place, n in SPARED if path == SOURCE / place}
        if "plain_file(" in whole or name.startswith(("os.", "files(")) or name in spared:
            continue
        if not name.startswith(("KeyframeStore.", "cls.", "self._open", "ReadingWorker.")):
            yield f"{path.relative_to(SOURCE)}:{call.lineno}: {whole}"
