"""Scenarios as records and as TOML."""

import pytest

from heliograph.errors import ConfigError
from heliograph.sim import SCENARIOS, find_scenario
from heliograph.sim.scenario import Scenario, from_toml, to_toml


@pytest.mark.parametrize("name", SCENARIOS)
def test_toml_round_trip_is_exact(name):
    scenario = SCENARIOS[name].varied(mount={"imu_rpy_deg": (90.0, 0.0, 1.0 / 3.0), "tf_static": False})
    assert from_toml(to_toml(scenario)) == scenario
    assert scenario != SCENARIOS[name]


def test_toml_keeps_defaults_for_what_it_leaves_out():
    assert from_toml("[lidar]\nbeams = 16\n") == Scenario().thinned(beams=16)


def test_unknown_key_is_named_with_the_nearest():
    with pytest.raises(ConfigError, match="beams"):
        from_toml("[lidar]\nbeam = 16\n")


def test_unknown_place_and_scenario_list_the_known():
    with pytest.raises(ConfigError, match="warehouse"):
        Scenario(place="warehose")
    with pytest.raises(ConfigError, match="did you mean 'tunnel'"):
        find_scenario("tunel")


def test_text_that_is_not_toml_is_refused():
    with pytest.raises(ConfigError, match="TOML"):
        from_toml("beams: 3")


def test_warehouse_has_the_figures_of_its_specification():
    s = SCENARIOS["warehouse"]
    assert (s.lidar.beams, s.lidar.columns, s.lidar.rate) == (64, 1024, 10.0)
    assert (s.lidar.range_noise, s.lidar.dropout) == (0.02, 0.01)
    assert (s.imu.rate, s.imu.gyro_noise, s.imu.accel_noise) == (200.0, 2e-4, 2e-3)
    assert (s.imu.gyro_bias, s.imu.accel_bias) == (0.01, 0.05)
    assert min(s.imu.gyro_walk, s.imu.accel_walk) > 0.0
    assert (s.mount.lever_arm, s.mount.rotation_deg) == ((0.05, 0.10), (5.0, 20.0))
    assert (s.gait.bounce, s.gait.frequency) == (0.02, 1.8)
    assert s.walk.speed == 1.5
    assert s.walk.rest >= 3.0


@pytest.mark.parametrize(
    "text",
    ["[walk]\nspeed = 0.0", "[imu]\nrate = 1e12", "[lidar]\nrate = 0.0", "[lidar]\nbeams = 0", "[gnss]\nrate = -1.0",
     "[walk]\nramp = 0.0", "[wheels]\nslips = -1", "[imu]\nrate = nan"],
)  # fmt: skip
def test_scenario_that_cannot_be_is_refused_in_one_line(text):
    with pytest.raises(ConfigError) as caught:
        from_toml(text)
    assert "\n" not in str(caught.value)
