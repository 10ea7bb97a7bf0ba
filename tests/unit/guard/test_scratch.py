"""Temporary folders of processes that were killed."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from heliograph.guard.scratch import ScratchFolder

pytest.importorskip("fcntl", reason="no locks of this kind on Windows")
HOLDER = (
    "import sys; from heliograph.guard.scratch import ScratchFolder; folder = ScratchFolder();"
    "(folder.path / 'copy').write_bytes(b'a recording'); print(folder.path, flush=True); sys.stdin.read()"
)


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_next_process_removes_what_a_killed_one_left_and_no_other(temporary):
    environment = {**os.environ, "TMPDIR": str(temporary)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", HOLDER], env=environment, **pipes) as holder:
        theirs = holder.stdout.readline().strip()
        strange = temporary / "heliograph-of somebody"
        strange.mkdir()
        first = ScratchFolder()
        assert {path.name for path in temporary.iterdir()} == {Path(theirs).name, strange.name, first.path.name}
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        second = ScratchFolder()
        assert {path.name for path in temporary.iterdir()} == {strange.name, first.path.name, second.path.name}
    for folder in (first, second, second):
        folder.close()
    assert list(temporary.iterdir()) == [strange]
