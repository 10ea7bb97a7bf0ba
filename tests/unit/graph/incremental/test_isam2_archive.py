"""A saved smoother goes on to the bit; what is not one is refused with one message."""

import json
import pickle

import numpy as np
import pytest

from heliograph.errors import FormatError, GraphError, OutputError
from heliograph.graph import ISAM2, Huber, ISAM2Settings, OutlierRejection, read_pose_graph
from heliograph.lie import SE2, SE3
from reference.growth import Offset2, cliques_of, growth
from reference.replay import Replay

EAGER = ISAM2Settings(relinearize_threshold=1e-3, relinearize_skip=3)


def state(smoother):
    tree = smoother._state.native
    return (
        [packed.tobytes() for packed in smoother.estimate().packed()],
        tree.delta().tobytes(),
        cliques_of(tree),
        smoother.cliques(),
    )


def half(steps, settings=EAGER):
    smoother, spare = ISAM2(settings), []
    for k, step in enumerate(steps[: len(steps) // 2]):
        numbers = smoother.update(
            step.graph(), step.values, remove=[spare.pop()] if k % 10 == 9 and spare else []
        ).factors
        spare += [int(numbers[row]) for row in step.spare]
    smoother.update(remove=spare[1:4])  # several numbers are free now: in which order they are used again is state, too
    smoother.switch(spare[:1], on=False)
    return smoother


def again(smoother, path, own):
    smoother.save(path)
    return ISAM2.load(path, factors=own), pickle.loads(pickle.dumps(smoother))


@pytest.mark.parametrize("group", [SE2, SE3])
def test_every_family_and_own_factors_go_on_to_the_bit(group, rng, tmp_path):
    steps = growth(group, 80, rng, kernel=Huber(0.7))
    first = half(steps)
    own = first._state.custom_classes()
    assert len(own) == 1
    others = again(first, tmp_path / "smoother.npz", own)
    spare = []
    for k, step in enumerate(steps[40:]):
        removed = [spare.pop(0)] if k % 9 == 4 and spare else []
        results = [s.update(step.graph(), step.values, remove=removed) for s in (first, *others)]
        spare += [int(results[0].factors[row]) for row in step.spare]
        for other, result in zip(others, results[1:], strict=True):
            assert result.factors.tolist() == results[0].factors.tolist()
            assert state(other) == state(first)
    ends = [s.update(iterate=1e-8, costs=True).cost_after for s in (first, *others)]
    assert ends[0] == ends[1] == ends[2]
    assert others[0].settings == first.settings


@pytest.mark.real
def test_intel_goes_on_to_the_bit_from_half_way(shared_data, tmp_path):
    path = shared_data / "posegraphs" / "intel.g2o"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    replay, first = Replay(read_pose_graph(path)), ISAM2()
    count = len(replay.ids)
    for k in range(count // 2):
        replay.step(first, k)
    other, third = again(first, tmp_path / "smoother.npz", ())
    for k in range(count // 2, count):
        results = [replay.step(smoother, k) for smoother in (first, other, third)]
        deltas = {smoother._state.native.delta().tobytes() for smoother in (first, other, third)}
        assert len(deltas) == 1
        assert len({result.factors.tobytes() for result in results}) == 1
    assert state(first) == state(other) == state(third)


def test_saving_changes_nothing_and_empty_ones_can_be_saved(rng, tmp_path):
    smoother = half(growth(SE2, 30, rng))
    before = state(smoother)
    smoother.save(tmp_path / "a.npz")
    assert state(smoother) == before
    ISAM2().save(tmp_path / "empty.npz")
    assert len(ISAM2.load(tmp_path / "empty.npz").estimate()) == 0
    with pytest.raises(OutputError):
        smoother.save(tmp_path / "no folder" / "a.npz")


def test_damaged_files_are_refused(rng, tmp_path):
    path, bad = tmp_path / "a.npz", tmp_path / "bad.npz"
    smoother = half(growth(SE2, 40, rng, others=False))
    smoother.save(path)
    whole = path.read_bytes()
    for length in [0, 1, 100, len(whole) // 2, len(whole) - 1]:
        bad.write_bytes(whole[:length])
        with pytest.raises(FormatError, match=r"bad\.npz"):
            ISAM2.load(bad)
    for place in rng.integers(0, len(whole), 60).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 0x55
        bad.write_bytes(bytes(damaged))
        try:
            loaded = ISAM2.load(bad)
        except FormatError:
            continue
        assert state(loaded) == state(smoother)  # a byte that says nothing, such as a date
    with pytest.raises(FormatError, match="cannot be read"):
        ISAM2.load(tmp_path / "none.npz")


@pytest.mark.parametrize("counts", [(1e12, 1.0, 0.0), (-1.0, 1.0, 0.0), (0.0, 1.0, 1e300), (np.nan, 1.0, 0.0)])
def test_counts_that_no_tree_has_are_refused(counts, tmp_path):
    """They are stored as floats and taken by the tree in 32 bits."""
    ISAM2(outliers=OutlierRejection()).save(tmp_path / "a.npz")
    arrays = dict(np.load(tmp_path / "a.npz"))
    np.savez(tmp_path / "b.npz", **{**arrays, "doubtful.when": np.array(counts)})
    with pytest.raises(FormatError, match=r"b\.npz"):
        ISAM2.load(tmp_path / "b.npz")


def test_a_damaged_native_state_is_refused(rng):
    smoother = half(growth(SE2, 20, rng, others=False))
    whole = smoother._state.native.save()
    for place in rng.integers(0, len(whole), 40).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 0x10
        with pytest.raises(ValueError, match="damaged"):
            ISAM2()._state.native.load(bytes(damaged))
    with pytest.raises(ValueError, match="damaged"):
        ISAM2()._state.native.load(whole[:-9])
    with pytest.raises(ValueError, match="empty"):
        smoother._state.native.load(whole)


def test_own_factors_need_their_class(rng, tmp_path):
    path = tmp_path / "a.npz"
    half(growth(SE2, 40, rng)).save(path)
    with pytest.raises(GraphError, match=r"factors=\[Offset2\]"):
        ISAM2.load(path)

    class Other(Offset2):
        variables = (SE2, SE2)
        rows = 1

    Other.__name__ = "Offset2"
    with pytest.raises(GraphError, match="1 rows"):
        ISAM2.load(path, factors=[Other])


def rewritten(path, change):
    """Change what a file says of itself."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    about = json.loads(arrays["about"].tobytes().decode())
    change(about)
    np.savez(path, **{**arrays, "about": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)})


@pytest.mark.parametrize(("version", "reason"), [(9, "later version"), (1, "earlier version")])
def test_other_versions_are_refused(rng, tmp_path, version, reason):
    path = tmp_path / "a.npz"
    half(growth(SE2, 20, rng, others=False)).save(path)
    rewritten(path, lambda about: about.update(version=version))
    with pytest.raises(FormatError, match=reason):
        ISAM2.load(path)


def test_version_2_is_read_with_the_names_that_settings_had_then(rng, tmp_path):
    path = tmp_path / "a.npz"
    smoother = half(growth(SE2, 20, rng, others=False), ISAM2Settings(max_steps=77, max_relinearized=88))
    smoother.save(path)

    def as_then(about):
        settings = about["settings"]
        settings["most_steps"], settings["most_relinearized"] = (
            settings.pop("max_steps"),
            settings.pop("max_relinearized"),
        )
        about["version"] = 2

    rewritten(path, as_then)
    loaded = ISAM2.load(path)
    assert loaded.settings == smoother.settings
    assert state(loaded) == state(smoother)
