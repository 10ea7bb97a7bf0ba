"""E57 (ASTM E2807) with a station a keyframe: its cloud in its own axes, and its pose in the coordinate system."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from heliograph.arrays import Array
from heliograph.atomic import atomic_path
from heliograph.data import Keyframe
from heliograph.errors import MissingDependencyError
from heliograph.lie import so3
from heliograph.survey.coordinates import CoordinateSystem

__all__ = ["station_poses", "write_survey_e57"]

_INSTALL = "pip install 'heliograph[e57]'"
_STEP = 1.0  # over which the system's axes are looked at [m]


def station_poses(T_enu_imu: Array, system: CoordinateSystem) -> Array:
    """Return poses (K, 4, 4) in a coordinate system of poses in east-north-up.

    A projection turns and stretches; a station is rigid and takes the turn alone. What is left is the scale of the
    projection over the reach of one scan: 4 mm in 10 m at the 0.9996 of UTM.
    """
    p = T_enu_imu[:, :3, 3]
    origin = system.from_enu(p)
    axes = [system.from_enu(p + _STEP * axis) - origin for axis in np.eye(3)]
    U, _, Vt = np.linalg.svd(np.stack(axes, axis=-1))
    T = np.tile(np.eye(4), (len(p), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = U @ Vt @ T_enu_imu[:, :3, :3], origin
    return T


def write_survey_e57(path: Path, keyframes: Iterable[Keyframe], T_system_imu: Array, system: CoordinateSystem) -> None:
    """Write keyframes' clouds, points in the imu frame, each with its pose.

    Parameters
    ----------
    path : Path
    keyframes : iterable of Keyframe
        Those without a point are left out: E57 has no bounds for them.
    T_system_imu : (K, 4, 4) float64
        As `station_poses` gives them.
    system : CoordinateSystem
        Its WKT is the file's ``coordinateMetadata``.

    Raises
    ------
    MissingDependencyError
        pye57 is not installed.
    """
    pye57 = _pye57(path)

    wkt = "" if system.crs is None else system.crs.to_wkt()

    class Georeferenced(pye57.E57):  # type: ignore[misc, name-defined]
        """Its own header has no coordinate system, and an element cannot be set twice."""

        def write_default_header(self) -> None:
            _write_head(self.image_file, pye57.libe57, wkt)

    with atomic_path(path) as temporary:
        file = Georeferenced(str(temporary), mode="w")
        try:
            for keyframe, T in zip(keyframes, T_system_imu, strict=True):
                if len(keyframe.points_imu):
                    _write_station(file, keyframe, T)
        finally:
            file.close()


def _write_head(image: Any, libe57: Any, wkt: str) -> None:  # noqa: ANN401 - libE57Format's own
    """Write the root element's children, E2807 table 9; a creation time of 0 keeps equal files equal but for guids."""
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    root = image.root()
    texts = {
        "formatName": "ASTM E57 3D Imaging Data File",
        "guid": f"{{{uuid.uuid4()}}}",
        "e57LibraryVersion": libe57.E57_LIBRARY_ID,
        "coordinateMetadata": wkt,
    }
    for name, text in texts.items():
        root.set(name, libe57.StringNode(image, text))
    root.set("versionMajor", libe57.IntegerNode(image, libe57.E57_FORMAT_MAJOR))
    root.set("versionMinor", libe57.IntegerNode(image, libe57.E57_FORMAT_MINOR))
    created = libe57.StructureNode(image)
    created.set("dateTimeValue", libe57.FloatNode(image, 0.0))
    created.set("isAtomicClockReferenced", libe57.IntegerNode(image, 0))
    root.set("creationDateTime", created)
    root.set("data3D", libe57.VectorNode(image, True))
    root.set("images2D", libe57.VectorNode(image, True))


def _write_station(file: Any, keyframe: Keyframe, T: Array) -> None:  # noqa: ANN401 - pye57's own
    points = keyframe.points_imu.astype(np.float64)
    data = {f"cartesian{axis}": np.ascontiguousarray(points[:, k]) for k, axis in enumerate("XYZ")}
    if keyframe.intensity is not None:
        data["intensity"] = keyframe.intensity.astype(np.float64)
    x, y, z, w = so3.to_quaternion(T[None, :3, :3])[0].tolist()
    low, high = points.min(axis=0), points.max(axis=0)
    bounds = {f"{axis}Minimum": float(low[k]) for k, axis in enumerate("xyz")}
    bounds |= {f"{axis}Maximum": float(high[k]) for k, axis in enumerate("xyz")}
    file.write_scan_raw(
        data,
        name=f"keyframe {keyframe.index} at {keyframe.stamp_ns} ns",
        rotation=np.array([w, x, y, z]),
        translation=T[:3, 3].copy(),
        scan_header=SimpleNamespace(**bounds),  # else pye57 writes bounds of a turned box, in the wrong frame
    )


def _pye57(path: Path) -> Any:  # noqa: ANN401 - an optional package without types
    try:
        import pye57
    except ImportError as error:
        raise MissingDependencyError(f"writing {path.name} needs pye57: {_INSTALL}") from error
    return pye57
