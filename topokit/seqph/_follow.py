"""The loops of a cloud whose points have moved: the same classes, at other places.

Idea: a tracked loop is more than its killer. Its cycle names vertices, and the class of that cycle can be looked up in any
cloud of the same points: the edge that ends it there lies across the opening. So where the motion of the points is known or
predicted, the motion of the loops is known too, and no two frames are matched.

Source: the elder rule for given cycles is that of `Diagram.killers_of`. Taught in chapter 14.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from topokit._validate import as_points
from topokit.rips import rips_persistence

from ._state import Loop, loop_at
from ._tracker import SeqPH


def follow(loops: Iterable[Loop], cloud: ArrayLike, tracker: SeqPH | None = None) -> list[Loop]:
    """Return the loops where the same points are now, those that are still there, longest lifetime first.

    A loop keeps its identity. It also keeps its birth, because birth measures the sampling and not the motion. Its new death is
    the filtration value at which its cycle is filled in the moved cloud. A loop is dropped when that value is not above its
    birth, or when the cycle is filled as soon as its longest edge enters. The points must be the same in each frame, as an
    episode's `points` are; its `observed` points are drawn anew for each frame.

    Parameters
    ----------
    loops : iterable of Loop
        Tracked, so that they have cycles; a state is one.
    cloud : (n, d) array_like
        The points of the cloud that the loops were found in, in their order, moved.
    tracker : SeqPH, optional
        The tracker whose last cloud has moved. Points that it left out are left out. Loops that are born in the moved cloud, by
        the evidence of the tracker, are returned too, with identities of their own.

    Examples
    --------
    >>> import numpy as np, topokit as tk
    >>> turn = 2 * np.pi * np.arange(12) / 12
    >>> ring = np.column_stack([np.cos(turn), np.sin(turn)])
    >>> loops = tk.track([ring], alpha=0.1)[0].loops
    >>> [round(loop.death, 2) for loop in tk.follow(loops, ring * [1, 0.8])]
    [0.79]
    """
    loops = list(loops)
    points = as_points(cloud, "cloud", copy=True)
    d = points.shape[1]
    for loop in loops:
        if len(loop.centre) != d:
            raise ValueError(f"cloud has {d} dimensions, and the loops have {len(loop.centre)}")
        last = loop.cycle.max()
        if last >= len(points):
            raise ValueError(
                f"a loop goes through point {last}, and the cloud has {len(points)}: give all, in their order"
            )

    # The bar of a loop is the bar whose killer edge ends the class of the loop's cycle.
    ids = np.arange(len(points)) if tracker is None else tracker.frame.ids
    diagram = rips_persistence(points[ids])
    bar_of_edge = {(a, b): bar for bar, (a, b) in enumerate(diagram.killer_edge.tolist())}
    cycles_in_diagram = [np.searchsorted(ids, loop.cycle) for loop in loops]
    bars = [bar_of_edge.get((a, b)) for a, b in diagram.killers_of(cycles_in_diagram).tolist()]

    loops_now = []
    for loop, bar in zip(loops, bars, strict=True):
        if bar is not None and diagram.death[bar] > loop.birth:
            moved = loop_at(diagram, bar, points, ids, loop.id, loop.killer_edge_points)
            loops_now.append(replace(moved, birth=loop.birth))

    # A loop is born where the tracker has evidence for a bar that ends none of the classes.
    if tracker is not None:
        evidence = tracker.evidence(diagram)
        next_id = max((loop.id for loop in loops), default=-1) + 1
        for bar in np.argsort(-diagram.lifetime).tolist():
            if evidence[bar] > 0 and bar not in bars:
                loops_now.append(loop_at(diagram, bar, points, ids, next_id, None))
                next_id += 1
    return sorted(loops_now, key=lambda loop: -loop.lifetime)
