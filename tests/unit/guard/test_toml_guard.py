"""TOML from strangers: refused in bounded time where the parser's would grow with the square of a key."""

import pytest

from heliograph.config_toml import load_config
from heliograph.errors import FormatError
from heliograph.guard.toml import TOMLDecodeError, parse_toml


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * 100_000) + " = 1",
        " . ".join("a" * 100_000) + " = 1",
        "[" + ".".join(['"a b"'] * 50_000) + "]",
        "x = {" + ".".join("a" * 100_000) + " = 1}",
        "x = " + "[" * 100_000,
        "# " + "a" * 600_000,
    ],
)
def test_what_would_take_forever_is_refused_at_once(text):
    with pytest.raises(TOMLDecodeError):
        parse_toml(text)


def test_what_people_write_is_read():
    numbers = ", ".join(["1.5"] * 400)
    text = f'a.b.c = "1.2.3.4. {"x.y" * 100}"\nm = [{numbers}]\n[d.e]\nf = 1.0  # a. b. c.\n'
    table = parse_toml(text)
    assert table["a"]["b"]["c"].startswith("1.2.3.4")
    assert len(table["m"]) == 400
    assert table["d"]["e"]["f"] == 1.0


def test_configuration_says_so_in_one_line(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text("[" + ".".join("a" * 10_000) + "]\n")
    with pytest.raises(FormatError, match="dotted parts") as caught:
        load_config(path)
    assert "\n" not in str(caught.value)
