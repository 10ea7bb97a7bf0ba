"""Breaks the code on purpose and sees the tests fail: `make mutants`, from tests/mutants.toml.

Each mutant is one replacement in one file of the source and the tests that must notice it. All of it happens in a copy
of the working tree; a native mutant is built there. A mutant that lives is a test that cannot fail.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_suffix(".toml")
# An editable install finds the package before any path does; in the copy it must not.
_PYTEST = """
import sys
sys.meta_path = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__]
sys.path[:0] = [sys.argv[1] + "/src", sys.argv[1]]
import pytest
import heliograph
assert heliograph.__file__.startswith(sys.argv[1]), heliograph.__file__
sys.exit(pytest.main(sys.argv[2:]))
"""
_FAILED = 1  # pytest: tests were collected and run, and some of them failed


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One defect: ``find``, which stands exactly once in ``file``, becomes ``replace``; ``tests`` must then fail."""

    name: str
    file: str
    find: str
    replace: str
    tests: tuple[str, ...]

    @property
    def native(self) -> bool:
        """Whether the core has to be built for it."""
        return self.file.startswith("cpp/")


def mutants(path: Path = LIST) -> list[Mutant]:
    """Read the list."""
    with path.open("rb") as file:
        rows = tomllib.load(file)["mutant"]
    return [Mutant(**{**row, "tests": tuple(row["tests"])}) for row in rows]


def copy_tree(target: Path) -> None:
    """Copy what git knows of the working tree, and the native module as it is built."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    )  # fmt: skip
    for name in listed.stdout.splitlines():
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)
    found = importlib.util.find_spec("heliograph._core")
    assert found is not None
    assert found.origin is not None
    shutil.copy2(found.origin, target / "src" / "heliograph")


def run_tests(tree: Path, tests: tuple[str, ...]) -> int:
    """Run tests on a tree; return pytest's exit code."""
    options = [
        "-q",
        "-x",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "--no-header",
        "-W",
        "ignore::pytest.PytestWarning",
    ]
    done = subprocess.run(
        [sys.executable, "-c", _PYTEST, str(tree), *options, *(str(tree / test) for test in tests)],
        cwd=tree, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": ""}, check=False,
    )  # fmt: skip
    if done.returncode not in (0, _FAILED):
        raise SystemExit(f"the tests {' '.join(tests)} could not be run:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode


def break_it(tree: Path, mutant: Mutant) -> None:
    """Write the defect into a tree."""
    path = tree / mutant.file
    text = path.read_text(encoding="utf-8")
    if text.count(mutant.find) != 1:
        times = text.count(mutant.find)
        raise SystemExit(f"mutant '{mutant.name}': its text stands {times} times in {mutant.file}; mend {LIST.name}")
    path.write_text(text.replace(mutant.find, mutant.replace), encoding="utf-8")


def build(tree: Path, where: Path) -> None:
    """Build the native module of a tree and put it beside its Python."""
    where.mkdir(parents=True, exist_ok=True)
    configure = ["cmake", "-S", str(tree), "-B", str(where), "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release",
                 f"-DPython_EXECUTABLE={sys.executable}"]  # fmt: skip
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    for command in (configure, ["cmake", "--build", str(where), "--target", "_core"]):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"a mutant does not build:\n{done.stdout[-3000:]}")
    for old in (tree / "src" / "heliograph").glob("_core.*.so"):
        old.unlink()
    [module] = where.glob("_core*.so")
    shutil.copy2(module, tree / "src" / "heliograph")


def lives(mutant: Mutant, work: Path) -> bool:
    """Return whether a mutant of Python passes its tests, in a tree of its own."""
    tree = Path(tempfile.mkdtemp(dir=work))
    copy_tree(tree)
    break_it(tree, mutant)
    return run_tests(tree, mutant.tests) == 0


def native_lives(found: list[Mutant], work: Path) -> list[bool]:
    """Return the same for native mutants, one after another in one tree, so that each build is a small one."""
    if not found:
        return []
    tree = work / "native"
    tree.mkdir()
    copy_tree(tree)
    build(tree, work / "build")
    answers = []
    for mutant in found:
        sound = (tree / mutant.file).read_text(encoding="utf-8")
        break_it(tree, mutant)
        build(tree, work / "build")
        answers.append(run_tests(tree, mutant.tests) == 0)
        (tree / mutant.file).write_text(sound, encoding="utf-8")
    return answers


def main() -> None:
    """Run all mutants, or those whose names hold one of the words given; exit code 1 where one lives."""
    words = sys.argv[1:]
    chosen = [mutant for mutant in mutants() if not words or any(word in mutant.name for word in words)]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(max_workers=2) as pool:
        work = Path(folder)
        sound = work / "sound"
        sound.mkdir()
        copy_tree(sound)
        if run_tests(sound, tuple(dict.fromkeys(test for mutant in chosen for test in mutant.tests))):
            raise SystemExit("the tests fail without any mutant; mend that first")
        native = [mutant for mutant in chosen if mutant.native]
        python = [mutant for mutant in chosen if not mutant.native]
        builds = pool.submit(native_lives, native, work)
        answers = [*zip(python, pool.map(lambda mutant: lives(mutant, work), python), strict=True)]
        answers += zip(native, builds.result(), strict=True)
    for mutant, alive in answers:
        print(f"{'LIVES ' if alive else 'killed'}  {mutant.name}  ({mutant.file})")
    alive = sum(lived for _, lived in answers)
    print(f"{len(answers) - alive} of {len(answers)} mutants killed")
    sys.exit(alive > 0)


if __name__ == "__main__":
    main()
