"""Parts that users bring along, found by name: registered, installed as an entry point, or written ``module:name``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from heliograph.errors import ConfigError, HeliographError, closest

__all__ = ["call_plugin", "check_plugin", "find_plugin", "import_named", "installed_plugins", "plugin_names"]


def plugin_names(registered: Iterable[str], group: str) -> list[str]:
    """Return all names that `find_plugin` knows, sorted."""
    return sorted({*registered, *installed_plugins(group)})


def installed_plugins(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group that the installed packages offer, by name; none of them is imported."""
    return {entry.name: entry for entry in entry_points(group=group)}


def find_plugin(kind: str, name: str, registered: Mapping[str, object], group: str) -> Any:  # noqa: ANN401
    """Return what a name stands for.

    Parameters
    ----------
    kind : str
        In words, for messages.
    name : str
        A registered name, that of an entry point, or ``"module:name"``, which is imported.
    registered : mapping
        Name -> the thing itself, or ``"module:name"``.
    group : str
        Entry points to look at.

    Raises
    ------
    ConfigError
        An unknown name (the message names the nearest), or a module that cannot be imported.
    """
    if name in registered:
        thing = registered[name]
        return import_named(kind, thing) if isinstance(thing, str) else thing
    installed = installed_plugins(group)
    if name in installed:
        return import_named(kind, installed[name].value)
    if ":" in name:
        return import_named(kind, name)
    names = plugin_names(registered, group)
    raise ConfigError(
        f"{kind} '{name}' is not one of {', '.join(names)}, nor written as module:name{closest(name, names)}"
    )


def import_named(kind: str, reference: str) -> Any:  # noqa: ANN401 - whatever the module holds
    """Import ``"module:name"``.

    Raises
    ------
    ConfigError
        The module or the name in it is not there, or the module fails while it is imported.
    """
    module, _, name = reference.partition(":")
    try:
        found: Any = import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except Exception as error:  # a user's module may fail in any way
        cause = f"{type(error).__name__}: {error}"
        raise ConfigError(f"{kind} '{reference}' cannot be imported ({cause}); check module and name") from error
    return found


def call_plugin(
    kind: str,
    name: str,
    function: Any,  # noqa: ANN401 - a user's function
    *arguments: object,
    **keywords: object,
) -> Any:  # noqa: ANN401
    """Call what `find_plugin` returned; a failure of a user's function is told as such, one of ours is not hidden.

    Raises
    ------
    ConfigError
        It is no function, or fails with anything but a `HeliographError`.
    """
    if not callable(function):
        raise ConfigError(f"{kind} '{name}' is no function that makes one, but a {type(function).__name__}")
    if str(getattr(function, "__module__", "")).partition(".")[0] == "heliograph":
        return function(*arguments, **keywords)
    try:
        return function(*arguments, **keywords)
    except HeliographError:
        raise
    except Exception as error:  # a user's function may fail in any way
        cause = f"{type(error).__name__}: {error}"
        raise ConfigError(
            f"{kind} '{name}' could not be made ({cause}); it was called with {len(arguments)} arguments"
        ) from error


def check_plugin(kind: str, name: str, thing: object, protocol: type) -> None:
    """Assert that what a user's function made has all that a protocol names.

    Raises
    ------
    ConfigError
        Something is missing; the message names it.
    """
    members = {*getattr(protocol, "__annotations__", {}), *vars(protocol)}
    missing = sorted(member for member in members if not member.startswith("_") and not hasattr(thing, member))
    if missing:
        raise ConfigError(
            f"{kind} '{name}' made a {type(thing).__name__} without {', '.join(missing)}; see heliograph.testing"
        )
