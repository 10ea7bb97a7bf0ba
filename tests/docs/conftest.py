"""A short simulated recording for what the documentation shows."""

from pathlib import Path

import pytest

from heliograph.sim import SCENARIOS
from heliograph.sim.write import write_recording


@pytest.fixture(scope="session")
def short_recording(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("docs") / "drive"
    write_recording(folder, SCENARIOS["room"].thinned(beams=16, columns=256, duration=4.0), seed=1)
    return folder
