"""The lesson's table holds: chapter, experiment, command and worked numbers are those of the engine."""

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from heliograph.cli.help import EXAMPLES
from heliograph.cli.main import app
from heliograph.lab import EXPERIMENTS

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "lesson.md").read_text()
_TABLE = [line for line in TEXT.splitlines() if line.startswith("| [")]
ROWS = [[cell.strip() for cell in line.strip()[1:-1].split("|")] for line in _TABLE]


def numbers(text):
    return {float(word) for word in re.findall(r"\d+(?:\.\d+)?", text)}


def test_lesson_has_every_chapter_and_every_experiment_once():
    assert [int(re.match(r"\[(\d+)", row[0])[1]) for row in ROWS] == list(range(11))
    assert sorted(word for row in ROWS for word in re.findall(r"`(\w+)`", row[1])) == sorted(EXPERIMENTS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: re.match(r"\[(\d+)", row[0])[1])
def test_row_of_the_lesson_holds(row):
    chapter, lab, command, worked = row
    number, anchor = re.match(r"\[(\d+) .*\]\(#(.*)\)", chapter).groups()
    headings = {re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-") for line in re.findall(r"^## (.*)$", TEXT, re.M)}
    assert anchor in headings
    section = TEXT[TEXT.index(f"\n## {number} ") :].split("\n## ")[1]
    for name in re.findall(r"`(\w+)`", lab):
        experiment = EXPERIMENTS[name]
        assert experiment.chapter.startswith(f"{number}:")
        told = {round(item.value, item.digits) for item in experiment.worked()}
        assert told <= numbers(worked), "the table says what the engine gives"
        assert told <= numbers(section), "and the chapter works it out"
    commands = [shlex.split(text) for text in re.findall(r"`([^`]+)`", command)]
    commands = [words for words in commands if words[0] in EXAMPLES]  # the rest are values of an option
    assert commands or "choosing.md" in command
    for name, *options in commands:
        shown = CliRunner().invoke(app, [name, "--help-all"])
        assert shown.exit_code == 0, f"there is no command {name}"
        for option in (word for word in options if word.startswith("--")):
            assert option in shown.output
        assert re.search(rf"^heliograph {name}\b", section, re.MULTILINE), f"{name} is typed in chapter {number}"
