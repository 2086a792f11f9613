"""The picture of a lune: what it colours is what the total order says, and its triangles are the library's killers."""

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import topokit as tk
from topokit import view
from topokit.rips import reduction
from topokit.view._lunes import _components, _joined_before

from pages import by_script, check_small_and_whole, needs_node, page_data


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


# ---- the figure, and its script, run by node

SQUARE = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
CALL = """(points) => {
  const complex = rips(points);
  return complex.edges.map((e, k) => [e.i, e.j, complex.does(k), e.parts]);
}"""


def test_lunes_holds_its_clouds_and_asks_nothing_of_the_network():
    figure = view.lunes({"square": SQUARE, "two": [[0, 0], [1, 1]]})
    assert page_data(figure)["shapes"] == {"square": SQUARE, "two": [[0.0, 0.0], [1.0, 1.0]]}
    check_small_and_whole(figure)
    assert repr(figure).startswith("Framed('The lunes of 4 or 2 points'")


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((61, 2)), "points must be 1 to 60 points, not 61"),
        (np.eye(3), "points must lie in the plane"),
        ([[0, 0]], "one point has no edge; give at least two"),
        ({}, "points names no cloud"),
    ],
)
def test_lunes_refuses_what_it_cannot_show(points, message):
    with pytest.raises(ValueError, match=message):
        view.lunes(points)


def what_edges_do(cloud):
    """The act of every edge by the textbook's pairs, and the components of its lune by the library's picture."""
    reduced = reduction.reduce(reduction.filtration(cloud, 3))
    pairs = {k: [p for p in reduced.pairs(k) if p.birth_edge != p.killer_edge] for k in range(3)}
    acts = {p.killer_edge: "joins" for p in pairs[0]}
    acts |= {p.birth_edge: "begins" for p in pairs[1]} | {p.killer_edge: "kills" for p in pairs[1]}
    acts |= {p.birth_edge: "void" for p in pairs[2]}
    for simplex in reduced.simplices:
        if len(simplex.vertices) == 2:
            joined = _joined_before(cloud, *simplex.vertices)
            x, y = simplex.vertices
            parts = _components(np.flatnonzero(joined[x] & joined[y]), joined)
            yield [x, y, acts.get((x, y), "nothing"), [part.tolist() for part in parts]]


@needs_node
def test_script_says_of_every_edge_what_the_textbook_says():
    """Order, lunes, components and acts, on rings, on clouds with ties and duplicates, and on hexagons, which bear voids."""
    rng, seen = np.random.default_rng(7), set()
    angle = np.pi / 3 * np.arange(6)
    hexagon = np.column_stack([np.cos(angle), np.sin(angle)])
    clouds = [(hexagon + rng.normal(0, 0.04, (6, 2))) * (1 + 0.3 * k) for k in range(20)]
    clouds += [rng.normal(size=(int(n), 2)) for n in rng.integers(2, 14, 20)]
    clouds += [rng.integers(0, 4, (int(n), 2)).astype(float) for n in rng.integers(2, 14, 20)]
    for cloud, theirs in zip(clouds, by_script(["rips.js"], CALL, [c.tolist() for c in clouds]), strict=True):
        ours = list(what_edges_do(cloud))
        assert [[x, y, act, sorted(map(sorted, parts))] for x, y, act, parts in theirs] == ours
        seen |= {act for _, _, act, _ in ours}
    assert seen == {"joins", "begins", "kills", "void", "nothing"}


@needs_node
def test_every_component_begins_with_its_apex():
    cloud = np.random.default_rng(8).normal(size=(25, 2))
    [edges] = by_script(["rips.js"], CALL, [cloud.tolist()])
    length = np.linalg.norm(cloud[:, None] - cloud, axis=2)
    for x, y, _, parts in edges:
        assert all(part[0] == min(part, key=lambda z: max(length[x, z], length[y, z])) for part in parts)
