"""How the LiDAR sits on the IMU: from the user's file, the recording's tf, or the sensor's maker."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.data import Event, Rig
from heliograph.io.files.extrinsic import read_extrinsic
from heliograph.io.inference.record import Inference, make_inference
from heliograph.io.inference.scans import valid_points
from heliograph.io.raw import RawCloud, RawImu, RawTransform

__all__ = ["FACTORY_MOUNTINGS", "FrameTree", "Mounting", "find_mounting", "recognise_livox"]

UNKNOWN_ROTATION = float(np.pi)
UNKNOWN_LEVER_ARM = 0.3
FACTORY_SIGMA = 0.005  # of a mounting inside one housing [m]

FACTORY_MOUNTINGS: dict[str, tuple[tuple[float, float, float], float]] = {
    # The IMU's position in the point cloud's frame and how well it is known [m]; axes parallel; from the user manuals.
    # The HAP's manual gives the axes but no position: anywhere in its housing.
    "Livox Mid-360": ((0.011, 0.02329, -0.04412), 0.005),
    "Livox Avia": ((-0.04165, -0.02326, 0.0284), 0.005),
    "Livox HAP": ((0.0, 0.0, 0.0), 0.05),
}


@dataclass(frozen=True, slots=True)
class Mounting:
    """The rig with what led to it."""

    rig: Rig
    inferences: tuple[Inference, ...]
    events: tuple[Event, ...]


class FrameTree:
    """The frames of a recording and the transforms between them."""

    def __init__(self, transforms: Iterable[RawTransform]) -> None:
        self._edges: dict[str, dict[str, tuple[NDArray[np.float64], bool]]] = {}
        for edge in transforms:
            inverse = np.linalg.inv(edge.T_parent_child).astype(np.float64)
            self._edges.setdefault(edge.parent, {})[edge.child] = (edge.T_parent_child, edge.static)
            self._edges.setdefault(edge.child, {})[edge.parent] = (inverse, edge.static)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names, sorted."""
        return tuple(sorted(self._edges))

    def find(self, a: str, b: str) -> tuple[NDArray[np.float64], tuple[str, ...], bool] | None:
        """Return ``T_a_b``, the frames on the way and whether every step is static; None where nothing links them."""
        a, b = a.lstrip("/"), b.lstrip("/")
        if a not in self._edges or b not in self._edges:
            return None
        start: tuple[str, NDArray[np.float64], tuple[str, ...], bool] = (a, np.eye(4), (a,), True)
        queue = deque([start])
        seen = {a}
        while queue:
            frame, T_a_frame, way, static = queue.popleft()
            if frame == b:
                return T_a_frame, way, static
            for following, (T_frame_following, fixed) in self._edges[frame].items():
                if following not in seen:
                    seen.add(following)
                    queue.append((following, T_a_frame @ T_frame_following, (*way, following), static and fixed))
        return None


def find_mounting(
    clouds: Sequence[RawCloud],
    samples: Sequence[RawImu],
    tree: FrameTree,
    factory: tuple[NDArray[np.float64], str] | None,
    extrinsic: str,
) -> Mounting:
    """Find ``T_imu_lidar``, in this order: the user's file, tf, the maker's figure, unknown.

    Parameters
    ----------
    clouds, samples : sequence
        First messages of the chosen topics; either may be empty.
    tree : FrameTree
        The recording's frames.
    factory : tuple or None
        What the container's own metadata say.
    extrinsic : str
        Path of the user's file, or empty.
    """
    if extrinsic:
        rig = read_extrinsic(Path(extrinsic))
        notes = (_describe(rig, "given by the user", "override"), *_describe_clock(rig))
        return Mounting(rig, notes, ())
    if not clouds or not samples:
        rig = Rig(T_imu_lidar=np.eye(4), source="one sensor only: its frame is the body")
        return Mounting(rig, (), ())
    lidar, imu = clouds[0].frame_id.lstrip("/"), samples[0].frame_id.lstrip("/")
    link = tree.find(imu, lidar) if lidar != imu else None
    if link is not None:
        return _from_tf(link, imu, lidar)
    if factory is None:
        factory = recognise_livox(clouds, samples)
    if factory is not None:
        T_imu_lidar, name = factory
        sigma = FACTORY_MOUNTINGS.get(name, ((), FACTORY_SIGMA))[1]
        rig = Rig(T_imu_lidar=T_imu_lidar, source=f"factory, {name}", sigma_rotation=0.005, sigma_translation=sigma)
        return Mounting(rig, (_describe(rig, f"no tf links '{imu}' and '{lidar}'; {name} recognised", "data"),), ())
    return _unknown(imu, lidar, tree)


def _describe(rig: Rig, evidence: str, source: str) -> Inference:
    T = rig.T_imu_lidar
    angle = np.rad2deg(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1)))
    x, y, z = T[:3, 3]
    return make_inference(
        "T_imu_lidar",
        f"({x:.4f}, {y:.4f}, {z:.4f}) m, turned {angle:.2f} deg",
        f"{rig.source}: {evidence}",
        source=source,
    )


def _describe_clock(rig: Rig) -> tuple[Inference, ...]:
    """Return what the samples' stamps are corrected by, if by anything."""
    clock = rig.clock
    if clock.exact:
        return ()
    value = f"{1e3 * clock.offset:+.3f} ms, {1e6 * clock.drift:+.1f} ppm"
    return (
        make_inference(
            "imu clock", value, f"{rig.source}: the samples are brought to the LiDAR's clock", source="override"
        ),
    )


def _from_tf(link: tuple[NDArray[np.float64], tuple[str, ...], bool], imu: str, lidar: str) -> Mounting:
    T_imu_lidar, way, static = link
    rig = Rig(T_imu_lidar=T_imu_lidar, source="tf_static" if static else "tf")
    events = []
    if not static:
        message = (
            f"the link from '{imu}' to '{lidar}' ({' - '.join(way)}) is on /tf, not /tf_static: its first "
            "value is used throughout"
        )
        events.append(Event(code="moving-mount", message=message))
    return Mounting(rig, (_describe(rig, " - ".join(way), "data"),), tuple(events))


def _unknown(imu: str, lidar: str, tree: FrameTree) -> Mounting:
    if imu == lidar:
        cause = f"both sensors name the frame '{imu}', which drivers do whatever the mounting"
    elif tree.frames:
        cause = f"tf links {', '.join(tree.frames[:8])}, but not '{imu}' with '{lidar}'"
    else:
        cause = f"no tf links '{imu}' and '{lidar}'"
    rig = Rig(
        T_imu_lidar=np.eye(4),
        source="unknown",
        known=False,
        sigma_rotation=UNKNOWN_ROTATION,
        sigma_translation=UNKNOWN_LEVER_ARM,
    )
    message = (
        f"the LiDAR-IMU transform is unknown ({cause}): the rotation is aligned from motion, the lever arm taken "
        "as 0 +- "
        f"{UNKNOWN_LEVER_ARM} m; give it with --extrinsic FILE"
    )
    return Mounting(
        rig,
        (make_inference("T_imu_lidar", "unknown", cause, source="default"),),
        (Event(code="unknown-mount", message=message),),
    )


def recognise_livox(clouds: Sequence[RawCloud], samples: Sequence[RawImu]) -> tuple[NDArray[np.float64], str] | None:
    """Return the maker's ``T_imu_lidar`` and the name of a Livox sensor with its built-in IMU, else None.

    The message and the frame tell the make, the field of view the model: a Mid-360 looks all around, an Avia into a
    cone of about 70 degrees, a HAP at a band of 120 by 25.
    """
    cloud, sample = clouds[0], samples[0]
    livox = (
        cloud.layout == "livox/CustomMsg"
        or "livox" in f"{cloud.frame_id} {cloud.topic}".lower()
        or {"tag", "line"} <= set(cloud.columns)
    )
    built_in = "livox" in f"{sample.topic} {sample.frame_id}".lower()
    if not livox or not built_in:
        return None
    points = np.concatenate([valid_points(c)[0] for c in clouds[:10]])
    if len(points) < 200:
        return None
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    covered = np.count_nonzero(np.histogram(azimuth, 72, (-np.pi, np.pi))[0]) * 5
    tall = float(np.rad2deg(np.quantile(elevation, 0.99) - np.quantile(elevation, 0.01)))
    wide = float(np.rad2deg(np.quantile(azimuth, 0.99) - np.quantile(azimuth, 0.01)))
    if covered >= 240:
        name = "Livox Mid-360"
    elif 55 < tall < 85 and 55 < wide < 80:
        name = "Livox Avia"
    elif tall < 30 and 100 < wide < 130:
        name = "Livox HAP"
    else:
        return None
    T_imu_lidar = np.eye(4)
    T_imu_lidar[:3, 3] = -np.array(FACTORY_MOUNTINGS[name][0])
    return T_imu_lidar, name
