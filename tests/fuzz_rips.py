"""Checks of one cloud: the engine and plain Python, against GUDHI and the textbook reduction; clouds where distances tie."""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Sequence
from functools import cached_property
from unittest import mock

import gudhi
import numpy as np

from topokit.rips import Diagram, _persistence, rips_persistence
from topokit.rips.reduction import Pair, Reduction, filtration, reduce

from clouds import FAMILIES, random_cloud, same, sorted_pairs

PATHS = ("engine", "plain Python")


def by(path: str, data: np.ndarray, metric: str = "euclidean", max_radius: float = np.inf) -> Diagram:
    """The diagram of a cloud by one of the paths."""
    with mock.patch.object(_persistence, "engine_is_ready", return_value=path == "engine"):
        return rips_persistence(data, metric=metric, max_radius=max_radius)


def same_by(paths: Sequence[str], data: np.ndarray, metric: str = "euclidean", max_radius: float = np.inf) -> Diagram:
    """The diagram of a cloud by the first path, with which the others agree, short loops included."""
    diagrams = [by(path, data, metric, max_radius) for path in paths]
    for path, diagram in zip(paths, diagrams, strict=True):
        same(diagrams[0], diagram)
        for ours, theirs in zip(diagrams[0]._simplices, diagram._simplices, strict=True):
            np.testing.assert_array_equal(ours, theirs, err_msg=path)
    return diagrams[0]


class Case:
    """A cloud with its fast diagram and its textbook reduction, and homology read off the latter."""

    def __init__(self, data: np.ndarray, metric: str = "euclidean") -> None:
        self.data, self.metric = data, metric
        self.fast: Diagram = rips_persistence(data, metric=metric)

    @cached_property
    def slow(self) -> Reduction:
        """The textbook reduction."""
        return reduce(filtration(self.data, 2, metric=self.metric))

    @cached_property
    def pairs(self) -> list[Pair]:
        """Its bars of positive length."""
        return [pair for pair in self.slow.pairs(1) if pair.death > pair.birth]

    @cached_property
    def position(self) -> dict[tuple[int, ...], int]:
        """Positions of simplices in the filtration."""
        return {simplex.vertices: i for i, simplex in enumerate(self.slow.simplices)}

    def edge(self, i: int, j: int) -> int:
        """Position of an edge in the filtration."""
        return self.position[min(i, j), max(i, j)]

    def value(self, *triangle: int) -> float:
        """Filtration value of a triangle."""
        return self.slow.simplices[self.position[tuple(sorted(triangle))]].value

    def chain(self, *walks: Iterable[int]) -> set[int]:
        """The edges that closed walks cross an odd number of times."""
        edges: set[int] = set()
        for walk in walks:
            for a, b in sides(walk):
                edges ^= {self.edge(a, b)}
        return edges

    def dies(self, chain: set[int]) -> float:
        """Position of the edge with which a cycle becomes a boundary: the latest whose triangles are needed to fill it."""
        chain, latest = set(chain), -1.0
        while chain:
            killer = self.slow.killer.get(max(chain))
            if killer is None:
                return np.inf
            latest = max(latest, self.edge(*self.slow.simplices[killer].latest_edge))
            chain ^= self.slow.columns[killer]
        return latest

    def youngest_before(self, chain: set[int], time: int) -> int:
        """The youngest creator in a cycle's class just before an edge, whose loop the cycle is (up to older ones)."""
        chain = set(chain)
        while True:
            killer = self.slow.killer.get(max(chain), None)
            if killer is None or self.edge(*self.slow.simplices[killer].latest_edge) >= time:
                return max(chain)
            chain ^= self.slow.columns[killer]

    def keys(self) -> np.ndarray:
        """(n, n) what orders edges: distances, or squared distances of points."""
        return self.data if self.metric == "precomputed" else squares(self.data)


def squares(points: np.ndarray) -> np.ndarray:
    """(n, n) squared distances."""
    return sum((points[:, None, k] - points[None, :, k]) ** 2 for k in range(points.shape[1]))


def random_matrix(rng: np.random.Generator, max_points: int = 14) -> np.ndarray:
    """A symmetric matrix of small integers that need not satisfy the triangle inequality."""
    n = int(rng.integers(1, max_points + 1))
    upper = np.triu(rng.integers(0, rng.integers(3, 40), size=(n, n)), 1).astype(float)
    return upper + upper.T


def check_diagram(case: Case) -> None:
    """The bars are those of GUDHI."""
    name = "distance_matrix" if case.metric == "precomputed" else "points"
    tree = gudhi.RipsComplex(**{name: case.data}).create_simplex_tree(max_dimension=2)
    tree.compute_persistence(homology_coeff_field=2)
    theirs = sorted_pairs(tree.persistence_intervals_in_dimension(1).reshape(-1, 2) / 2)
    ours = sorted_pairs(np.column_stack([case.fast.birth, case.fast.death]))
    assert ours.shape == theirs.shape, f"{len(ours)} bars, GUDHI has {len(theirs)}"
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def check_paths(case: Case) -> None:
    """Every path finds the same edges and apexes, short loops too: to the end, and to a radius in the middle."""
    same(case.fast, same_by(PATHS, case.data, case.metric))
    lengths = np.sort(case.keys()[np.triu_indices(len(case.data), 1)])
    middle = float(lengths[len(lengths) // 3]) if len(lengths) else 0.0
    same_by(PATHS, case.data, case.metric, (middle if case.metric == "precomputed" else np.sqrt(middle)) / 2)


def check_pairing(case: Case) -> None:
    """The same edge bears and the same edge kills each loop as in the textbook, whatever ties."""
    ours = set(zip(map(tuple, case.fast.birth_edge.tolist()), map(tuple, case.fast.killer_edge.tolist()), strict=True))
    assert len(ours) == len(case.fast)
    assert ours == {(pair.birth_edge, pair.killer_edge) for pair in case.pairs}


def check_killers(case: Case) -> None:
    """Lengths say birth and death; the triangles arrive with the killer edge, thick first, in two components of its lune."""
    fast, d = case.fast, case.keys()
    lengths = d if case.metric == "precomputed" else np.sqrt(d)
    np.testing.assert_allclose(fast.birth, lengths[tuple(fast.birth_edge.T)] / 2, rtol=1e-15)
    np.testing.assert_allclose(fast.death, lengths[tuple(fast.killer_edge.T)] / 2, rtol=1e-15)
    for (x, y), triangles in zip(fast.killer_edge.tolist(), fast.killer_triangles.tolist(), strict=True):
        assert [t[:2] for t in triangles] == [[x, y]] * 2
        for triangle in triangles:
            arrived = case.slow.simplices[case.position[tuple(sorted(triangle))]]
            assert arrived.latest_edge == (x, y)  # so it is in the complex at death and not before
        thick, thin = (z for _, _, z in triangles)
        assert max(d[x, thick], d[y, thick]) >= max(d[x, thin], d[y, thin])
        components = lune_components(case, x, y)
        home = [next(c for c in components if z in c) for z in (thick, thin)]
        assert home[0] is not home[1]
        for z, component in zip((thick, thin), home, strict=True):
            assert z == min(component, key=lambda v: (max(d[x, v], d[y, v]), v))


def lune_components(case: Case, x: int, y: int) -> list[set[int]]:
    """Components of the graph on the vertices joined to both ends of an edge before it arrives."""
    time = case.edge(x, y)
    rest = {z for z in range(len(case.data)) if z not in (x, y) and max(case.edge(x, z), case.edge(y, z)) < time}
    components = []
    while rest:
        component, waiting = set(), [rest.pop()]
        while waiting:
            z = waiting.pop()
            component.add(z)
            reached = {w for w in rest if case.edge(z, w) < time}
            rest -= reached
            waiting += reached
        components.append(component)
    return components


def check_neighbours(case: Case) -> None:
    """On each outer edge of the killer triangles the earliest other triangle, by value, then apex; if it is there at death."""
    for i, triangles in enumerate(case.fast.killer_triangles.tolist()):
        expected = []
        for x, y, apex in triangles:
            for a, b, opposite in ((x, apex, y), (apex, y, x)):
                others = set(range(len(case.data))) - {a, b, opposite}
                found = min(((case.value(a, b, c), c) for c in others), default=(np.inf, -1))
                if found[0] <= case.value(*triangles[0]):
                    expected.append([a, b, found[1]])
        assert case.fast.neighbours(i).tolist() == expected


def check_quadrilaterals(case: Case) -> None:
    """x, z1, y, z2 is in a class of a loop that the killer edge kills: not a boundary before, a boundary with it."""
    for (x, y), ((_, _, z1), (_, _, z2)) in zip(
        case.fast.killer_edge.tolist(), case.fast.killer_triangles.tolist(), strict=True
    ):
        death, curve = case.edge(x, y), case.chain([x, z1, y, z2])
        assert max(curve) < death
        assert case.dies(curve) == death
        killed = {case.edge(*pair.birth_edge) for pair in case.slow.pairs(1) if pair.killer_edge == (x, y)}
        assert case.youngest_before(curve, death) in killed - {death}


def check_cycles(case: Case) -> None:
    """The representative cycle is born with the birth edge and is a boundary with the killer edge, not before."""
    for i in range(len(case.fast)):
        walk = case.fast.cycle(i).tolist()
        birth, death = case.edge(*case.fast.birth_edge[i]), case.edge(*case.fast.killer_edge[i])
        assert {walk[0], walk[-1]} == set(case.fast.birth_edge[i].tolist())
        arrivals, chain = [case.edge(a, b) for a, b in sides(walk)], case.chain(walk)
        assert len(arrivals) == len(walk)  # no vertex follows itself
        assert max(chain) == birth
        assert case.dies(chain) == death
        assert max(arrivals) < death
        assert max(arrivals) == birth or len(set(walk)) < len(walk)  # a bridge between two rings is crossed twice


def check_tighten(case: Case) -> None:
    """A tightened walk is homologous to what it was, and not longer: at its own scale and at larger ones."""
    for i in range(min(len(case.fast), 3)):
        (x, y), ((_, _, z1), (_, _, z2)) = case.fast.killer_edge[i].tolist(), case.fast.killer_triangles[i].tolist()
        cycle, middle = case.fast.cycle(i).tolist(), float(case.fast.birth[i] + case.fast.death[i]) / 2
        for walk in (cycle, [x, z1, y, z2], [*cycle, *range(len(case.data))]):
            least = max(case.slow.simplices[case.edge(a, b)].value for a, b in sides(walk))
            for radius in (least, max(least, middle)):
                tight = case.fast.tighten(walk, radius).tolist()
                time = latest_edge_within(case, radius)
                assert max((case.edge(a, b) for a, b in sides(tight)), default=0) <= time
                assert length(case, tight) <= length(case, walk) * (1 + 1e-12)
                assert case.dies(case.chain(walk, tight)) <= time


def sides(walk: Iterable[int]) -> list[tuple[int, int]]:
    """The edges of a closed walk; a vertex that follows itself makes none."""
    ids = list(walk)
    return [(a, b) for a, b in zip(ids, ids[1:] + ids[:1], strict=True) if a != b]


def length(case: Case, walk: Iterable[int]) -> float:
    """Length of a closed walk."""
    return 2 * sum(case.slow.simplices[case.edge(a, b)].value for a, b in sides(walk))


def latest_edge_within(case: Case, radius: float) -> int:
    """Position of the last edge that is in VR_radius."""
    simplices = enumerate(case.slow.simplices)
    return max(i for i, s in simplices if len(s.vertices) == 2 and s.value <= radius * (1 + 1e-12))


def check_cut(case: Case) -> None:
    """max_radius makes later deaths infinite and drops later births; min_lifetime drops short loops."""
    fast = case.fast
    if not len(fast):
        return
    values = np.sort(np.concatenate([fast.birth, fast.death]))
    for radius in (values[0], values[len(values) // 2], values[-1], (values[0] + values[-1]) / 2):
        cut = rips_persistence(case.data, metric=case.metric, max_radius=float(radius))
        here = [p for p in case.slow.pairs(1) if p.birth <= radius and p.death > p.birth]
        expected = {(p.birth_edge, p.killer_edge if p.death <= radius else (-1, -1)) for p in here}
        assert {
            (tuple(a), tuple(b)) for a, b in zip(cut.birth_edge.tolist(), cut.killer_edge.tolist(), strict=True)
        } == expected
        assert (np.isinf(cut.death) == (cut.killer_edge[:, 0] < 0)).all()
        for i in np.flatnonzero(np.isinf(cut.death)).tolist():
            chain = case.chain(cut.cycle(i))
            assert max(chain) == case.edge(*cut.birth_edge[i])
            assert case.dies(chain) > latest_edge_within(case, radius * (1 - 1e-12)) or radius in values
    shortest = float(np.median(fast.lifetime))
    long = rips_persistence(case.data, metric=case.metric, min_lifetime=shortest)
    keep = fast.lifetime >= shortest
    for name in ("birth", "death", "birth_edge", "killer_edge", "killer_triangles"):
        np.testing.assert_array_equal(getattr(long, name), getattr(fast, name)[keep])


CHECKS = (
    check_paths,
    check_diagram,
    check_pairing,
    check_killers,
    check_neighbours,
    check_quadrilaterals,
    check_cycles,
    check_tighten,
    check_cut,
)


def clouds(seed: int, index: int) -> Iterable[tuple[np.ndarray, str]]:
    """The inputs of one number, with the metric of each: points, their distances, and sometimes a matrix that is no metric."""
    rng = np.random.default_rng([seed, index])
    points = random_cloud(rng, FAMILIES[index % len(FAMILIES)])
    yield points, "euclidean"
    yield np.sqrt(squares(points)), "precomputed"
    if index % 8 == 0:
        yield random_matrix(rng), "precomputed"


def failure(data: np.ndarray, metric: str) -> str | None:
    """How the first check fails, and of what."""
    try:
        case = Case(data, metric)
        for check in CHECKS:
            check(case)
    except Exception:
        return f"{traceback.format_exc(limit=-3)}\nrips_persistence({data.tolist()}, metric={metric!r})"
    return None
