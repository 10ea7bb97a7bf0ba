"""What a bug report needs of a run, in one file: no points, no trajectory, no name of a person, machine or folder."""

from __future__ import annotations

import contextlib
import getpass
import json
import platform
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from heliograph.atomic import atomic_path
from heliograph.errors import FormatError
from heliograph.guard.account import read_account
from heliograph.guard.files import TABLE, plain_file

__all__ = ["pack_support"]

_TEXTS = ("run.json", "config.toml", "scans.csv", "loops.csv")
_POSITIONS = {"scans.csv": re.compile(r"(position|velocity)_[xyz]")}
# A drive or a slash before at least one folder; an URL's "//" is none.
_PATH = re.compile(r"(?<![\w/:.])(?:[A-Za-z]:)?(?:[\\/][^\s\\/'\"`,;:()\[\]<>|=]+){1,}[\\/]?")
_QUOTED = re.compile(r"(['\"`])((?:[A-Za-z]:)?[\\/][^'\"`\n]*[\\/][^'\"`\n]*)\1")  # a path in quotes may hold spaces
_ALL_PATH = ("folder", "recording")  # of `run.json`: these are paths or names as a whole


def pack_support(folder: Path, target: Path) -> list[str]:
    """Write a zip archive of a run's account, settings, tables and the list of its files.

    Absolute paths become ``<path>``; names of the user, the machine and the recording become ``<user>``, ``<host>`` and
    ``<recording>``. Positions are left out: what remains of a scan is what the estimation says of itself.

    Parameters
    ----------
    folder : Path
        What `run` wrote, whether the run has ended or not.
    target : Path
        The archive.

    Returns
    -------
    list of str
        Names in the archive.

    Raises
    ------
    FormatError
        It is no folder of a run.
    OutputError
        The archive cannot be written.
    """
    if not (folder / "run.json").is_file():
        raise FormatError(folder, "is no folder of a run (it holds no run.json); name what `run` wrote")
    facts = _facts(folder)
    hidden, topics = _names(folder, facts), _topics(facts)
    texts = {name: _read(folder / name) for name in _TEXTS if (folder / name).is_file()}
    for name, columns in _POSITIONS.items():
        if name in texts:
            texts[name] = _without(texts[name], columns)
    texts["files.txt"] = "".join(
        f"{file.stat().st_size:>14} {file.relative_to(folder).as_posix()}\n"
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file.parent.name != "keyframes"
    )
    count = sum(1 for _ in folder.glob("keyframes/*.npz"))
    texts["files.txt"] += f"{'':>14} keyframes: {count}\n"
    with atomic_path(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in texts.items():
            if name == "run.json" and facts:
                text = json.dumps(_clean_tree(facts, hidden, topics), indent=2) + "\n"
            archive.writestr(name, _clean(text, hidden, topics))
    return list(texts)


def _read(path: Path) -> str:
    return plain_file(path, TABLE).read_text(encoding="utf-8", errors="replace")


def _facts(folder: Path) -> dict[str, Any]:
    try:
        return read_account(folder)
    except FormatError:
        return {}  # it is packed as text, for that may be what the report is about


def _topics(facts: Mapping[str, Any]) -> set[str]:
    """Return the topics of a recording, which look like paths and are none."""
    recording = facts.get("recording")
    topics = recording.get("topics") if isinstance(recording, dict) else None
    return {topic for topic in topics.values() if isinstance(topic, str)} if isinstance(topics, dict) else set()


def _names(folder: Path, facts: Mapping[str, Any]) -> dict[str, str]:
    """Return words to hide with what stands for them."""
    names: dict[str, str] = {}
    with contextlib.suppress(OSError, KeyError, ImportError):  # a user without a name
        names[getpass.getuser()] = "<user>"
    names[platform.node()] = "<host>"
    names[Path.home().name] = "<user>"
    names[folder.resolve().name] = "<run>"
    for entry in facts.get("inputs", ()):
        for part in Path(str(entry.get("name", ""))).parts:
            names |= {part: "<recording>", Path(part).stem: "<recording>"}
    return {word: mark for word, mark in names.items() if len(word) > 2}


def _clean_tree(value: Any, hidden: Mapping[str, str], topics: set[str], key: str = "") -> Any:  # noqa: ANN401
    if isinstance(value, dict):
        return {name: _clean_tree(item, hidden, topics, name) for name, item in value.items()}
    if isinstance(value, list):
        return [_clean_tree(item, hidden, topics, key) for item in value]
    if not isinstance(value, str):
        return value
    return "<path>" if key in _ALL_PATH else _clean(value, hidden, topics)


def _clean(text: str, hidden: Mapping[str, str], topics: set[str]) -> str:
    text = _QUOTED.sub(lambda found: found[0] if found[2] in topics else f"{found[1]}<path>{found[1]}", text)
    text = _PATH.sub(lambda found: found[0] if found[0] in topics else "<path>", text)
    for word in sorted(hidden, key=len, reverse=True):
        text = re.sub(rf"(?<![A-Za-z0-9]){re.escape(word)}(?![A-Za-z0-9])", hidden[word], text)
    return text


def _without(table: str, columns: re.Pattern[str]) -> str:
    """Return a table of comma-separated values without some columns."""
    lines = table.splitlines()
    if not lines:
        return table
    head = lines[0].split(",")
    kept = [k for k, name in enumerate(head) if not columns.fullmatch(name)]
    rows = (line.split(",") for line in lines)
    return "".join(",".join(row[k] for k in kept if k < len(row)) + "\n" for row in rows)
