"""All of a run's settings in one record."""

from __future__ import annotations

from dataclasses import dataclass, field

from heliograph.config.calibration import CalibrationConfig
from heliograph.config.checks import CheckConfig
from heliograph.config.files import InputConfig, OutputConfig
from heliograph.config.gnss import GnssConfig
from heliograph.config.loam import LoamConfig
from heliograph.config.localization import LocalizationConfig
from heliograph.config.loops import LoopConfig, PlacesConfig
from heliograph.config.odometry import CloudConfig, FilterConfig, ImuConfig, MapConfig
from heliograph.config.slam import SlamConfig
from heliograph.config.wheels import WheelConfig
from heliograph.config_checks import check_choice, check_range

__all__ = ["RunConfig"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """All of a run.

    Parameters
    ----------
    odometry : str
        ``"filter"``, ``"loam"``, a name that was registered, or ``"module:factory"`` of one's own, which is imported;
        see docs/howto/plug_in.md.
    sensors : str
        ``"auto"`` (what the recording holds), ``"lidar,imu"``, ``"lidar"`` or ``"imu"``.
    threads : int
        0 means the smaller of 2 and the number of cores.
    """

    odometry: str = "filter"
    sensors: str = "auto"
    threads: int = 0
    input: InputConfig = field(default_factory=InputConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    cloud: CloudConfig = field(default_factory=CloudConfig)
    map: MapConfig = field(default_factory=MapConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
    loam: LoamConfig = field(default_factory=LoamConfig)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    slam: SlamConfig = field(default_factory=SlamConfig)
    places: PlacesConfig = field(default_factory=PlacesConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    gnss: GnssConfig = field(default_factory=GnssConfig)
    wheels: WheelConfig = field(default_factory=WheelConfig)
    localization: LocalizationConfig = field(default_factory=LocalizationConfig)
    check: CheckConfig = field(default_factory=CheckConfig)
    output: OutputConfig = field(default_factory=OutputConfig)

    def __post_init__(self) -> None:
        check_choice(self, "sensors", "auto", "lidar,imu", "lidar", "imu")
        check_range(self, "threads", low=0)
