"""Speeds of wheels or legs from a topic of a recording: odometry, twists, or joints that turn wheels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from heliograph.arrays import Array
from heliograph.config import WheelConfig
from heliograph.data import WheelSpeeds
from heliograph.errors import ConfigError, DataError, TopicError, closest
from heliograph.io.files.wheels import FASTEST
from heliograph.io.raw import RawSpeed, TopicInfo

__all__ = ["require_speed_topic", "to_speeds"]

_MOVED = 0.5  # [m]; a pose that goes so far while its twist stays zero has a driver that leaves the twist out


def require_speed_topic(topics: Sequence[TopicInfo], topic: str) -> None:
    """Raise `TopicError` unless a topic is one of speeds; the message names those that are."""
    valid = [t.name for t in topics if t.kind == "speed" and t.count]
    if topic not in valid:
        names = ", ".join(valid) or "none"
        raise TopicError(
            f"--wheels {topic}: neither a file nor a topic of speeds; topics of Odometry, TwistStamped or JointState: "
            f"{names}{closest(topic, valid)}"
        )


def to_speeds(messages: Sequence[RawSpeed], config: WheelConfig, T_imu_vehicle: Array | None) -> WheelSpeeds:
    """Return the speeds of the messages of ``config.topic``, in the recording's clock.

    An axis that is zero in every message is one that the vehicle's model leaves out, and counts as not measured.
    Messages whose stamp does not advance, or whose numbers are not finite, are left out.

    Parameters
    ----------
    messages : sequence of RawSpeed
    config : WheelConfig
    T_imu_vehicle : (4, 4) float64 or None
        Where the recording's transforms have the frame of the speeds.

    Raises
    ------
    ConfigError
        The joints of a JointState are not given, or not its.
    DataError
        Its speeds are none of a vehicle.
    """
    raw = _advancing(messages)
    if not raw:
        raise DataError(f"{config.topic} holds no usable speed; `heliograph info` lists the topics")
    if raw[0].joints:
        v = np.column_stack([_of_joints(raw, config), np.full((len(raw), 2), np.nan)])
    else:
        v = np.stack([message.v_body for message in raw])
        v[:, ~np.any(v, axis=0)] = np.nan
    sound = np.isfinite(v).any(axis=1)
    if not sound.any():
        raise DataError(_nothing(config.topic, raw))
    fastest = float(np.nanmax(np.abs(v)))
    if fastest > FASTEST:
        raise DataError(f"{config.topic} holds speeds of up to {fastest:.0f} m/s: a vehicle's are metres a second")
    kept = [message for message, is_sound in zip(raw, sound.tolist(), strict=True) if is_sound]
    stamps = np.array([message.stamp_ns for message in kept], dtype=np.int64) - round(1e9 * config.clock_offset)
    return WheelSpeeds(
        stamps_ns=stamps,
        v_body=v[sound],
        received_ns=int(kept[-1].received_ns),
        sigma=np.median([message.sigma for message in kept], axis=0),
        T_imu_vehicle=T_imu_vehicle,
    )


def _advancing(messages: Sequence[RawSpeed]) -> list[RawSpeed]:
    kept: list[RawSpeed] = []
    for message in messages:
        finite = (
            all(np.isfinite(list(message.joints.values()))) if message.joints else np.isfinite(message.v_body).all()
        )
        if finite and (not kept or message.stamp_ns > kept[-1].stamp_ns):
            kept.append(message)
    return kept


def _of_joints(raw: Sequence[RawSpeed], config: WheelConfig) -> Array:
    """Return the forward speed (N,) of wheels that turn; NaN where a message lacks a joint."""
    known = sorted({name for message in raw for name in message.joints})
    if not config.joints or not config.radius:
        raise ConfigError(
            f"{config.topic} tells how joints turn: give wheels.joints (of {', '.join(known)}) and wheels.radius [m]"
        )
    names = [name.removeprefix("-") for name in config.joints]
    signs = [-1.0 if name.startswith("-") else 1.0 for name in config.joints]
    if unknown := [name for name in names if name not in known]:
        raise ConfigError(
            f"wheels.joints: {config.topic} has no joint '{unknown[0]}'; it has {', '.join(known)}"
            f"{closest(unknown[0], known)}"
        )
    rates = np.array([[sign * m.joints.get(n, np.nan) for n, sign in zip(names, signs, strict=True)] for m in raw])
    return np.asarray(config.radius * rates.mean(axis=1))


def _nothing(topic: str, raw: Sequence[RawSpeed]) -> str:
    places = [message.position for message in raw if message.position is not None]
    gone = float(np.linalg.norm(places[-1] - places[0])) if places else 0.0
    if gone > _MOVED:
        return f"{topic}: its twist is zero throughout while its pose moves by {gone:.1f} m: its driver leaves it out"
    return f"{topic}: all its speeds are zero; without motion they tell nothing"
