"""Mesh a surface anew with triangles of nearly equal size, as a mass-spring cloth needs them.

Idea: all springs of a cloth have the same stiffness, however long they are, and all vertices the same mass. So a mesh of unequal
edges is rubber here and board there: its short edges tear, and its long edges let a rod through. First, edges that are too long
are halved. Then vertices are chosen so that no two are nearer than a radius along the mesh, those of borders first. The cell of
a chosen vertex holds the vertices that are nearest to it. Where three cells meet in a face, there is a face of the new mesh: the
dual of a Voronoi diagram. It has the topology of the surface when every cell, and every two neighbours together, have no holes,
and three cells meet once (the nerve lemma). Where this fails, as in a strap narrower than the radius, the radius is made smaller.

Source: Peyre and Cohen 2006, *Geodesic remeshing using front propagation*.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from ._surface import (
    Array,
    Ids,
    edge_lengths,
    face_areas,
    half_edges,
    of_three_vertices,
    once_each,
    simple_cycles,
    weighted,
)

_USUAL = 450  # vertices that a garment shall have
_MOST = 700  # vertices that a large garment may have, so that it does not get longer edges
_EQUILATERAL = 1.15  # an equilateral mesh of area A and edge L has 1.15 A / L^2 vertices
_SPACINGS = (0.014, 0.035)  # metres: the shortest and the longest edge that is usual for a garment
_EVEN = (0.4, 2.3)  # the shortest and the longest edge of an even mesh, as multiples of the median
_FITTING = (0.55, 1.4)  # the median edge of a mesh that is kept, as multiples of the usual spacing
_RADIUS = 0.85  # the least distance of two chosen vertices, as a multiple of the spacing
_FINE = 0.35  # the longest edge before vertices are chosen, as a multiple of the spacing
_SMALLER = 0.6  # factor of the radius where cells are no discs


class Evened(NamedTuple):
    """A surface that was meshed anew."""

    vertices: Array  # (k, 3)
    faces: Ids  # (F, 3)
    nearest: Ids  # (N,) the new vertex that is nearest to each old one
    cycles: list[Ids]  # the given cycles, along the new edges


def usual_spacing(vertices: Array, faces: Ids) -> float:
    """Return the length of edges that suits a garment of this area, metres."""
    area = _EQUILATERAL * float(face_areas(vertices, faces).sum())
    low, high = _SPACINGS
    return max(min(max((area / _USUAL) ** 0.5, low), high), (area / _MOST) ** 0.5)


def is_even(vertices: Array, faces: Ids, spacing: float) -> bool:
    """Return whether the edges of a mesh are alike, and about as long as the spacing."""
    lengths = edge_lengths(vertices, np.unique(half_edges(faces), axis=0))
    median = float(np.median(lengths))
    alike = _EVEN[0] * median <= lengths.min() and lengths.max() <= _EVEN[1] * median
    return bool(alike and _FITTING[0] * spacing <= median <= _FITTING[1] * spacing)


def evened(vertices: Array, faces: Ids, spacing: float, cycles: Sequence[Ids] = ()) -> Evened:
    """Return a surface of the same topology whose edges are about as long as the spacing, or shorter in narrow straps.

    Parameters
    ----------
    vertices, faces : (N, 3) arrays
    spacing : float
    cycles : sequence of (L,) arrays of int
        Closed cycles along edges.
    """
    first = _meshed_anew(vertices, faces, spacing, cycles)
    if is_even(first.vertices, first.faces, spacing):
        return first
    # Along long and thin triangles distances are overestimated. The new triangles are not thin, and a second pass evens them.
    second = _meshed_anew(first.vertices, first.faces, spacing, first.cycles)
    return second._replace(nearest=second.nearest[first.nearest])


def simplified(vertices: Array, faces: Ids, most: int) -> Evened:
    """Return a surface of the same topology with at most so many vertices.

    Raises
    ------
    ValueError
        When there are not enough vertices for these loops.
    """
    spacing = float((_EQUILATERAL * face_areas(vertices, faces).sum() / most) ** 0.5)
    longest = float(np.ptp(vertices, axis=0).max())
    while spacing < longest:
        simple = _meshed_anew(vertices, faces, spacing, ())
        if len(simple.vertices) <= most:
            return simple
        spacing *= 1.1
    raise ValueError(f"{most} vertices are not enough for its loops; raise max_vertices, or decimate the mesh")


def _meshed_anew(vertices: Array, faces: Ids, spacing: float, cycles: Sequence[Ids]) -> Evened:
    """Return a surface that was meshed anew once."""
    n = len(vertices)
    vertices, faces, walks = _halved(vertices, faces, _FINE * spacing, cycles)
    everything = np.arange(len(vertices))
    edges, uses = np.unique(half_edges(faces), axis=0, return_counts=True)
    on_border = np.unique(edges[uses != 2])
    graph = weighted(vertices, edges)
    both_ways = graph + graph.T  # searched as it is; of a graph without directions each search would make this anew
    order = np.concatenate([on_border, np.setdiff1d(everything, on_border)])
    pinched = _n_fans(faces, len(vertices)) > 1
    radius = np.full(len(vertices), _RADIUS * spacing)
    distance = np.full(len(vertices), np.inf)
    chosen: list[int] = []
    while True:
        # Choose every vertex that is farther than the radius from all that were chosen before it.
        for i in order[distance[order] > radius[order]].tolist():
            if distance[i] > radius[i]:
                chosen.append(i)
                near = dijkstra(both_ways, indices=i, limit=_RADIUS * spacing)
                distance = np.minimum(distance, near)
        # The new faces are where three cells meet. Once they have the topology of the surface, the mesh is done.
        _, _, source = dijkstra(graph, directed=False, indices=chosen, min_only=True, return_predecessors=True)
        number = np.zeros(len(vertices), dtype=np.int64)
        number[chosen] = np.arange(len(chosen))
        cell = number[source]
        bad = _bad_cells(faces, cell, len(chosen), pinched)
        if not bad.any():
            break
        radius[bad[cell]] *= _SMALLER
    new_faces = once_each(of_three_vertices(cell[faces]))
    carried = [np.array(max(simple_cycles(_without_repeats(cell[walk])), key=len, default=[])) for walk in walks]
    return Evened(vertices[chosen], new_faces, cell[:n], carried)


def _halved(vertices: Array, faces: Ids, longest: float, cycles: Sequence[Ids]) -> tuple[Array, Ids, list[Ids]]:
    """Halve every edge longer than `longest`, until there is none; the faces of an edge are cut alike."""
    walks = [np.asarray(cycle) for cycle in cycles]
    while True:
        edges, edge_of = np.unique(half_edges(faces), axis=0, return_inverse=True)
        long = edge_lengths(vertices, edges) > longest
        if not long.any():
            return vertices, faces, walks
        middle = np.where(long, len(vertices) + np.cumsum(long) - 1, -1)
        vertices = np.concatenate([vertices, vertices[edges[long]].mean(axis=1)])
        walks = [_with_middles(walk, edges, middle) for walk in walks]
        middles = middle[edge_of.reshape(-1, 3)]
        faces = np.concatenate([_cut(faces, middles, count) for count in range(4)])


def _cut(faces: Ids, middles: Ids, count: int) -> Ids:
    """Return what the faces with so many halved edges are cut into; `middles` (F, 3) are those of edges 01, 12 and 20, or -1."""
    chosen = (middles >= 0).sum(axis=1) == count
    faces = faces[chosen]
    middles = middles[chosen]
    # Turn each face so that, of one or two halved edges, the edge 01 is one, and 20 is none.
    first = np.argmax((middles >= 0) & (np.roll(middles, 1, axis=1) < 0), axis=1)
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, 1).T
    ab, bc, ca = np.take_along_axis(middles, turn, 1).T
    parts = {
        0: [[a, b, c]],
        1: [[a, ab, c], [ab, b, c]],
        2: [[a, ab, c], [ab, bc, c], [ab, b, bc]],
        3: [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]],
    }[count]
    return np.concatenate([np.column_stack(part) for part in parts])


def _with_middles(walk: Ids, edges: Ids, middle: Ids) -> Ids:
    """Return a closed cycle along edges with the middles of those that were halved."""
    pairs = np.sort(np.column_stack([walk, np.roll(walk, -1)]), axis=1)
    size = edges.max() + 1
    between = middle[np.searchsorted(edges @ [size, 1], pairs @ [size, 1])]
    both = np.column_stack([walk, between]).ravel()
    return both[both >= 0]


def _n_fans(faces: Ids, n: int) -> Ids:
    """Return (n,) how many fans of faces meet at a vertex at most: edges less faces; 1 at a border, 0 inside a surface."""
    edges = np.unique(half_edges(faces), axis=0)
    return np.bincount(edges.ravel(), minlength=n) - np.bincount(faces.ravel(), minlength=n)


def _bad_cells(faces: Ids, cell: Ids, n: int, pinched: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (n,) which cells are no discs, or meet their neighbours in a way that a triangle mesh cannot show.

    `pinched` are the vertices of the surface at which parts of it hang together by a vertex alone.
    """
    edges = np.sort(cell[np.unique(half_edges(faces), axis=0)], axis=1)
    corners = np.sort(cell[faces], axis=1)
    inner_edges = edges[:, 0] == edges[:, 1]
    one_cell = corners[:, 0] == corners[:, 2]
    three_cells = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])
    # A cell is a disc when its Euler characteristic is 1.
    characteristic = np.bincount(cell, minlength=n)
    characteristic = characteristic - np.bincount(edges[inner_edges, 0], minlength=n)
    bad = characteristic + np.bincount(corners[one_cell, 0], minlength=n) != 1
    # Two cells meet along one line when they have one edge between them more than faces.
    pairs, n_edges = np.unique(edges[~inner_edges], axis=0, return_counts=True)
    strips = corners[~one_cell & ~three_cells][:, [0, 2]]
    size = n + 1
    n_strips = np.bincount(np.searchsorted(pairs @ [size, 1], strips @ [size, 1]), minlength=len(pairs))
    # Their edge is in a new face, and three cells meet in one face at most.
    triples, n_meetings = np.unique(corners[three_cells], axis=0, return_counts=True)
    seen = np.isin(pairs @ [size, 1], half_edges(triples) @ [size, 1])
    bad[pairs[(n_edges - n_strips != 1) | ~seen]] = True
    bad[triples[n_meetings > 1]] = True
    # Every cell is in a face, and no part of the new surface hangs by a vertex unless it did so before.
    bad[np.setdiff1d(np.arange(n), triples)] = True
    bad[(_n_fans(triples, n) > 1) & (np.bincount(cell[pinched], minlength=n) == 0)] = True
    return bad


def _without_repeats(walk: Ids) -> list[int]:
    """Return a closed walk without vertices that follow themselves."""
    return walk[walk != np.roll(walk, 1)].tolist()
