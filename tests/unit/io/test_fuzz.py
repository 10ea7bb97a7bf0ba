"""No damage of a file may end in anything but a result or one of our errors."""

import random

import pytest
from tests.bags import drive
from tests.fuzz.containers import in_bag, in_frame, in_mcap

from heliograph.errors import HeliographError
from heliograph.io import open_recording

WRITERS = {
    "mcap": lambda path: drive(6).mcap(path / "a.mcap"),
    "mcap zstd": lambda path: next(drive(6).ros2(path / "z", compression="storage").glob("*.mcap")),
    "ros 1 bag": lambda path: drive(6).ros1(path / "a.bag"),
    "ros 1 bag lz4": lambda path: drive(6).ros1(path / "l.bag", "lz4"),
    "sqlite": lambda path: next(drive(6).ros2(path / "s", storage="sqlite3").glob("*.db3")),
}


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Flip, blank, cut or repeat something; the ends, where the structure is, more often than the middle."""
    content = bytearray(data)
    edge = min(3000, len(content))
    at = rng.choice([rng.randrange(edge), len(content) - 1 - rng.randrange(edge), rng.randrange(len(content))])
    kind = rng.choice(["flip", "flip", "blank", "cut", "repeat"])
    if kind == "flip":
        for k in range(at, min(at + rng.choice([1, 8]), len(content))):
            content[k] = rng.randrange(256)
    elif kind == "blank":
        content[at : at + 200] = bytes(len(content[at : at + 200]))
    elif kind == "cut":
        del content[at:]
    else:
        content[at:at] = content[at : at + 50]
    return bytes(content)


@pytest.mark.parametrize("name", WRITERS)
def test_damaged_file_gives_a_result_or_a_known_error(name, tmp_path):
    whole = WRITERS[name](tmp_path)
    data = whole.read_bytes()
    rng = random.Random(name)
    read = 0
    for _ in range(25):
        path = tmp_path / f"damaged{whole.suffix}"
        path.write_bytes(damaged(data, rng))
        try:
            with open_recording(path) as recording:
                read += sum(1 for _ in recording.stream()) > 0
                recording.summary()
        except HeliographError:
            continue
    assert read > 5


STRUCTURED = {
    "mcap": (in_mcap, lambda path: drive(4).mcap(path / "a.mcap")),
    "mcap zstd": (in_mcap, lambda path: next(drive(4).ros2(path / "z", compression="storage").glob("*.mcap"))),
    "mcap file": (in_frame, lambda path: next(drive(4).ros2(path / "f", compression="file").glob("*.zstd"))),
    "ros 1 bag": (in_bag, lambda path: drive(4).ros1(path / "a.bag")),
    "ros 1 bag bz2": (in_bag, lambda path: drive(4).ros1(path / "b.bag", "bz2")),
}


@pytest.mark.parametrize("name", STRUCTURED)
def test_fields_that_lie_in_records_that_are_whole_give_a_result_or_a_known_error(name, tmp_path):
    spoil, write = STRUCTURED[name]
    whole = write(tmp_path)
    data, rng, read = whole.read_bytes(), random.Random(name), 0
    for _ in range(20):
        path = tmp_path / f"damaged{''.join(whole.suffixes)}"
        path.write_bytes(spoil(data, rng))
        try:
            with open_recording(path) as recording:
                read += sum(1 for _ in recording.stream()) > 0
                recording.summary()
        except HeliographError:
            continue
    assert read > 1
