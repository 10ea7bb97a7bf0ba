"""The page for people who come from GTSAM: both programs of each section run, and find the same numbers."""

import re
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "from_gtsam.md"
BLOCK = re.compile(r"^```(py|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SECTIONS = [part for part in re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE) if "```" in part]
# Names on both sides, and how near their numbers are. GTSAM's chart of planar poses, its preintegration (first order in
# the step) and its fixed lag (relinearised elsewhere) are not ours.
COMPARED = {
    "Pose2SLAM": {"poses": 1e-6, "sigma": 1e-4},
    "Pose3SLAM, with a prior": {"poses": 1e-5, "error": 1e-5, "covariance": 1e-6, "joint": 1e-6},
    "Symbols, errors, printing": {"key": 0.0, "total": 1e-12, "errors": 1e-12},
    "Robust kernels": {"costs": 1e-12},
    "iSAM2 with IMU, GPS and a fixed lag": {"kept": 0.0, "positions": 0.01, "velocities": 0.01},
}


def both_sides():
    """Return the sections with the names that either side ends with."""
    pytest.importorskip("gtsam", reason="gtsam has no wheel for this Python")
    theirs, ours, found = {"__name__": "theirs"}, {"__name__": "ours"}, {}
    for section in SECTIONS:
        title = section.splitlines()[0]
        for kind, block in BLOCK.findall(section):
            code = compile(block, f"from_gtsam.md, {title}", "exec")
            shared = block.startswith("# both")
            if kind == "py" or shared:
                assert shared or block.startswith("# gtsam")
                exec(code, theirs)
            if kind == "python":
                exec(code, ours)
        found[title] = dict(theirs), dict(ours)
    return found


def test_both_programs_find_the_same():
    found = both_sides()
    assert set(found) == set(COMPARED)
    for title, names in COMPARED.items():
        theirs, ours = found[title]
        for name, tolerance in names.items():
            np.testing.assert_allclose(
                ours[name], theirs[name], rtol=0.0, atol=tolerance, err_msg=f"{title}: {name}", strict=False
            )


def test_every_name_of_the_table_is_there():
    import heliograph.factors
    import heliograph.graph
    import heliograph.imu
    import heliograph.lie

    table = PAGE.read_text(encoding="utf-8").split("## Words")[1].split("##")[0]
    rows = [line.split("|")[2] for line in table.splitlines() if line.startswith("| `")]
    modules = (heliograph.graph, heliograph.factors, heliograph.imu, heliograph.lie)
    names = {name for row in rows for name in re.findall(r"`([A-Z]\w+)", row)} - {"X"}
    assert len(names) >= 28
    assert [name for name in sorted(names) if not any(hasattr(module, name) for module in modules)] == []
