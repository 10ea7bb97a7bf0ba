"""Row files and tables: whole rows whatever interrupts the writing."""

import errno
import io

import pytest

from heliograph.errors import OutputError
from heliograph.io.files.csvs import CsvWriter
from heliograph.io.files.rows import RowFile


class FillingDisk(io.FileIO):
    """A file on a disk with room for ``room`` bytes, that writes at most 7 bytes a call as the kernel may."""

    room = 0
    failure: BaseException = OSError(errno.ENOSPC, "No space left on device")

    def write(self, data):
        if self.tell() >= self.room:
            raise self.failure
        return super().write(bytes(data)[: min(7, self.room - self.tell())])


@pytest.fixture
def filling_disk(monkeypatch):
    monkeypatch.setattr("heliograph.io.files.rows.io.FileIO", FillingDisk)
    return FillingDisk


@pytest.mark.parametrize("room", [0, 3, 9, 10, 11, 25])
def test_row_file_on_a_full_disk_holds_only_whole_rows(tmp_path, filling_disk, monkeypatch, room):
    monkeypatch.setattr(filling_disk, "room", room)
    file = RowFile(tmp_path / "a.txt")
    file.write("row one x\nrow two x\n")
    file.write("row three\n")
    with pytest.raises(OutputError, match=r"a\.txt: the disk is full; free some space"):
        file.flush()
    assert (tmp_path / "a.txt").read_text() == "row one x\nrow two x\nrow three\n"[: room // 10 * 10]
    monkeypatch.setattr(filling_disk, "room", 1000)
    file.write("more rows\n")
    file.close()
    assert (tmp_path / "a.txt").read_text().endswith("more rows\n")


def test_row_file_interrupted_holds_only_whole_rows(tmp_path, filling_disk, monkeypatch):
    monkeypatch.setattr(filling_disk, "room", 14)
    monkeypatch.setattr(filling_disk, "failure", KeyboardInterrupt())
    file = RowFile(tmp_path / "a.txt")
    file.write("row one x\nrow two x\n")
    with pytest.raises(KeyboardInterrupt):
        file.flush()
    assert (tmp_path / "a.txt").read_text() == "row one x\n"
    monkeypatch.setattr(filling_disk, "room", 1000)
    file.close()
    assert (tmp_path / "a.txt").read_text() == "row one x\nrow two x\n"


def test_row_file_writes_by_itself_once_enough_rows_wait(tmp_path):
    file = RowFile(tmp_path / "a.txt")
    file.write("x" * 100 + "\n")
    assert (tmp_path / "a.txt").stat().st_size == 0
    file.write(("y" * 99 + "\n") * 700)
    assert (tmp_path / "a.txt").stat().st_size == 101 + 70_000
    file.close()


def test_row_file_refuses_half_a_row(tmp_path):
    with RowFile(tmp_path / "a.txt") as file, pytest.raises(ValueError, match="newline"):
        file.write("half")


def test_csv_writer_writes_header_then_rows(tmp_path):
    with CsvWriter(tmp_path / "a.csv", ["stamp_ns", "rms", "ok", "note"]) as table:
        assert (tmp_path / "a.csv").read_text() == "stamp_ns,rms,ok,note\n"
        table.append([1_700_000_000_123_456_789, 0.1, True, "a, b"])
        table.append({"note": "x", "rms": float("nan")})
        table.append((2, 1e-17, False, None))
        table.flush()
        assert (tmp_path / "a.csv").read_text().splitlines()[1:] == [
            '1700000000123456789,0.1,1,"a, b"',
            ",,,x",
            "2,1e-17,0,",
        ]


def test_csv_writer_refuses_wrong_columns(tmp_path):
    with pytest.raises(ValueError, match="unique"):
        CsvWriter(tmp_path / "a.csv", ["a", "a"])
    with CsvWriter(tmp_path / "a.csv", ["a", "b"]) as table:
        with pytest.raises(ValueError, match="3 values for 2 columns"):
            table.append([1, 2, 3])
        with pytest.raises(ValueError, match="unknown columns"):
            table.append({"c": 1})
