"""The loops of a cloud whose points have moved: the same classes, at other places.

Idea: a tracked loop is more than its killer. Its cycle names vertices, and the class of that cycle can be looked up in any
cloud of the same points: the edge that ends it there lies across the opening. So where the motion of the points is known or
predicted, the motion of the loops is known too, and no two frames are matched.

Source: the elder rule for given cycles is that of `Diagram.killers_of`. Taught in chapter 14.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from topokit._validate import as_points
from topokit.rips import rips_persistence

from ._frames import Frame
from ._state import Loop, loop_at


def follow(loops: Iterable[Loop], cloud: ArrayLike) -> list[Loop]:
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

    Raises
    ------
    ValueError
        When the cloud lacks a point of a loop's cycle, or has another dimension than the loops.
    LookupError
        When a loop has no cycle.

    Examples
    --------
    >>> import numpy as np, topokit as tk
    >>> turn = 2 * np.pi * np.arange(12) / 12
    >>> ring = np.column_stack([np.cos(turn), np.sin(turn)])
    >>> loops = tk.track([ring], alpha=0.1)[0].loops
    >>> [round(loop.death, 2) for loop in tk.follow(loops, ring * [1, 0.8])]
    [0.79]
    """
    return follow_all(list(loops), cloud)[0]


def follow_all(loops: Sequence[Loop], cloud: ArrayLike, frame: Frame | None = None) -> tuple[list[Loop], list[Loop]]:
    """Return what `follow` returns, and the loops that are born in the moved cloud, longest lifetime first.

    Parameters
    ----------
    loops : sequence of Loop
    cloud : (n, d) array_like
    frame : Frame, optional
        Which points of the cloud count, and which bars of them are loops. No loop is born when it is not given.

    Raises
    ------
    ValueError, LookupError
        As `follow` does.
    """
    points = as_points(cloud, "cloud", copy=True)
    d = points.shape[1]
    known = len(loops[0].centre) if loops else d
    if d != known:
        raise ValueError(f"cloud has {d} dimensions, and the loops have {known}")
    cycles = [loop.cycle for loop in loops]
    last = max((int(cycle.max()) for cycle in cycles), default=-1)
    if last >= len(points):
        raise ValueError(f"a loop goes through point {last}, and the cloud has {len(points)}: give all, in their order")

    # The bar of a loop is the bar whose killer edge ends the class of the loop's cycle.
    ids = np.arange(len(points)) if frame is None else frame.ids
    diagram = rips_persistence(points[ids])
    bar_of_edge = {(a, b): bar for bar, (a, b) in enumerate(diagram.killer_edge.tolist())}
    cycles_in_diagram = [np.searchsorted(ids, cycle) for cycle in cycles]
    bars = [bar_of_edge.get((a, b)) for a, b in diagram.killers_of(cycles_in_diagram).tolist()]

    followed = []
    for loop, bar in zip(loops, bars, strict=True):
        if bar is not None and diagram.death[bar] > loop.birth:
            moved = loop_at(diagram, bar, points, ids, loop.id, loop.killer_edge_points)
            followed.append(replace(moved, birth=loop.birth))
    followed.sort(key=lambda loop: -loop.lifetime)

    # A loop is born where the frame has evidence for a bar that ends none of the classes.
    born: list[Loop] = []
    if frame is not None:
        evidence = frame.diagram_evidence(diagram)
        identity = max((loop.id for loop in loops), default=-1)
        for bar in np.argsort(-diagram.lifetime).tolist():
            if evidence[bar] > 0 and bar not in bars:
                identity += 1
                born.append(loop_at(diagram, bar, points, ids, identity, None))
    return followed, born
