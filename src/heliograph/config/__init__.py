"""Every default of Heliograph, once: frozen dataclasses, read from and written to TOML."""

from heliograph.config.calibration import CalibrationConfig
from heliograph.config.checks import CheckConfig
from heliograph.config.files import InputConfig, OutputConfig
from heliograph.config.loops import LoopConfig, PlacesConfig
from heliograph.config.odometry import CloudConfig, FilterConfig, ImuConfig, MapConfig
from heliograph.config.registration import AlignConfig, GlobalAlignConfig, KdTreeMapConfig
from heliograph.config.run import RunConfig

__all__ = [
    "AlignConfig",
    "CalibrationConfig",
    "CheckConfig",
    "CloudConfig",
    "FilterConfig",
    "GlobalAlignConfig",
    "ImuConfig",
    "InputConfig",
    "KdTreeMapConfig",
    "LoopConfig",
    "MapConfig",
    "OutputConfig",
    "PlacesConfig",
    "RunConfig",
]
