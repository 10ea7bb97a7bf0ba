"""Configuration to and from TOML, and single overrides; generic over nested dataclasses.

Field types understood: float, int, bool, str, tuples of these, and further dataclasses, which become tables.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
import typing
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

from heliograph.config import RunConfig
from heliograph.errors import ConfigError, FormatError, closest
from heliograph.guard.files import SETTINGS, plain_file
from heliograph.guard.toml import parse_toml

__all__ = ["apply_overrides", "build", "dump_config", "field_docs", "keys", "load_config"]

C = TypeVar("C")
_MAX_SHOWN = 80  # characters of a value in a message
Value = Any  # what TOML can hold: the types are checked where the values are used


def load_config(path: Path | str) -> RunConfig:
    """Read a configuration; keys that the file leaves out keep their defaults.

    Raises
    ------
    ConfigError
        The file does not exist, a key is unknown (the message names the nearest), or a value has the wrong type or
        range.
    FormatError
        The file is not TOML.
    """
    path = Path(path)
    try:
        values = parse_toml(plain_file(path, SETTINGS).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: the configuration cannot be read ({error.strerror}); check the path") from error
    except ValueError as error:  # of TOML, of UTF-8, of numbers of thousands of digits
        raise FormatError(path, f"not valid TOML ({error})") from error
    try:
        return build(RunConfig, values)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def build(cls: type[C], values: Mapping[str, Value], *, section: str = "") -> C:
    """Return a configuration dataclass from nested mappings; what is left out keeps its default.

    Parameters
    ----------
    cls : type
        The dataclass.
    values : mapping
        Field name -> value or mapping.
    section : str
        Dotted path of this table, for messages.

    Raises
    ------
    ConfigError
        An unknown key, a wrong type, or a value that the dataclass refuses; the message begins with the full key.
    """
    types = _types(cls)
    arguments: dict[str, Value] = {}
    for name, value in values.items():
        key = _join(section, name)
        if name not in types:
            raise ConfigError(_unknown(key, cls, section))
        arguments[name] = _convert(types[name], value, key)
    return _construct(cls, arguments, section)


def apply_overrides(config: C, overrides: Iterable[str]) -> C:
    """Return the configuration with ``"section.key=value"`` overrides applied in order.

    Values are written as in TOML; quotes around strings may be left out.

    Raises
    ------
    ConfigError
        As `build`, or an override without ``=``.
    """
    # All are set before the dataclasses check themselves: two that only fit together must not depend on their order.
    values = dataclasses.asdict(config)  # type: ignore[call-overload]
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals:
            raise ConfigError(f"override '{override}' has no '='; write it as section.key=value")
        _set(values, type(config), key.strip(), text.strip())
    return build(type(config), values)


def dump_config(config: object) -> str:
    """Return the configuration as TOML, each key under a comment with its meaning and unit."""
    return "\n".join(_table(config, section="")).lstrip("\n") + "\n"


def keys(cls: type, *, section: str = "") -> Iterator[str]:
    """Yield every dotted key of a configuration dataclass."""
    for name, kind in _types(cls).items():
        key = _join(section, name)
        if _is_section(kind):
            yield from keys(kind, section=key)
        else:
            yield key


def field_docs(cls: type) -> dict[str, str]:
    """Return field name -> description, read from the class's numpydoc Parameters section."""
    docs: dict[str, str] = {}
    names: list[str] = []
    # After the section's ruler, a line at the left margin names fields and the indented lines under it describe them.
    _, _, section = re.sub(r"\n    ", "\n", cls.__doc__ or "").partition("Parameters\n----------\n")
    for line in section.splitlines():
        if line and not line[0].isspace():
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
        elif line.strip():
            docs.update({name: f"{docs.get(name, '')} {line.strip()}".strip() for name in names})
    return docs


def _join(section: str, name: str) -> str:
    return f"{section}.{name}" if section else name


def _is_section(kind: Any) -> TypeGuard[type]:  # noqa: ANN401 - any annotation
    return dataclasses.is_dataclass(kind)


def _types(cls: type) -> dict[str, Any]:
    hints = typing.get_type_hints(cls)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls)}


def _unknown(key: str, cls: type, section: str, *, root: type | None = None) -> str:
    """Return the message for a key that does not exist, with the nearest one that does and the valid ones here."""
    everywhere = list(keys(root or cls, section="" if root else section))
    same_name = [candidate for candidate in everywhere if candidate.rpartition(".")[2] == key.rpartition(".")[2]]
    hint = f"; did you mean '{same_name[0]}'?" if same_name else closest(key, everywhere) or "."
    where = f"[{section}]" if section else "the top level"
    return f"unknown key '{key}'{hint} Valid in {where}: {', '.join(_types(cls)) or 'nothing'}"


def _construct(cls: type[C], arguments: Mapping[str, Value], section: str) -> C:
    try:
        return cls(**arguments)
    except ConfigError as error:
        raise ConfigError(_join(section, str(error))) from error


def _set(values: dict[str, Value], root: type, key: str, text: str) -> None:
    """Put the override into the nested values."""
    *sections, name = key.split(".")
    cls, at = root, ""
    for section in sections:
        kind = _types(cls).get(section)
        if kind is None:
            raise ConfigError(_unknown(key, cls, at, root=root))
        at = _join(at, section)
        if not _is_section(kind):
            raise ConfigError(f"'{at}' is a value, not a section; write {at}=value")
        cls, values = kind, values[section]
    kind = _types(cls).get(name)
    if kind is None:
        raise ConfigError(_unknown(key, cls, at, root=root))
    if _is_section(kind):
        raise ConfigError(f"'{key}' is a section; override one of its keys: {', '.join(keys(kind, section=key))}")
    values[name] = _parse(kind, text)


def _parse(kind: Any, text: str) -> Value:  # noqa: ANN401 - a type, and whatever the text holds
    try:
        value = parse_toml(f"value = {text}")["value"]
    except ValueError:
        return text
    # A bare 5 or true is still a string where a string is wanted.
    return text if kind is str and not isinstance(value, str) else value


def _convert(kind: Any, value: Value, key: str) -> Value:  # noqa: ANN401 - a type, and whatever the file holds
    """Return the value as the field's type, or raise with the key; nothing is converted but int to float."""
    if _is_section(kind):
        if not isinstance(value, Mapping):
            raise ConfigError(f"{key} = {_shown(value)} is not a table; write a [{key}] section")
        return build(kind, value, section=key)
    if typing.get_origin(kind) is tuple:
        return _convert_tuple(kind, value, key)
    if isinstance(value, int) and abs(value) >= 1 << 63:
        raise ConfigError(f"{key} = {_shown(value)} is beyond any number that is meant")
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not kind:
        raise ConfigError(f"{key} = {_shown(value)} is {_noun(type(value))}; it must be {_noun(kind)}")
    if kind is float and math.isnan(value):
        raise ConfigError(f"{key} = nan; it must be a number")
    if kind is float and math.isinf(value):
        raise ConfigError(f"{key} = {value}; it must be finite - for no limit give a large number such as 1e9")
    return value


def _convert_tuple(kind: Any, value: Value, key: str) -> tuple[Value, ...]:  # noqa: ANN401 - a type, a file's value
    if not isinstance(value, (list, tuple)):
        raise ConfigError(f"{key} = {_shown(value)} is {_noun(type(value))}; it must be a list")
    entries = typing.get_args(kind)
    if len(entries) == 2 and entries[1] is Ellipsis:
        entries = (entries[0],) * len(value)
    if len(entries) != len(value):
        raise ConfigError(f"{key} = {_shown(value)} has {len(value)} entries; it must have {len(entries)}")
    return tuple(
        _convert(entry, item, f"{key}[{i}]") for i, (entry, item) in enumerate(zip(entries, value, strict=True))
    )


def _shown(value: Value) -> str:
    """Return a value for a message, of bounded length whatever a file holds."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]}..."


def _noun(kind: type) -> str:
    nouns = {float: "a number", int: "a whole number", bool: "true or false", str: "a string", list: "a list"}
    return nouns.get(kind, f"a {getattr(kind, '__name__', kind)}")


def _table(config: Any, *, section: str) -> Iterator[str]:  # noqa: ANN401 - any dataclass
    docs, nested = field_docs(type(config)), []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            nested.append((field.name, value))
            continue
        if field.name in docs:
            yield f"# {docs[field.name].replace('``', '')}"
        yield f"{field.name} = {_literal(value)}"
    for name, value in nested:
        key = _join(section, name)
        summary = (type(value).__doc__ or "").strip().partition("\n")[0]
        yield ""
        yield f"[{key}]" + (f"  # {summary.replace('``', '')}" if summary else "")
        yield from _table(value, section=key)


def _literal(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return "[" + ", ".join(_literal(entry) for entry in value) + "]"
    if isinstance(value, str):
        # JSON's escapes are TOML's but for DEL, which only TOML wants escaped.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)
