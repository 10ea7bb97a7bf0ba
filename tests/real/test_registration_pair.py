"""The real pair of scans: one basin from every start (its truth is another system's answer, so only loosely held)."""

from pathlib import Path

import numpy as np
import pytest
from tests import scenes

from heliograph.io.files.clouds import read_cloud
from heliograph.lie import se3
from heliograph.registration import align

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "registration"
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not DATA.exists(), reason="../shared/data/registration is not there"),
]


@pytest.mark.parametrize("method", ["gicp", "vgicp", "point-to-plane"])
def test_real_pair_settles_in_one_basin_from_every_start(method):
    target, source = (read_cloud(DATA / f"{name}.ply").points for name in ("target", "source"))
    truth, rng = np.loadtxt(DATA / "T_target_source.txt"), np.random.default_rng(0)
    poses = []
    for _ in range(10):
        start = truth @ scenes.random_motion(rng, 0.5, np.radians(10.0))
        result = align(target, source, start=start, method=method)
        assert result.status == "converged"
        poses.append(result.T_target_source)
        error = se3.log(se3.inverse(truth) @ poses[-1])
        assert np.linalg.norm(error[3:]) < 0.05 and np.linalg.norm(error[:3]) < np.radians(0.5)
    assert max(np.linalg.norm(se3.log(se3.inverse(poses[0]) @ T)) for T in poses) < 1e-3
