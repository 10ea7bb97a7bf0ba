"""Words of the source: one public class a name, limits called `max_*`, docstrings that say what a thing is."""

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2] / "src" / "heliograph"
MODULES = sorted(SOURCE.rglob("*.py"))


def public_classes(tree):
    """Names of the classes at a module's top that other modules may use."""
    return [node.name for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]


def docstrings(tree):
    """Yield line and text of every docstring, and of the comments on attributes that stand as bare strings."""
    for node in ast.walk(tree):
        for child in getattr(node, "body", ()) if isinstance(getattr(node, "body", ()), list) else ():
            if (
                isinstance(child, ast.Expr)
                and isinstance(child.value, ast.Constant)
                and isinstance(child.value.value, str)
            ):
                yield child.lineno, child.value.value


def begins_with_of(text):
    """Sentences of a docstring that begin with "Of" at the start of a line, as under a parameter."""
    return [line.strip() for line in text.splitlines() if re.match(r"\s*Of\b", line)]


def limits_called_most(tree):
    """Names of parameters, attributes, functions and variables that begin with "most" or end with it."""
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            names.append(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.append(node.id)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.append(node.attr)
    return [name for name in names if re.fullmatch(r"_?most(_\w+)?", name, re.IGNORECASE)]


COINED = re.compile(r"\bso many\b|\bso-manieth\b|\bput off\b", re.IGNORECASE)


def parsed(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def test_public_classes_have_names_of_their_own():
    homes = defaultdict(list)
    for path in MODULES:
        for name in public_classes(parsed(path)):
            homes[name].append(str(path.relative_to(SOURCE)))
    assert {name: where for name, where in homes.items() if len(where) > 1} == {}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(SOURCE)))
def test_words_are_those_of_the_field(path):
    tree = parsed(path)
    genitives = [f"{line}: {words}" for line, text in docstrings(tree) for words in begins_with_of(text)]
    assert genitives == [], "a docstring says whose, not what: begin with the noun"
    assert limits_called_most(tree) == [], "an upper limit is called max_*"
    coined = [
        number for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if COINED.search(line)
    ]
    assert coined == [], "say how many by name; what waits is deferred"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("Of the IMU.", ["Of the IMU."]),
        ("Do it.\n\nParameters\n----------\nnoise : Noise\n    Of the IMU.\n", ["Of the IMU."]),
        ("Do it.\n\nParameters\n----------\nrmse, mean\n    Of the error.\n", ["Of the error."]),
        ("Noise of the IMU.", []),
        ("Take the part\nof which no one speaks.", []),
        ("Often.", []),
    ],
)
def test_checker_finds_a_genitive_without_its_noun(text, found):
    assert begins_with_of(text) == found


def test_checker_finds_limits_called_most():
    tree = ast.parse("def f(most_steps, most):\n    self.most_rows = 1\n    MOST = almost = utmost_x = 2")
    assert sorted(limits_called_most(tree)) == ["MOST", "most", "most_rows", "most_steps"]


def test_checker_finds_public_classes_only():
    assert public_classes(ast.parse("class A: ...\nclass _B: ...\ndef f():\n    class C: ...")) == ["A"]
