"""The mounting in a parameter file of FAST-LIO2 or LIO-SAM, whichever way round it states it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from heliograph.errors import ConfigError
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.lie import se3

__all__ = ["StatedMounting", "read_params_yaml"]

_FAST_LIO = ("extrinsic_T", "extrinsic_R")  # p_imu = R p_lidar + T (its README)
_LIO_SAM = ("extrinsicTrans", "extrinsicRot")  # p_lidar = R p_imu + T (its imageProjection turns the IMU by R)
_OFFSET = "time_offset_lidar_to_imu"  # taken off the IMU's stamps
_MAX_BYTES = 1_000_000
_MAX_DEPTH = 8

StatedMounting = tuple[NDArray[np.float64], float]
"""T_imu_lidar (4, 4), its rotation as the file has it, and how much more the IMU's clock shows [s]."""


def read_params_yaml(path: Path) -> StatedMounting:
    """Read the mounting that a parameter file of another system states.

    ``extrinsic_T`` and ``extrinsic_R`` (FAST-LIO2 and its family) are the LiDAR in the IMU's frame; ``extrinsicTrans``
    and ``extrinsicRot`` (LIO-SAM) the IMU in the LiDAR's, and are inverted. They may lie at any depth: ROS 1 and ROS 2
    nest them differently. ``time_offset_lidar_to_imu`` of FAST-LIO2 is what the IMU's clock shows more.

    Parameters
    ----------
    path : Path

    Raises
    ------
    ConfigError
        It cannot be read, is not YAML, states no mounting or two, or not in 3 and 9 finite numbers.
    """
    found: dict[str, Any] = {}
    for key, value in _entries(path, _content(path), 0):
        if key in found and found[key] != value:
            raise ConfigError(f"extrinsic {path}: '{key}' is given twice, and differently; leave the one that holds")
        found[key] = value
    stated = [pair for pair in (_FAST_LIO, _LIO_SAM) if set(pair) & set(found)]
    if len(stated) != 1:
        what = "no mounting" if not stated else "two mountings"
        raise ConfigError(
            f"extrinsic {path}: states {what}; expected {' with '.join(_FAST_LIO)} (FAST-LIO2), or "
            f"{' with '.join(_LIO_SAM)} (LIO-SAM); or write a TOML file with T_imu_lidar"
        )
    T = np.eye(4)
    T[:3, 3] = _numbers(path, found, stated[0][0], 3)
    T[:3, :3] = _numbers(path, found, stated[0][1], 9).reshape(3, 3)
    offset = float(_numbers(path, found, _OFFSET, 1)[0]) if _OFFSET in found else 0.0
    return (T if stated[0] == _FAST_LIO else se3.inverse(T)), offset


def _content(path: Path) -> object:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ConfigError(f"extrinsic {path}: has {path.stat().st_size} bytes, too many for a file of parameters")
        text = plain_file(path, SETTINGS).read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"extrinsic {path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"extrinsic {path}: is not YAML: {error}") from error
    try:
        reader = YAML(typ="safe", pure=True)
        return reader.load("\n".join(line for line in text.splitlines() if not line.startswith("%YAML")))
    except RecursionError as error:
        raise ConfigError(f"extrinsic {path}: is not YAML: it nests too deep") from error
    except (YAMLError, ValueError) as error:
        raise ConfigError(f"extrinsic {path}: is not YAML: {str(error).splitlines()[0]}") from error


def _entries(path: Path, content: object, depth: int) -> Iterator[tuple[str, Any]]:
    """Yield the keys that are looked for, and their values, wherever they lie."""
    if not isinstance(content, Mapping) or depth > _MAX_DEPTH:
        return
    for key, value in content.items():
        name = str(key).rpartition("/")[2]
        if name in (*_FAST_LIO, *_LIO_SAM, _OFFSET):
            yield name, value
        else:
            yield from _entries(path, value, depth + 1)


def _numbers(path: Path, found: Mapping[str, Any], key: str, count: int) -> NDArray[np.float64]:
    if key not in found:
        raise ConfigError(f"extrinsic {path}: has no '{key}'")
    try:
        values = np.array(found[key], dtype=np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        values = np.empty(0)
    if values.size != count or not np.isfinite(values).all():
        raise ConfigError(f"extrinsic {path}: '{key}' must be {count} finite numbers")
    return values
