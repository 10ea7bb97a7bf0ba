from importlib.metadata import EntryPoint

import pytest

from heliograph import plugins
from heliograph.errors import ConfigError, FormatError
from heliograph.io import OPENERS, reader_names, register_reader
from heliograph.io.registry import open_raw_source

PLUGIN = """
from types import SimpleNamespace


def open_any(paths):
    parts = {"messages": iter, "factory_T_imu_lidar": None, "close": None}
    return SimpleNamespace(description="opened", topics=(), events=[], **parts)
"""


class FakeSource:
    description, topics, events = "mine", (), ()

    def messages(self, topics):
        return iter(())

    def factory_T_imu_lidar(self):
        return None

    def close(self):
        pass


TABLE = "t,gx,gy,gz,ax,ay,az\n" + "".join(f"{0.01 * k:.2f},0,0,0,0,0,9.81\n" for k in range(50))


@pytest.fixture(autouse=True)
def restored():
    before = dict(OPENERS)
    yield
    OPENERS.clear()
    OPENERS.update(before)


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "imu.csv"
    path.write_text(TABLE)
    return path


def test_registered_reader_is_asked_before_the_others(table):
    opened = FakeSource()
    register_reader("mine", lambda paths: opened if paths == [table] else None)
    assert next(iter(OPENERS)) == "mine"
    assert open_raw_source([table]) is opened


def test_registered_reader_of_a_standing_name_keeps_its_place(table):
    order = list(OPENERS)
    register_reader("imu", lambda _: None)
    assert list(OPENERS) == order
    with pytest.raises(FormatError, match="not a recording that Heliograph reads"):
        open_raw_source([table])


def test_reader_by_name_is_the_only_one_asked(table):
    register_reader("mine", lambda _: 1 / 0)
    assert "imu.csv" in open_raw_source([table], reader="imu").description
    with pytest.raises(FormatError, match="the reader 'kitti' knows; leave --reader out"):
        open_raw_source([table], reader="kitti")
    with pytest.raises(ConfigError, match="did you mean 'kitti'"):
        open_raw_source([table], reader="kity")
    assert "imu.csv" in open_raw_source([table], reader="heliograph.io.files.imu_files:open_imu_file").description


def test_installed_reader_is_asked_last(table, monkeypatch):
    entry = EntryPoint(name="packed", value="reader_plugin:open_any", group="heliograph.readers")
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == "heliograph.readers" else [])
    (table.parent / "reader_plugin.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(table.parent)
    assert open_raw_source([table]).description != "opened"
    other = table.with_suffix(".mine")
    other.write_text("x")
    assert open_raw_source([other]).description == "opened"
    assert "packed" in reader_names()


def test_reader_names_that_cannot_be_are_refused():
    for name in ("", "a:b"):
        with pytest.raises(ConfigError, match="cannot name a reader"):
            register_reader(name, lambda _: None)


def broken(_paths):
    raise KeyError("no such thing")


@pytest.mark.parametrize(
    ("opener", "words"),
    [
        (lambda _paths: 5, r"reader 'mine' made a int without close, description, events, factory_T_imu_lidar"),
        (broken, r"reader 'mine' could not be made \(KeyError: 'no such thing'\)"),
        (7, r"reader 'mine' is no function"),
    ],
)
def test_reader_that_makes_no_source_is_told_in_one_line(table, opener, words):
    register_reader("mine", opener)
    with pytest.raises(ConfigError, match=words):
        open_raw_source([table])
