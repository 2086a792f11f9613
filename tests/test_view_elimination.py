"""The reduction of chapter 2, a sum at a time: what its page holds, and that its script does what topokit.rips.reduction does."""

from __future__ import annotations

import numpy as np
import pytest

from topokit import view
from topokit.rips import reduction

from pages import by_script, check_small_and_whole, needs_node, page_data

SEVEN = [[2.0, 0.0], [9.0, 0.0], [17.0, 0.0], [17.0, 9.0], [9.0, 10.0], [0.0, 9.0], [-4.0, 6.0]]
CALL = """([points, radius]) => {
  const { rows, columns, steps } = eliminate(points, radius), whole = (s) => (
    { ...s, column: s.column ? bits(s.column) : [], chain: bits(s.chain), pivot: s.column ? pivot(s.column) : null });
  return { rows: rows.map((e) => [e.i, e.j]), columns: columns.map((c) => c.ids), steps: steps.map(whole) };
}"""


def test_elimination_holds_its_points_and_asks_nothing_of_the_network():
    figure = view.elimination(SEVEN, 6.2)
    assert page_data(figure)["points"] == SEVEN
    assert page_data(figure)["radius"] == 6.2
    check_small_and_whole(figure)
    assert repr(figure).startswith("Framed('The boundary matrix of 7 points, reduced'")


@pytest.mark.parametrize(
    ("points", "radius", "message"),
    [
        (np.zeros((11, 2)), 1, "points must be 1 to 10 points, not 11"),
        (np.zeros((5, 3)), 1, "points must lie in the plane"),
        (SEVEN, 0, "max_radius must be more than zero"),
    ],
)
def test_elimination_refuses_what_it_cannot_show(points, radius, message):
    with pytest.raises(ValueError, match=message):
        view.elimination(points, radius)


def clouds() -> list[tuple[np.ndarray, float]]:
    """The chapter's seven points, random ones, and ones with ties and duplicates; with all their edges and with some."""
    rng = np.random.default_rng(0)
    found = [(np.array(SEVEN), radius) for radius in (4.0, 6.2, 99.0)]
    for n in rng.integers(1, 11, 60).tolist():
        found.append((rng.normal(size=(n, 2)), float(rng.uniform(0.3, 2))))
        found.append((rng.integers(0, 4, (n, 2)).astype(float), float(rng.uniform(0.3, 3))))
    return found


@needs_node
def test_script_reduces_as_the_library_does():
    """The same rows and columns, the same reduced columns, chains and pairs; each step adds the column that owns the pivot."""
    cases, emptied, added = clouds(), 0, 0
    for (cloud, radius), theirs in zip(
        cases, by_script(["rips.js", "columns.js"], CALL, [(c.tolist(), r) for c, r in cases]), strict=True
    ):
        ours = reduction.reduce(reduction.filtration(cloud, 2, max_radius=radius))
        kind = [[j for j, s in enumerate(ours.simplices) if len(s.vertices) == size] for size in (2, 3)]
        edges, triangles = kind
        assert theirs["rows"] == [list(ours.simplices[j].vertices) for j in edges]
        assert theirs["columns"] == [list(ours.simplices[j].vertices) for j in triangles]
        final: dict[int, dict] = {}
        for before, step in zip([None, *theirs["steps"]], theirs["steps"], strict=False):
            if step["added"] >= 0:
                other = final[step["added"]]
                assert other["pivot"] == before["pivot"]
                assert before["next"] == step["added"]
                assert set(step["column"]) == set(before["column"]) ^ set(other["column"])
                assert step["k"] == before["k"]
                added += 1
            else:
                facets = {edges.index(f) for f in boundary(ours, triangles[step["k"]])}
                assert set(step["column"]) == facets
            if step["next"] < 0:
                final[step["k"]] = step
        for k, j in enumerate(triangles):
            assert {edges[row] for row in final[k]["column"]} == ours.columns[j]
            assert {triangles[t] for t in final[k]["chain"]} == ours.chains[j]
            emptied += not ours.columns[j]
        pairs = {edges[step["pivot"]]: triangles[k] for k, step in final.items() if step["column"]}
        assert pairs == {birth: death for birth, death in ours.killer.items() if birth in edges}
    assert emptied > 100
    assert added > 100


def boundary(reduced: reduction.Reduction, j: int) -> list[int]:
    """The positions of the three sides of a triangle."""
    position = {simplex.vertices: k for k, simplex in enumerate(reduced.simplices)}
    a, b, c = reduced.simplices[j].vertices
    return [position[side] for side in ((a, b), (a, c), (b, c))]
