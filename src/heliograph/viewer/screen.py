"""Rerun behind a door of our own: where it shows things, and the few shapes that a run is made of."""

from __future__ import annotations

import errno
import os
import shutil
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from heliograph.atomic import output_error
from heliograph.errors import MissingDependencyError, OutputError
from heliograph.lie import so3

__all__ = ["FAR", "HEIGHT", "PORT", "RESIDUAL", "TIME", "Screen", "check_display", "colored", "free_port"]

TIME = "time"
"""Name of the time line: the recording's own clock."""
Scale: TypeAlias = tuple[tuple[int, int, int], ...]
HEIGHT: Scale = ((47, 95, 179), (43, 147, 184), (53, 181, 151), (134, 207, 106), (227, 216, 90), (232, 86, 63))
"""Colours from low to high, ordered in lightness up to the last."""
RESIDUAL: Scale = ((49, 120, 198), (70, 176, 123), (245, 184, 61), (229, 72, 77))
"""Colours from none to large."""
FAR = 0.10
"""Residual at which that scale ends [m]."""
PORT = 9876
"""First port that a window listens on."""
_PORTS_TRIED, _PATIENCE = 20, 20.0  # [s]
_LITTLE = 1 << 20  # bytes: Rerun's own thread, which writes the file, says no more than that it failed
_EXTRA = "the viewer needs rerun-sdk; install it with `pip install 'heliograph[view]'`"


def colored(values: NDArray[Any], low: float, high: float, colors: Scale) -> NDArray[np.uint8]:
    """Return (N, 3) colours of a scale that runs from ``low`` to ``high``; what is not finite is grey."""
    share = np.asarray(values, dtype=np.float64) - low
    at = np.clip(share / max(high - low, 1e-9), 0.0, 1.0) * (len(colors) - 1)
    table, known = np.array(colors, dtype=np.float64), np.isfinite(share)
    mixed = [np.interp(np.where(known, at, 0.0), np.arange(len(table)), channel) for channel in table.T]
    return np.where(known[:, None], np.stack(mixed, axis=1), 128.0).astype(np.uint8)


class Screen:
    """One recording of Rerun: in its viewer, in a file, or both.

    Parameters
    ----------
    name : str
        What the viewer calls it.
    file : Path, optional
        A ``.rrd`` to write; shared, it opens with `rerun FILE`.
    window : bool
        Open the viewer, on the first port that is free from 9876 on.

    Raises
    ------
    MissingDependencyError
        Without the extra ``view``.
    OutputError
        The file cannot be written, there is no display, or no viewer starts.
    """

    def __init__(self, name: str, *, file: Path | None = None, window: bool = False) -> None:
        os.environ.setdefault("RUST_LOG", "off")  # what goes wrong comes back as an exception, and is told in our words
        try:
            import rerun
        except ImportError:
            raise MissingDependencyError(_EXTRA) from None
        self.port: int | None = None
        self._file = file
        self._rr: Any = rerun
        self._stream = rerun.RecordingStream("heliograph", send_properties=False)
        sinks: list[Any] = []
        try:
            if file is not None:
                if file.is_dir():
                    raise OutputError(f"{file} is a folder; name a file, such as run.rrd")
                with file.open("wb"):
                    pass  # Rerun writes in a thread of its own, where a path that cannot be written goes unheard
                sinks.append(rerun.FileSink(str(file)))
            if window:
                check_display()
                self.port = free_port()
                with _streams_kept():
                    rerun.spawn(
                        port=self.port, connect=False, recording=self._stream, executable_path=_viewer_program()
                    )
                sinks.append(rerun.GrpcSink(f"rerun+http://127.0.0.1:{self.port}/proxy"))
        except (OSError, RuntimeError) as error:
            raise OutputError(f"the viewer does not open ({error}); write a file with --rrd FILE instead") from error
        self._stream.set_sinks(*sinks)
        self._stream.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._stream.send_recording_name(name)

    def at(self, stamp_ns: int) -> None:
        """Set the time of what is logged next, on the recording's clock [ns]."""
        self._stream.set_time(TIME, timestamp=np.datetime64(int(stamp_ns), "ns"))

    def points(
        self,
        place: str,
        points: NDArray[np.floating],
        *,
        colors: object = None,
        static: bool = False,
        size: float = 1.5,
    ) -> None:
        """Show points (N, 3) [m] with their colours, ``size`` wide in the window."""
        radii = self._rr.Radius.ui_points(size)
        self._stream.log(place, self._rr.Points3D(points, colors=colors, radii=radii), static=static)

    def pose(self, place: str, T: NDArray[np.float64]) -> None:
        """Put what lies below a place at a pose (4, 4)."""
        self._stream.log(place, self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))

    def lines(
        self, place: str, strips: Sequence[NDArray[np.floating]], color: tuple[int, int, int], *, static: bool = False,
        labels: Sequence[str] | None = None,
    ) -> None:  # fmt: skip
        """Show lines, each (N, 3) [m]."""
        radii = self._rr.Radius.ui_points(1.2)
        shape = self._rr.LineStrips3D(strips, colors=[color] * len(strips), radii=radii, labels=labels)
        self._stream.log(place, shape, static=static)

    def ellipsoid(
        self, place: str, centre: NDArray[np.float64], covariance: NDArray[np.float64], sigmas: float
    ) -> None:
        """Show a covariance (3, 3) about a centre [m^2], its half axes in one-sigmas."""
        variances, axes = np.linalg.eigh(covariance)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        turn = so3.log(axes)
        angle = float(np.linalg.norm(turn))
        self._stream.log(
            place,
            self._rr.Ellipsoids3D(
                centers=[centre],
                half_sizes=[sigmas * np.sqrt(np.maximum(variances, 0.0))],
                rotation_axis_angles=[
                    self._rr.RotationAxisAngle(turn / angle if angle > 0.0 else [1.0, 0.0, 0.0], radians=angle)
                ],
                colors=[(245, 184, 61)],
            ),
        )

    def curves(
        self, place: str, stamps_ns: NDArray[np.int64], values: NDArray[np.float64], names: Sequence[str]
    ) -> None:
        """Show columns (N, C) over time, each under its name."""
        self._stream.log(place, self._rr.SeriesLines(names=list(names)), static=True)
        stamps = np.asarray(stamps_ns).astype("datetime64[ns]")
        columns = self._rr.Scalars.columns(scalars=np.ascontiguousarray(values, dtype=np.float64))
        self._stream.send_columns(place, indexes=[self._rr.TimeColumn(TIME, timestamp=stamps)], columns=columns)

    def values(self, place: str, values: Iterable[float]) -> None:
        """Add one row to curves."""
        self._stream.log(place, self._rr.Scalars(list(values)))

    def network(
        self, place: str, nodes: Mapping[str, tuple[float, float] | None], edges: Sequence[tuple[str, str]],
        colors: Sequence[tuple[int, int, int]], *, directed: bool = False,
    ) -> None:  # fmt: skip
        """Show nodes, at positions in the plane where they have some, and edges between them."""
        positions = None if None in nodes.values() else list(nodes.values())
        shape = self._rr.GraphNodes(list(nodes), positions=positions, colors=list(colors), labels=list(nodes))
        kind = "directed" if directed else "undirected"
        self._stream.log(place, shape, self._rr.GraphEdges(list(edges), graph_type=kind), static=True)

    def say(self, place: str, text: str, level: str = "INFO") -> None:
        """Add a line of text at the present time."""
        self._stream.log(place, self._rr.TextLog(text, level=level))

    def document(self, place: str, text: str) -> None:
        """Show a text in Markdown."""
        self._stream.log(place, self._rr.TextDocument(text, media_type="text/markdown"), static=True)

    def close(self) -> None:
        """Hand over all that has not gone out yet.

        Raises
        ------
        OutputError
            The window was closed meanwhile, or never came up.
        """
        try:
            self._stream.flush(timeout_sec=_PATIENCE)
        except (RuntimeError, ValueError) as error:
            if self._file is not None and shutil.disk_usage(self._file.parent).free < _LITTLE:
                raise output_error(self._file, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))) from error
            raise OutputError(
                "the viewer's window is gone: not all was shown; `heliograph view RUN` shows it"
            ) from error
        finally:
            self._stream.disconnect()


def check_display() -> None:
    """Raise `OutputError` where no window can open; a viewer without a screen would end as soon as it starts."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise OutputError(
            "there is no display to open a window on (neither DISPLAY nor WAYLAND_DISPLAY is set); write a file with "
            "--rrd FILE and open it elsewhere with `rerun FILE`"
        )


def free_port(first: int = PORT) -> int:
    """Return the first port that nobody listens on.

    Raises
    ------
    OutputError
        None of twenty is free.
    """
    for port in range(first, first + _PORTS_TRIED):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as trial:
            try:
                trial.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OutputError(
        f"no port from {first} to {first + _PORTS_TRIED - 1} is free for the viewer; close one of its windows"
    )


@contextmanager
def _streams_kept() -> Iterator[None]:
    """Keep our output from a program that outlives us: a pipe behind this one would wait for its window to close."""
    kept = [os.dup(number) for number in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in (1, 2):
            os.dup2(nowhere, number)
        yield
    finally:
        for number, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, number)
            os.close(copy)
        os.close(nowhere)


def _viewer_program() -> str | None:
    """Return the program that the package brings: it need not be on the path of whoever calls ours by its full name."""
    beside = Path(sys.executable).with_name("rerun.exe" if sys.platform == "win32" else "rerun")
    return str(beside) if beside.is_file() else None
