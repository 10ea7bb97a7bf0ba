"""Output: all or nothing, and errors that say what to do."""

import errno
import os
import re
import stat
from pathlib import Path

import pytest

from heliograph.atomic import (
    atomic_folder,
    atomic_path,
    check_output_directory,
    output_error,
    remove_partials,
    write_text,
)
from heliograph.errors import OutputError


def _write_half_then_raise(path, error):
    with atomic_path(path) as temporary:
        temporary.write_text("half")
        raise error


def test_atomic_path_replaces_only_on_success(tmp_path):
    path = tmp_path / "map.ply"
    path.write_text("old")
    with atomic_path(path) as temporary:
        assert temporary.suffix == ".ply"
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt()])
def test_atomic_path_leaves_the_old_file_when_interrupted(tmp_path, error):
    path = tmp_path / "map.ply"
    path.write_text("old")
    with pytest.raises(type(error)):
        _write_half_then_raise(path, error)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_path_on_a_full_disk_says_so_and_cleans_up(tmp_path):
    with pytest.raises(OutputError, match=r"map\.ply: the disk is full; free some space"):
        _write_half_then_raise(tmp_path / "map.ply", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    assert list(tmp_path.iterdir()) == []


def test_atomic_path_gives_the_mode_of_an_ordinary_file(tmp_path):
    (tmp_path / "ordinary").touch()
    write_text(tmp_path / "atomic", "x")
    assert stat.S_IMODE((tmp_path / "atomic").stat().st_mode) == stat.S_IMODE((tmp_path / "ordinary").stat().st_mode)


@pytest.mark.parametrize("path", ["missing/map.ply", "file/map.ply"])
def test_atomic_path_without_a_folder_is_an_output_error(tmp_path, path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="choose another folder with -o"), atomic_path(tmp_path / path):
        pass


@pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_output_error_names_path_and_remedy(code):
    message = str(output_error("out/map.ply", OSError(code, os.strerror(code))))
    assert "out/map.ply" in message
    assert "choose another folder with -o" in message
    assert "\n" not in message


def test_output_directory_is_made_with_its_parents(tmp_path):
    assert check_output_directory(tmp_path / "a" / "b").is_dir()
    assert check_output_directory(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert list((tmp_path / "a" / "b").iterdir()) == []


def test_output_directory_with_results_needs_overwrite(tmp_path):
    (tmp_path / "run.json").touch()
    with pytest.raises(OutputError, match=r"holds an earlier run \(1 entries\); add --overwrite"):
        check_output_directory(tmp_path)
    check_output_directory(tmp_path, overwrite=True)
    assert (tmp_path / "run.json").exists()


def test_output_directory_that_is_not_empty_needs_overwrite(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(OutputError, match=r"is not empty .* --overwrite"):
        check_output_directory(tmp_path)


def test_output_directory_cannot_be_a_file_or_below_one(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="it is a file"):
        check_output_directory(tmp_path / "file", overwrite=True)
    with pytest.raises(OutputError, match="a part of the path is a file"):
        check_output_directory(tmp_path / "file" / "out")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc on this system")
def test_output_directory_that_cannot_be_written_is_an_output_error():
    with pytest.raises(OutputError, match="choose another folder with -o"):
        check_output_directory("/proc/heliograph")
    with pytest.raises(OutputError, match="choose another folder with -o"):
        check_output_directory("/proc/self", overwrite=True)


def test_messages_name_the_file_and_not_its_temporary_sibling(tmp_path):
    def inner():
        with atomic_folder(tmp_path) as folder, atomic_path(folder / "scans.csv"):
            raise OSError(errno.ENOSPC, "full")

    with pytest.raises(OutputError, match=re.escape(f"cannot write {tmp_path / 'scans.csv'}: the disk is full")):
        inner()


def test_what_a_killed_process_left_of_files_goes_and_nothing_else(tmp_path):
    with atomic_path(tmp_path / "a.b.csv") as temporary, atomic_folder(tmp_path) as folder:
        kept = {tmp_path / ".partial", tmp_path / ".mine.partial", tmp_path / "x.12345678.partial.csv"}
        for path in kept:
            path.touch()
        remove_partials(tmp_path)
        assert not temporary.exists() and not folder.exists()
        temporary.touch()
        folder.mkdir()
    assert {tmp_path / "a.b.csv", *kept} == set(tmp_path.iterdir())
