"""Cliques as records, as Graphviz text and as a picture."""

import numpy as np
import pytest

from heliograph.errors import GraphError
from heliograph.graph import ISAM2, plot_cliques, tree_to_dot
from heliograph.lie import SE2
from reference.growth import growth


@pytest.fixture
def smoother(rng):
    smoother = ISAM2()
    for step in growth(SE2, 40, rng):
        smoother.update(step.graph(), step.values)
    return smoother


def test_cliques_form_a_tree_over_all_variables_with_running_intersection(smoother):
    cliques = smoother.cliques()
    known, above = {}, {}
    for clique in cliques:
        assert clique.parent is None or clique.parent in known  # parents first
        if clique.parent is None:
            assert clique.rows == ()
        else:
            parent = known[clique.parent]
            assert set(clique.rows) <= set(parent.pivots) | set(parent.rows)
            assert set(clique.rows) & set(parent.pivots)
        known[clique.number] = clique
        above.update(dict.fromkeys(clique.pivots, clique.number))
    keys = [key for key in smoother.estimate().keys().tolist() if key != 0]  # held
    assert sorted(above) == sorted(keys)
    assert sum(len(clique.pivots) for clique in cliques) == len(keys)
    assert 0 < sum(clique.touched for clique in cliques) < len(cliques)


def test_touched_cliques_are_closed_upwards(smoother):
    by_number = {clique.number: clique for clique in smoother.cliques()}
    for clique in by_number.values():
        if clique.touched and clique.parent is not None:
            assert by_number[clique.parent].touched


def test_graphviz_names_pivots_and_rows(smoother):
    cliques = smoother.cliques()
    text = tree_to_dot(cliques, names={39: 'the "last"'})
    assert text.startswith("digraph")
    assert text.count("->") == sum(clique.parent is not None for clique in cliques)
    assert text.count("fillcolor") == sum(clique.touched for clique in cliques)
    assert 'the \\"last\\"' in text
    clique = next(c for c in cliques if c.rows and 39 not in (*c.pivots, *c.rows))
    label = " ".join(map(str, clique.pivots)) + " : " + " ".join(map(str, clique.rows))
    assert f'label="{label}"' in text
    with pytest.raises(GraphError, match="at most 500"):
        tree_to_dot(cliques * 20)
    assert "->" not in tree_to_dot([c for c in cliques if c.parent is None])


def test_picture_has_every_clique_once_and_parents_above(smoother):
    pytest.importorskip("matplotlib")
    cliques = smoother.cliques()
    (axes,) = plot_cliques(cliques, title="tree").axes
    places = np.concatenate([np.asarray(part.get_offsets()) for part in axes.collections])
    assert len(places) == len(cliques)
    assert len(np.unique(places, axis=0)) == len(cliques)
    assert axes.get_title() == "tree"
    assert axes.yaxis_inverted()
    with pytest.raises(GraphError, match="nothing to plot"):
        plot_cliques([])
