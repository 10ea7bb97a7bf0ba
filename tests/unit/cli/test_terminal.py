"""Names out of files do not command the terminal, lines end, and a full output is told in one line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.bags import drive

from heliograph.cli.main import main
from heliograph.cli.terminal import MAX_LINE, plain

EVIL = "/po\x1b]0;owned\x07ints\x1b[31m\u202etxt\x9b2J"


def test_controls_and_marks_of_direction_are_written_out():
    assert plain("a\x1b[31mb\u202ec\n\td") == "a\\x1b[31mb\\u202ec\n\td"
    assert plain("déjà 北京 µm²") == "déjà 北京 µm²"


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_names_of_topics_do_not_reach_the_terminal_raw(options, tmp_path, capsys):
    bag = drive(5)
    bag.messages = [(EVIL if topic == "/points" else topic, *rest) for topic, *rest in bag.messages]
    assert main(["info", str(bag.mcap(tmp_path / "a.mcap")), *options]) == 0
    said = capsys.readouterr()
    assert "owned" in said.out
    assert not {"\x1b", "\x07", "\x9b", "\u202e"} & set(said.out + said.err)


def test_an_error_is_one_line_of_bounded_length(tmp_path, capsys):
    assert main(["info", str(tmp_path / ("\x1b[2J" + "a" * 180)), *["--lidar-topic", "x" * 5000]]) == 2
    said = capsys.readouterr().err
    assert "\x1b" not in said and max(map(len, said.splitlines())) <= MAX_LINE


def is_full(device):
    """Tell whether a device is what it should be: some containers have an ordinary file in its place."""
    return device.is_char_device()


@pytest.mark.skipif(not is_full(Path("/dev/full")), reason="needs /dev/full")
def test_a_full_output_is_one_line(tmp_path):
    path = drive(5).mcap(tmp_path / "a.mcap")
    code = "import sys; from heliograph.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "info", str(path), "--json"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, env={**os.environ}, check=False)
    assert done.returncode == 2
    assert (
        done.stderr.startswith("error: cannot write standard output: the disk is full") and done.stderr.count("\n") == 1
    )


def test_sensors_that_were_not_used_are_named_in_the_closing_lines():
    from heliograph.cli.closing import unused_lines

    held = {"recording": {"streams": {"gnss": {"count": 12}, "wheels": {"count": 0}, "imu": {"count": 5}}}}
    (line,) = unused_lines(held)
    assert line.startswith("gnss: 12 fixes in the recording were not used")
    assert unused_lines(held | {"graph": {"gnss": {}}}) == []
    held["recording"]["streams"]["wheels"]["count"] = 3
    assert len(unused_lines(held)) == 2
