"""Ways to spoil what a message says: its fields by name, whatever their place, and the whole serialised again."""

from __future__ import annotations

import random
import struct
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from rosbags.serde.errors import SerdeError
from tests.bags import STORES
from tests.fuzz.containers import MAGIC, Record, records_of
from tests.fuzz.mutations import TOKENS, WORDS, of_bytes

__all__ = ["in_fields"]

_HEAD = 22  # bytes before the message in its record
FLOATS = (0.0, -0.0, 1e308, -1e308, 1e30, 1e-320, 3e38, float("nan"), float("inf"), float("-inf"))
INTEGERS = (*WORDS, -1, -(2**31), 2**62, -(2**62), 2**63 - 1, *range(3, 12), 255, 65_536)


def in_fields(data: bytes, rng: random.Random) -> bytes:
    """Change fields of the messages of an MCAP file without chunks."""
    records = records_of(data[len(MAGIC) :])
    kinds = {}
    schemas = {}
    for record in records:
        if record.opcode == 0x03:
            number, length = struct.unpack_from("<HI", record.body)
            schemas[number] = record.body[6 : 6 + length].decode()
        elif record.opcode == 0x04:
            number, schema = struct.unpack_from("<HH", record.body)
            kinds[number] = schemas[schema]
    found = [k for k, record in enumerate(records) if record.opcode == 0x05]
    number = struct.unpack_from("<H", records[rng.choice(found)].body)[0]  # each topic as often as it speaks
    if rng.random() < 0.5:
        number = rng.choice(sorted(kinds))
    of_topic = [k for k in found if struct.unpack_from("<H", records[k].body)[0] == number]
    chosen = rng.sample(of_topic, min(len(of_topic), rng.choice([1, 1, 2, 10, len(of_topic)])))
    same = rng.random() < 0.5
    seed = rng.random()
    for place in chosen:
        chance = random.Random(seed) if same else rng  # the same fault in each, or another
        body = records[place].body
        records[place] = Record(0x05, body[:_HEAD] + _changed(body[_HEAD:], kinds[number], chance))
    return MAGIC + b"".join(record.packed() for record in records) + MAGIC


def _changed(data: bytes, kind: str, rng: random.Random) -> bytes:
    store = STORES[2]
    for _ in range(5):
        message = store.deserialize_cdr(data, kind)
        for _ in range(rng.choice([1, 1, 2, 4])):
            _spoil(message, rng)
        try:
            return bytes(store.serialize_cdr(message, kind))
        except (struct.error, ValueError, TypeError, AssertionError, OverflowError, AttributeError, SerdeError):
            continue  # a value that the field cannot hold
    return of_bytes(data, rng)


def _spoil(message: Any, rng: random.Random) -> None:
    while True:
        name = rng.choice([field.name for field in fields(message) if not field.name.startswith("__")])
        value = getattr(message, name)
        if isinstance(value, list) and value and is_dataclass(value[0]):
            if rng.random() < 0.3:
                setattr(message, name, rng.choice([[], value[:1], value * 2, value[::-1], value * 50]))
                return
            value = rng.choice(value)
        if not is_dataclass(value):
            setattr(message, name, _other(value, rng))
            return
        message = value


def _other(value: Any, rng: random.Random) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice((*INTEGERS, value + 1, value - 1, value * 2))
    if isinstance(value, float):
        return rng.choice((*FLOATS, -value, value * 1e3))
    if isinstance(value, str):
        return rng.choice([token.replace("\x00", "") for token in TOKENS])
    if isinstance(value, np.ndarray):
        some = np.frombuffer(of_bytes(value.tobytes(), rng), np.uint8)
        some = some[: len(some) // value.itemsize * value.itemsize].view(value.dtype)
        fill = np.full_like(value, rng.choice(FLOATS) if value.dtype.kind == "f" else rng.choice([0, 1, 127]))
        return rng.choice([value[:0], value[: len(value) // 2], np.concatenate([value, value]), fill, some])
    return value
