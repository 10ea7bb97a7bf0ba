"""What each warning means and what helps: the table of docs/howto/bad_data.md, which travels with the package."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import fnmatchcase
from functools import cache
from html import escape
from importlib.resources import files

__all__ = ["anchor", "find_meaning", "meanings_section"]

_LINK = re.compile(r"\[([^\]]+)\]\(([^)]+)\)")


@cache
def _table() -> tuple[tuple[tuple[str, ...], str, str], ...]:
    """Return codes, which may hold wildcards, what they mean, and what helps, a row each."""
    text = files("heliograph.report").joinpath("warnings.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip().strip("|").split(" | ")] for line in text.splitlines()]
    return tuple((tuple(re.findall(r"`([^`]+)`", row[0])), row[1], row[2] if len(row) > 2 else "") for row in rows)


def find_meaning(code: str) -> tuple[str, str] | None:
    """Return what a warning means and what helps, in Markdown; None for a code of somebody else's."""
    found = next((row for row in _table() if any(fnmatchcase(code, pattern) for pattern in row[0])), None)
    return None if found is None else (found[1], found[2])


def anchor(code: str) -> str:
    """Return the name of a warning's place in the page."""
    return f"means-{escape(code)}"


def meanings_section(codes: Iterable[str]) -> str:
    """Return the section of a page that explains its warnings; nothing without any."""
    rows = ""
    for code in dict.fromkeys(codes):
        meaning = find_meaning(code)
        if meaning is not None:
            means, helps = (_words(text) for text in meaning)
            rows += (
                f'<dt id="{anchor(code)}">{escape(code)}</dt><dd>{means}{f"<br><i>{helps}</i>" if helps else ""}</dd>'
            )
    note = '<p class="note">From docs/howto/bad_data.md, which has all of them.</p>'
    return (
        f'<section id="warnings"><h2>What the warnings mean</h2><dl class="means">{rows}</dl>{note}</section>'
        if rows
        else ""
    )


def _words(text: str) -> str:
    """Return Markdown of the table as HTML: links as words with the document they lead to."""
    plain = _LINK.sub(lambda link: f"{link[1]} (docs/howto/{link[2]})".replace("docs/howto/../", "docs/"), text)
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(plain))
