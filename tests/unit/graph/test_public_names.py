"""The package's names are imported when they are used; its lists of them agree."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import heliograph.graph as engine


def imported_for_types():
    tree = ast.parse(Path(engine.__file__).read_text(encoding="utf-8"))
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("heliograph.graph."):
            found |= {alias.name: node.module.removeprefix("heliograph.graph.") for alias in node.names}
    return found


def test_graph_s_lists_of_names_agree():
    assert imported_for_types() == engine._MODULES
    assert sorted(engine._MODULES) == sorted(engine.__all__)
    assert set(engine.__all__) <= set(dir(engine))


@pytest.mark.parametrize("name", engine.__all__)
def test_graph_s_names_are_found(name):
    thing = getattr(engine, name)
    assert getattr(thing, "__name__", name).rpartition(".")[2] == name


def test_graph_s_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'ISAM3'"):
        _ = engine.ISAM3


def test_graph_s_parts_wait_for_their_first_use():
    code = (
        "import sys, heliograph.graph as g; g.solve, g.FactorGraph;"
        "assert not [m for m in sys.modules if m.startswith('heliograph.graph.incremental')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
