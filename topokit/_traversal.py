"""The compiled part of `farthest_point_sample`, in a file of its own because importing topokit must not import numba."""

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True)
def traverse(axes: Any, nearest: Any, ids: Any, following: Any) -> Any:
    """Fill `ids` from a first one on, and return the next; `nearest` has each point's squared distance from those chosen."""
    for k in range(len(ids)):
        ids[k] = following
        apart = (axes[0] - axes[0, following]) ** 2
        for axis in axes[1:]:
            apart += (axis - axis[following]) ** 2
        for i in range(len(apart)):  # by itself, so that it becomes vector instructions
            nearest[i] = min(nearest[i], apart[i])
        following = np.argmax(nearest)
    return following
