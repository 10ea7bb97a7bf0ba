"""Scenarios: every parameter of a simulated recording in one frozen record, kept as TOML beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any

import tomli_w

from heliograph.config_checks import check_range
from heliograph.config_toml import build
from heliograph.errors import ConfigError, closest
from heliograph.guard.toml import parse_toml
from heliograph.sim.places import PLACES
from heliograph.sim.receiver import GnssModel, GnssSpell
from heliograph.sim.sensors import ImuModel, LidarModel
from heliograph.sim.trajectory import Gait
from heliograph.sim.wheels import WheelModel

__all__ = ["SCENARIOS", "Mount", "Scenario", "Walk", "find_scenario", "from_toml", "to_toml"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Walk:
    """How the course is walked.

    Parameters
    ----------
    speed : float
        Cruising speed [m/s].
    rest : float
        Standing still before the start [s].
    ramp : float
        Duration of the smooth start and of the stop [s].
    after : float
        Standing still after the stop [s].
    begin : float
        The recording begins this long after the beginning of the rest, so a larger value than ``rest`` starts it in
        motion [s].
    duration : float
        Length of the recording; 0 means: to the end [s].
    """

    speed: float = 1.5
    rest: float = 4.0
    ramp: float = 2.0
    after: float = 1.0
    begin: float = 0.0
    duration: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "speed", "ramp", low=0.01, high=1000.0)
        check_range(self, "rest", "after", "begin", "duration", low=0.0, high=1e6)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """How the sensors sit on the walker.

    Parameters
    ----------
    rig_rpy_deg : (float, float, float)
        Roll, pitch, yaw of the whole rig (IMU and LiDAR together) against the upright body [deg].
    imu_rpy_deg : (float, float, float)
        Further turn of the IMU alone [deg].
    lever_arm : (float, float)
        Range of the distance between IMU and LiDAR; direction and length are drawn by the seed [m].
    rotation_deg : (float, float)
        Range of the LiDAR's rotation against the rig; axis and angle are drawn by the seed [deg].
    tf_static : bool
        Whether the recording tells the mounting.
    """

    rig_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    imu_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lever_arm: tuple[float, float] = (0.05, 0.10)
    rotation_deg: tuple[float, float] = (5.0, 20.0)
    tf_static: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """All of a simulated recording but its seed.

    Parameters
    ----------
    name : str
        Shown to people.
    place : str
        Key of `heliograph.sim.places.PLACES`: the world and the course.
    walk, gait, mount, lidar, imu, gnss, wheels
        See their classes.
    point_times : bool
        False drops the per-point times of the records that `simulate` yields (a file's layout decides for itself).
    """

    name: str = "warehouse"
    place: str = "warehouse"
    walk: Walk = field(default_factory=Walk)
    gait: Gait = field(default_factory=Gait)
    mount: Mount = field(default_factory=Mount)
    lidar: LidarModel = field(default_factory=LidarModel)
    imu: ImuModel = field(default_factory=ImuModel)
    gnss: GnssModel = field(default_factory=GnssModel)
    wheels: WheelModel = field(default_factory=WheelModel)
    point_times: bool = True

    def __post_init__(self) -> None:
        if self.place not in PLACES:
            raise ConfigError(
                f"place '{self.place}' is unknown; there are {', '.join(PLACES)}{closest(self.place, PLACES)}"
            )

    def thinned(
        self, *, beams: int | None = None, columns: int | None = None, duration: float | None = None
    ) -> Scenario:
        """Return the same scenario with fewer rays or a shorter recording, for tests."""
        lidar = replace(self.lidar, beams=beams or self.lidar.beams, columns=columns or self.lidar.columns)
        walk = self.walk if duration is None else replace(self.walk, duration=duration)
        return replace(self, lidar=lidar, walk=walk)

    def varied(self, **changes: Mapping[str, Any]) -> Scenario:
        """Return a copy with some fields of its parts changed.

        Examples
        --------
        >>> SCENARIOS["warehouse"].varied(mount={"tf_static": False}, imu={"rate": 50.0}).imu.rate
        50.0
        """
        return replace(self, **{part: replace(getattr(self, part), **values) for part, values in changes.items()})


def to_toml(scenario: Scenario) -> str:
    """Return the scenario as TOML; `from_toml` reads it back equal."""
    return tomli_w.dumps(asdict(scenario))


def from_toml(text: str) -> Scenario:
    """Read a scenario from TOML; what is left out keeps its default.

    Raises
    ------
    ConfigError
        If the text is not TOML, a key is unknown, or a value is of the wrong type.
    """
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise ConfigError(f"not a scenario in TOML: {error}") from error
    return build(Scenario, table)


def _registry() -> dict[str, Scenario]:
    warehouse = Scenario()
    indoors = LidarModel(beams=32, columns=360, elevation_deg=(-30.0, 30.0), min_range=0.3, max_range=40.0)
    short = Walk(speed=0.6, rest=1.5, ramp=1.5, duration=24.0)
    waved = Gait(frequency=1.1, bounce=0.08, lateral=0.10, roll_deg=18.0, pitch_deg=14.0, yaw_deg=22.0)
    slalom = Gait(frequency=1.0, bounce=0.0, lateral=0.12, roll_deg=0.0, pitch_deg=0.0, yaw_deg=25.0)
    usual = ImuModel(accel_bias=0.075)
    poor = ImuModel(gyro_noise=1e-3, accel_noise=1e-2, gyro_walk=5e-5, accel_walk=5e-4, gyro_bias=0.03, accel_bias=0.15)
    handheld = Gait(frequency=1.9, bounce=0.015, lateral=0.02, roll_deg=4.0, pitch_deg=3.0, yaw_deg=8.0)
    return {
        "warehouse": warehouse,
        "demo": Scenario(name="demo", place="aisles", walk=Walk(rest=3.0)).thinned(columns=512),
        "room": Scenario(
            name="room",
            place="room",
            walk=Walk(speed=0.8, rest=3.0, ramp=1.5),
            gait=handheld,
            lidar=LidarModel(beams=32, columns=512, elevation_deg=(-30.0, 30.0), min_range=0.3, max_range=40.0),
        ),
        "calibration": Scenario(name="calibration", place="room", walk=short, gait=waved, lidar=indoors),
        "planar": Scenario(name="planar", place="level_room", walk=short, gait=slalom, lidar=indoors),
        "tunnel": Scenario(name="tunnel", place="tunnel", gnss=GnssModel(rate=0.0)),
        "campus": Scenario(
            name="campus",
            place="campus",
            walk=Walk(speed=2.5),
            lidar=LidarModel(beams=32, columns=512, max_range=80.0),
        ),
        "warehouse-laps": Scenario(
            name="warehouse-laps",
            place="warehouse_laps",
            lidar=LidarModel(beams=16),
            imu=poor,
            gnss=GnssModel(rate=0.0),
        ),
        "aisle-laps": Scenario(
            name="aisle-laps",
            place="aisle_laps",
            lidar=LidarModel(beams=16, columns=256),
            imu=poor,
            gnss=GnssModel(rate=0.0),
        ),
        "storeys": Scenario(
            name="storeys",
            place="storeys",
            walk=Walk(speed=1.4),
            lidar=LidarModel(beams=32, columns=512, elevation_deg=(-30.0, 30.0), max_range=60.0),
            gnss=GnssModel(rate=0.0),
        ),
        **{scenario.name: scenario for scenario in _surveys()},
        **{scenario.name: scenario for scenario in _weakly_seen()},
        "field": Scenario(name="field", place="open_field").thinned(beams=32, columns=512),
        "traffic": Scenario(
            name="traffic",
            place="traffic",
            walk=Walk(speed=6.0, rest=3.0, ramp=3.0),
            gait=Gait(frequency=1.2, bounce=0.01, lateral=0.005, roll_deg=0.8, pitch_deg=0.8, yaw_deg=0.3),
            lidar=LidarModel(beams=32, columns=512, max_range=80.0),
        ),
        "forest": Scenario(name="forest", place="forest", walk=Walk(rest=3.0)).thinned(beams=32, columns=512),
        "rough": Scenario(
            name="rough",
            place="rough",
            walk=Walk(speed=1.0, rest=3.0),
            gait=Gait(frequency=1.4, bounce=0.03, lateral=0.02, roll_deg=6.0, pitch_deg=6.0, yaw_deg=4.0),
        ).thinned(beams=32, columns=512),
        "bare-field": Scenario(name="bare-field", place="bare_field").thinned(beams=32, columns=512),
        "level-straight": Scenario(
            name="level-straight", place="level_street", walk=Walk(duration=38.0), imu=usual
        ).thinned(beams=32, columns=512),
        "level-turns": Scenario(name="level-turns", place="level_aisles", imu=usual).thinned(beams=32, columns=512),
        **{scenario.name: scenario for scenario in _moving_starts()},
    }


def _surveys() -> Iterator[Scenario]:
    """Yield recordings whose receiver has good and bad spells, with an antenna that is not at the IMU."""
    car = Gait(frequency=1.3, bounce=0.01, lateral=0.01, roll_deg=0.6, pitch_deg=0.5, yaw_deg=0.6)
    sparse = LidarModel(beams=32, columns=512, max_range=90.0)
    spells = (
        GnssSpell(kind="outage", duration=60.0),
        GnssSpell(kind="multipath", duration=20.0, size=15.0),
        GnssSpell(kind="jump", duration=3.0, size=8.0),
        GnssSpell(kind="jump", duration=5.0, size=30.0),
        GnssSpell(kind="frozen", duration=8.0),
    )
    single = GnssModel(noise_horizontal=1.0, noise_vertical=2.0, antenna=(-0.4, 0.2, 0.7), spells=spells)
    fixed = replace(single, solution="fixed", noise_horizontal=0.02, noise_vertical=0.03)
    for name, place, speed in (("survey-campus", "campus", 2.5), ("city-loop", "city", 8.0)):
        walk = Walk(speed=speed, rest=3.0, ramp=3.0)
        gait = car if place == "city" else Gait()
        yield Scenario(name=name, place=place, walk=walk, gait=gait, lidar=sparse, gnss=single)
        yield Scenario(name=f"{name}-rtk", place=place, walk=walk, gait=gait, lidar=sparse, gnss=fixed)


def _weakly_seen() -> Iterator[Scenario]:
    """Yield recordings of which one direction is not seen at all for a while."""
    car = Gait(frequency=1.3, bounce=0.01, lateral=0.01, roll_deg=0.6, pitch_deg=0.5, yaw_deg=0.6)
    sparse = LidarModel(beams=32, columns=512, max_range=90.0)
    drive = Walk(speed=3.0, rest=3.0, ramp=3.0)
    yield Scenario(
        name="long-tunnel", place="long_tunnel", walk=drive, gait=car, lidar=sparse, gnss=GnssModel(rate=0.0)
    )
    wheels = WheelModel(rate=50.0, scale=1.03, slips=3)
    yield Scenario(
        name="tunnel-wheels", place="long_tunnel", walk=drive, gait=car, lidar=sparse, gnss=GnssModel(rate=0.0),
        wheels=wheels,
    )  # fmt: skip
    legs = WheelModel(rate=100.0, scale=1.03, noise=0.05, legs=True)
    yield Scenario(
        name="tunnel-legs", place="long_tunnel", walk=Walk(speed=1.5, rest=3.0, ramp=2.0), lidar=sparse,
        gnss=GnssModel(rate=0.0), wheels=legs,
    )  # fmt: skip


def _moving_starts() -> Iterator[Scenario]:
    """Yield recordings that begin in motion; ``walk.begin`` 0 makes of each the same course with a rest before it."""
    wheels = Gait(bounce=0.0, lateral=0.0, roll_deg=0.0, pitch_deg=0.0, yaw_deg=0.0)
    shaken = Gait(frequency=3.0, bounce=0.02, lateral=0.02, roll_deg=8.0, pitch_deg=6.0, yaw_deg=12.0)
    yield Scenario(name="start-constant", place="aisles", gait=wheels, walk=Walk(begin=6.5, duration=15.0)).thinned(
        columns=512
    )
    yield Scenario(name="start-turning", place="aisles", gait=wheels, walk=Walk(begin=12.6, duration=15.0)).thinned(
        columns=512
    )
    yield Scenario(
        name="start-shaking",
        place="room",
        walk=Walk(speed=0.8, rest=3.0, ramp=1.5, begin=6.3, duration=15.0),
        gait=shaken,
        lidar=LidarModel(beams=32, columns=512, elevation_deg=(-30.0, 30.0), min_range=0.3, max_range=40.0),
    )
    yield Scenario(
        name="start-vehicle",
        place="street",
        gait=wheels,
        walk=Walk(speed=15.0, rest=3.0, ramp=4.0, begin=8.0, duration=15.0),
    ).thinned(columns=512)


SCENARIOS: MappingProxyType[str, Scenario] = MappingProxyType(_registry())


def find_scenario(name: str) -> Scenario:
    """Return a scenario by name, or raise `ConfigError` with the names there are."""
    if name not in SCENARIOS:
        raise ConfigError(f"scenario '{name}' is unknown; there are {', '.join(SCENARIOS)}{closest(name, SCENARIOS)}")
    return SCENARIOS[name]
