"""The compiled part of `farthest_point_sample`, in a file of its own because importing topokit must not import numba."""

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True)
def traverse(axes: Any, nearest: Any, ids: Any, following: Any) -> Any:
    """Fill `ids` from a first one on, and return the next; `nearest` has each point's squared distance from those chosen."""
    apart = np.empty(len(nearest))
    for k in range(len(ids)):
        ids[k] = following
        apart[:] = 0
        for a in range(0, len(axes), 3):  # in threes they become vector instructions; what is missing is 0
            x, y, z = axes[a, following], axes[a + 1, following], axes[a + 2, following]
            for i in range(len(apart)):
                apart[i] = apart[i] + (axes[a, i] - x) ** 2 + (axes[a + 1, i] - y) ** 2 + (axes[a + 2, i] - z) ** 2
        for i in range(len(apart)):
            nearest[i] = min(nearest[i], apart[i])
        following = np.argmax(nearest)
    return following
