"""Degree 0: the edges with which components merge, a minimum spanning tree in the total order. By Prim's method."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ._cloud import Cloud
from ._edges import edge_length, precedes
from ._jit import njit


@njit()
def _tree(data, axes):
    """(n - 1, 2) the edges of the tree, as it grows from vertex 0."""
    n = len(data)
    waiting, near, length = np.arange(1, n), np.zeros(n, np.int64), np.empty(n)
    for v in range(1, n):
        length[v] = edge_length(data, 0, v, axes)
    tree = np.empty((max(n - 1, 0), 2), np.int64)
    for size in range(n - 1, 0, -1):
        best = 0
        for i in range(1, size):
            v, b = waiting[i], waiting[best]
            if precedes(length[v], near[v], v, length[b], near[b], b):
                best = i
        new = waiting[best]
        tree[size - 1, 0], tree[size - 1, 1] = near[new], new
        waiting[best] = waiting[size - 1]
        for v in waiting[: size - 1]:
            key = edge_length(data, new, v, axes)
            if precedes(key, new, v, length[v], near[v], v):
                near[v], length[v] = new, key
    return tree


def merges(cloud: Cloud, max_radius: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The edges (m, 2) with which components merge, smaller vertex first and in the total order, and half their lengths."""
    edges = np.sort(_tree(cloud.data, cloud.axes))
    order = np.lexsort((edges[:, 1], edges[:, 0], cloud.keys(edges[:, 0], edges[:, 1])))
    edges = edges[order]
    radii = cloud.radii(edges[:, 0], edges[:, 1]) / cloud.scale
    inside = radii <= max_radius
    return edges[inside], radii[inside]


def elders(edges: NDArray[np.int64], n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The vertex that dies with each merge, the one with the larger number of two first vertices; and those that never die."""
    first, dying = list(range(n)), list[int]()
    for edge in edges.tolist():
        roots = []
        for v in edge:
            while first[v] != v:
                first[v] = v = first[first[v]]
            roots.append(v)
        first[max(roots)] = min(roots)
        dying.append(max(roots))
    return np.array(dying, np.int64), np.array([v for v in range(n) if first[v] == v], np.int64)
