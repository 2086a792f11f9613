"""One colour for one identity, in every picture, and axes to draw it on.

The six colours are those of Okabe and Ito that read on white and on near-black alike; they stay apart for the common kinds
of colour blindness. Loop 3 looks the same in the diagram, on the cloth, in the player and in the next chapter.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from topokit.state import TopologicalState

OKABE_ITO = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def loop_colour(loop_id: int) -> str:
    """Return the colour of an identity as `#RRGGBB`; identities six apart share one."""
    return OKABE_ITO[int(loop_id) % len(OKABE_ITO)]


def appearances(states: Sequence[TopologicalState]) -> dict[int, NDArray[np.int64]]:
    """Return for every identity the positions in `states` at which it is there, identities in order of first appearance."""
    places: defaultdict[int, list[int]] = defaultdict(list)
    for position, state in enumerate(states):
        for loop in state.loops:
            places[loop.id].append(position)
    return {loop_id: np.array(positions, dtype=np.int64) for loop_id, positions in places.items()}


def long_lived(states: Sequence[TopologicalState], share: float = 0.2) -> tuple[int, ...]:
    """Identities worth a name in a picture, the weightiest first; each weighs the sum of its lifetimes over the states."""
    weight: defaultdict[int, float] = defaultdict(float)
    for state in states:
        for loop in state.loops:
            weight[loop.id] += loop.lifetime
    least = share * max(weight.values(), default=0.0)
    return tuple(sorted((i for i in weight if weight[i] >= least), key=lambda i: (-weight[i], i)))


def new_axes(ax: Axes | None, **options: Any) -> Axes:
    """`ax`, or the axes of a new pyplot figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    axes: Axes = plt.figure(layout="constrained").add_subplot(**options)
    return axes
