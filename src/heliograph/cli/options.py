"""Command-line options that several commands share, and how they become a configuration."""

from __future__ import annotations

import sys
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heliograph.cli.help import Page

if TYPE_CHECKING:
    from heliograph.config import RunConfig

__all__ = ["MapFormat", "PluggableCommand", "build_config", "input_options", "sensor_list"]

Recordings = Annotated[
    list[Path],
    typer.Argument(metavar="RECORDING", help="A bag, an MCAP file, a pcap, a folder, or several that belong together."),
]
Reader = Annotated[
    str | None,
    typer.Option("--reader", metavar="NAME", help="Reader of the recording; default: the first that knows it."),
]
LidarTopic = Annotated[
    str | None, typer.Option("--lidar-topic", metavar="TOPIC", help="LiDAR topic, where there are several.")
]
ImuTopic = Annotated[
    str | None, typer.Option("--imu-topic", metavar="TOPIC", help="IMU topic, where there are several.")
]
Extrinsic = Annotated[
    Path | None,
    typer.Option("--extrinsic", metavar="FILE", help="TOML with T_imu_lidar, or FAST-LIO2's or LIO-SAM's params.yaml."),
]
Start = Annotated[float | None, typer.Option("--start", metavar="S", min=0.0, help="Skip the first S seconds.")]
Duration = Annotated[float | None, typer.Option("--duration", metavar="S", min=0.0, help="Use only S seconds.")]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="TOML with settings; see config.toml of any run.")
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as output.map_voxel=0.2; repeatable."),
]
Threads = Annotated[int | None, typer.Option("--threads", metavar="N", min=0, help="Default: min(2, cores).")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object to standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no closing lines; only warnings and errors.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an earlier run in the output folder.")]


class PluggableCommand(Page):
    """A command whose help lists the readers and odometries that are registered or installed."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:  # noqa: ANN401 - typer's own click has no public types
        """Write the names under the options."""
        from heliograph.io import reader_names
        from heliograph.odometry import odometry_names

        lists = {"reader": reader_names(), "odometry": odometry_names()}
        options = {parameter.name for parameter in self.params}
        with formatter.section("Names"):
            formatter.write_dl([
                (f"--{option}", f"{', '.join(names)}, or module:name of one's own in the current folder")
                for option, names in lists.items()
                if option in options
            ])  # fmt: skip
        super().format_epilog(ctx, formatter)


class MapFormat(str, Enum):
    """Formats of the map file."""

    ply = "ply"
    pcd = "pcd"
    laz = "laz"


def build_config(
    config_file: Path | None,
    settings: list[str] | None,
    *,
    run: dict[str, Any] | None = None,
    input: dict[str, Any] | None = None,
    output: dict[str, Any] | None = None,
    slam: dict[str, Any] | None = None,
    gnss: dict[str, Any] | None = None,
    wheels: dict[str, Any] | None = None,
) -> RunConfig:
    """Return the defaults, overlaid with the file, then ``--set``, then the options that were given (not None).

    Raises
    ------
    ConfigError
        Unknown key or wrong type, with a suggestion.
    """
    from heliograph.config import RunConfig
    from heliograph.config_toml import apply_overrides, load_config

    config = RunConfig() if config_file is None else load_config(config_file)
    config = apply_overrides(config, settings or [])
    sections = {
        "input": _given(input),
        "output": _given(output),
        "slam": _given(slam),
        "gnss": _given(gnss),
        "wheels": _given(wheels),
    }
    changed = {name: replace(getattr(config, name), **values) for name, values in sections.items() if values}
    config = replace(config, **changed, **_given(run))
    if ":" in config.odometry + config.input.reader and (here := str(Path.cwd())) not in sys.path:
        sys.path.append(here)  # a user's own module lies where the command is typed; behind all else, it hides nothing
    return config


def input_options(
    lidar_topic: str | None,
    imu_topic: str | None,
    extrinsic: Path | None,
    start: float | None,
    duration: float | None,
    reader: str | None = None,
) -> dict[str, Any]:
    """Return the options that say how a recording is read, by their names in the configuration."""
    return {
        "reader": reader,
        "lidar_topic": lidar_topic,
        "imu_topic": imu_topic,
        "extrinsic": None if extrinsic is None else str(extrinsic),
        "start": start,
        "duration": duration,
    }


def wheel_options(given: str | None) -> dict[str, Any]:
    """Return what ``--wheels`` names: a file that is there, or else a topic where it looks like one."""
    if given is None:
        return {}
    is_topic = given.startswith("/") and not Path(given).exists()
    return {"file": "", "topic": given} if is_topic else {"file": given, "topic": ""}


def sensor_list(text: str | None) -> str | None:
    """Return ``"imu, lidar"`` as ``"lidar,imu"``: the order in which they are named does not matter."""
    if text is None or text == "auto":
        return text
    names = {name.strip() for name in text.split(",") if name.strip()}
    return ",".join(sorted(names, key=lambda name: (name != "lidar", name)))


def _given(values: dict[str, Any] | None) -> dict[str, Any]:
    return {name: value for name, value in (values or {}).items() if value is not None}
