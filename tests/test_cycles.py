"""Cycles: short, born when the bar is, a boundary at death and not before; and when given walks die.

`fuzz_rips` has the checks of each cycle by the textbook reduction.
"""

from __future__ import annotations

import numpy as np
import pytest
from fuzz_rips import Case, check_cycles, length, sides

from topokit import rips_persistence
from topokit.rips import _cycles

from clouds import random_cloud
from conftest import polygon

# The shortest way around loop 1 is the outline of loop 0's other side, {1, 3, 5, 4}, and lives on when loop 1 dies.
MIXED = np.array([[1, 5], [3, 2], [4, 6], [5, 0], [6, 4], [7, 1]], float)
SQUARE = np.array([[0, 0], [2, 0], [2, 2], [0, 2]], float)


def rank(rows: list[set[int]]) -> int:
    """Rank over GF(2) of sets."""
    pivots: dict[int, set[int]] = {}
    for row in rows:
        while row and max(row) in pivots:
            row = row ^ pivots[max(row)]
        if row:
            pivots[max(row)] = row
    return len(pivots)


def end_of(walk: list[int], earlier: list[list[int]], case: Case) -> int:
    """The first edge with which a walk bounds together with walks before it, all its own edges being there."""
    reduced = case.slow
    arrived = {j: case.edge(*s.latest_edge) for j, s in enumerate(reduced.simplices) if len(s.vertices) == 3}
    start = max(case.edge(a, b) for a, b in sides(walk))
    for step in sorted({start, *arrived.values()}):
        known = [reduced.columns[j] for j, edge in arrived.items() if edge <= step] + [case.chain(w) for w in earlier]
        if step >= start and rank([*known, case.chain(walk)]) == rank(known):
            return step
    raise AssertionError("the walk never ends")


@pytest.mark.parametrize("family", ["gaussian", "grid", "cocircular", "duplicates"])
def test_walks_die_when_ranks_say_they_do(family):
    rng = np.random.default_rng(len(family))
    for _ in range(40):
        cloud = random_cloud(rng, family, 9)
        if len(cloud) < 4:
            continue
        walks = [rng.permutation(len(cloud))[: rng.integers(3, len(cloud) + 1)].tolist() for _ in range(3)]
        case = Case(cloud)
        # By ranks, a walk that is a sum of earlier ones may have to wait for their edges; then any order of steps will do.
        latest = np.maximum.accumulate([max(case.edge(a, b) for a, b in sides(walk)) for walk in walks])
        ends = np.maximum([case.edge(*edge) for edge in case.fast.killers_of(walks).tolist()], latest)
        expected = [end_of(walk, walks[:k], case) for k, walk in enumerate(walks)]
        np.testing.assert_array_equal(ends, np.maximum(expected, latest))


def test_loops_that_merge_end_one_by_one():
    """Two squares side by side: around the left, around the right, around both."""
    points = [[0, 0], [2, 0], [2, 2], [0, 2], [4.5, 0], [4.5, 2]]
    left, right, both = [0, 1, 2, 3], [1, 4, 5, 2], [0, 1, 4, 5, 2, 3]
    diagram = rips_persistence(points)
    for walks, ends in (
        ([left, right], [[0, 2], [1, 5]]),
        ([both], [[1, 5]]),
        ([both, right], [[1, 5], [0, 2]]),  # at the left's end they are the same
        ([left, right, both], [[0, 2], [1, 5], [2, 5]]),
        ([], []),
    ):
        assert diagram.killers_of(walks).tolist() == ends
    assert rips_persistence(points, max_radius=1.55).killers_of([both]).tolist() == [[-1, -1]]


@pytest.mark.parametrize(
    ("walk", "error", "names"),
    [([], TypeError, "vertex ids"), ([0, 1, 4], ValueError, "vertex 4"), (0, TypeError, None)],
)
def test_what_is_no_walk_is_refused(walk, error, names):
    diagram = rips_persistence(SQUARE)
    for call in (lambda: diagram.killers_of([walk]), lambda: diagram.tighten(walk, 1.0)):
        with pytest.raises(error, match=names):
            call()
    with pytest.raises(ValueError, match="empty"):
        diagram.killers_of([[3]])
    assert diagram.tighten([3, 3], 1.0).tolist() == [3]


def test_square_by_hand():
    diagram = rips_persistence(SQUARE)
    assert diagram.cycle(0).tolist() == diagram.cycle(-1).tolist() == [2, 1, 0, 3]  # birth edge {2, 3} closes it
    for call in (diagram.cycle, diagram.neighbours):
        with pytest.raises(IndexError):
            call(1)


def test_shortest_walk_that_outlives_the_bar_is_not_taken():
    case = Case(MIXED)
    shortest, death = [1, 3, 5, 4], case.edge(*case.fast.killer_edge[1])
    assert case.fast.birth_edge[1].tolist() == [1, 4]
    assert length(case, shortest) < length(case, [1, 0, 2, 4])
    assert case.dies(case.chain(shortest)) > death
    assert case.fast.cycle(1).tolist() == [1, 0, 2, 4]


def test_cycle_is_the_shortest_that_will_do():
    """Against all simple paths between the ends of the birth edge."""
    rng = np.random.default_rng(77)
    for _ in range(60):
        case = Case(np.unique(rng.integers(0, 6, size=(8, 2)).astype(float), axis=0))
        for i in range(len(case.fast)):
            birth, death = case.edge(*case.fast.birth_edge[i]), case.edge(*case.fast.killer_edge[i])
            paths = simple_paths(case, *case.fast.birth_edge[i].tolist(), birth)
            best = min(length(case, path) for path in paths if case.dies(case.chain(path)) <= death)
            assert length(case, case.fast.cycle(i)) <= best * (1 + 1e-12)


def simple_paths(case: Case, x: int, y: int, time: int, so_far: tuple[int, ...] = ()):
    """All paths from x to y without repetition along edges before a time."""
    path = (*so_far, x)
    if x == y:
        yield path
        return
    for v in range(len(case.data)):
        if v not in path and case.edge(x, v) < time:
            yield from simple_paths(case, v, y, time, path)


def test_two_rings_of_a_pipe_die_together():
    """What dies when the pipe is filled is the sum of the rings, which no connected walk at birth is in.

    The lower ring is denser, hence older, and wider, so that it lives on when the pipe between them is filled.
    """
    upper = np.column_stack([polygon(12, 0.8), np.full(12, 0.6)])
    case = Case(np.vstack([np.column_stack([polygon(16), np.zeros(16)]), upper]))
    check_cycles(case)
    walk, birth = case.fast.cycle(1).tolist(), case.edge(*case.fast.birth_edge[1])
    assert case.fast.cycle(0).tolist() == list(range(16))
    assert case.chain(walk) == case.chain(range(16), range(16, 28))
    bridge = [edge for edge in (case.edge(a, b) for a, b in sides(walk)) if edge > birth]
    assert len(bridge) == 2
    assert bridge[0] == bridge[1] < case.edge(*case.fast.killer_edge[1])
    tight = case.fast.tighten(walk, radius=case.fast.birth[1] * 1.01)  # the bridge is longer
    assert case.dies(case.chain(tight, walk)) < case.edge(*case.fast.killer_edge[1])
    assert length(case, tight) <= length(case, walk)


def test_search_that_gives_up_still_dies_with_its_loop(monkeypatch):
    monkeypatch.setattr(_cycles, "SEARCH_LIMIT", 0)
    rng = np.random.default_rng(78)
    for _ in range(150):
        check_cycles(Case(np.unique(rng.integers(0, 9, size=(10, 2)).astype(float), axis=0)))
    case = Case(MIXED)
    assert case.chain(case.fast.cycle(1)) == case.chain([1, 0, 2, 4])


def test_cycles_do_not_depend_on_the_order_of_points():
    rng = np.random.default_rng(80)
    cloud = rng.normal(size=(80, 3))
    order = rng.permutation(80)
    one, other = rips_persistence(cloud), rips_persistence(cloud[order])
    for i in range(len(one)):
        walk, same = one.cycle(i).tolist(), order[other.cycle(i)].tolist()
        assert same in (walk, walk[::-1])


def test_tighten_at_a_radius():
    """A dented ring: a larger radius cuts across the dent, and across corners."""
    ring = polygon(40)
    ring[5] *= 0.7
    case = Case(ring)
    diagram, own = case.fast, case.fast.cycle(0).tolist()
    radii = [0.0, 0.2, 0.4, 0.6, float(diagram.death[0]) * 0.999]
    walks = [diagram.tighten(own, radius).tolist() for radius in radii]
    lengths = [length(case, walk) for walk in walks]
    assert lengths == sorted(lengths, reverse=True)
    assert length(case, own) > lengths[1] > lengths[4]
    for walk, radius in zip(walks[1:], radii[1:], strict=True):
        assert max(case.slow.simplices[case.edge(a, b)].value for a, b in sides(walk)) <= radius
        assert case.dies(case.chain(walk)) == case.edge(*diagram.killer_edge[0])
    for radius in (2.0, np.inf):
        assert diagram.tighten(own, radius).tolist() == [own[0]]  # it is a boundary by then

    # The same of a matrix, and of a diagram that ends there, which does not know what is beyond.
    cut = rips_persistence(ring, max_radius=0.4)
    matrix = rips_persistence(np.sqrt(case.keys()), metric="precomputed")
    for other in (cut, matrix):
        assert other.tighten(own, 0.4).tolist() == walks[2]
    with pytest.raises(ValueError, match="max_radius"):
        cut.tighten(own, 0.6)
