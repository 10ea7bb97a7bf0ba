"""A folder that one run writes at a time."""

import os
import signal

import pytest

from heliograph.atomic import LOCK
from heliograph.errors import OutputError
from heliograph.output.lock import FolderLock

fcntl = pytest.importorskip("fcntl", reason="no locks of this kind on Windows")


def test_second_run_is_told_who_holds_the_folder_and_gets_it_once_released(tmp_path):
    lock = FolderLock(tmp_path)
    with pytest.raises(OutputError, match=rf"another run \(process {os.getpid()}\) is writing into .*-o"):
        FolderLock(tmp_path)
    lock.release()
    lock.release()
    assert not (tmp_path / LOCK).exists()
    FolderLock(tmp_path).release()


def test_killed_run_leaves_the_folder_free(tmp_path):
    ready, told = os.pipe()
    child = os.fork()
    if child == 0:
        FolderLock(tmp_path)
        os.write(told, b"x")
        signal.pause()
    assert os.read(ready, 1) == b"x"
    with pytest.raises(OutputError, match=f"process {child}"):
        FolderLock(tmp_path)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(ready)
    os.close(told)
    FolderLock(tmp_path).release()


def test_lock_that_was_removed_while_it_was_waited_for_is_no_lock(tmp_path, monkeypatch):
    """A holder removes the file and frees it; who opened it before that would hold what nobody else sees."""
    first, flock, times = FolderLock(tmp_path), fcntl.flock, []

    def slow(file, how):
        times.append(file)
        if len(times) == 1:
            first.release()
        flock(file, how)

    monkeypatch.setattr(fcntl, "flock", slow)
    second = FolderLock(tmp_path)
    assert len(times) == 2 and (tmp_path / LOCK).exists()
    with pytest.raises(OutputError):
        FolderLock(tmp_path)
    second.release()
