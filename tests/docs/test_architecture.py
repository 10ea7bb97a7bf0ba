"""The page on the architecture knows every room."""

from pathlib import Path

import pytest
from tests.rooms import STOREYS, picture

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "architecture.md").read_text(encoding="utf-8")
HELPERS = {"config_checks", "config_toml", "draw", "raw", "prefetch", "tally", "info"}


@pytest.mark.parametrize("place", ["", *STOREYS])
def test_architecture_names_every_room(place):
    missing = [room for room in picture(place).names if room not in HELPERS and f"`{room}`" not in PAGE]
    assert missing == []
