"""Every default of Heliograph, once: frozen dataclasses, read from and written to TOML."""

from heliograph.config.calibration import CalibrationConfig
from heliograph.config.checks import CheckConfig
from heliograph.config.files import InputConfig, OutputConfig
from heliograph.config.gnss import GnssConfig
from heliograph.config.loam import FeatureConfig, LoamConfig
from heliograph.config.localization import LocalizationConfig
from heliograph.config.loops import LoopConfig, PlacesConfig
from heliograph.config.odometry import CloudConfig, FilterConfig, ImuConfig, MapConfig
from heliograph.config.registration import AlignConfig, GlobalAlignConfig, KdTreeMapConfig
from heliograph.config.run import RunConfig
from heliograph.config.slam import SlamConfig
from heliograph.config.wheels import WheelConfig

__all__ = [
    "AlignConfig",
    "CalibrationConfig",
    "CheckConfig",
    "CloudConfig",
    "FeatureConfig",
    "FilterConfig",
    "GlobalAlignConfig",
    "GnssConfig",
    "ImuConfig",
    "InputConfig",
    "KdTreeMapConfig",
    "LoamConfig",
    "LocalizationConfig",
    "LoopConfig",
    "MapConfig",
    "OutputConfig",
    "PlacesConfig",
    "RunConfig",
    "SlamConfig",
    "WheelConfig",
]
