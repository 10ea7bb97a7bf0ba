"""Why a run is not simply ok: a code that stays, a sentence with numbers, and the one thing to do next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

__all__ = ["ACTIONS", "Reason", "next_action", "reason_facts"]

ACTIONS = {
    "ok": "use the result",
    "lost": "do not use the result; `heliograph check RECORDING` looks for the cause",
    "unmatched": "look at scans.csv where the verdict is not tracked; `heliograph check RECORDING` looks for the cause",
    "blind": "do not measure along that direction there; drive where the sensor sees ends of walls, or add a loop",
    "imu-alone": "record the LiDAR too; without it only seconds are of use",
    "imu-held": "check the IMU's clock and gaps with `heliograph check RECORDING --imu`",
    "against-imu": "`heliograph check RECORDING --imu`; else look where like places were taken for one another",
    "unsteady": "record an IMU, or let the LiDAR turn faster: motion that changes within a sweep is not followed",
    "interrupted": "run it again with --resume for the rest of the recording",
    "failure": "read `failure`, mend it, and run it again with --resume",
    "other": "read the reason; docs/howto/bad_data.md says what helps",
}
"""Code -> what to do next."""


class Reason(str):
    """A reason in words, which knows its code.

    Parameters
    ----------
    code : str
        One of `ACTIONS`; stays the same from version to version.
    text : str
        The sentence, with numbers.
    """

    __slots__ = ("code",)
    code: str

    def __new__(cls, code: str, text: str) -> Reason:
        """Make one."""
        if code not in ACTIONS:
            raise ValueError(f"'{code}' is no code of a reason; known are {', '.join(ACTIONS)}")
        made = super().__new__(cls, text)
        made.code = code
        return made


def reason_facts(reasons: Sequence[str]) -> list[dict[str, Any]]:
    """Return each reason with its code and the next action."""
    coded = [(getattr(reason, "code", "other"), str(reason)) for reason in reasons]
    return [{"code": code, "text": text, "action": ACTIONS[code]} for code, text in coded]


def next_action(status: str, reasons: Sequence[str], failure: str) -> str:
    """Return the one thing to do next: that of a failure, else of the first reason."""
    if failure:
        return ACTIONS["failure"]
    known = reason_facts(reasons)
    return str(known[0]["action"]) if known else ACTIONS[status if status in ACTIONS else "other"]
