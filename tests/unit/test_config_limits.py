"""Numbers that would divide by zero or make no sense are refused where they are given."""

import pytest

from heliograph.config import RunConfig
from heliograph.config_toml import apply_overrides
from heliograph.errors import ConfigError


@pytest.mark.parametrize(
    "setting",
    [
        "cloud.target_points=0",
        "cloud.deskew=maybe",
        "map.voxel=0.0",
        "map.levels=9",
        "filter.correlation=0.0",
        "filter.residual=line",
        "imu.max_step=0.0",
        "input.max_probe=0.0",
        "check.max_missing=1.5",
        "check.max_mounting_deg=181.0",
        "calibration.plane_gate=0.0",
    ],
)
def test_estimator_settings_out_of_range_are_refused_by_name(setting):
    with pytest.raises(ConfigError, match=setting.split("=")[0]):
        apply_overrides(RunConfig(), [setting])
