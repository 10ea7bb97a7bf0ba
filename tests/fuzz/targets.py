"""What reads the spoilt files: the commands, and the loaders that no command reaches."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from tests.fuzz.mutations import in_archive, in_database, in_messages, in_text, in_tree, of_bytes

from heliograph.cli.main import main
from heliograph.errors import HeliographError
from heliograph.graph import ISAM2, Between, Diagonal, FactorGraph, Values
from heliograph.graph.files.archive import load_graph
from heliograph.io import open_recording
from heliograph.lie import SE3

__all__ = ["TARGETS", "Target"]

Spoil = Callable[[bytes, random.Random], bytes]
DEFECT = 1  # exit code of a command that ended in an exception that is none of ours


@dataclass(frozen=True)
class Target:
    """A seed, how it is spoilt, and what reads it; the reader returns whether it took the file."""

    name: str
    seed: str
    spoil: Spoil
    read: Callable[[Path], bool]
    weight: int = 10
    inner: str = ""  # the file of a folder that is spoilt; "*": any


class DefectError(Exception):
    """A command said that it has met a defect of its own."""


def command(*arguments: str) -> Callable[[Path], bool]:
    """Return a reader: a command line, ``{}`` being the file and ``{out}`` a folder to write to."""

    def read(path: Path) -> bool:
        words = {"{}": str(path), "{out}": str(path.parent / "out"), "{seeds}": os.environ.get("FUZZ_SEEDS", "")}
        line = list(arguments)
        for name, word in words.items():
            line = [argument.replace(name, word) for argument in line]
        code = main(line)
        if code == DEFECT:
            raise DefectError(" ".join(arguments))
        return code == 0

    return read


def stream(path: Path) -> bool:
    """Read a recording through as an estimator would."""
    with open_recording(path) as recording:
        for message in recording.stream():
            _ = message.received_ns
        recording.summary()
        _ = recording.events
    return True


def smoother(path: Path) -> bool:
    """Load a saved smoother and use all of it."""
    loaded = ISAM2.load(path)
    values = loaded.estimate()
    keys = np.sort(values.keys())
    loaded.cliques()
    last = int(keys[-1])
    graph, new = FactorGraph(), Values()
    new.insert(last + 1, values.at(last))
    graph.add(Between(last, last + 1, SE3.exp(np.full(6, 0.01)), Diagonal(np.full(6, 0.1))))
    graph.add(Between(int(keys[0]), last + 1, SE3.exp(np.full(6, 0.01)), Diagonal(np.full(6, 0.1))))
    loaded.update(graph, new)
    loaded.finish()
    loaded.covariance(int(keys[0]))
    loaded.joint(keys[:3])
    loaded.update(iterate=1e-6, max_iterations=3, costs=True)
    loaded.marginalize(int(keys[1]))
    loaded.estimate()
    loaded.save(path.with_suffix(".again"))
    ISAM2.load(path.with_suffix(".again"))
    return True


def graph_archive(path: Path) -> bool:
    """Load a graph and write it again."""
    from heliograph.graph.files.archive import save_graph

    save_graph(path.with_suffix(".again"), *load_graph(path))
    return True


def spoilt_database(data: bytes, rng: random.Random) -> bytes:
    """As `in_database`, in a folder of its own."""
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        return in_database(data, rng, Path(folder))


def quietly(read: Callable[[Path], bool]) -> Callable[[Path], bool]:
    """Return a reader for which one of our errors is an answer like another."""

    def guarded(path: Path) -> bool:
        try:
            return read(path)
        except HeliographError:
            return False

    return guarded


INFO = command("info", "{}", "--json")
RUN = command("run", "{}", "-o", "{out}", "--threads", "1", "--json")
CHECK = command("check", "{}", "--imu", "--json")
STREAM = quietly(stream)
LOOPS = command("loops", "{}", "--json")


def _targets() -> list[Target]:
    found = [
        Target("mcap bytes", "ouster.mcap", of_bytes, STREAM, 20),
        Target("mcap messages", "ouster.mcap", in_messages, STREAM, 30),
        Target("livox messages", "livox-custom.mcap", in_messages, STREAM, 15),
        Target("mcap chunks", "chunked.mcap", of_bytes, STREAM, 20),
        Target("ros 1 bag", "plain.bag", of_bytes, STREAM, 20),
        Target("ros 1 bag bz2", "bz2.bag", of_bytes, STREAM, 10),
        Target("ros 1 bag lz4", "lz4.bag", of_bytes, STREAM, 10),
        Target("sqlite", "plain.db3", spoilt_database, STREAM, 20),
        Target("zstd messages", "sqlite3_message", of_bytes, STREAM, 8, "*"),
        Target("zstd file", "packed.mcap.zstd", of_bytes, STREAM, 10),
        Target("zstd folder", "mcap_file", in_text, STREAM, 8, "metadata.yaml"),
        Target("metadata", "sqlite3_", in_text, STREAM, 6, "metadata.yaml"),
        Target("info", "ouster.mcap", in_messages, INFO, 8),
        Target("run", "ouster.mcap", in_messages, RUN, 6),
        Target("run livox", "livox-custom.mcap", in_messages, RUN, 3),
        Target("check", "ouster.mcap", in_messages, CHECK, 4),
        Target("clouds", "clouds", of_bytes, STREAM, 10, "*"),
        Target("stamps", "clouds", in_text, STREAM, 6, "times.txt"),
        Target("kitti", "kitti", in_text, STREAM, 10, "*"),
        Target("imu table", "imu.csv", in_text, command("check", "{}", "--imu"), 10),
        Target("imu noise", "imu.csv", in_text, command("calibrate", "--imu-noise", "{}", "-o", "{out}"), 3),
        Target("run imu", "imu.csv", in_text, command("run", "{}", "--sensors", "imu", "-o", "{out}"), 4),
        Target("evaluate", "poses.tum", in_text, command("evaluate", "{}", "{}"), 10),
        Target("evaluate kitti", "poses.kitti", in_text, command("evaluate", "{}", "{}"), 6),
        Target("g2o", "graph.g2o", in_text, command("solve", "{}", "--json"), 12),
        Target("g2o in space", "spatial.g2o", in_text, command("solve", "{}", "-o", "{out}.g2o"), 10),
        Target("toro", "graph.toro", in_text, command("solve", "{}", "--json"), 8),
        Target("graph archive", "graph.npz", in_archive, quietly(graph_archive), 20),
        Target("solve archive", "graph.npz", in_archive, command("solve", "{}"), 8),
        Target("smoother", "plain.isam2", in_archive, quietly(smoother), 20),
        Target("smoother robust", "robust.isam2", in_archive, quietly(smoother), 15),
        Target("tree", "plain.isam2", in_tree, quietly(smoother), 40),
        Target("tree robust", "robust.isam2", in_tree, quietly(smoother), 40),
        Target("tree open", "open.isam2", in_tree, quietly(smoother), 40),
        Target("scenario", "scenario.toml", in_text, command("simulate", "{}", "-o", "{out}", "--duration", "0.2"), 4),
        Target("config", "config.toml", in_text, command("run", "{seeds}/chunked.mcap", "-c", "{}", "-o", "{out}"), 3),
        Target("loops", "run", in_text, LOOPS, 8, "*"),
        Target("loop joined", "run", of_bytes, command("loops", "{}", "--add", "0", "1"), 4, "*"),
    ]  # fmt: skip
    for suffix, weight in (("ply", 8), ("pcd", 8), ("las", 8), ("laz", 8), ("xyz", 5)):
        spoil = in_text if suffix == "xyz" else of_bytes
        found.append(Target(f"{suffix} cloud", f"cloud.{suffix}", spoil, command("align", "{}", "{}"), weight))
    for name in ("ascii.ply", "ascii.pcd", "packed.pcd"):
        found.append(Target(name, name, in_text, command("align", "{}", "{}"), 8))
    if find_spec("velodyne_decoder") is not None:
        found.append(Target("velodyne pcap", "velodyne.pcap", of_bytes, STREAM, 12))
    return found


TARGETS = _targets()


def place(target: Target, seeds: Path, folder: Path, rng: random.Random) -> Path:
    """Put a spoilt copy of the target's seed into a folder; return what is to be read."""
    seed = seeds / target.seed
    path = folder / seed.name
    if not target.inner:
        path.write_bytes(target.spoil(seed.read_bytes(), rng))
        return path
    shutil.copytree(seed, path)
    files = sorted(p for p in path.rglob("*" if target.inner == "*" else target.inner) if p.is_file())
    chosen = rng.choice(files)
    chosen.write_bytes(target.spoil(chosen.read_bytes(), rng))
    return path
