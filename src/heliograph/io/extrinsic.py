"""The LiDAR-IMU mounting from a user's TOML file."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Rig
from heliograph.errors import ConfigError, closest
from heliograph.lie import so3

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["read_extrinsic"]

_TABLE = "T_imu_lidar"
_KEYS = ("rotation", "quaternion_xyzw", "translation", "matrix")
_MAX_DEFECT = 1e-3


def read_extrinsic(path: Path | str) -> Rig:
    """Read ``T_imu_lidar`` (``p_imu = T_imu_lidar @ p_lidar``) from a TOML file.

    The file holds, in a table ``[T_imu_lidar]`` or at its top, either ``matrix`` (4x4), or ``translation`` (metres)
    together with ``rotation`` (3x3 by rows, or a quaternion xyzw) or ``quaternion_xyzw``.

    Parameters
    ----------
    path : Path or str
        The file.

    Returns
    -------
    Rig
        The rotation is made exactly orthonormal.

    Raises
    ------
    ConfigError
        No such file, not TOML, keys that are unknown, missing or contradict each other, a wrong number of values, or a
        rotation that is none (defect above 1e-3, or a mirror).
    """
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"extrinsic {path}: cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"extrinsic {path}: is not TOML: {error}") from error
    table = content.get(_TABLE, content)
    if not isinstance(table, dict):
        raise ConfigError(f"extrinsic {path}: '{_TABLE}' is no table; write [{_TABLE}] on a line of its own")
    unknown = [key for key in table if key not in _KEYS]
    if unknown:
        raise ConfigError(f"extrinsic {path}: unknown key '{unknown[0]}'{closest(unknown[0], _KEYS)}")
    T_imu_lidar = np.eye(4)
    given = sorted({"rotation", "quaternion_xyzw", "matrix"} & set(table))
    if len(given) != 1 or ("translation" in table) == ("matrix" in table):
        raise ConfigError(
            f"extrinsic {path}: give 'matrix', or 'translation' with one of 'rotation' and 'quaternion_xyzw'; "
            f"it has {', '.join(table) or 'nothing'}"
        )
    if given == ["matrix"]:
        T_imu_lidar = _numbers(path, table, "matrix", (4, 4))
        if not np.allclose(T_imu_lidar[3], [0, 0, 0, 1]):
            raise ConfigError(f"extrinsic {path}: the last row of 'matrix' must be 0 0 0 1")
    else:
        T_imu_lidar[:3, 3] = _numbers(path, table, "translation", (3,))
        T_imu_lidar[:3, :3] = _rotation(path, table, given[0])
    T_imu_lidar[:3, :3] = _orthonormal(path, T_imu_lidar[:3, :3])
    return Rig(T_imu_lidar=T_imu_lidar, source=f"file {path}")


def _rotation(path: Path, table: Mapping[str, Any], key: str) -> NDArray[np.float64]:
    flat = isinstance(table[key], list) and len(table[key]) == 4
    if key == "rotation" and not flat:
        return _numbers(path, table, key, (3, 3))
    quaternion = _numbers(path, table, key, (4,))
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > _MAX_DEFECT:
        raise ConfigError(f"extrinsic {path}: the quaternion (x, y, z, w) has length {length:.6f}, expected 1")
    return so3.from_quaternion(quaternion)


def _numbers(path: Path, table: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return an array of a shape; a flat list of the right length will do."""
    try:
        values = np.array(table[key], dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.size != np.prod(shape) or values.shape not in (shape, (values.size,)) or not np.isfinite(values).all():
        raise ConfigError(f"extrinsic {path}: '{key}' must be {'x'.join(map(str, shape))} finite numbers")
    return values.reshape(shape)


def _orthonormal(path: Path, R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation nearest to ``R``, if it is near (orthogonal Procrustes)."""
    defect = float(np.abs(R.T @ R - np.eye(3)).max())
    if defect > _MAX_DEFECT or np.linalg.det(R) < 0:
        kind = (
            "is a mirror" if np.linalg.det(R) < 0 else f"is no rotation (R^T R differs from identity by {defect:.2g})"
        )
        raise ConfigError(f"extrinsic {path}: the rotation {kind}; check the order of its rows")
    return so3.project(R)
