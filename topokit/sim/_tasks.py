"""Tasks: which garment goes to which target, on which scripted path, and when it hangs there.

Source: Antonova et al. 2021, section 6. Taught in chapter 7.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points

from ._garments import WARDROBE, Garment
from ._paths import GripperPath, Via
from ._targets import Hanger, Hook, Mannequin, Target

Array = NDArray[np.float64]
Planner = Callable[[Garment, Target, np.random.Generator], GripperPath]


@dataclass(frozen=True)
class Task:
    """A garment to be hung on a target."""

    name: str  #: garment, hyphen, target
    garment: Callable[[], Garment]  #: makes the garment
    target: Target  #: what it is hung on
    plan: Planner  #: draws the path; all its randomness comes from the generator
    loops: tuple[int, ...] = (0,)  #: numbers of the true loops of which one at least must be on the target
    every: bool = False  #: whether each of them must be

    def hangs(self, points: ArrayLike, loops: Sequence[ArrayLike], target: Target | None = None) -> bool:
        """Whether the loops that must be are on the target, and the garment has not slid down around it.

        Parameters
        ----------
        points : (N, 3) array_like
            The garment's vertices, metres.
        loops : sequence of (L,) array_like of int
            Its true loops.
        target : Target, optional
            The task's own when not given.
        """
        cloud, target = as_points(points), target or self.target
        if not self.loops or cloud[:, 2].max() <= target.lowest:
            return False
        on = (target.holds(cloud[np.asarray(loops[i])]) for i in self.loops)
        return all(on) if self.every else any(on)


def hang_by_strap(
    garment: Garment, target: Target, rng: np.random.Generator, *, opening: float = 1.0, rest: float = 1.05
) -> GripperPath:
    """Carry the first true loop over the upturned tip of a hook or a hanger, and lower it onto the arm.

    An `opening` above 1 turns straps at either side of a bag to face the arm; `rest` seconds lie between release and end.
    """
    aside, below = _opening(garment, opening)
    tip, seat, radius = target.centre_line[-1], target.seat, target.rods[0][2]
    over = np.array([-aside, seat[1], tip[2] + radius + 0.04 + below])
    start = over * [1, 0, 1] + [0, tip[1] - _reach(garment), 0]
    start = start + _uniform(rng, (-0.12, 0.12), (-0.42, -0.32), (-0.06, 0.10))
    before = over * [1, 0, 1] + [0, tip[1], 0] + _uniform(rng, (-0.015, 0.015), (-0.14, -0.10), (0.0, 0.02))
    middle = (start + before) / 2 + _uniform(rng, (-0.05, 0.05), (-0.03, 0.03), (-0.04, 0.04))
    over += _uniform(rng, (-0.015, 0.015), (-0.01, 0.01), (0, 0))
    down = over * [1, 1, 0] + [0, 0, seat[2] + radius + 0.005]
    approach = [Via(0.1, start), Via(0.7, middle, (1 + opening) / 2), Via(1.2, before, opening)]
    vias = [*approach, Via(1.8, over, opening, rest=True), Via(2.35, down, opening)]
    return GripperPath(vias, _spread(garment), release=2.4, end=2.4 + rest)


def pull_over_head(garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Carry a neck strap, drawn wide, over the head of a mannequin from the front, and lower it behind the neck."""
    dummy, spread, below = _mannequin(target), _spread(garment), _opening(garment)[1]
    wide = max(1.0, (2 * dummy.head_radius + 0.06) / float(np.linalg.norm(spread[0] - spread[1])))
    top, axis = dummy.height + below, dummy.distance
    start = np.array([0, axis - dummy.depth / 2 - 0.1 - _reach(garment), dummy.height])
    start = start + _uniform(rng, (-0.1, 0.1), (-0.4, -0.3), (-0.15, 0.05))
    before = np.array([0, axis - 0.12, top + 0.06]) + _uniform(rng, (-0.02, 0.02), (-0.03, 0.0), (0.0, 0.02))
    over = np.array([0, axis + dummy.head_radius + 0.05, top + 0.03])
    over = over + _uniform(rng, (-0.01, 0.01), (0, 0.02), (0, 0.02))
    behind = np.array([over[0], over[1], dummy.head_centre[2] - 0.02])
    nape = np.array([over[0], axis + dummy.neck_radius + 0.04, dummy.shoulder_height + 0.06])
    stations = zip((1.2, 2.1, 2.8, 3.4), (before, over, behind, nape), strict=True)
    vias = [Via(0.1, start), *(Via(time, place, wide) for time, place in stations)]
    return GripperPath(vias, spread, release=3.45, end=4.6)


def put_on_shoulders(garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Carry two straps past the shoulders of a mannequin, one on either side, draw them together behind, and lower them."""
    dummy, spread = _mannequin(target), _spread(garment)
    x, y, z = dummy.shoulder
    half = float(np.linalg.norm(spread[0] - spread[1])) / 2
    wide, narrow = (x + 0.11) / half, (x - 0.08) / half
    start = np.array([0, y - 0.45, z + 0.10]) + _uniform(rng, (-0.08, 0.08), (-0.25, -0.15), (-0.1, 0.1))
    before = np.array([0, y - 0.10, z + 0.11]) + _uniform(rng, (-0.01, 0.01), (-0.02, 0.0), (0.0, 0.02))
    past = np.array([0, y + 0.13, z + 0.11]) + _uniform(rng, (-0.01, 0.01), (-0.005, 0.005), (0.0, 0.01))
    approach = [Via(0.1, start), Via(1.2, before, wide), Via(2.0, past, wide, rest=True)]
    vias = [*approach, Via(2.5, past, narrow, rest=True), Via(3.1, past + [0, -0.03, -0.18], narrow)]
    return GripperPath(vias, spread, release=3.15, end=4.3)


def dress(garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Lift a garment by its shoulders over a mannequin, and lower it over head and shoulders."""
    dummy = _mannequin(target)
    top, axis = dummy.height, dummy.distance
    length = float(garment.vertices[garment.grips, 2].mean() - garment.vertices[:, 2].min())
    start = np.array([0, axis, top + length + 0.10]) + _uniform(rng, (-0.08, 0.08), (-0.45, -0.35), (-0.05, 0.05))
    above = np.array([0, axis, top + length + 0.06]) + _uniform(rng, (-0.01, 0.01), (-0.01, 0.01), (0, 0.03))
    head = np.array([0, axis, top + 0.03]) + _uniform(rng, (-0.01, 0.01), (-0.01, 0.01), (0, 0))
    down = np.array([0, axis, dummy.shoulder_height + 0.03])
    vias = [Via(0.1, start), Via(1.2, above, rest=True), Via(2.8, head), Via(3.9, down)]
    return GripperPath(vias, _spread(garment), release=4.0, end=5.2)


def _mannequin(target: Target) -> Mannequin:
    if not isinstance(target, Mannequin):
        raise TypeError(f"this path is for a Mannequin, not for a {type(target).__name__}")
    return target


def _spread(garment: Garment) -> Array:
    """(2, 3) the grips about their middle."""
    grips = garment.vertices[garment.grips]
    return np.asarray(grips - grips.mean(axis=0))


def _reach(garment: Garment) -> float:
    """How far the garment lies before its grips, towards the target."""
    return float(garment.vertices[:, 1].max() - garment.vertices[garment.grips, 1].mean())


def _opening(garment: Garment, opening: float = 1.0) -> tuple[float, float]:
    """How far to the right of the middle between the grips the first loop will hang, and how far below them its top."""
    if not garment.loops:
        return 0.0, 0.0
    grips, curve = _spread(garment), garment.vertices[garment.loops[0]]
    curve = curve - garment.vertices[garment.grips].mean(axis=0)
    gap = np.linalg.norm(curve[:, None] - grips, axis=2)  # (L, 2)
    grips = grips * opening
    aside = float(curve[:, 0].mean())
    holding = grips[gap.min(axis=0) < 0.06, 0]  # x of the grips that hold this loop: it hangs below them
    slope = 0.0
    if len(holding):
        aside = float(holding.mean() + np.clip(aside - holding.mean(), -0.12, 0.12))
        slope = 0.6 * abs(aside - float(holding.mean()))  # a strap held at one place falls off to the side
    ends, step = gap.argmin(axis=0), np.linalg.norm(curve - np.roll(curve, -1, axis=0), axis=1)
    arc, chord = float(step[ends.min() : ends.max()].sum()), float(np.linalg.norm(grips[0] - grips[1]))
    arc = min(arc, float(step.sum()) - arc)  # of the strap between the grips, which sags like a shallow parabola
    return aside, max(-float(curve[:, 2].max()), 0.0) + slope + float(np.sqrt(3 / 8 * chord * max(arc - chord, 0)))


def _uniform(rng: np.random.Generator, *ranges: tuple[float, float]) -> Array:
    return np.array([rng.uniform(low, high) for low, high in ranges])


def _tasks() -> dict[str, Task]:
    sideways: Planner = partial(hang_by_strap, opening=1.15, rest=2.0)
    tasks = {}
    for target in (Hook(), Hanger()):
        for garment in ("apron", "apron2", "tote", "tote2", "backpack", "mask", "sheet", "sheet2"):
            plan = sideways if garment == "backpack" else hang_by_strap
            loops: tuple[int, ...] = (0, 1) if garment in ("tote2", "backpack") else (0,)
            name = f"{garment}-{target.name}"
            every = garment != "backpack"  # which hangs by either strap
            tasks[name] = Task(name, WARDROBE[garment], target, plan, loops, every)
    bodies: dict[str, tuple[Planner, tuple[int, ...]]] = {
        "apron": (pull_over_head, (0,)),
        "apron2": (pull_over_head, (0,)),
        "backpack": (put_on_shoulders, (0, 1)),
        "shirt": (dress, (0, 3)),  # neck and hem
        "vest": (dress, (0, 3)),
    }
    for garment, (plan, loops) in bodies.items():
        name = f"{garment}-{Mannequin.name}"
        tasks[name] = Task(name, WARDROBE[garment], Mannequin(), plan, loops, every=True)
    return tasks


TASKS: Mapping[str, Task] = _tasks()
"""Every task by its name: garment, hyphen, target."""


def task_named(name: str) -> Task:
    """Return the task of that name, or raise ValueError that lists the names."""
    if name not in TASKS:
        raise ValueError(f"there is no task {name!r}; there are {', '.join(TASKS)}")
    return TASKS[name]


def task_for(garment: Garment, target: Target) -> Task:
    """Return the task of `TASKS` for a garment and a target, or else to get any of its loops there, as a strap goes.

    Parameters
    ----------
    garment : Garment
    target : Target
    """
    name = f"{garment.name}-{target.name}"
    if name in TASKS:
        return replace(TASKS[name], garment=lambda: garment, target=target)
    plan = pull_over_head if isinstance(target, Mannequin) else hang_by_strap
    return Task(name, lambda: garment, target, plan, tuple(range(len(garment.loops))))
