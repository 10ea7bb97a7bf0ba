"""Range checks for the ``__post_init__`` of configuration dataclasses."""

from __future__ import annotations

import math

from heliograph.errors import ConfigError, closest

__all__ = ["check_choice", "check_range"]


def check_range(
    config: object,
    *names: str,
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
    below: float | None = None,
) -> None:
    """Raise `ConfigError` unless every named field lies in the range; a tuple's every entry is checked.

    Parameters
    ----------
    config : object
        The dataclass.
    *names : str
        Its numeric fields.
    low, high : float
        Closed ends.
    above, below : float
        Open ends.
    """
    ends = ((">=", low), ("<=", high), (">", above), ("<", below))
    wanted = " and ".join(f"{sign} {end:g}" for sign, end in ends if end is not None)
    for name in names:
        value = getattr(config, name)
        for number in value if isinstance(value, tuple) else (value,):
            inside = (
                (low is None or number >= low)
                and (high is None or number <= high)
                and (above is None or number > above)
                and (below is None or number < below)
            )
            if math.isnan(number) or not inside:
                raise ConfigError(f"{name} = {value!r} is out of range; it must be {wanted or 'a number'}")


def check_choice(config: object, name: str, *choices: str) -> None:
    """Raise `ConfigError` unless the named field is one of the choices."""
    value = getattr(config, name)
    if value not in choices:
        listed = ", ".join(repr(choice) for choice in choices)
        raise ConfigError(f"{name} = {value!r} is not one of {listed}{closest(str(value), choices)}")
