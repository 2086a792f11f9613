"""What orders the edges, compiled: lengths, the same to the last bit wherever they are computed, and how ties fall."""

from __future__ import annotations

from ._jit import njit

__all__ = ["edge_length", "precedes"]


@njit(forceinline=True)
def edge_length(data, i, j, axes):
    """The entry of a matrix (no axes), or the squared distance of two points; the same for (i, j) and (j, i)."""
    if len(axes) == 0:
        return data[i, j]
    total = 0.0
    for k in range(len(axes)):
        step = data[i, k] - data[j, k]
        total += step * step
    return total


@njit(forceinline=True)
def precedes(length, a, b, other, x, y):
    """Whether the edge {a, b} comes before {x, y} in the total order, given what `edge_length` says of both."""
    if length != other:
        return length < other
    low, least = min(a, b), min(x, y)
    return low < least or (low == least and max(a, b) < max(x, y))
