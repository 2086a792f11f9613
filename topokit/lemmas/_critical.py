"""Which edges are critical, compiled: the test behind `beta_critical`.

Idea: the killer of a loop seen through samples is an edge whose lune falls apart there. An edge is critical when two points of
its lune, seen with all slack that sampling and motion allow, are not joined through the points that are surely in the lune,
with steps that surely survive. Only such edges can be seen as killers.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_ROUNDING = 1e-12  # relative; rounding may only make more edges critical


@njit(cache=True)
def is_critical(distances: NDArray[np.float64], x: int, y: int, alpha: float, epsilon: float) -> bool:
    """Whether the edge {x, y} is (alpha, epsilon)-critical; `beta_critical` says what that means."""
    length = distances[x, y]
    inner = (length - alpha - 4 * epsilon) * (1 - _ROUNDING)  # of points that carry paths, and of a path's end steps
    step = (length - 2 * alpha - 4 * epsilon) * (1 - _ROUNDING)
    outer = (length + 4 * epsilon) * (1 + _ROUNDING)
    apart = (length - 4 * epsilon) * (1 - _ROUNDING)
    n = len(distances)
    lens, carriers = np.empty(n, np.int64), np.empty(n, np.int64)
    n_lens, n_carriers = 0, 0
    for z in range(n):
        farther = max(distances[z, x], distances[z, y])
        if z != x and z != y and farther <= outer:
            lens[n_lens] = z
            n_lens += 1
        if farther < inner:
            carriers[n_carriers] = z
            n_carriers += 1
    component, n_components = _components(distances, carriers[:n_carriers], step)
    reached = np.zeros((n_lens, n_components), dtype=np.bool_)
    for i in range(n_lens):
        for j in range(n_carriers):
            if distances[lens[i], carriers[j]] < inner:
                reached[i, component[j]] = True
    for i in range(n_lens):
        for j in range(i):
            if distances[lens[i], lens[j]] >= apart and not (reached[i] & reached[j]).any():
                return True
    return False


@njit(cache=True)
def _components(
    distances: NDArray[np.float64], vertices: NDArray[np.int64], step: float
) -> tuple[NDArray[np.int64], int]:
    """Number of each vertex's component under steps shorter than `step`, and how many components there are."""
    m = len(vertices)
    component, waiting = np.full(m, -1, np.int64), np.empty(m, np.int64)
    n_components = 0
    for start in range(m):
        if component[start] >= 0:
            continue
        component[start], waiting[0], top = n_components, start, 1
        while top > 0:
            top -= 1
            near = distances[vertices[waiting[top]]]
            for w in range(m):
                if component[w] < 0 and near[vertices[w]] < step:
                    component[w], waiting[top] = n_components, w
                    top += 1
        n_components += 1
    return component, n_components


@njit(cache=True)
def first_critical(distances: NDArray[np.float64], edges: NDArray[np.int64], alpha: float, epsilon: float) -> int:
    """Place of the first critical edge in a (m, 2) list, -1 when there is none."""
    for i in range(len(edges)):
        if is_critical(distances, edges[i, 0], edges[i, 1], alpha, epsilon):
            return i
    return -1
