"""A saved smoother with a word changed and its checksum made right is refused, or good for use; never a crash."""

import json
import random
import zipfile
from collections import Counter

import numpy as np
import pytest
from tests.fuzz.mutations import in_archive, in_tree
from tests.fuzz.runner import Case, run_case
from tests.fuzz.seeds import chain
from tests.fuzz.targets import Target, quietly, smoother

from heliograph.errors import FormatError, HeliographError
from heliograph.graph import ISAM2, OutlierRejection


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seeds")
    plain = ISAM2(outliers=OutlierRejection())
    plain.update(*chain(12))
    plain.save(folder / "plain.isam2")
    return folder


@pytest.mark.parametrize("spoil", [in_tree, in_archive])
def test_forged_saves_neither_crash_nor_surprise(spoil, seeds):
    target = Target("forged", "plain.isam2", spoil, quietly(smoother))
    outcomes = [run_case(Case(n, f"forged/{n}", target), seeds) for n in range(25)]
    assert [(o.number, o.fault, o.detail) for o in outcomes if o.fault] == []
    assert Counter(outcome.taken for outcome in outcomes)[False] > 2


def changed(path, name, value):
    """Write another array for one of a saved smoother's."""
    with np.load(path) as archive:
        arrays = {key: archive[key] for key in archive.files}
    arrays[name] = value(arrays[name])
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("keys", lambda keys: keys[:-1]),
        ("keys", lambda keys: np.zeros_like(keys)),
        ("numbers", lambda numbers: numbers + 1000),
        ("numbers", lambda numbers: numbers - 5),
        ("switched", lambda _: np.array([[1e6, 0.0]])),
        ("doubtful.numbers", lambda numbers: numbers + 77),
        ("doubtful.ends", lambda ends: ends + 10_000),
        ("doubtful.active", lambda active: ~active),
        ("doubtful.rows", lambda rows: rows[:0]),
        ("left", lambda _: np.array([[5, 1]], dtype=np.int64)),
        ("about", lambda _: np.frombuffer(b"[" * 100_000, np.uint8)),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(name, value, seeds, tmp_path):
    path = tmp_path / "smoother.npz"
    path.write_bytes((seeds / "plain.isam2").read_bytes())
    changed(path, name, value)
    with pytest.raises(FormatError, match=r"smoother\.npz.*damaged"):
        ISAM2.load(path)


def test_a_table_of_contents_cannot_ask_for_memory(seeds, tmp_path):
    path = tmp_path / "smoother.npz"
    path.write_bytes((seeds / "plain.isam2").read_bytes())

    def endless(contents):
        table = json.loads(contents.tobytes())
        table["families"] = [["SE3", 10**12]]
        return np.frombuffer(json.dumps(table).encode(), np.uint8)

    changed(path, "contents", endless)
    with pytest.raises(FormatError, match="a family for each variable"):
        ISAM2.load(path)


def test_mutations_depend_on_their_seed_alone(seeds):
    whole = (seeds / "plain.isam2").read_bytes()
    assert in_tree(whole, random.Random(3)) == in_tree(whole, random.Random(3)) != whole
    assert zipfile.is_zipfile(seeds / "plain.isam2") and issubclass(FormatError, HeliographError)
