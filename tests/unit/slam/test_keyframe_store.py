"""The keyframe store: what was appended is read back to the bit, and whatever was cut off costs the last ones only."""

import json
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heliograph.data import ImuBatch, Keyframe
from heliograph.errors import DataError, FormatError
from heliograph.lie import se3
from heliograph.slam import KeyframeStore

NO_IMU = ImuBatch.joined([])


def keyframe(index, rng=None, *, points=20, intensity=True, imu=5):
    rng = rng or np.random.default_rng(index)
    stamps = np.arange(imu, dtype=np.int64) * 5_000_000 + index * 10**9
    return Keyframe(
        index=index,
        stamp_ns=10**9 * (index + 1),
        T_odom_imu=se3.exp(rng.normal(size=6)),
        v_odom=rng.normal(size=3),
        gyro_bias=rng.normal(size=3),
        accel_bias=rng.normal(size=3),
        g_odom=np.array([0.0, 0.0, -9.81]),
        step_covariance=np.eye(6) * 1e-4,
        lidar_information=np.eye(6),
        points_imu=rng.normal(size=(points, 3)).astype(np.float32),
        intensity=rng.uniform(size=points).astype(np.float32) if intensity else None,
        imu=ImuBatch(
            stamps_ns=stamps,
            gyro=rng.normal(size=(imu, 3)),
            accel=rng.normal(size=(imu, 3)),
            received_ns=7,
            frame_id="i",
        ),
    )


def assert_equal(a, b):
    for name in Keyframe.__slots__:
        x, y = getattr(a, name), getattr(b, name)
        if isinstance(x, ImuBatch):
            assert x.frame_id == y.frame_id and x.received_ns == y.received_ns
            for part in ("stamps_ns", "gyro", "accel"):
                np.testing.assert_array_equal(getattr(x, part), getattr(y, part))
        else:
            np.testing.assert_array_equal(x, y)


def filled(path, count=5):
    store = KeyframeStore.create(path)
    for index in range(count):
        store.append(keyframe(index, intensity=index != 3, imu=0 if index == 2 else 5))
    store.close()
    return store


def test_store_reads_back_what_was_appended(tmp_path):
    filled(tmp_path)
    again = KeyframeStore.open(tmp_path)
    assert len(again) == 5
    for index, read in enumerate(again):
        assert_equal(read, keyframe(index, intensity=index != 3, imu=0 if index == 2 else 5))
        assert not read.points_imu.flags.writeable
    assert again[3].intensity is None and len(again[2].imu) == 0


def test_store_goes_on_after_it_was_opened(tmp_path):
    filled(tmp_path, 3)
    again = KeyframeStore.open(tmp_path)
    again.append(keyframe(3))
    again.close()
    assert len(KeyframeStore.open(tmp_path)) == 4


@settings(max_examples=40, deadline=None)
@given(cut=st.integers(min_value=1, max_value=600))
def test_store_cut_off_anywhere_keeps_whole_keyframes(tmp_path_factory, cut):
    path = tmp_path_factory.mktemp("store")
    filled(path)
    journal = path / "journal.jsonl"
    content = journal.read_bytes()
    journal.write_bytes(content[: max(len(content) - cut, 1 + content.index(b"\n"))])
    left = KeyframeStore.open(path)
    assert len(left) <= 5
    for index, read in enumerate(left):
        assert read.index == index
    left.append(keyframe(len(left)))  # and it goes on where it ends
    left.close()
    assert len(KeyframeStore.open(path)) == len(left)


def test_keyframe_file_that_is_not_whole_ends_the_store(tmp_path):
    filled(tmp_path)
    file = tmp_path / "000003.npz"
    file.write_bytes(file.read_bytes()[:-10])
    assert len(KeyframeStore.open(tmp_path)) == 3


def test_keyframe_files_that_a_power_loss_left_empty_end_the_store(tmp_path):
    filled(tmp_path)
    for name in ("000003.npz", "000004.npz"):
        (tmp_path / name).write_bytes(bytes((tmp_path / name).stat().st_size))
    left = KeyframeStore.open(tmp_path)
    assert len(left) == 3
    left.append(keyframe(3))
    left.close()
    assert len(KeyframeStore.open(tmp_path)) == 4


def test_keyframe_file_that_was_changed_is_refused(tmp_path):
    filled(tmp_path)
    file = tmp_path / "000001.npz"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(FormatError, match=r"000001.npz.*damaged"):
        KeyframeStore.open(tmp_path)[1]


def test_keyframe_file_that_unpacks_to_more_than_it_weighs_is_refused(tmp_path):
    filled(tmp_path)
    file = tmp_path / "000001.npz"
    with np.load(file) as archive:
        arrays = {**archive, "points_imu": np.zeros((100_000, 3), np.float32)}
    np.savez_compressed(file, **arrays)
    content, journal = file.read_bytes(), tmp_path / "journal.jsonl"
    lines = journal.read_text().splitlines()
    lines[2] = json.dumps({**json.loads(lines[2]), "size": len(content), "crc32": zlib.crc32(content)})
    journal.write_text("\n".join(lines) + "\n")
    with pytest.raises(FormatError, match=r"000001.npz.*more than the file holds"):
        KeyframeStore.open(tmp_path)[1]


@pytest.mark.parametrize(
    "head",
    [
        b"",
        b"{}\n",
        b"[1]\n",
        b'{"format": "heliograph keyframes", "version": 99}\n',
        b"\xff\xfe\n",
        b"[" * 9999 + b"\n",
    ],
)
def test_journal_that_is_none_is_refused(tmp_path, head):
    (tmp_path / "journal.jsonl").write_bytes(head)
    with pytest.raises(FormatError):
        KeyframeStore.open(tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"index": "1"},
        {"size": 10**18},
        {"file": "../../etc/passwd"},
        {"crc32": None},
        {"stamp_ns": 0},
        {"stamp_ns": 10**30},
        {"more": 1},
    ],
)
def test_journal_line_with_nonsense_ends_the_store(tmp_path, change):
    filled(tmp_path)
    journal = tmp_path / "journal.jsonl"
    lines = journal.read_text().splitlines()
    lines[2] = json.dumps({**json.loads(lines[2]), **change})
    journal.write_text("\n".join(lines) + "\n")
    assert len(KeyframeStore.open(tmp_path)) == 1


def test_missing_store_is_one_line(tmp_path):
    with pytest.raises(FormatError, match="holds no keyframes"):
        KeyframeStore.open(tmp_path / "nowhere")


def test_append_refuses_a_gap_and_an_older_stamp(tmp_path):
    store = KeyframeStore.create(tmp_path)
    store.append(keyframe(0))
    with pytest.raises(DataError, match="does not follow"):
        store.append(keyframe(2))
    late = keyframe(1)
    with pytest.raises(DataError, match="not later"):
        store.append(Keyframe(**{n: getattr(late, n) for n in Keyframe.__slots__} | {"stamp_ns": 5}))
    store.close()
    assert len(store) == 1


def test_create_replaces_an_earlier_store(tmp_path):
    filled(tmp_path)
    store = KeyframeStore.create(tmp_path)
    assert len(store) == 0 and not list(tmp_path.glob("*.npz"))
