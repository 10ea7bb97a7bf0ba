"""Pictures of graphs."""

import builtins

import numpy as np
import pytest

from heliograph.errors import GraphError, MissingDependencyError
from heliograph.graph import Between, FactorGraph, Isotropic, Landmark, Prior, Values
from heliograph.graph.draw import plot_poses, to_dot
from heliograph.graph.files.worlds import grid_walk, manhattan
from heliograph.lie import SE2, SE3


def small():
    graph, values = FactorGraph(), Values()
    values.insert([0, 1], SE2.identity((2,)))
    values.insert(9, [1.0, 2.0])
    graph.add(Prior(0, SE2.identity(), Isotropic(0.1)))
    graph.add(Between(0, 1, SE2.exp([0.0, 1.0, 0.0]), Isotropic(0.1)))
    graph.add(Landmark(1, 9, [0.0, 1.0], Isotropic(0.1)))
    graph.fix(0)
    return graph, values


def test_dot_names_variables_and_factors():
    text = to_dot(small()[0], names={9: 'a "tree"'})
    assert text.startswith("graph factors {") and text.endswith("}\n")
    assert '"v0" [label="0", shape=doublecircle]' in text
    assert '"v9" [label="a \\"tree\\"", shape=circle]' in text
    assert 'xlabel="Between 1"' in text
    assert text.count(" -- ") == 5
    assert '"v1" -- "f2"' in text


def test_dot_refuses_what_nobody_could_read():
    graph = FactorGraph()
    graph.add(Between(np.arange(500), np.arange(1, 501), SE2.identity((500,)), Isotropic(0.1)))
    with pytest.raises(GraphError, match=r"501 variables .* plot_poses"):
        to_dot(graph)
    assert to_dot(FactorGraph()).startswith("graph")


@pytest.mark.parametrize("make", [manhattan, grid_walk])
def test_plot_draws_loops_and_odometry(make, rng, tmp_path):
    world = make(100, rng)
    values = Values()
    values.insert(np.arange(100), world.truth)
    figure = plot_poses(world.file.graph(), values, before=world.file.odometry_values(), title="a walk")
    assert [axes.get_title() for axes in figure.axes] == ["before", "after"]
    for axes in figure.axes:
        loops, odometry = axes.lines
        assert len(odometry.get_data()[0]) == 3 * 99
        assert len(loops.get_data()[0]) == 3 * world.loops
        assert loops.get_color() != odometry.get_color()
    figure.savefig(tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 1000


def test_plot_shows_landmarks():
    figure = plot_poses(*small())
    assert len(figure.axes) == 1
    assert figure.axes[0].lines[-1].get_marker() == "+"


def test_plot_needs_poses():
    values = Values()
    values.insert(0, [1.0])
    with pytest.raises(GraphError, match="no poses"):
        plot_poses(FactorGraph(), values)


def test_plot_says_what_to_install(monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **options):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *args, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MissingDependencyError, match="pip install matplotlib"):
        plot_poses(FactorGraph(), Values())


def test_plot_of_space_has_three_axes(rng):
    values = Values()
    values.insert([0, 1], SE3.exp(rng.normal(size=(2, 6))))
    assert plot_poses(FactorGraph(), values).axes[0].name == "3d"
