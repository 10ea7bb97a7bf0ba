"""What ``--wheels`` names: a file, or a topic of the recording."""

import pytest

from heliograph.cli.options import wheel_options
from heliograph.config import RunConfig, WheelConfig
from heliograph.errors import DataError
from heliograph.pipeline import wheel_speeds


def test_wheels_are_a_file_where_one_is_there_and_else_a_topic(tmp_path):
    path = tmp_path / "wheels.csv"
    path.write_text("stamp,vx\n1.0,2.0\n")
    assert wheel_options(None) == {}
    assert wheel_options(str(path)) == {"file": str(path), "topic": ""}
    assert wheel_options("/wheels/odometry") == {"file": "", "topic": "/wheels/odometry"}
    assert wheel_options("missing.csv") == {"file": "missing.csv", "topic": ""}


def test_a_live_source_has_no_topic_of_wheels():
    with pytest.raises(DataError, match="live source"):
        wheel_speeds(object(), RunConfig(wheels=WheelConfig(topic="/wheels")))
