"""Parts found by name: registered, installed, imported; a wrong name or module is one line with the remedy."""

from importlib.metadata import EntryPoint

import pytest

from heliograph import plugins
from heliograph.errors import ConfigError
from heliograph.plugins import find_plugin, plugin_names

GROUP = "heliograph.tests"


@pytest.fixture
def installed(monkeypatch):
    entry = EntryPoint(name="packed", value="math:tau", group=GROUP)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == GROUP else [])


@pytest.mark.parametrize(
    ("name", "expected"),
    [("pi", 3.141592653589793), ("by_text", 2.718281828459045), ("packed", 6.283185307179586), ("posixpath:sep", "/")],
)
def test_plugin_is_found_by_every_kind_of_name(installed, name, expected):
    assert find_plugin("number", name, {"pi": 3.141592653589793, "by_text": "math:e"}, GROUP) == expected


def test_registered_plugin_goes_before_an_installed_one(installed):
    assert find_plugin("number", "packed", {"packed": 1.0}, GROUP) == 1.0
    assert plugin_names({"packed": 1.0, "a": 2.0}, GROUP) == ["a", "packed"]


def test_unknown_name_is_told_with_the_nearest(installed):
    with pytest.raises(ConfigError, match=r"number 'pakced' is not one of packed, pi.*did you mean 'packed'"):
        find_plugin("number", "pakced", {"pi": 3.14}, GROUP)


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("no_such_module:f", "No module named 'no_such_module'"),
        ("math:no_such_name", "no_such_name"),
        ("broken_plugin:f", "ZeroDivisionError: division by zero"),
        (":f", "ValueError"),
    ],
)
def test_what_cannot_be_imported_is_one_line(tmp_path, monkeypatch, reference, words):
    (tmp_path / "broken_plugin.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=words) as caught:
        find_plugin("number", reference, {}, GROUP)
    assert "check module and name" in str(caught.value) and "\n" not in str(caught.value)
