"""``python -m tests.fuzz``: spoil and read for a while; every fault is told with the words that repeat it."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from tests.fuzz.runner import Outcome, choose, run_case
from tests.fuzz.seeds import make_seeds
from tests.fuzz.targets import TARGETS, Target


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1_000_000, help="how many at most")
    parser.add_argument("--seconds", type=float, default=120.0, help="how long; 0: until all cases are done")
    parser.add_argument("--seed", type=int, default=1, help="of chance")
    parser.add_argument("--jobs", type=int, default=2, help="children at once")
    parser.add_argument("--only", default="", help="a part of the targets' names")
    parser.add_argument("--case", type=int, default=None, help="this case alone, with all that it said")
    return parser.parse_args()


def _work(
    todo: tuple[int, int, int, float], targets: list[Target], seeds: Path, results: SimpleQueue[Outcome | None]
) -> None:
    first, step, cases, end = todo[0], todo[1], todo[2], todo[3]
    for case in choose(targets, cases, _arguments().seed, first, step):
        if time.monotonic() > end:
            break
        results.put(run_case(case, seeds))
    results.put(None)


def main() -> int:
    """Return 0 where no case had a fault."""
    options = _arguments()
    targets = [target for target in TARGETS if options.only in target.name]
    with tempfile.TemporaryDirectory(prefix="fuzz-seeds-") as folder:
        seeds = Path(folder)
        # In a child: threads that a library starts here would be missing in all others, which would wait for them.
        maker = get_context("fork").Process(target=make_seeds, args=(seeds,))
        maker.start()
        maker.join()
        if maker.exitcode:
            return 1
        os.environ["FUZZ_SEEDS"] = str(seeds)
        if options.case is not None:
            *_, case = choose(targets, options.case + 1, options.seed, options.case)
            _tell(run_case(case, seeds), options)
            return 0
        end = time.monotonic() + (options.seconds or 1e9)
        context = get_context("fork")
        results: SimpleQueue[Outcome | None] = context.SimpleQueue()
        workers = [
            context.Process(target=_work, args=((k, options.jobs, options.cases, end), targets, seeds, results))
            for k in range(options.jobs)
        ]
        for worker in workers:
            worker.start()
        faults = _gather(results, len(workers), options)
        for worker in workers:
            worker.join()
    return 1 if faults else 0


def _gather(results: SimpleQueue[Outcome | None], running: int, options: argparse.Namespace) -> int:
    done, taken, worst, peak = 0, 0, 0.0, 0.0
    faults: Counter[str] = Counter()
    while running:
        outcome = results.get()
        if outcome is None:
            running -= 1
            continue
        done, taken = done + 1, taken + outcome.taken
        worst, peak = max(worst, outcome.seconds), max(peak, outcome.megabytes)
        if outcome.fault:
            faults[outcome.name] += 1
            _tell(outcome, options)
    total = sum(faults.values())
    print(
        f"{done} cases of seed {options.seed}: {taken} read, {done - taken - total} refused, {total} faults; the "
        f"slowest took {worst:.1f} s of processor time, the largest {peak:.0f} MB"
    )
    for name, count in faults.most_common():
        print(f"  {count} in {name}")
    return total


def _tell(outcome: Outcome, options: argparse.Namespace) -> None:
    only = f" --only '{options.only}'" if options.only else ""
    print(
        f"case {outcome.number} ({outcome.name}): {outcome.fault or 'no fault'}, {outcome.seconds:.1f} s, "
        f"{outcome.megabytes:.0f} MB; again: python -m tests.fuzz --seed {options.seed} --case {outcome.number}{only}\n"
        f"{outcome.detail}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
