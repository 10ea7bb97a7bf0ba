"""What reads the spoilt files: the commands, and the loaders that no command reaches."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from tests.fuzz.containers import in_bag, in_frame, in_head, in_las, in_mcap, in_pcap, in_shapes
from tests.fuzz.folders import in_json, in_keyframe, in_nest
from tests.fuzz.messages import in_fields
from tests.fuzz.mutations import in_archive, in_database, in_messages, in_text, in_tree, of_bytes

from heliograph.cli.main import main
from heliograph.config import InputConfig
from heliograph.errors import HeliographError
from heliograph.graph import ISAM2, Between, Diagonal, FactorGraph, Values
from heliograph.graph.files.archive import load_graph
from heliograph.io import open_recording
from heliograph.lie import SE3

__all__ = ["TARGETS", "Target", "place", "sound"]

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
    spoil_folder: Callable[[Path, random.Random], None] | None = None  # instead, where files belong together
    threads: bool = False  # whether a library that reads it starts threads

    @property
    def warms(self) -> object:
        """What a process that has read it knows: targets that are alike in it warm the same."""
        return (self.seed, self.read)


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


def answered(read: Callable[[Path], bool]) -> Callable[[Path], bool]:
    """Return a reader for which a refusal of the sound seed, too, is an answer."""

    def guarded(path: Path) -> bool:
        read(path)
        return True

    return guarded


def loader(name: str, *arguments: object, **keywords: object) -> Callable[[Path], bool]:
    """Return a reader: the function ``module:name``, called with the path."""
    module, _, function = name.partition(":")

    def read(path: Path) -> bool:
        getattr(import_module(module), function)(path, *arguments, **keywords)
        return True

    return quietly(read)


def mounted(path: Path) -> bool:
    """Open a recording with a mounting from the file."""
    config = InputConfig(extrinsic=str(path))
    with open_recording(Path(os.environ["FUZZ_SEEDS"]) / "plain.bag", config) as recording:
        recording.summary()
    return True


def control_points(path: Path) -> bool:
    """Read control points of the seeds' run."""
    from heliograph.survey import open_placed_run
    from heliograph.survey.control import read_control_points

    read_control_points(path, open_placed_run(Path(os.environ["FUZZ_SEEDS"]) / "run"))
    return True


def submaps(path: Path) -> bool:
    """Read what the map of a run is made of."""
    from heliograph.output.submaps import read_submaps, read_voxel

    read_voxel(path)
    return len([submap.T_odom_imu for submap in read_submaps(path)]) > 0


def quick_run(option: str) -> Callable[[Path], bool]:
    """Return a reader: a short run with the file as an option, where the estimation is not the point."""
    short = ("-o", "{out}", "--no-graph", "--duration", "0.4", "--threads", "1")
    return command("run", "{seeds}/ouster.mcap", option, "{}", *short)


INFO = command("info", "{}", "--json")
RUN = command("run", "{}", "-o", "{out}", "--threads", "1", "--json")
SIMULATE = command("simulate", "{}", "-o", "{out}", "--duration", "0.2")
CHECK = command("check", "{}", "--imu", "--json")
STREAM = quietly(stream)
LOOPS = command("loops", "{}", "--json")


def _recordings() -> list[Target]:
    return [
        Target("mcap bytes", "short-ouster.mcap", of_bytes, STREAM, 20),
        Target("mcap messages", "short-ouster.mcap", in_messages, STREAM, 30),
        Target("mcap fields", "short-ouster.mcap", in_fields, STREAM, 40),
        Target("mcap records", "short-ouster.mcap", in_mcap, STREAM, 20),
        Target("livox messages", "short-livox-custom.mcap", in_messages, STREAM, 15),
        Target("livox fields", "short-livox-custom.mcap", in_fields, STREAM, 20),
        Target("mcap chunks", "chunked.mcap", of_bytes, STREAM, 20),
        Target("mcap inside chunks", "chunked.mcap", in_mcap, STREAM, 40),
        Target("ros 1 bag", "plain.bag", of_bytes, STREAM, 20),
        Target("ros 1 bag bz2", "bz2.bag", of_bytes, STREAM, 10),
        Target("ros 1 bag lz4", "lz4.bag", of_bytes, STREAM, 10),
        Target("ros 1 records", "plain.bag", in_bag, STREAM, 20),
        Target("ros 1 records bz2", "bz2.bag", in_bag, STREAM, 15),
        Target("ros 1 records lz4", "lz4.bag", in_bag, STREAM, 15),
        Target("sqlite", "plain.db3", spoilt_database, STREAM, 25),
        Target("zstd messages", "sqlite3_message", of_bytes, STREAM, 8, "*"),
        Target("zstd file", "packed.mcap.zstd", of_bytes, STREAM, 10),
        Target("zstd frames", "packed.mcap.zstd", in_frame, STREAM, 15),
        Target("zstd folder", "mcap_file", in_text, STREAM, 8, "metadata.yaml"),
        Target("metadata", "sqlite3_", in_text, STREAM, 6, "metadata.yaml"),
        Target("metadata nested", "sqlite3_", in_nest, STREAM, 4, "metadata.yaml"),
        Target("velodyne pcap", "velodyne.pcap", of_bytes, STREAM, 12),
        Target("velodyne packets", "velodyne.pcap", in_pcap, STREAM, 20),
        Target("clouds", "clouds", of_bytes, STREAM, 10, "*"),
        Target("stamps", "clouds", in_text, STREAM, 6, "times.txt"),
        Target("kitti", "kitti", in_text, STREAM, 10, "*"),
        Target("info", "ouster.mcap", in_fields, INFO, 8),
        Target("info chunks", "chunked.mcap", in_mcap, INFO, 5),
        Target("run", "ouster.mcap", in_messages, RUN, 1),
        Target("run fields", "ouster.mcap", in_fields, RUN, 2),
        Target("run livox", "livox-custom.mcap", in_fields, RUN, 1),
        Target("check", "ouster.mcap", in_messages, CHECK, 4),
        Target("check fields", "ouster.mcap", in_fields, CHECK, 4),
    ]


def _tables() -> list[Target]:
    fixes, wheels = (loader(f"heliograph.io.files.{name}") for name in ("fixes:read_fixes", "wheels:read_wheel_speeds"))
    return [
        Target("imu table", "imu.csv", in_text, command("check", "{}", "--imu"), 10),
        Target("imu noise", "imu.csv", in_text, command("calibrate", "--noise", "{}", "-o", "{out}"), 3),
        Target("run imu", "imu.csv", in_text, command("run", "{}", "--sensors", "imu", "-o", "{out}"), 4),
        Target("evaluate", "poses.tum", in_text, command("evaluate", "{}", "{}"), 10),
        Target("evaluate kitti", "poses.kitti", in_text, command("evaluate", "{}", "{}"), 6),
        Target("given poses", "poses.tum", in_text, quick_run("--odometry"), 3),
        Target("fixes csv", "fixes.csv", in_text, fixes, 6),
        Target("fixes nmea", "fixes.nmea", in_text, fixes, 6),
        Target("fixes pos", "fixes.pos", in_text, fixes, 6),
        Target("run with fixes", "fixes.csv", in_text, quick_run("--gnss"), 2),
        Target("wheels", "wheels.csv", in_text, wheels, 6),
        Target("control points", "control.csv", in_text, quietly(control_points), 6),
        Target("scenario", "scenario.toml", in_text, SIMULATE, 4),
        Target("scenario nested", "scenario.toml", in_nest, SIMULATE, 2),
        Target("config", "config.toml", in_text, quick_run("--config"), 3),
        Target("extrinsic", "extrinsic.toml", in_text, quietly(mounted), 10),
        Target("extrinsic nested", "extrinsic.toml", in_nest, quietly(mounted), 4),
        Target("fast-lio params", "params.yaml", in_text, quietly(mounted), 8),
        Target("params nested", "params.yaml", in_nest, quietly(mounted), 6),
    ]  # fmt: skip


def _graphs() -> list[Target]:
    return [
        Target("g2o", "graph.g2o", in_text, command("solve", "{}", "--json"), 12),
        Target("g2o in space", "spatial.g2o", in_text, command("solve", "{}", "-o", "{out}.g2o"), 10),
        Target("g2o one by one", "graph.g2o", in_text, command("solve", "{}", "--solver", "isam2"), 6),
        Target("toro", "graph.toro", in_text, command("solve", "{}", "--json"), 8),
        Target("graph archive", "graph.npz", in_archive, quietly(graph_archive), 20),
        Target("graph shapes", "graph.npz", in_shapes, quietly(graph_archive), 12),
        Target("solve archive", "graph.npz", in_archive, command("solve", "{}"), 8),
        Target("smoother", "plain.isam2", in_archive, quietly(smoother), 20),
        Target("smoother robust", "robust.isam2", in_archive, quietly(smoother), 15),
        Target("smoother shapes", "robust.isam2", in_shapes, quietly(smoother), 12),
        Target("tree", "plain.isam2", in_tree, quietly(smoother), 40),
        Target("tree robust", "robust.isam2", in_tree, quietly(smoother), 40),
        Target("tree open", "open.isam2", in_tree, quietly(smoother), 40),
    ]


def _runs() -> list[Target]:
    survey = command("survey", "{}", "--crs", "local", "--json")
    return [
        Target("loops", "run", in_text, LOOPS, 8, "*"),
        Target("loops bytes", "run", of_bytes, command("loops", "{}", "--all"), 6, "*"),
        Target("loop explained", "run", in_text, command("loops", "{}", "--explain", "0"), 3, "loops.csv"),
        Target("loop joined", "run", of_bytes, command("loops", "{}", "--add", "0", "1"), 4, "*"),
        Target("keyframes", "run", of_bytes, command("loops", "{}", "--add", "0", "1"), 5, spoil_folder=in_keyframe),
        Target("run's graph", "run", in_archive, command("loops", "{}", "--add", "0", "1"), 4, "graph.npz"),
        Target("run checked", "run", in_json, command("check", "{}", "--json"), 8, "run.json"),
        Target("run shown", "run", in_text, command("check", "{}"), 4, "run.json"),
        Target("compare", "run", in_text, command("compare", "{}", "{seeds}/run"), 4, "*"),
        Target("compare accounts", "run", in_json, command("compare", "{}", "{seeds}/run", "--json"), 4, "run.json"),
        Target("support", "run", in_json, command("support", "{}", "-o", "{out}.zip"), 4, "run.json"),
        Target("support bytes", "run", of_bytes, command("support", "{}", "-o", "{out}.zip"), 3, "*"),
        Target("survey", "run", in_text, survey, 4, "*"),
        Target("survey account", "run", in_json, survey, 3, "run.json"),
        Target("submaps", "run/submaps.bin", of_bytes, quietly(submaps), 8),
    ]


def _later() -> list[Target]:
    """What is done with the folders of runs afterwards."""
    merge = answered(command("merge", "{}", "{seeds}/run", "-o", "{out}"))  # too small a map to be linked for sure
    edit = command("edit", "{}", "{seeds}/plan.toml")
    short = ("-o", "{out}", "--duration", "0.4", "--threads", "1", "-q")
    localize = command("localize", "{seeds}/ouster.mcap", "--map", "{}", *short)
    return [
        Target("merge", "run", in_text, merge, 3, "*"),
        Target("merge bytes", "run", of_bytes, merge, 3, "*"),
        Target("merge account", "run", in_json, merge, 3, "run.json"),
        Target("edit", "run", in_text, edit, 3, "*"),
        Target("edit bytes", "run", of_bytes, edit, 3, "*"),
        Target("edit account", "run", in_json, edit, 2, "run.json"),
        Target("plan", "plan.toml", in_text, loader("heliograph.edits:read_edits"), 6),
        Target("plan nested", "plan.toml", in_nest, loader("heliograph.edits:read_edits"), 4),
        Target("map of a run", "run", of_bytes, localize, 2, "*"),
        Target("map account", "run", in_json, localize, 2, "run.json"),
        Target("map keyframes", "run", of_bytes, localize, 2, spoil_folder=in_keyframe),
        Target("map cloud", "run/map.ply", in_head, localize, 2),
    ]


def _clouds() -> list[Target]:
    found = [Target("cloud.xyz", "cloud.xyz", in_text, command("align", "{}", "{}"), 5)]
    for suffix in ("ply", "pcd"):
        found.append(Target(f"cloud.{suffix}", f"cloud.{suffix}", of_bytes, command("align", "{}", "{}"), 8))
        found.append(Target(f"head of cloud.{suffix}", f"cloud.{suffix}", in_head, command("align", "{}", "{}"), 10))
    for suffix in ("las", "laz"):
        name, align = f"cloud.{suffix}", command("align", "{}", "{}")
        found.append(Target(name, name, of_bytes, align, 6, threads=True))
        found.append(Target(f"head of {name}", name, in_las, align, 8, threads=True))
    for name in ("ascii.ply", "ascii.pcd", "packed.pcd"):
        found.append(Target(name, name, in_text, command("align", "{}", "{}"), 8))
        found.append(Target(f"head of {name}", name, in_head, command("align", "{}", "{}"), 8))
    return found


_DECODERS = {"velodyne": "velodyne_decoder"}  # extras without which a file is refused, sound or not
TARGETS = [
    target for target in (*_recordings(), *_tables(), *_graphs(), *_runs(), *_clouds(), *_later())
    if all(find_spec(decoder) for name, decoder in _DECODERS.items() if target.name.startswith(name))
]  # fmt: skip


def sound(target: Target) -> Target:
    """Return the target with its seed unspoilt."""
    untouched = None if target.spoil_folder is None else (lambda _folder, _rng: None)
    return replace(target, spoil=lambda data, _: data, spoil_folder=untouched)


def place(target: Target, seeds: Path, folder: Path, rng: random.Random) -> Path:
    """Put a spoilt copy of the target's seed into a folder; return what is to be read."""
    seed = seeds / target.seed
    path = folder / seed.name
    if target.spoil_folder is not None:
        shutil.copytree(seed, path)
        target.spoil_folder(path, rng)
        return path
    if not target.inner:
        path.write_bytes(target.spoil(seed.read_bytes(), rng))
        return path
    shutil.copytree(seed, path)
    files = sorted(p for p in path.rglob("*" if target.inner == "*" else target.inner) if p.is_file())
    chosen = rng.choice(files)
    chosen.write_bytes(target.spoil(chosen.read_bytes(), rng))
    return path
