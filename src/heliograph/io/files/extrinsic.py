"""The LiDAR-IMU mounting and the IMU's clock in a TOML file: a user's, or what `heliograph calibrate` writes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from heliograph.atomic import write_text
from heliograph.data import ImuClock, Rig
from heliograph.errors import ConfigError, closest
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.guard.limits import MAX_NS
from heliograph.guard.toml import parse_toml
from heliograph.io.files.params_yaml import read_params_yaml
from heliograph.lie import so3

__all__ = ["read_extrinsic", "write_extrinsic"]

_TABLE = "T_imu_lidar"
_KEYS = ("rotation", "quaternion_xyzw", "translation", "matrix")
_CLOCK, _CLOCK_KEYS = "clock", ("offset", "drift_ppm", "reference_ns")
_NOTES = "calibration"  # what a calibration says about itself; for people
_MAX_DEFECT = 1e-3
_MAX_DRIFT_PPM = 1e4


def read_extrinsic(path: Path | str) -> Rig:
    """Read ``T_imu_lidar`` (``p_imu = T_imu_lidar @ p_lidar``) from a TOML file, or another system's YAML.

    A ``.yaml`` is read as parameters of FAST-LIO2 or LIO-SAM, see `read_params_yaml`; of a run's ``run.json`` the
    mounting that it used is taken, and not its clock, which was that recording's. The TOML holds, in a table
    ``[T_imu_lidar]`` or at its top, either ``matrix`` (4x4), or ``translation`` (metres) together with ``rotation``
    (3x3 by rows, or a quaternion xyzw) or ``quaternion_xyzw``. A table ``[clock]`` may hold ``offset`` (seconds),
    ``drift_ppm`` and ``reference_ns``, see `ImuClock`; a table ``[calibration]`` is not read.

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
    if path.suffix.lower() in (".yaml", ".yml"):
        T_imu_lidar, offset = read_params_yaml(path)
        T_imu_lidar[:3, :3] = _orthonormal(path, T_imu_lidar[:3, :3])
        return Rig(T_imu_lidar=T_imu_lidar, source=f"file {path}", clock=ImuClock(offset=offset))
    if path.suffix.lower() == ".json":
        T_imu_lidar = _numbers(path, _mounting_of_run(path), _TABLE, (4, 4))
        T_imu_lidar[:3, :3] = _orthonormal(path, T_imu_lidar[:3, :3])
        return Rig(T_imu_lidar=T_imu_lidar, source=f"file {path}")
    try:
        content = parse_toml(plain_file(path, SETTINGS).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"extrinsic {path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # of TOML, of UTF-8, of numbers of thousands of digits
        raise ConfigError(f"extrinsic {path}: is not TOML: {error}") from error
    clock = _clock(path, content.pop(_CLOCK, {}))
    content.pop(_NOTES, None)
    if _TABLE in content and len(content) > 1:
        other = next(key for key in content if key != _TABLE)
        raise ConfigError(f"extrinsic {path}: unknown key '{other}'{closest(other, (_TABLE, _CLOCK, _NOTES))}")
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
    return Rig(T_imu_lidar=T_imu_lidar, source=f"file {path}", clock=clock)


def _mounting_of_run(path: Path) -> dict[str, Any]:
    """Return the mounting in a run's account."""
    try:
        found = json.loads(plain_file(path, SETTINGS).read_text(encoding="utf-8"))
        mounting = found["mounting"]
        return {_TABLE: mounting[_TABLE]}
    except OSError as error:
        raise ConfigError(f"extrinsic {path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"extrinsic {path}: is not JSON: {error}") from error
    except (KeyError, TypeError) as error:
        raise ConfigError(
            f"extrinsic {path}: holds no mounting; name the run.json of a run with LiDAR and IMU, or a TOML file"
        ) from error


def write_extrinsic(path: Path | str, rig: Rig, notes: Mapping[str, Any], *, header: str = "") -> None:
    """Write a mounting and a clock for `read_extrinsic`.

    Parameters
    ----------
    path : Path or str
        Replaced if it exists, all at once.
    rig : Rig
    notes : mapping
        Plain values for people, in a table ``[calibration]`` that is not read back.
    header : str
        Lines of comment at the top, without the marks.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    clock = rig.clock
    content = {
        _TABLE: {
            "translation": rig.T_imu_lidar[:3, 3].tolist(),
            "quaternion_xyzw": so3.to_quaternion(rig.T_imu_lidar[:3, :3]).tolist(),
        },
        _CLOCK: {"offset": clock.offset, "drift_ppm": 1e6 * clock.drift, "reference_ns": clock.reference_ns},
        _NOTES: dict(notes),
    }
    comment = "".join(f"# {line}\n" for line in header.splitlines())
    write_text(Path(path), comment + tomli_w.dumps(content))


def _clock(path: Path, table: object) -> ImuClock:
    """Return the clock of a table; without one both clocks agree."""
    if not isinstance(table, dict):
        raise ConfigError(f"extrinsic {path}: '{_CLOCK}' is no table; write [{_CLOCK}] on a line of its own")
    unknown = [key for key in table if key not in _CLOCK_KEYS]
    if unknown:
        raise ConfigError(
            f"extrinsic {path}: [{_CLOCK}] has an unknown key '{unknown[0]}'{closest(unknown[0], _CLOCK_KEYS)}"
        )
    offset, drift_ppm = (float(_numbers(path, {k: table.get(k, 0.0)}, k, ())) for k in _CLOCK_KEYS[:2])
    reference_ns = table.get("reference_ns", 0)
    if isinstance(reference_ns, bool) or not isinstance(reference_ns, int) or abs(reference_ns) > MAX_NS:
        raise ConfigError(f"extrinsic {path}: 'reference_ns' must be a whole number of nanoseconds")
    if drift_ppm != 0.0 and "reference_ns" not in table:
        raise ConfigError(f"extrinsic {path}: [{_CLOCK}] has a drift, so give 'reference_ns': when the offset holds")
    if abs(drift_ppm) > _MAX_DRIFT_PPM:
        raise ConfigError(
            f"extrinsic {path}: a drift of {drift_ppm:g} ppm is none of a clock (at most {_MAX_DRIFT_PPM:g}); "
            "'drift_ppm' counts millionths"
        )
    return ImuClock(offset=offset, drift=1e-6 * drift_ppm, reference_ns=reference_ns)


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
    except (TypeError, ValueError, OverflowError):
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
