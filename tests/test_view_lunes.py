"""The picture of a lune: what it colours is what the total order says, and its triangles are the library's killers."""

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import topokit as tk
from topokit import view
from topokit.view._lunes import _components, _joined_before


@pytest.fixture(autouse=True)
def _no_windows():
    mpl.use("agg")
    yield
    plt.close("all")


def filled(axes):
    """The triangles of a picture, as sets of corners."""
    polygons = [patch.get_xy()[:-1] for patch in axes.patches]
    return {frozenset(map(tuple, polygon.tolist())) for polygon in polygons if len(polygon) == 3}


@pytest.mark.parametrize(
    ("apexes", "title"),
    [
        ([], "empty"),
        ([[1.0, 0.2]], "connected"),
        ([[1.0, 0.2], [1.0, -0.2]], "connected"),
        ([[1.0, 1.2], [1.0, -1.2]], "2 components"),
    ],
)
def test_counts_components(apexes, title):
    cloud = np.array([[0.0, 0.0], [2.0, 0.0], *apexes])
    axes = view.plot_lune(cloud, (1, 0))
    assert axes.get_title() == title
    assert len(filled(axes)) == (2 if len(apexes) == 2 and title != "connected" else 0)


def test_ties_go_by_index():
    """All six edges of two equilateral triangles' union but the long one tie; the lune holds the earlier ones only."""
    cloud = [[0, 0], [4, 0], [4, 3], [0, 3]]
    assert view.plot_lune(cloud, (0, 2)).get_title() == "2 components"
    assert view.plot_lune(cloud, (1, 3)).get_title() == "connected"  # the other diagonal came before


def test_draws_the_killer_triangles_of_every_loop():
    cloud = np.random.default_rng(5).normal(size=(40, 2))
    diagram = tk.rips_persistence(cloud)
    assert len(diagram) > 3
    for edge, triangles in zip(diagram.killer_edge, diagram.killer_triangles, strict=True):
        axes = view.plot_lune(cloud, edge, plt.figure().add_subplot())
        assert filled(axes) == {frozenset(map(tuple, cloud[t].tolist())) for t in triangles}


def test_only_disconnected_lunes_kill():
    cloud = np.random.default_rng(6).normal(size=(25, 2))
    disconnected = set()
    for x in range(25):
        for y in range(x + 1, 25):
            joined = _joined_before(cloud, x, y)
            if len(_components(np.flatnonzero(joined[x] & joined[y]), joined)) > 1:
                disconnected.add((x, y))
    assert disconnected.issuperset(map(tuple, tk.rips_persistence(cloud).killer_edge.tolist()))


@pytest.mark.parametrize(
    ("points", "edge", "message"),
    [
        (np.eye(3), (0, 1), "points must lie in the plane, not in 3 dimensions"),
        (np.eye(2), (0, 0), r"two different vertices from 0 to 1, not \(0, 0\)"),
        (np.eye(2), (0, 2), r"two different vertices from 0 to 1, not \(0, 2\)"),
        (np.eye(2), (0, 1, 1), r"ids of two different vertices from 0 to 1, not \(0, 1, 1\)"),
        (np.eye(2), (0.0, 1.0), r"ids of two different vertices from 0 to 1, not \(0.0, 1.0\)"),
    ],
)
def test_refuses_what_has_no_lune(points, edge, message):
    with pytest.raises(ValueError, match=message):
        view.plot_lune(points, edge)
