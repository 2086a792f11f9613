"""Cycles: born when the bar is, a boundary at death and not before, short; checked by ranks over GF(2)."""

from __future__ import annotations

import copy
from itertools import combinations

import numpy as np
import pytest

from topokit import rips_persistence
from topokit.rips import _cycles

from clouds import FAMILIES, random_cloud
from conftest import polygon

# The shortest way around loop 1 is the outline of loop 0's other side, {1, 3, 5, 4}, and lives on when loop 1 dies.
MIXED = np.array([[1, 5], [3, 2], [4, 6], [5, 0], [6, 4], [7, 1]], float)


class Ranks:
    """Degree-1 homology of the Rips complex at every step of the total order, by Gaussian elimination and nothing else."""

    def __init__(self, cloud: np.ndarray) -> None:
        n = len(cloud)
        key = sum((cloud[:, None, k] - cloud[None, :, k]) ** 2 for k in range(cloud.shape[1]))
        order = sorted(combinations(range(n), 2), key=lambda e: (key[e], *e))
        self.edges = {edge: k for k, edge in enumerate(order)}
        self.triangles = [[self.edges[e] for e in combinations(t, 2)] for t in combinations(range(n), 3)]
        self.n = n

    def __getitem__(self, edge) -> int:
        a, b = sorted(int(v) for v in edge)
        return self.edges[a, b]

    def sides(self, walk) -> list[int]:
        return [self[a, b] for a, b in zip(walk, np.roll(walk, -1), strict=True)]

    def chain(self, *walks) -> int:
        total = 0
        for walk in walks:
            for side in self.sides(walk) if len(walk) > 1 else ():
                total ^= 1 << side
        return total

    def bounds(self, chain: int, last: int) -> bool:
        """Whether a cycle is a boundary in the complex of the edges up to `last`."""
        boundaries = [sum(1 << k for k in triangle) for triangle in self.triangles if max(triangle) <= last]
        return rank([*boundaries, chain]) == rank(boundaries)

    def is_older(self, chain: int, last: int) -> bool:
        """Whether a cycle is homologous, in the complex of the edges up to `last`, to one without the edge `last`."""
        boundaries = [sum(1 << k for k in triangle) for triangle in self.triangles if max(triangle) <= last]
        at_vertices = [sum(1 << v for v in edge) for edge, k in self.edges.items() if k < last]
        older = cycles(at_vertices)
        return rank([*boundaries, *older, chain]) == rank([*boundaries, *older])


def rank(rows: list[int]) -> int:
    """Rank over GF(2) of rows of bits."""
    pivots: dict[int, int] = {}
    for row in rows:
        while row and row.bit_length() in pivots:
            row ^= pivots[row.bit_length()]
        if row:
            pivots[row.bit_length()] = row
    return len(pivots)


def cycles(boundaries: list[int]) -> list[int]:
    """A basis of the relations between rows of bits, each as the set of the rows that add up to nothing."""
    pivots: dict[int, tuple[int, int]] = {}
    found = []
    for k, row in enumerate(boundaries):
        chain = 1 << k
        while row and row.bit_length() in pivots:
            other, with_it = pivots[row.bit_length()]
            row, chain = row ^ other, chain ^ with_it
        if row:
            pivots[row.bit_length()] = row, chain
        else:
            found.append(chain)
    return found


def check_cycles(cloud: np.ndarray) -> int:
    """Check every cycle of a cloud by ranks; return how many there are."""
    diagram, ranks = rips_persistence(cloud), Ranks(cloud)
    for i in range(len(diagram)):
        walk = diagram.cycle(i)
        birth, death = ranks[diagram.birth_edge[i]], ranks[diagram.killer_edge[i]]
        chain = ranks.chain(walk)
        assert max(ranks.sides(walk)) == birth == chain.bit_length() - 1
        assert not ranks.is_older(chain, birth)
        assert ranks.bounds(chain, death)
        assert not ranks.bounds(chain, death - 1)
    return len(diagram)


@pytest.mark.parametrize("family", FAMILIES)
def test_cycle_is_born_and_dies_with_its_loop(family):
    rng = np.random.default_rng(500 + FAMILIES.index(family))
    clouds = [random_cloud(rng, family, 12) for _ in range(60)]
    assert (sum(map(check_cycles, clouds)) == 0) == (family == "collinear")


def ends_by_ranks(walks: list, ranks: Ranks) -> list[int]:
    """For each walk: the first step at which it bounds together with walks before it, all its own edges being there."""
    ends = []
    for k, walk in enumerate(walks):
        step = max(ranks.sides(walk))
        while True:
            boundaries = [sum(1 << e for e in triangle) for triangle in ranks.triangles if max(triangle) <= step]
            before = [ranks.chain(other) for other in walks[:k]]
            if rank([*boundaries, *before, ranks.chain(walk)]) == rank([*boundaries, *before]):
                break
            step += 1
        ends.append(step)
    return ends


@pytest.mark.parametrize("family", ["gaussian", "grid", "cocircular", "duplicates"])
def test_killers_of_walks_are_when_ranks_say_they_end(family):
    rng = np.random.default_rng(900 + FAMILIES.index(family))
    for _ in range(60):
        cloud = random_cloud(rng, family, 9)
        if len(cloud) < 4:
            continue
        walks = [rng.permutation(len(cloud))[: rng.integers(3, len(cloud) + 1)] for _ in range(3)]
        diagram, ranks = rips_persistence(cloud), Ranks(cloud)
        # By ranks, a walk that is a sum of earlier ones may have to wait for their edges; then any order of steps will do.
        latest = np.maximum.accumulate([max(ranks.sides(walk)) for walk in walks])
        ends = np.maximum([ranks[edge] for edge in diagram.killers_of(walks)], latest)
        np.testing.assert_array_equal(ends, np.maximum(ends_by_ranks(walks, ranks), latest))


def test_loops_that_merge_end_one_by_one():
    """Two squares side by side: around the left, around the right, around both."""
    points = [[0, 0], [2, 0], [2, 2], [0, 2], [4.5, 0], [4.5, 2]]
    left, right, both = [0, 1, 2, 3], [1, 4, 5, 2], [0, 1, 4, 5, 2, 3]
    diagram = rips_persistence(points)
    assert diagram.killers_of([left, right]).tolist() == [[0, 2], [1, 5]]
    assert diagram.killers_of([both]).tolist() == [[1, 5]]
    assert diagram.killers_of([both, right]).tolist() == [[1, 5], [0, 2]]  # at the left's end they are the same
    assert diagram.killers_of([left, right, both]).tolist() == [[0, 2], [1, 5], [2, 5]]
    assert rips_persistence(points, max_radius=1.55).killers_of([both]).tolist() == [[-1, -1]]
    assert diagram.killers_of([]).shape == (0, 2)
    with pytest.raises(ValueError, match="edge"):
        diagram.killers_of([[3]])
    with pytest.raises(ValueError, match="vertex 6"):
        diagram.killers_of([left, [0, 1, 6]])


def test_square_by_hand():
    diagram = rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]])
    assert diagram.cycle(0).tolist() == [2, 1, 0, 3]  # birth edge {2, 3} closes it
    assert diagram.cycle(-1).tolist() == diagram.cycle(0).tolist()
    with pytest.raises(IndexError, match="no loop 1"):
        diagram.cycle(1)


def test_cycle_goes_around_the_polygon():
    diagram = rips_persistence(polygon(24))
    walk = diagram.cycle(0)
    assert sorted(walk.tolist()) == list(range(24))
    assert set(walk[[0, -1]].tolist()) == set(diagram.birth_edge[0].tolist())


def test_shortest_walk_that_outlives_the_bar_is_not_taken():
    diagram, ranks = rips_persistence(MIXED), Ranks(MIXED)
    assert diagram.birth_edge[1].tolist() == [1, 4]
    shortest, death = [1, 3, 5, 4], ranks[diagram.killer_edge[1]]
    assert length(MIXED, shortest) < length(MIXED, [1, 0, 2, 4])
    assert not ranks.bounds(ranks.chain(shortest), death)  # it outlives the bar
    assert diagram.cycle(1).tolist() == [1, 0, 2, 4]
    assert check_cycles(MIXED) == 2


def test_cycle_is_the_shortest_that_will_do():
    """Against all simple paths between the ends of the birth edge."""
    rng = np.random.default_rng(77)
    for _ in range(60):
        cloud = rng.integers(0, 6, size=(8, 2)).astype(float)
        cloud = np.unique(cloud, axis=0)
        diagram, ranks = rips_persistence(cloud), Ranks(cloud)
        for i in range(len(diagram)):
            birth, death = ranks[diagram.birth_edge[i]], ranks[diagram.killer_edge[i]]
            best = min(
                length(cloud, walk)
                for walk in simple_paths(ranks, *diagram.birth_edge[i].tolist(), birth)
                if ranks.bounds(ranks.chain(walk), death)
            )
            assert length(cloud, diagram.cycle(i)) <= best * (1 + 1e-12)


def simple_paths(ranks: Ranks, x: int, y: int, time: int, so_far: tuple[int, ...] = ()):
    """All paths from x to y without repetition along edges before a time."""
    path = (*so_far, x)
    if x == y:
        yield path
        return
    for v in range(ranks.n):
        if v not in path and ranks[x, v] < time:
            yield from simple_paths(ranks, v, y, time, path)


def length(cloud: np.ndarray, walk) -> float:
    walk = np.asarray(walk)
    return float(np.linalg.norm(cloud[walk] - cloud[np.roll(walk, -1)], axis=1).sum())


def pipe(height: float) -> np.ndarray:
    """Two rings, the lower denser, hence older, and wider, so that it lives on when the pipe between them is filled."""
    return np.vstack(
        [np.column_stack([polygon(16), np.zeros(16)]), np.column_stack([polygon(12, 0.8), np.full(12, height)])]
    )


def test_two_rings_of_a_pipe_die_together():
    """What dies when the pipe is filled is the sum of the rings, which no connected walk at birth is in."""
    cloud = pipe(0.6)
    diagram, ranks = rips_persistence(cloud), Ranks(cloud)
    assert diagram.cycle(0).tolist() == list(range(16))
    walk = diagram.cycle(1)
    chain = ranks.chain(walk)
    birth, death = ranks[diagram.birth_edge[1]], ranks[diagram.killer_edge[1]]
    assert chain == ranks.chain(range(16), range(16, 28))
    assert chain.bit_length() - 1 == birth
    assert ranks.bounds(chain, death)
    assert not ranks.bounds(chain, death - 1)
    bridge = [side for side in ranks.sides(walk) if side > birth]
    assert len(bridge) == 2
    assert bridge[0] == bridge[1] < death
    assert set(walk[[0, -1]].tolist()) == set(diagram.birth_edge[1].tolist())
    tight = diagram.tighten(walk, radius=diagram.birth[1] * 1.01)  # the bridge is longer
    assert ranks.bounds(ranks.chain(tight, walk), death - 1)
    assert length(cloud, tight) <= length(cloud, walk)


def test_search_that_gives_up_still_dies_with_its_loop(monkeypatch):
    monkeypatch.setattr(_cycles, "SEARCH_LIMIT", 0)
    rng = np.random.default_rng(78)
    for _ in range(150):
        cloud = np.unique(rng.integers(0, 9, size=(10, 2)).astype(float), axis=0)
        diagram, ranks = rips_persistence(cloud), Ranks(cloud)
        for i in range(len(diagram)):
            walk = diagram.cycle(i)
            chain, death = ranks.chain(walk), ranks[diagram.killer_edge[i]]
            assert chain.bit_length() - 1 == ranks[diagram.birth_edge[i]]
            assert ranks.bounds(chain, death)
            assert not ranks.bounds(chain, death - 1)
    walk = rips_persistence(MIXED).cycle(1)
    assert Ranks(MIXED).chain(walk) == Ranks(MIXED).chain([1, 0, 2, 4])


def test_loops_that_max_radius_keeps_open():
    cloud = polygon(30)
    cut, whole = rips_persistence(cloud, max_radius=0.5), rips_persistence(cloud)
    assert cut.death.tolist() == [np.inf]
    assert cut.cycle(0).tolist() == whole.cycle(0).tolist()
    at_birth = rips_persistence(cloud, max_radius=float(whole.birth[0]))
    assert at_birth.cycle(0).tolist() == whole.cycle(0).tolist()


def test_cycles_do_not_depend_on_the_order_of_points():
    rng = np.random.default_rng(80)
    cloud = rng.normal(size=(80, 3))
    order = rng.permutation(80)
    one, other = rips_persistence(cloud), rips_persistence(cloud[order])
    for i in range(len(one)):
        walk, same = one.cycle(i).tolist(), order[other.cycle(i)].tolist()
        assert same in (walk, walk[::-1])


def test_duplicated_points_do_not_lengthen_a_walk():
    cloud = np.repeat(polygon(12), 3, axis=0)
    diagram = rips_persistence(cloud)
    assert len(diagram) == 1
    assert len(diagram.cycle(0)) <= 13  # all at its place in the ring but the birth edge's other end
    assert length(cloud, diagram.cycle(0)) == pytest.approx(length(polygon(12), range(12)))


def test_a_diagram_with_cycles_can_be_copied():
    diagram = rips_persistence(polygon(10))
    before = diagram.cycle(0).tolist()
    assert copy.deepcopy(diagram).cycle(0).tolist() == before


@pytest.mark.parametrize("family", FAMILIES)
def test_tightened_walk_is_homologous_and_not_longer(family):
    rng = np.random.default_rng(600 + FAMILIES.index(family))
    for _ in range(60):
        cloud = random_cloud(rng, family, 11)
        ranks = Ranks(cloud)
        walk = rng.integers(0, len(cloud), size=rng.integers(1, 9))
        tight = rips_persistence(cloud).tighten(walk)
        if len(set(walk.tolist())) == 1:
            assert tight.tolist() == [walk[0]]
            continue
        walk = walk[walk != np.roll(walk, -1)]
        latest = max(ranks.sides(walk))
        assert length(cloud, tight) <= length(cloud, walk) * (1 + 1e-12)
        assert ranks.bounds(ranks.chain(walk, tight), latest)
        assert len(tight) == 1 or max(ranks.sides(tight)) <= latest
        assert (len(tight) == 1) == ranks.bounds(ranks.chain(walk), latest)


def test_tighten_at_a_radius():
    """A dented ring: at its own scale nothing is shorter; a larger radius cuts across the dent, and across corners."""
    ring = polygon(40)
    ring[5] *= 0.7
    diagram = rips_persistence(ring)
    own = diagram.cycle(0)
    assert sorted(diagram.tighten(own).tolist()) == sorted(own.tolist())
    radii = [0.2, 0.4, 0.6, float(diagram.death[0]) * 0.999]
    walks = [diagram.tighten(own, radius=radius) for radius in radii]
    lengths = [length(ring, walk) for walk in walks]
    assert length(ring, own) > lengths[0]
    assert lengths == sorted(lengths, reverse=True)
    ranks = Ranks(ring)
    for walk, radius in zip(walks, radii, strict=True):
        sides = np.linalg.norm(ring[walk] - ring[np.roll(walk, -1)], axis=1)
        assert sides.max() <= 2 * radius
        assert not ranks.bounds(ranks.chain(walk), ranks[diagram.killer_edge[0]] - 1)
    assert diagram.tighten(own, radius=2.0).tolist() == [own[0]]  # it is a boundary by then
    assert diagram.tighten(own, radius=np.inf).tolist() == [own[0]]


def test_tighten_of_a_matrix_and_of_a_diagram_that_ends():
    cloud = np.random.default_rng(82).normal(size=(50, 2))
    matrix = np.sqrt(((cloud[:, None] - cloud[None]) ** 2).sum(axis=2))
    diagram = rips_persistence(cloud)
    walk = diagram.cycle(0)
    radius = float(diagram.death[0]) * 0.99
    for other in (rips_persistence(matrix, metric="precomputed"), rips_persistence(cloud, max_radius=radius)):
        for chosen in (None, radius):
            assert other.tighten(walk, radius=chosen).tolist() == diagram.tighten(walk, radius=chosen).tolist()
    cut = rips_persistence(cloud, max_radius=float(diagram.birth[0]))
    with pytest.raises(ValueError, match="max_radius"):
        cut.tighten(walk, radius=radius)


@pytest.mark.parametrize(
    ("cycle", "error", "names"),
    [([], ValueError, "empty"), ([0, 1, 4], ValueError, "vertex 4"), ([0.5, 1.0], TypeError, "vertex ids")],
)
def test_tighten_refuses_what_is_no_walk(cycle, error, names):
    with pytest.raises(error, match=names):
        rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]]).tighten(cycle)
