"""Tasks: a garment, its target, a scripted path to it, and the test whether the garment hangs there.

Idea: a script carries the loop by which a person would hang the garment (`Garment.hanging_loop`). It places a few stations
relative to target and garment, and moves them by draws from given ranges.

Source: Antonova et al. 2021, section 6. Taught in chapter 10.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from topokit._validate import WrongKindError, as_points
from topokit.io import LOOP_NAMES
from topokit.linking import side_lengths

from ._garments import Garment
from ._hung import choose, hang_by_opening, hung
from ._names import kind, to_hang_by
from ._path import GripperPath, Via, drawn_about
from ._surface import Array, EdgeGraph
from ._targets import Hanger, Hook, Mannequin, Placed, Target
from ._wardrobe import WARDROBE

Loop = TypeVar("Loop", bound=ArrayLike)
_SMALL = ("scarf", "belt", "net")
_STRETCH = 1.15  # how far a loop can be stretched, as a multiple of its length
_REACH = 1.7  # the same for the strip between the grips alone; a coarse apron goes over a head at 1.57
_log = logging.getLogger("topokit.sim")
PathScript = Callable[[Garment, Target, np.random.Generator], GripperPath]


@dataclass(frozen=True)
class Task:
    """A garment to be hung on a target."""

    name: str  #: name, made of garment, hyphen, target
    garment: Callable[[], Garment]  #: function that makes the garment
    target: Target  #: target to hang it on
    plan: PathScript  #: function that draws the path, with the given generator alone
    #: Names of the true loops, of which at least one must be on the target; "handle" also means "handle 1", "handle 2", ...
    loops: tuple[str, ...] = ()
    all_loops: bool = False  #: switch: all of these loops must be on the target

    def wanted(self, loops: Mapping[str, Loop]) -> dict[str, Loop]:
        """Return the named loops that the task asks for.

        Parameters
        ----------
        loops : mapping of str to anything
            True loops by their names (`named_loops` of a garment, or of an episode).
        """
        return {name: loop for name, loop in loops.items() if {name, kind(name)} & {*self.loops}}

    def needed(self, loops: Mapping[str, Loop]) -> int:
        """Return the number of named loops that must hang: all that the task asks for, or one of them.

        Parameters
        ----------
        loops : mapping of str to anything
            True loops by their names.
        """
        count = len(self.wanted(loops))
        return count if self.all_loops else min(count, 1)

    def hangs(self, points: ArrayLike, loops: Mapping[str, ArrayLike], target: Target | None = None) -> bool:
        """Return whether the loops that the task asks for are on the target, and the garment has not slid down around it.

        Parameters
        ----------
        points : (N, 3) array_like
            Vertices of the garment, metres.
        loops : mapping of str to (L,) array_like of int
            True loops by their names (`named_loops` of a garment, or of an episode).
        target : Target, optional
            Target to check; the task's own when not given.
        """
        cloud = as_points(points)
        target = target or self.target
        wanted = self.wanted(loops)
        if not wanted or cloud[:, 2].max() <= target.lowest:
            return False
        on = (target.holds(cloud[np.asarray(loop)]) for loop in wanted.values())
        return all(on) if self.all_loops else any(on)


def check_loops(task: Task, garment: Garment) -> None:
    """Raise ValueError when the garment lacks loops that the task asks for; the message lists its loops."""
    names = garment.loop_names
    if not {*task.loops} <= {*names, *map(kind, names)}:
        asks = ", ".join(task.loops) or "none"
        has = ", ".join(names) or "none"
        raise ValueError(f"{task.name} asks for the loops {asks}; the {garment.name} has {has}: mark or name them")


def planned(task: Task, garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Return the path of a task; the path to a `Placed` target is planned for the inner target, and moved with it."""
    if isinstance(target, Placed):
        return planned(task, garment, target.target, rng).moved(target.place, target.yaw)
    return task.plan(garment, target, rng)


def hang_by_strap(
    garment: Garment, target: Target, rng: np.random.Generator, *, opening: float = 1.0, rest: float = 1.05
) -> GripperPath:
    """Carry the first true loop over the upturned tip, and lower it; an `opening` above 1 turns straps to face the arm."""
    aside, below = _opening(garment, opening)
    tip = target.centre_line[-1]
    seat = target.seat
    radius = target.rods[0][2]
    # Stations of the middle between the grippers: far before the tip, before it, above the seat, and down.
    over = np.array([-aside, seat[1], tip[2] + radius + 0.04 + below])
    start = drawn_about(rng, [over[0], tip[1] - _reach(garment), over[2]], (-0.12, 0.12), (-0.42, -0.32), (-0.06, 0.10))
    before = drawn_about(rng, [over[0], tip[1], over[2]], (-0.015, 0.015), (-0.14, -0.10), (0.0, 0.02))
    middle = drawn_about(rng, (start + before) / 2, (-0.05, 0.05), (-0.03, 0.03), (-0.04, 0.04))
    over = drawn_about(rng, over, (-0.015, 0.015), (-0.01, 0.01), (0, 0))
    down = over * [1, 1, 0] + [0, 0, seat[2] + radius + 0.005]
    approach = [Via(0.1, start), Via(0.7, middle, (1 + opening) / 2), Via(1.2, before, opening)]
    vias = [*approach, Via(1.8, over, opening, rest=True), Via(2.35, down, opening)]
    return GripperPath(vias, _spread(garment), release=2.4, end=2.4 + rest)


def pull_over_head(garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Carry a neck strap, drawn wide, over the head of a mannequin from the front, and lower it behind the neck."""
    dummy = _mannequin(target)
    spread = _spread(garment)
    below = _opening(garment)[1]
    needed = 2 * dummy.head_radius + 0.06
    _check_fits(garment, dummy)
    _check_reach(garment, needed, "to go over the head")
    wide = max(1.0, needed / float(np.linalg.norm(spread[0] - spread[1])))
    top = dummy.height + below
    axis = dummy.distance
    # Stations: far before the head, before it, over it, behind it, and down at the nape.
    far = axis - dummy.depth / 2 - 0.1 - _reach(garment)
    start = drawn_about(rng, [0, far, dummy.height], (-0.1, 0.1), (-0.4, -0.3), (-0.15, 0.05))
    before = drawn_about(rng, [0, axis - 0.12, top + 0.06], (-0.02, 0.02), (-0.03, 0.0), (0.0, 0.02))
    over = drawn_about(rng, [0, axis + dummy.head_radius + 0.05, top + 0.03], (-0.01, 0.01), (0, 0.02), (0, 0.02))
    behind = np.array([over[0], over[1], dummy.head_centre[2] - 0.02])
    nape = np.array([over[0], axis + dummy.neck_radius + 0.04, dummy.shoulder_height + 0.06])
    stations = zip((1.2, 2.1, 2.8, 3.4), (before, over, behind, nape), strict=True)
    vias = [Via(0.1, start), *(Via(time, place, wide) for time, place in stations)]
    return GripperPath(vias, spread, release=3.45, end=4.6)


def put_on_shoulders(garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Carry two straps past the shoulders of a mannequin, one on either side, draw them together behind, and lower them."""
    dummy = _mannequin(target)
    spread = _spread(garment)
    x, y, z = dummy.shoulder
    half = float(np.linalg.norm(spread[0] - spread[1])) / 2
    _check_reach(garment, 2 * (x + 0.11), "to pass the shoulders")
    wide = (x + 0.11) / half
    narrow = (x - 0.08) / half
    # Stations: far before the shoulders, before them, past them, together behind them, and down.
    start = drawn_about(rng, [0, y - 0.45, z + 0.10], (-0.08, 0.08), (-0.25, -0.15), (-0.1, 0.1))
    before = drawn_about(rng, [0, y - 0.10, z + 0.11], (-0.01, 0.01), (-0.02, 0.0), (0.0, 0.02))
    past = drawn_about(rng, [0, y + 0.13, z + 0.11], (-0.01, 0.01), (-0.005, 0.005), (0.0, 0.01))
    approach = [Via(0.1, start), Via(1.2, before, wide), Via(2.0, past, wide, rest=True)]
    vias = [*approach, Via(2.5, past, narrow, rest=True), Via(3.1, past + [0, -0.03, -0.18], narrow)]
    return GripperPath(vias, spread, release=3.15, end=4.3)


def dress(garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Lift a garment by its shoulders over a mannequin, and lower it over head and shoulders."""
    dummy = _mannequin(target)
    _check_fits(garment, dummy)
    top = dummy.height
    axis = dummy.distance
    # Stations: before the body, above it, with the grippers at the head, and down at the shoulders.
    length = float(garment.vertices[garment.grips, 2].mean() - garment.vertices[:, 2].min())
    start = drawn_about(rng, [0, axis, top + length + 0.10], (-0.08, 0.08), (-0.45, -0.35), (-0.05, 0.05))
    above = drawn_about(rng, [0, axis, top + length + 0.06], (-0.01, 0.01), (-0.01, 0.01), (0, 0.03))
    head = drawn_about(rng, [0, axis, top + 0.03], (-0.01, 0.01), (-0.01, 0.01), (0, 0))
    down = [0, axis, dummy.shoulder_height + 0.03]
    vias = [Via(0.1, start), Via(1.2, above, rest=True), Via(2.8, head), Via(3.9, down)]
    return GripperPath(vias, _spread(garment), release=4.0, end=5.2)


def dress_as_it_hangs(garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Lower a garment over a mannequin as `dress` does, with the middle of its open ends as they hang over the head."""
    path = dress(garment, target, rng)
    shape = hung(garment)
    ends = [shape[loop].mean(axis=0) for name, loop in garment.named_loops.items() if kind(name) in ("neck", "hem")]
    aside = np.mean(ends, axis=0) * [1, 1, 0]
    # What hangs longer than it is on the mesh is lifted higher before it is over the head.
    length = float(garment.vertices[garment.grips, 2].mean() - garment.vertices[:, 2].min())
    longer = max(0.0, -float(shape[:, 2].min()) - length)
    vias = [replace(via, place=np.asarray(via.place) - aside + [0, 0, longer]) for via in path.vias[:2]]
    vias += [replace(via, place=np.asarray(via.place) - aside) for via in path.vias[2:]]
    return replace(path, vias=vias)


def _mannequin(target: Target) -> Mannequin:
    """Return the target, or raise TypeError when it is no mannequin."""
    if not isinstance(target, Mannequin):
        raise TypeError(f"this path is for a Mannequin, not for a {type(target).__name__}")
    return target


def _check_fits(garment: Garment, dummy: Mannequin) -> None:
    """Raise ValueError when the loop that goes over the head of a mannequin is too small for it."""
    if not garment.loops:
        return
    around = float(side_lengths(garment.vertices[garment.hanging_loop]).sum())
    head = 2 * np.pi * dummy.head_radius
    if _STRETCH * around < head:
        sizes = f"is {around:.2f} m around, the head {head:.2f} m"
        raise ValueError(f"the loop that goes over the head {sizes}: give the garment another size")


def _check_reach(garment: Garment, needed: float, what: str) -> None:
    """Raise ValueError when the grips cannot go so far apart, because the cloth between them is too short."""
    along = float(EdgeGraph(garment.vertices, garment.edges).distances(garment.grips)[0, 1])
    if _REACH * along < needed:
        raise ValueError(
            f"the cloth between the grips is {along:.2f} m long, and they must be {needed:.2f} m apart {what}: "
            "give the garment another size, or other grips"
        )


def _spread(garment: Garment) -> Array:
    """Return the grips (2, 3) relative to their middle."""
    grips = garment.vertices[garment.grips]
    return np.asarray(grips - grips.mean(axis=0))


def _reach(garment: Garment) -> float:
    """Return the length of the garment before its grips, towards the target, metres."""
    return float(garment.vertices[:, 1].max() - garment.vertices[garment.grips, 1].mean())


def _opening(garment: Garment, opening: float = 1.0) -> tuple[float, float]:
    """Return the distances of the hanging loop to the right of the grips' middle, and of its top below them."""
    if not garment.loops:
        return 0.0, 0.0
    curve = garment.vertices[garment.hanging_loop] - garment.vertices[garment.grips].mean(axis=0)
    grips = _spread(garment)
    gap = np.linalg.norm(curve[:, None] - grips, axis=2)  # (L, 2)
    grips = grips * opening
    # A loop that the grips hold hangs below them.
    aside = float(curve[:, 0].mean())
    holding = grips[gap.min(axis=0) < 0.06, 0]
    slope = 0.0
    if len(holding):
        aside = float(holding.mean() + np.clip(aside - holding.mean(), -0.12, 0.12))
        slope = 0.6 * abs(aside - float(holding.mean()))  # a strap held at one place falls off to the side
    # The strap between the grips sags like a shallow parabola of its arc length over their distance.
    ends = gap.argmin(axis=0)
    step = np.linalg.norm(curve - np.roll(curve, -1, axis=0), axis=1)
    arc = float(step[ends.min() : ends.max()].sum())
    arc = min(arc, float(step.sum()) - arc)
    chord = float(np.linalg.norm(grips[0] - grips[1]))
    sag = float(np.sqrt(3 / 8 * chord * max(arc - chord, 0)))
    return aside, max(-float(curve[:, 2].max()), 0.0) + slope + sag


def warn_of_floor(garment: Garment, target: Target) -> None:
    """Log a warning when a garment, from its hanging loop down, is longer than its target is high."""
    long = garment.hangs_down
    high = float(target.seat[2])
    if long > high:
        hint = "it will touch the floor; use a smaller size, or a higher target"
        _log.warning("the %s hangs %.2f m down from a %s %.2f m high: %s", garment.name, long, target.name, high, hint)


def hang_as_it_hangs(garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Carry the loop that an arm enters most easily as the garment hangs, or the first one where none is open."""
    choice = choose(garment, target)
    if choice is None:
        return hang_by_strap(garment, target, rng, rest=2.0)
    return hang_by_opening(garment, target, choice, rng)


_sideways = functools.partial(hang_by_strap, opening=1.15, rest=2.0)


def _tasks() -> Iterator[Task]:
    """Yield every task of the wardrobe."""
    # Everything with a loop to hang by goes on hooks and hangers.
    for target in (Hook(), Hanger()):
        for name in ("apron", "apron2", "tote", "tote2", "backpack", "mask", "sheet", "sheet2", *_SMALL):
            plan: PathScript = _sideways if name == "backpack" else hang_by_strap
            several = {"tote2": LOOP_NAMES["tote2"], "backpack": ("strap",), "net": ("handle",)}
            loops = several.get(name) or LOOP_NAMES[name][:1]
            yield Task(f"{name}-{target.name}", WARDROBE[name], target, plan, loops, all_loops=name == "tote2")
    # What is worn goes on a mannequin.
    bodies: list[tuple[str, PathScript, tuple[str, ...]]] = [
        ("apron", pull_over_head, ("neck",)),
        ("apron2", pull_over_head, ("neck",)),
        ("backpack", put_on_shoulders, ("strap 1", "strap 2")),
        ("shirt", dress, ("neck", "hem")),
        ("vest", dress, ("neck", "hem")),
    ]
    for name, plan, loops in bodies:
        yield Task(f"{name}-{Mannequin.name}", WARDROBE[name], Mannequin(), plan, loops, all_loops=True)


TASKS: Mapping[str, Task] = {task.name: task for task in _tasks()}
"""All tasks by their names: garment, hyphen, target."""


def as_task(task: str | Task) -> Task:
    """Return a task, given it or its name in `TASKS`."""
    if isinstance(task, Task):
        return task
    if task not in TASKS:
        raise ValueError(f"there is no task {task!r}; there are {', '.join(TASKS)}")
    return TASKS[task]


def resolved(task: str | Task | None, garment: Garment | None, target: Target | None) -> tuple[Task, Garment, Target]:
    """Return a task, its garment and its target, given some of them; by default an apron is hung on a hook."""
    if garment is not None and not isinstance(garment, Garment):
        advice = "make one with Garment.from_mesh or from WARDROBE"
        if isinstance(garment, str | Path):
            advice = f"make one with Garment.from_mesh({str(garment)!r})"
            if str(garment) in WARDROBE:
                advice = f"make one with WARDROBE[{str(garment)!r}]()"
        raise WrongKindError(f"garment must be a Garment, not {type(garment).__name__}: {advice}")
    if target is not None and not isinstance(target, Target):
        raise WrongKindError(f"target must be a Target such as Hook(), not {type(target).__name__}")
    if task is None:
        task = task_for(garment or WARDROBE["apron"](), target or Hook())
    task = as_task(task)
    return task, garment or task.garment(), target or task.target


def task_for(garment: Garment, target: Target) -> Task:
    """Return the task of `TASKS` for a garment and a target when the garment has its loops; else make one from its loops' names.

    On a mannequin, a garment with a neck and a hem is put on as a shirt is, one with two straps as a backpack is, any other as an
    apron is. On other targets one of its loops is carried there, but not its hem, its waist or its edge.

    Parameters
    ----------
    garment : Garment
    target : Target
    """
    if isinstance(target, Placed):
        return replace(task_for(garment, target.target), target=target)
    name = f"{garment.name}-{target.name}"
    names = to_hang_by(garment.loop_names)
    kinds = [*map(kind, garment.loop_names)]
    if name in TASKS and {*TASKS[name].loops} <= {*kinds, *garment.loop_names}:
        return replace(TASKS[name], garment=functools.partial(_itself, garment), target=target)
    make = functools.partial(_itself, garment)
    straps = kinds.count("strap") > 1
    if not isinstance(target, Mannequin):
        return Task(name, make, target, hang_as_it_hangs, tuple(names))
    if {"neck", "hem"} <= {*kinds}:
        # Of several necks, such as the openings of a dress with shoulder straps, the head goes through the one above the hem.
        loops = {called: garment.vertices[loop].mean(axis=0) for called, loop in garment.named_loops.items()}
        hem = next(place for called, place in loops.items() if kind(called) == "hem")
        necks = [called for called in loops if kind(called) == "neck"]
        neck = min(necks, key=lambda called: float(np.linalg.norm((loops[called] - hem)[:2])))
        return Task(name, make, target, dress_as_it_hangs, (neck, "hem"), all_loops=True)
    if straps:
        return Task(name, make, target, put_on_shoulders, ("strap",), all_loops=True)
    over = ("neck",) if "neck" in kinds else tuple(names)
    return Task(name, make, target, pull_over_head, over)


def _itself(garment: Garment) -> Garment:
    """Return the garment: with `functools.partial`, a function for a task that can be pickled."""
    return garment
