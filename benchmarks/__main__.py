"""Run the benchmarks: `python -m benchmarks kitti --data ../shared/data/kitti_0005`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks import kitti
from benchmarks.rivals import ADAPTERS

_ROOT = Path(__file__).resolve().parent.parent
_RESULTS = _ROOT / "benchmarks" / "results"


def _write(name: str, rows: list[dict[str, Any]]) -> None:
    _RESULTS.mkdir(exist_ok=True)
    (_RESULTS / f"{name}.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    for row in rows:
        print(json.dumps(row))


def main() -> None:
    """Parse the command line and run one benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("benchmark", choices=["kitti", "sharpness"])
    parser.add_argument("--data", type=Path, default=_ROOT.parent / "shared" / "data" / "kitti_0005")
    parser.add_argument("--work", type=Path, default=_ROOT / "build" / "bench")
    parser.add_argument("--rival-bin", type=Path, default=_ROOT / "build" / "bench-venv" / "bin")
    parser.add_argument("--systems", nargs="+", choices=list(ADAPTERS), default=list(ADAPTERS))
    arguments = parser.parse_args()
    bins = dict.fromkeys(ADAPTERS, arguments.rival_bin) | {"heliograph": Path(sys.executable).parent}
    chosen = [ADAPTERS[name] for name in arguments.systems]
    if arguments.benchmark == "kitti":
        _write("kitti", kitti.compare(arguments.data, chosen, arguments.work, bins))
    else:
        _write("sharpness", kitti.sharpness(arguments.data, ADAPTERS["heliograph"], arguments.work, bins))


if __name__ == "__main__":
    main()
