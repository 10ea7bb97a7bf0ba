"""What reaches the terminal: words only. Names out of files may hold anything, and a terminal obeys some of it."""

from __future__ import annotations

import io
import os
import re
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

from heliograph.atomic import output_error

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

__all__ = ["MAX_LINE", "LiveLine", "console", "guarded_streams", "is_live", "live_line", "plain", "raw"]

MAX_LINE = 2_000
"""Characters of one line that is printed; JSON is not cut."""
# Controls (ESC among them, and those of eight bits), marks that turn the direction of writing, and line separators that
# are none; a line break, a tab and a return to its beginning are ours.
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff]")


def plain(text: str) -> str:
    r"""Return a text with what a terminal would obey written out: ESC as ``\x1b``."""
    return _CONTROL.sub(lambda found: _written_out(found.group()), text)


def _written_out(character: str) -> str:
    return f"\\x{ord(character):02x}" if ord(character) < 256 else f"\\u{ord(character):04x}"


def _cut(line: str) -> str:
    if len(line) <= MAX_LINE or line.lstrip()[:1] in ("{", "["):
        return line
    end = line[len(line.rstrip("\r\n")) :]
    return f"{line[: MAX_LINE - 40]} ... ({len(line) - MAX_LINE + 40} characters more){end}"


def is_live(stream: TextIO) -> bool:
    """Return whether a stream is a terminal that can draw over its own line."""
    return stream.isatty() and os.environ.get("TERM") not in ("dumb", "unknown")


class LiveLine:
    """A line at the bottom of the terminal that is drawn over, and gone before anything else is written."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._drawn = ""
        self.at_margin = True
        """Whether the last thing written was a whole line; below half a line nothing is drawn."""

    def show(self, text: str) -> None:
        """Draw a text in place of the last one, cut to the width of the terminal (``COLUMNS`` where that is set)."""
        width = max(shutil.get_terminal_size().columns - 1, 10)
        with self._lock:
            line = plain(text).replace("\n", " ")[:width]
            if self.at_margin and line != self._drawn:
                self._draw(line)
                self._drawn = line

    def erase(self) -> None:
        """Leave the line empty."""
        with self._lock:
            if self._drawn:
                self._draw("")
                self._drawn = ""

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Keep the line away while something else is written."""
        with self._lock:
            self.erase()
            yield

    def _draw(self, text: str) -> None:
        try:
            stream = raw(sys.stderr)
            stream.write(f"\r\x1b[K{text}")
            stream.flush()
        except (OSError, ValueError):  # the terminal is gone: what is being done goes on
            return


live_line = LiveLine()


class _Words(io.TextIOBase):
    """A stream that passes on words only, and tells of a full disk as of any other output.

    A reader who has left, as in ``heliograph info ... | head``, ends no work: what is written then goes nowhere.
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        self.stream, self._name = stream, name

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self.stream.encoding or "utf-8"

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        return self.stream.errors

    @property
    def buffer(self) -> object:
        return self.stream.buffer

    def write(self, text: str) -> int:
        if text == "":  # a probe of what kind of stream this is
            return 0
        words = "".join(_cut(line) for line in plain(text).splitlines(keepends=True))
        written = words.encode(self.encoding, "backslashreplace").decode(self.encoding)
        with live_line.aside():
            self._do(lambda: self.stream.write(written))
            if self.stream.isatty():
                live_line.at_margin = text.endswith("\n")
        return len(text)

    def flush(self) -> None:
        self._do(self.stream.flush)

    def _do(self, action: object) -> None:
        try:
            action()  # type: ignore[operator]
        except BrokenPipeError:
            _give_up(self.stream)
        except OSError as error:
            _give_up(self.stream)
            raise output_error(self._name, error) from error

    def fileno(self) -> int:
        return self.stream.fileno()

    def isatty(self) -> bool:
        return self.stream.isatty()

    def writable(self) -> bool:
        return True


def _give_up(stream: TextIO) -> None:
    """Let what is left in a stream's buffer go nowhere: Python would try once more when it ends, and complain."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError, io.UnsupportedOperation):
        return


def raw(stream: TextIO) -> TextIO:
    """Return the stream behind a guarded one, for a bar that moves the cursor; what it says of files is for `plain`."""
    return stream.stream if isinstance(stream, _Words) else stream


def console() -> Console:
    """Return a console for tables on standard output; whatever they hold is words.

    Where the output goes to a file or a pipe, rows are not folded at the width of a terminal that is not there, but at
    that of ``COLUMNS`` where it is set. ``NO_COLOR`` is honoured.
    """
    from rich.console import Console

    class _WordsConsole(Console):
        def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401
            return super().render_str(plain(text), **options)

        def print(self, *objects: Any, **options: Any) -> None:  # noqa: ANN401
            with live_line.aside():
                super().print(*objects, **options)

    terminal = sys.stdout.isatty()
    file = raw(sys.stdout) if terminal else sys.stdout
    width = None if terminal or os.environ.get("COLUMNS", "").isdecimal() else 200
    return _WordsConsole(file=file, highlight=False, width=width, soft_wrap=False)


@contextmanager
def guarded_streams() -> Iterator[None]:
    """Pass words only to standard output and error inside the block."""
    out, err = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Words(out, "standard output"), _Words(err, "standard error")
    try:
        yield
    finally:
        sys.stdout, sys.stderr = out, err
