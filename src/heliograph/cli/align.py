"""`heliograph align`: the pose of one cloud in the frame of another, and how far to trust it."""

from __future__ import annotations

import json as jsonlib
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heliograph.cli import options
from heliograph.cli.activity import stage
from heliograph.guard.files import SETTINGS, plain_file

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from heliograph.registration import AlignResult

    Points = NDArray[np.float32] | NDArray[np.float64]

__all__ = ["align", "align_lines", "draw_pair"]


class Method(str, Enum):
    """Residuals."""

    gicp = "gicp"
    vgicp = "vgicp"
    plane = "point-to-plane"
    point = "point-to-point"
    edge = "point-to-edge"


def align(
    target: Annotated[Path, typer.Argument(metavar="A", help="Target: PLY, PCD, LAS, LAZ, or text with x y z a row.")],
    source: Annotated[Path, typer.Argument(metavar="B", help="Source, of any of these kinds.")],
    method: Annotated[Method, typer.Option("--method", help="Residual that is minimised.")] = Method.gicp,
    start: Annotated[
        str,
        typer.Option(
            "--start", metavar="FILE|identity|global", help="T_A_B to begin from: 4x4 or 3x4 numbers; or none."
        ),
    ] = "identity",
    voxel: Annotated[
        float, typer.Option("--voxel", metavar="M", help="Edge of the finest cubes; 0: every point.")
    ] = 0.25,
    picture: Annotated[Path | None, typer.Option("--picture", metavar="PNG", help="Both clouds from above.")] = None,
    threads: options.Threads = 1,
    json: options.Json = False,
) -> None:
    """Find T_A_B, which takes the points of B into the frame of A: pose, sigmas, overlap, and what was not observable.

    Clouds that do not overlap, and a global search without enough evidence, are answers: exit code 0 and a status.
    """
    from heliograph.config import AlignConfig
    from heliograph.io.files.cloud_points import read_points
    from heliograph.registration import align as align_clouds
    from heliograph.registration.align import checked_pose

    T_start = None if start == "identity" else start if start == "global" else checked_pose(_read_pose(Path(start)))
    stage("reading the clouds")
    points = read_points(target), read_points(source)
    _check_picture(picture)
    stage("aligning")
    result = align_clouds(
        *points, method=method.value, start=T_start, config=AlignConfig(voxel=voxel), threads=max(threads or 1, 1)
    )
    if picture is not None and result.T_target_source is not None:
        draw_pair(picture, points[0], points[1], result.T_target_source)
    typer.echo(jsonlib.dumps(_plain(result.as_dict()), allow_nan=False) if json else "\n".join(align_lines(result)))


def _read_pose(path: Path) -> NDArray[np.float64]:
    import numpy as np

    from heliograph.errors import FormatError

    try:
        words = plain_file(path, SETTINGS).read_text(encoding="utf-8", errors="replace").replace(",", " ").split()
        numbers = np.array([float(word) for word in words])
    except OSError as error:
        raise FormatError(
            path, f"cannot be read ({error.strerror}); give --start a file, 'identity' or 'global'"
        ) from error
    except ValueError as error:
        raise FormatError(path, f"is not a pose: {error}; write 16 or 12 numbers, row by row") from error
    if len(numbers) not in (12, 16):
        raise FormatError(path, f"holds {len(numbers)} numbers; a pose has 16 (4x4) or 12 (3x4), row by row")
    return (
        np.vstack([numbers.reshape(-1, 4)[:3], [0.0, 0.0, 0.0, 1.0]]) if len(numbers) == 12 else numbers.reshape(4, 4)
    )


def _check_picture(path: Path | None) -> None:
    from heliograph.errors import OutputError

    if path is not None and path.suffix.lower() != ".png":
        raise OutputError(f"cannot write {path}: a picture's suffix must be .png")


def draw_pair(path: Path, target: Points, source: Points, T: NDArray[np.float64]) -> None:
    """Draw the target in blue and the source, at its pose, in orange, from above."""
    import numpy as np

    from heliograph.atomic import atomic_path
    from heliograph.report.png import encode_png
    from heliograph.report.raster import color_image, render, top_view

    a, b = (cloud[np.isfinite(cloud).all(axis=1)].astype(np.float64) for cloud in (target, source))
    origin = np.round(np.median(a, axis=0))
    moved = b @ T[:3, :3].T + T[:3, 3] - origin
    points = np.concatenate([a - origin, moved]).astype(np.float32)
    view = top_view(points, np.zeros((1, 3)))
    label = np.concatenate([np.zeros(len(a)), np.ones(len(moved))]).astype(np.float32)
    image = color_image(render(points, view), label, ("#4aa3ff", "#ff9a3c"), (0.0, 1.0))
    with atomic_path(path) as temporary:
        temporary.write_bytes(encode_png(image))


def align_lines(result: AlignResult) -> list[str]:
    """Return a result in words, with units."""
    import numpy as np

    from heliograph.lie import so3

    lines = [f"{result.status}: {result.reason}" if result.reason else result.status]
    if result.T_target_source is not None and result.covariance is not None:
        T, sigma = result.T_target_source, np.sqrt(np.diag(result.covariance))
        lines += ["T_A_B", *("  " + " ".join(f"{x: .9f}" for x in row) for row in T)]
        angle = np.degrees(np.linalg.norm(so3.log(T[:3, :3])))
        lines.append(f"moves {np.linalg.norm(T[:3, 3]):.4f} m and turns {angle:.4f} deg")
        turn, shift = np.degrees(sigma[:3]), 1e3 * sigma[3:]
        lines.append(
            f"sigmas about and along B's axes: {turn[0]:.4f} {turn[1]:.4f} {turn[2]:.4f} deg, "
            f"{shift[0]:.2f} {shift[1]:.2f} {shift[2]:.2f} mm"
        )
    r = result.residuals
    lines.append(
        f"{result.inliers} inliers of {result.matches} matches of {result.elements} elements; overlap "
        f"{result.overlap_source:.0%} of B, {result.overlap_target:.0%} of A"
    )
    lines.append(
        f"residual rms {1e3 * r.rms:.1f} mm, median {1e3 * r.median:.1f}, "
        f"90 % {1e3 * r.p90:.1f}, 99 % {1e3 * r.p99:.1f}"
    )
    if result.observability is not None:
        o = result.observability
        lines.append(
            f"condition of rotation {o.condition_rotation:.1f}, of translation {o.condition_translation:.1f}; "
            f"least known: {o.rotation[0]}, {o.translation[0]}"
        )
    milliseconds = ", ".join(f"{name} {1e3 * value:.1f}" for name, value in result.seconds.items())
    lines.append(f"{result.iterations} iterations of {result.method}; ms: {milliseconds}")
    return lines


def _plain(value: object) -> object:
    """NaN and infinity have no place in JSON."""
    if isinstance(value, dict):
        return {key: _plain(some) for key, some in value.items()}
    if isinstance(value, list):
        return [_plain(some) for some in value]
    return None if isinstance(value, float) and not abs(value) < float("inf") else value
