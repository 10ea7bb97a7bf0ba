"""What a command is at is told when it takes its time, and neither a reader who left nor a full disk ends its work."""

import errno
import io
import json
import os
import sys

import pytest

from heliograph.cli import activity
from heliograph.cli.activity import LIVE_SECONDS, Activity, announced, hush, stage
from heliograph.cli.help import EXAMPLES
from heliograph.cli.main import main
from heliograph.cli.progress import ProgressSink
from heliograph.cli.terminal import guarded_streams, live_line
from heliograph.sim import find_scenario
from heliograph.sim.write import write_recording


class Terminal(io.StringIO):
    """A terminal that keeps what is written to it."""

    def isatty(self):
        return True


class Gone(io.StringIO):
    """A pipe whose reader has left, or a full disk."""

    def __init__(self, error):
        super().__init__()
        self.error = error

    def write(self, text):
        raise OSError(self.error, os.strerror(self.error))

    def flush(self):
        raise OSError(self.error, os.strerror(self.error))


def a_terminal(monkeypatch):
    """Put a terminal in the place of standard error, inside a test: pytest sets its own before one."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(live_line, "at_margin", True)
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    scenario = find_scenario("room").thinned(beams=16, columns=64, duration=2.5).varied(walk={"rest": 1.0})
    return write_recording(tmp_path_factory.mktemp("pipe") / "room", scenario, seed=2).folder


def test_line_is_shown_after_two_seconds_on_a_terminal_and_goes_before_other_words(monkeypatch):
    terminal = a_terminal(monkeypatch)
    monkeypatch.setenv("COLUMNS", "40")
    told = Activity("merge", 100.0)
    told.stage("comparing the runs, place", 3, 12, 100.0)
    told.tell(100.0 + 0.9 * LIVE_SECONDS)
    assert terminal.getvalue() == ""
    told.tell(103.0)
    assert terminal.getvalue() == "\r\x1b[K" + "merge: comparing the runs, place 3 of 12, 3 s, 9 s left"[:39]
    with guarded_streams():
        print("done", file=sys.stderr)
    assert terminal.getvalue().endswith("\r\x1b[Kdone\n")
    told.hush()
    told.tell(200.0)
    assert terminal.getvalue().endswith("done\n"), "a bar of its own has the word"


def test_nothing_is_drawn_below_half_a_line(monkeypatch):
    terminal = a_terminal(monkeypatch)
    with guarded_streams():
        print("half", end="", file=sys.stderr)
        Activity("run", 0.0).tell(99.0)
        assert terminal.getvalue() == "half"
        print("", file=sys.stderr)
        Activity("run", 0.0).tell(99.0)
    assert "at work, 99 s" in terminal.getvalue()
    live_line.erase()


@pytest.mark.parametrize("dumb", [True, False])
def test_elsewhere_it_is_a_line_every_few_seconds(dumb, monkeypatch):
    stream = a_terminal(monkeypatch) if dumb else io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(activity, "LINE_SECONDS", 5.0)
    told = Activity("solve", 0.0)
    told.stage("solving", 0, 0, 0.0)
    for now in range(13):
        told.tell(float(now))
    assert stream.getvalue().splitlines() == [f"solve: solving, {5 * n} s" for n in (1, 2)]


def test_quiet_commands_tell_nothing():
    with announced("x", quiet=True):
        assert activity._current == []
    with announced("x", quiet=False):
        stage("a")
        hush()
        assert activity._current[0]._hushed
        stage("b", 1, 2)
        assert "b 1 of 2" in activity._current[0].text(0.0)
    assert activity._current == []


@pytest.mark.parametrize("error", [errno.EPIPE, errno.ENOSPC])
def test_progress_without_a_reader_ends_no_work(error, monkeypatch):
    monkeypatch.setattr(sys, "stderr", Gone(error))
    monkeypatch.setattr("heliograph.cli.progress._LINE_SECONDS", -1.0)
    monkeypatch.setattr(activity, "LINE_SECONDS", 5.0)
    with guarded_streams():
        told = Activity("run", 0.0)
        told.tell(60.0)
        ProgressSink(3, "drive").add(None)
        live_line.show("x")


def test_reader_who_leaves_does_not_end_a_run(recording, tmp_path, monkeypatch):
    """As in `heliograph run ... 2>&1 | head -1`: the files are there, and the exit code is the run's."""
    monkeypatch.setattr(sys, "stdout", Gone(errno.EPIPE))
    monkeypatch.setattr(sys, "stderr", Gone(errno.EPIPE))
    monkeypatch.setattr("heliograph.report.write_report", lambda _: [])
    assert main(["run", str(recording), "-o", str(tmp_path / "out"), "--no-graph"]) == 0
    assert json.loads((tmp_path / "out" / "run.json").read_text())["interrupted"] is False
    assert main(["info", str(tmp_path / "nothing")]) == 2


def test_help_keeps_to_the_width_and_says_nothing_in_colour(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    for command in (None, *EXAMPLES):
        assert main(["--help"] if command is None else [command, "--help"]) == 0
        out = capsys.readouterr().out
        assert "\x1b" not in out
        said = [f"heliograph {example}" for example in EXAMPLES.get(command, ())]  # to be typed: not broken
        lines = [line for line in out.splitlines() if line.strip() not in said and "--help-all has" not in line]
        long = [line for line in lines if len(line) > 80]
        assert not long, (command, long)


def test_tables_keep_to_columns_and_to_no_color(recording, monkeypatch):
    """A terminal with NO_COLOR gets no colours; a pipe is as wide as COLUMNS says, else wide enough for every row."""
    widths = {}
    for columns in ("70", ""):
        stream = io.StringIO()
        monkeypatch.setattr(sys, "stdout", stream)
        monkeypatch.setenv("COLUMNS", columns)
        assert main(["info", str(recording)]) == 0
        widths[columns] = max(map(len, stream.getvalue().splitlines()))
    assert widths["70"] <= 70 < widths[""]
    shown = Terminal()
    monkeypatch.setattr(sys, "stdout", shown)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("NO_COLOR", "1")
    assert main(["info", str(recording)]) == 0
    assert not [code for code in shown.getvalue().split("\x1b[")[1:] if code[:2] in ("31", "32", "33", "34", "38")]
