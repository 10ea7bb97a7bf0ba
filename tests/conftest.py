"""Fixtures that every test shares: seeded randomness and the real recordings."""

from pathlib import Path

import numpy as np
import pytest

SHARED_DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    if not SHARED_DATA.is_dir():
        pytest.skip(f"the real recordings are not at {SHARED_DATA}")
    return SHARED_DATA


@pytest.fixture(autouse=True, scope="session")
def silent_activity():
    """Keep what a slow command is at from the errors that tests read: how slow it is hangs on the machine."""
    from heliograph.cli import activity

    before, activity.LINE_SECONDS = activity.LINE_SECONDS, float("inf")
    yield
    activity.LINE_SECONDS = before
