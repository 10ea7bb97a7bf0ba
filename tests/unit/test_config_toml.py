import dataclasses
from dataclasses import dataclass, field

import pytest

from heliograph.config import RunConfig
from heliograph.config_checks import check_choice, check_range
from heliograph.config_toml import apply_overrides, build, dump_config, field_docs, keys, load_config
from heliograph.errors import ConfigError, FormatError
from heliograph.guard.toml import parse_toml


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner:
    """A part.

    Parameters
    ----------
    low, high : float
        Ends of the range
        of something [m].
    levels : tuple of float
        Sizes [m].
    """

    low: float = 0.0
    high: float = 1.0
    levels: tuple[float, ...] = (1.0, 2.0)
    window: tuple[int, int] = (3, 4)
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_range(self, "low", below=self.high)
        check_range(self, "levels", above=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outer:
    """The whole."""

    count: int = 1
    fast: bool = False
    mode: str = "a"
    inner: Inner = field(default_factory=Inner)

    def __post_init__(self) -> None:
        check_choice(self, "mode", "a", "b", 'quo"te\\\n\x7f')


ODD = Outer(
    count=-3,
    fast=True,
    mode='quo"te\\\n\x7f',
    inner=Inner(low=1e-30, high=1e300, levels=(0.1,), window=(0, -1), names=("ä", "")),
)


@pytest.mark.parametrize("config", [RunConfig(), Outer(), ODD])
def test_dump_then_load_gives_the_same_configuration(config):
    assert build(type(config), parse_toml(dump_config(config))) == config


def test_load_config_reads_what_dump_config_wrote(tmp_path):
    config = apply_overrides(RunConfig(), ["output.map_voxel=0.25", "threads=2"])
    (tmp_path / "run.toml").write_text(dump_config(config))
    assert load_config(tmp_path / "run.toml") == config


def test_load_config_keeps_defaults_for_missing_keys(tmp_path):
    (tmp_path / "run.toml").write_text("[output]\nmap_voxel = 1\n")
    config = load_config(tmp_path / "run.toml")
    assert config.output.map_voxel == 1.0
    assert isinstance(config.output.map_voxel, float)
    assert config.input == RunConfig().input


def test_load_config_names_the_file_that_is_missing(tmp_path):
    with pytest.raises(ConfigError, match=r"absent\.toml"):
        load_config(tmp_path / "absent.toml")


def test_load_config_refuses_what_is_not_toml(tmp_path):
    (tmp_path / "run.toml").write_text("a = = 1")
    with pytest.raises(FormatError, match=r"run\.toml"):
        load_config(tmp_path / "run.toml")


def test_load_config_error_names_file_key_and_suggestion(tmp_path):
    (tmp_path / "run.toml").write_text("[output]\nmap_voxl = 1\n")
    with pytest.raises(ConfigError, match=r"run.toml: unknown key 'output.map_voxl'; did you mean 'output.map_voxel'"):
        load_config(tmp_path / "run.toml")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("inner.hihg=2", "did you mean 'inner.high'"),
        ("high=2", "did you mean 'inner.high'"),
        ("iner.high=2", "did you mean 'inner.high'"),
        ("zzz=2", "Valid in the top level: count, fast, mode, inner"),
        ("inner.high=two", "inner.high = 'two' is a string; it must be a number"),
        ("count=1.5", "count = 1.5 is a number; it must be a whole number"),
        ("count=true", "it must be a whole number"),
        ("inner.high=true", "it must be a number"),
        ("inner.high=nan", "it must be a number"),
        ("inner.high=inf", "inner.high = inf; it must be finite.*1e9"),
        ("inner.low=-inf", "it must be finite"),
        ("inner.levels=[1.0, inf]", r"inner.levels\[1\] = inf"),
        ("fast=1", "it must be true or false"),
        ("inner=1", "is a section"),
        ("count.x=1", "'count' is a value, not a section"),
        ("count", "no '='"),
        ("mode=c", "mode = 'c' is not one of 'a', 'b'"),
        ("inner.low=5", "inner.low = 5.0 is out of range; it must be < 1"),
        ("inner.levels=[1.0, -1.0]", "inner.levels = .* must be > 0"),
        ("inner.levels=[0.0]", "inner.levels = .* must be > 0"),
        ("inner.low=1.0", "must be < 1"),
        ("inner.levels=1.0", "it must be a list"),
        ("inner.levels=[1.0, 'a']", r"inner.levels\[1\] = 'a'"),
        ("inner.window=[1]", "has 1 entries; it must have 2"),
    ],
)
def test_override_error_states_key_and_remedy(override, message):
    with pytest.raises(ConfigError, match=message):
        apply_overrides(Outer(), [override])


def test_section_given_as_a_value_is_an_error():
    with pytest.raises(ConfigError, match=r"write a \[inner\] section"):
        build(Outer, {"inner": 3})


def test_overrides_are_checked_together_whatever_their_order():
    config = apply_overrides(Outer(), ["inner.low=5", "inner.high=9"])
    assert (config.inner.low, config.inner.high) == (5.0, 9.0)


def test_override_of_a_string_needs_no_quotes():
    assert apply_overrides(RunConfig(), ["input.lidar_topic=/points"]).input.lidar_topic == "/points"
    assert apply_overrides(RunConfig(), ["input.lidar_topic=5"]).input.lidar_topic == "5"
    assert apply_overrides(RunConfig(), ['input.lidar_topic="5"']).input.lidar_topic == "5"


def test_override_leaves_the_original_alone():
    original = Outer()
    apply_overrides(original, ["count=7"])
    assert original.count == 1


def test_keys_lists_every_leaf():
    assert list(keys(Outer))[-2:] == ["inner.window", "inner.names"]
    assert "inner" not in list(keys(Outer))


def test_field_docs_joins_lines_and_shares_them_among_names():
    docs = field_docs(Inner)
    assert docs == {
        "low": "Ends of the range of something [m].",
        "high": "Ends of the range of something [m].",
        "levels": "Sizes [m].",
    }


def test_dump_writes_the_meaning_above_the_key():
    assert "# Sizes [m].\nlevels = [1.0, 2.0]" in dump_config(Outer())


def test_every_configuration_key_is_documented():
    def undocumented(config):
        for entry in dataclasses.fields(config):
            value = getattr(config, entry.name)
            if dataclasses.is_dataclass(value):
                yield from undocumented(value)
            elif entry.name not in field_docs(type(config)):
                yield f"{type(config).__name__}.{entry.name}"

    assert list(undocumented(RunConfig())) == []
