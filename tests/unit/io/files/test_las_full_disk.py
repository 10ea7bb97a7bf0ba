"""A disk that fills under the LAZ compressor, which tells no more than that it failed."""

import errno
import resource

import numpy as np
import pytest

from heliograph.atomic import atomic_path
from heliograph.errors import OutputError
from heliograph.io.files.cloud_stream import LasStream
from heliograph.io.files.las import write_las
from heliograph.survey.coordinates import find_coordinate_system
from heliograph.survey.las import write_survey_las

pytest.importorskip("lazrs")
TABLE = {axis: np.random.default_rng(1).normal(scale=30.0, size=60_000) for axis in "xyz"}


def stream(path):
    cloud = LasStream(path, {name: column.dtype for name, column in TABLE.items()}, (), 1.0)
    try:
        for _ in range(20):
            cloud.append(TABLE)
    finally:
        cloud.close()


def survey(path):
    p = np.stack(list(TABLE.values()), axis=1)
    write_survey_las(
        path,
        p,
        None,
        np.full(len(p), 1_700_000_000_000_000_000),
        find_coordinate_system("local", np.array([52.0, 11.0, 80.0])),
        "test",
    )


@pytest.mark.parametrize("suffix", [".laz", ".las"])
@pytest.mark.parametrize("write", [lambda path: write_las(path, TABLE, ()), stream, survey])
@pytest.mark.parametrize("room", [100, 100_000])
def test_full_disk_is_told_as_one(write, suffix, room, tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        with pytest.raises(OutputError) as caught, atomic_path(tmp_path / f"map{suffix}") as temporary:
            write(temporary)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    cause = caught.value.__cause__
    while isinstance(cause, OutputError):
        cause = cause.__cause__
    assert cause.errno == errno.EFBIG and str(tmp_path / f"map{suffix}") in str(caught.value)
    assert not list(tmp_path.iterdir())
