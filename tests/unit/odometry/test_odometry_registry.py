import pytest

from fakes import FakeOdometry, FakeRecording
from heliograph.config import RunConfig
from heliograph.errors import ConfigError
from heliograph.odometry import ODOMETRIES, FilterOdometry, make_odometry, odometry_names, register_odometry

RIG = FakeRecording(1).rig
BOTH = frozenset({"lidar", "imu"})


@pytest.fixture(autouse=True)
def restored():
    before = dict(ODOMETRIES)
    yield
    ODOMETRIES.clear()
    ODOMETRIES.update(before)


def test_odometry_by_default_is_the_filter():
    assert isinstance(make_odometry(RunConfig(), RIG, BOTH, 1), FilterOdometry)


def test_registered_odometry_is_made_with_what_the_run_has():
    given = []
    register_odometry("mine", lambda *arguments: given.append(arguments) or FakeOdometry())
    config = RunConfig(odometry="mine")
    assert isinstance(make_odometry(config, RIG, BOTH, 2), FakeOdometry)
    assert given == [(config, RIG, BOTH, 2)]
    assert odometry_names() == ["filter", "loam", "mine"]


def test_odometry_of_a_module_is_imported():
    register_odometry("text", "fakes:FakeOdometry")
    with pytest.raises(
        ConfigError, match="TypeError"
    ):  # found and called, with arguments that this class does not take
        make_odometry(RunConfig(odometry="text"), RIG, BOTH, 1)
    with pytest.raises(ConfigError, match="is no function that makes one, but a int"):
        make_odometry(RunConfig(odometry="fakes:PERIOD_NS"), RIG, BOTH, 1)


def test_odometry_wrong_names_are_told():
    with pytest.raises(ConfigError, match=r"odometry 'fitler' is not one of filter.*did you mean 'filter'"):
        make_odometry(RunConfig(odometry="fitler"), RIG, BOTH, 1)
    for name in ("", "a:b"):
        with pytest.raises(ConfigError, match="cannot name an odometry"):
            register_odometry(name, FakeOdometry)


def test_odometry_without_a_sensor_is_refused():
    with pytest.raises(ConfigError, match="neither a LiDAR nor an IMU"):
        make_odometry(RunConfig(), RIG, frozenset({"gnss"}), 1)


def broken(*_arguments):
    raise KeyError("no such thing")


@pytest.mark.parametrize(
    ("factory", "words"),
    [
        (lambda *_: 5, r"odometry 'mine' made a int without add, events, finish, leveling, start"),
        (broken, r"odometry 'mine' could not be made \(KeyError: 'no such thing'\)"),
        (lambda: None, r"could not be made \(TypeError: .*it was called with 4 arguments"),
    ],
)
def test_factory_that_makes_no_odometry_is_told_in_one_line(factory, words):
    register_odometry("mine", factory)
    with pytest.raises(ConfigError, match=words):
        make_odometry(RunConfig(odometry="mine"), RIG, BOTH, 1)


def test_defects_of_our_own_factory_are_not_hidden(monkeypatch):
    def fails(*_arguments, **_settings):
        raise KeyError("a defect")

    monkeypatch.setattr("heliograph.odometry.registry.FilterOdometry", fails)
    with pytest.raises(KeyError, match="a defect"):
        make_odometry(RunConfig(), RIG, BOTH, 1)
