"""``python -m tests.fuzz``: spoil and read for a while; every fault is told with the words that repeat it.

A process that has imported everything and read every sound seed forks a child for each case.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
import time
import traceback
from collections import Counter
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from tests.fuzz.runner import Outcome, choose, run_case
from tests.fuzz.seeds import make_seeds
from tests.fuzz.targets import TARGETS, place
from tests.fuzz.warm import warm_up


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1_000_000, help="how many at most")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seconds", type=float, default=120.0, help="how long; 0: until all cases are done")
    parser.add_argument("--seed", type=int, default=1, help="of chance")
    parser.add_argument("--jobs", type=int, default=1, help="children at once")
    parser.add_argument("--only", default="", help="a part of the targets' names")
    parser.add_argument("--case", type=int, default=None, help="this case alone, with all that it said")
    parser.add_argument("--keep", type=Path, default=None, metavar="DIR", help="with --case: leave its file there")
    return parser.parse_args()


def _work(
    step: tuple[int, int], options: argparse.Namespace, seeds: Path, results: SimpleQueue[Outcome | None]
) -> None:
    """Run every n-th case; the time counts from when all is warm."""
    first, jobs = step
    targets = [target for target in TARGETS if options.only in target.name]
    try:
        for number, line in enumerate(warm_up(targets, seeds)):
            results.put(Outcome(-1 - number, "a seed", line, "", 0.0, 0.0, False))
        end = time.monotonic() + (options.seconds or 1e9)
        for case in choose(targets, options.cases, options.seed, options.first + first, jobs):
            if time.monotonic() > end:
                break
            results.put(run_case(case, seeds))
    except Exception as error:
        traceback.print_exc()
        results.put(Outcome(-1, "the fuzzer", f"failed itself: {error}", "", 0.0, 0.0, False))
    finally:
        results.put(None)


def main() -> int:
    """Return 0 where no case had a fault."""
    options = _arguments()
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
            targets = [target for target in TARGETS if options.only in target.name]
            *_, case = choose(targets, options.case + 1, options.seed, options.case)
            if options.keep:
                options.keep.mkdir(parents=True, exist_ok=True)
                place(case.target, seeds, options.keep, random.Random(case.seed + "/spoil"))
            _tell(run_case(case, seeds), options)
            return 0
        context = get_context("fork")
        results: SimpleQueue[Outcome | None] = context.SimpleQueue()
        workers = [
            context.Process(target=_work, args=((k, options.jobs), options, seeds, results))
            for k in range(options.jobs)
        ]
        for worker in workers:
            worker.start()
        faults = _gather(results, len(workers), options)
        for worker in workers:
            worker.join()
    return 1 if faults else 0


def _gather(results: SimpleQueue[Outcome | None], running: int, options: argparse.Namespace) -> int:
    done, taken, worst, peak, spent = 0, 0, 0.0, 0.0, 0.0
    faults: Counter[str] = Counter()
    while running:
        outcome = results.get()
        if outcome is None:
            running -= 1
            continue
        done, taken = done + 1, taken + outcome.taken
        worst, peak = max(worst, outcome.seconds), max(peak, outcome.megabytes)
        spent += outcome.seconds
        if done % 1000 == 0:
            print(f"{done} cases, {sum(faults.values())} faults", flush=True)
        if outcome.fault:
            faults[outcome.name] += 1
            _tell(outcome, options)
    total = sum(faults.values())
    print(
        f"{done} cases of seed {options.seed}: {taken} read, {done - taken - total} refused, {total} faults; "
        f"{1e3 * spent / max(done, 1):.0f} ms of processor time a case, the slowest took {worst:.1f} s, the largest "
        f"{peak:.0f} MB"
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
