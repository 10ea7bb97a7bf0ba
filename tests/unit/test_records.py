"""Every array of every record is read-only, so that no reader of a result can write into what made it."""

import dataclasses
import importlib
import inspect
import pkgutil
import re

import numpy as np
import pytest

import heliograph
from heliograph.checks.records import CheckedMotion
from heliograph.data import Georeference, GnssFix, ImuBatch, Keyframe, Rig, Scan, Trajectory, WheelSpeeds
from heliograph.data.imu_record import ImuRecord
from heliograph.lie import S2, SE2, SE3, SO2, SO3, ExtendedPose
from heliograph.maps.feature_map import FeaturePoints
from heliograph.maps.global_map import MapCells
from heliograph.output.final_poses import FinalPoses
from heliograph.output.submaps import Submap
from heliograph.registration.linearize import MapMounting
from heliograph.sim.world import Primitive

ARRAY = re.compile(r"\b(NDArray|ndarray|Array|Stamps|Indices|Ints|Keys|Points|Mask|Order|Flags)\b")
STAMPS, POSES = np.arange(2), np.tile(np.eye(4), (2, 1, 1))
PATH = Trajectory(stamps_ns=STAMPS, T_frame_body=POSES)

CELLS = MapCells(
    cubes=np.zeros((2, 3), np.int32),
    sums=np.zeros((2, 3), np.float32),
    intensity=np.zeros(2, np.float32),
    counts=np.ones(2, np.float32),
)

# Records that check their fields need fields that fit; all others take any.
CHECKED = {
    ImuBatch: {"stamps_ns": STAMPS, "gyro": np.zeros((2, 3)), "accel": np.zeros((2, 3))},
    ImuRecord: {"stamps_ns": STAMPS, "received_ns": STAMPS.copy(), "gyro": np.zeros((2, 3)), "accel": np.zeros((2, 3))},
    CheckedMotion: {"trajectory": PATH, "tracked": np.zeros(2, bool)},
    Trajectory: {"stamps_ns": STAMPS, "T_frame_body": POSES},
    GnssFix: {"covariance_enu": np.eye(3)},
    Georeference: {"origin_deg": np.zeros(3), "T_map_enu": np.eye(4), "covariance": np.eye(6)},
    WheelSpeeds: {"stamps_ns": STAMPS, "v_body": np.zeros((2, 3)), "T_imu_vehicle": np.eye(4)},
    Rig: {"T_imu_lidar": np.eye(4), "antenna_imu": np.zeros(3)},
    Scan: {
        "points": np.zeros((2, 3), np.float32),
        "offsets_ns": np.zeros(2, np.int32),
        "intensity": np.zeros(2, np.float32),
        "ring": np.zeros(2, np.uint16),
    },
    Keyframe: {
        "T_odom_imu": np.eye(4),
        **{name: np.zeros(3) for name in ("v_odom", "gyro_bias", "accel_bias", "g_odom")},
        **{name: np.eye(6) for name in ("step_covariance", "lidar_information")},
        "points_imu": np.zeros((2, 3), np.float32),
        "intensity": np.zeros(2, np.float32),
        "imu": ImuBatch.joined([]),
    },
    Primitive: {"shape": "box", "center": np.zeros(3), "half": np.ones(3), "R_world_local": np.eye(3)},
    SO2: {"matrix": np.eye(2)},
    SO3: {"matrix": np.eye(3)},
    SE2: {"matrix": np.eye(3)},
    SE3: {"matrix": np.eye(4)},
    ExtendedPose: {"matrix": np.eye(5)},
    MapMounting: {"T_imu_lidar": np.eye(4), "T_odom_imu_first": np.eye(4)},
    MapCells: {name: getattr(CELLS, name).copy() for name in ("cubes", "sums", "intensity", "counts")},
    FeaturePoints: {name: np.zeros((2, 3), np.float32) for name in ("edges", "planes")},
    FinalPoses: {"stamps_ns": STAMPS, "T_odom_imu": POSES.copy(), "T_map_imu": POSES.copy()},
    Submap: {"T_odom_imu": np.eye(4), "cells": CELLS},
    S2: {"vector": np.ones(3)},
}
ABSTRACT = {"MatrixGroup", "_Rigid", "FactorRecord"}


def records():
    """Frozen dataclasses of the package with a field that is, or holds, arrays."""
    found = set()
    for module in pkgutil.walk_packages(heliograph.__path__, "heliograph."):
        if module.name.endswith("__main__"):
            continue
        for _, kind in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if kind.__module__ != module.name or not dataclasses.is_dataclass(kind) or kind.__name__ in ABSTRACT:
                continue
            if kind.__dataclass_params__.frozen and array_fields(kind):
                found.add(kind)
    return sorted(found, key=lambda kind: (kind.__module__, kind.__name__))


def array_fields(kind):
    return [f.name for f in dataclasses.fields(kind) if ARRAY.search(str(f.type)) and "Callable" not in str(f.type)]


def build(kind):
    """Make a record of writeable arrays as its constructor does, without asking what its other fields mean."""
    record = object.__new__(kind)
    for field in dataclasses.fields(kind):
        value = None
        if field.name in array_fields(kind):
            value = np.zeros(3)
            if re.match(r"tuple|Mapping|dict", str(field.type)):
                value = (value, np.ones(2)) if str(field.type).startswith("tuple") else {"x": value}
        object.__setattr__(record, field.name, CHECKED.get(kind, {}).get(field.name, value))
    record.__post_init__()
    return record


def arrays_of(record):
    for name in array_fields(type(record)):
        value = getattr(record, name)
        items = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else [value]
        yield from ((name, item) for item in items if item is not None)


def test_records_are_found():
    names = {kind.__name__ for kind in records()}
    assert {"NavState", "ScanResult", "NormalEquations", "RawCloud", "Trajectory", "Whitening"} <= names
    assert len(names) > 85


@pytest.mark.parametrize("kind", records(), ids=lambda kind: f"{kind.__module__}.{kind.__name__}")
def test_records_arrays_are_read_only(kind):
    found = list(arrays_of(build(kind)))
    assert found
    for name, array in found:
        assert isinstance(array, np.ndarray), name
        assert not array.flags.writeable, f"{kind.__name__}.{name} can be written to"
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 1
