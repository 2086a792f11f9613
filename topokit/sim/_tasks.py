"""Tasks: a garment, its target, a scripted path to it, and the test whether the garment hangs there.

Idea: a script carries a loop of the garment to the target. It places a few stations relative to target and garment, and moves
them by draws from given ranges.

Source: Antonova et al. 2021, section 6. Taught in chapter 10.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from topokit._validate import WrongKindError
from topokit.io import LOOP_NAMES

from ._garments import Garment
from ._path import GripperPath, Via, drawn_about, off_script
from ._surface import Array
from ._targets import Hanger, Hook, Mannequin, Target
from ._wardrobe import WARDROBE

Loop = TypeVar("Loop", bound=ArrayLike)
PathScript = Callable[[Garment, Any, np.random.Generator], GripperPath]


@dataclass(frozen=True)
class Task:
    """A garment to be hung on a target."""

    name: str  #: name, made of garment, hyphen, target
    garment: Callable[[], Garment]  #: function that makes the garment
    target: Target  #: target to hang it on
    plan: PathScript  #: function that draws the path to the target before it is placed, with the given generator alone
    loops: tuple[str, ...] = ()  #: names of the true loops, of which at least one must be on the target
    all_loops: bool = False  #: switch: all of these loops must be on the target

    @classmethod
    def of(cls, garment: Garment, target: Target, loops: Sequence[str] = ()) -> Task:
        """Return the task of `TASKS` for a garment and a target; for a garment of one's own, a task that needs its loops.

        The first of these loops is carried over the target's tip.

        Parameters
        ----------
        garment : Garment
        target : Hook, Hanger or Mannequin
        loops : sequence of str, optional
            The loops of which one must be on the target; not needed for a garment of the wardrobe, or with a single loop.
        """
        if not (isinstance(garment, Garment) and isinstance(target, Hook | Hanger | Mannequin)):
            raise WrongKindError(f"a task needs a Garment and a target (a Hook(), say), not {garment!r} and {target!r}")
        name = f"{garment.name}-{target.name}"
        if name in TASKS and not loops:
            return replace(TASKS[name], garment=lambda: garment, target=target)
        if isinstance(target, Mannequin):
            raise ValueError(f"no script puts a {garment.name} on a mannequin: make a Task with a plan of your own")
        if not loops and len(garment.loop_names) != 1:
            raise ValueError(f"name the loops by which the {garment.name} may hang; it has {list(garment.loop_names)}")
        loops = tuple(loops or garment.loop_names)
        plan = functools.partial(carry_over_tip, loop=loops[0], rest=2.0)
        return cls(name, lambda: garment, target, plan, loops)

    def path(self, garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
        """Return a path to a target where it is: the plan for it before it is placed, turned and moved with it.

        Parameters
        ----------
        garment, target, rng
            As the plan takes them.
        """
        return self.plan(garment, replace(target, place=(0.0, 0.0, 0.0), yaw=0.0), rng).placed(target)

    def off_script(self, rng: np.random.Generator) -> Task:
        """Return the same task with a plan that leaves its script by draws of a generator; the path's `drawn` notes them."""
        plan = self.plan
        return replace(
            self, plan=lambda garment, target, own: off_script(plan(garment, target, own), garment, target, rng)
        )

    def wanted(self, loops: Mapping[str, Loop]) -> dict[str, Loop]:
        """Return the loops that the task asks for, of true loops by their names."""
        return {name: loop for name, loop in loops.items() if name in self.loops}

    def needed(self, loops: Mapping[str, Loop]) -> int:
        """Return the number of loops that must hang, of true loops by their names: all that the task asks for, or one."""
        count = len(self.wanted(loops))
        return count if self.all_loops else min(count, 1)

    def succeeds(self, points: ArrayLike, loops: Mapping[str, ArrayLike], target: Target | None = None) -> bool:
        """Return whether the loops that the task asks for are on the target, and the garment has not slid down around it.

        Parameters
        ----------
        points : (N, 3) array_like
            Vertices of the garment, metres.
        loops : mapping of str to (L,) array_like of int
            True loops by their names (`named_loops` of a garment, or of an episode).
        target : optional
            Target to check; the task's own when not given.
        """
        cloud = np.asarray(points, dtype=np.float64)
        target = target or self.target
        wanted = self.wanted(loops)
        if not wanted or cloud[:, 2].max() <= target.lowest:
            return False
        on = (target.holds(cloud[np.asarray(loop)]) for loop in wanted.values())
        return all(on) if self.all_loops else any(on)


def carry_over_tip(
    garment: Garment,
    target: Target,
    rng: np.random.Generator,
    *,
    loop: str | None = None,
    opening: float = 1.0,
    rest: float = 1.05,
) -> GripperPath:
    """Carry a true loop, by default the first, over the tip and lower it; an `opening` above 1 turns straps to the arm."""
    aside, below = _opening(garment, loop, opening)
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


def pull_over_head(garment: Garment, target: Mannequin, rng: np.random.Generator) -> GripperPath:
    """Carry a neck strap, drawn wide, over the head of a mannequin from the front, and lower it behind the neck."""
    spread = _spread(garment)
    below = _opening(garment)[1]
    needed = 2 * target.head_radius + 0.06
    wide = max(1.0, needed / float(np.linalg.norm(spread[0] - spread[1])))
    top = target.height + below
    axis = target.distance
    # Stations: far before the head, before it, over it, behind it, and down at the nape.
    far = axis - target.depth / 2 - 0.1 - _reach(garment)
    start = drawn_about(rng, [0, far, target.height], (-0.1, 0.1), (-0.4, -0.3), (-0.15, 0.05))
    before = drawn_about(rng, [0, axis - 0.12, top + 0.06], (-0.02, 0.02), (-0.03, 0.0), (0.0, 0.02))
    over = drawn_about(rng, [0, axis + target.head_radius + 0.05, top + 0.03], (-0.01, 0.01), (0, 0.02), (0, 0.02))
    behind = np.array([over[0], over[1], target.head_centre[2] - 0.02])
    nape = np.array([over[0], axis + target.neck_radius + 0.04, target.shoulder_height + 0.06])
    stations = zip((1.2, 2.1, 2.8, 3.4), (before, over, behind, nape), strict=True)
    vias = [Via(0.1, start), *(Via(time, place, wide) for time, place in stations)]
    return GripperPath(vias, spread, release=3.45, end=4.6)


def put_on_shoulders(garment: Garment, target: Mannequin, rng: np.random.Generator) -> GripperPath:
    """Carry two straps past the shoulders of a mannequin, one on either side, draw them together behind, and lower them."""
    spread = _spread(garment)
    x, y, z = target.shoulders[0]
    half = float(np.linalg.norm(spread[0] - spread[1])) / 2
    wide = (x + 0.11) / half
    narrow = (x - 0.08) / half
    # Stations: far before the shoulders, before them, past them, together behind them, and down.
    start = drawn_about(rng, [0, y - 0.45, z + 0.10], (-0.08, 0.08), (-0.25, -0.15), (-0.1, 0.1))
    before = drawn_about(rng, [0, y - 0.10, z + 0.11], (-0.01, 0.01), (-0.02, 0.0), (0.0, 0.02))
    past = drawn_about(rng, [0, y + 0.13, z + 0.11], (-0.01, 0.01), (-0.005, 0.005), (0.0, 0.01))
    approach = [Via(0.1, start), Via(1.2, before, wide), Via(2.0, past, wide, rest=True)]
    vias = [*approach, Via(2.5, past, narrow, rest=True), Via(3.1, past + [0, -0.03, -0.18], narrow)]
    return GripperPath(vias, spread, release=3.15, end=4.3)


def dress(garment: Garment, target: Mannequin, rng: np.random.Generator) -> GripperPath:
    """Lift a garment by its shoulders over a mannequin, and lower it over head and shoulders."""
    top = target.height
    axis = target.distance
    # Stations: before the body, above it, with the grippers at the head, and down at the shoulders.
    length = float(garment.vertices[garment.grips, 2].mean() - garment.vertices[:, 2].min())
    start = drawn_about(rng, [0, axis, top + length + 0.10], (-0.08, 0.08), (-0.45, -0.35), (-0.05, 0.05))
    above = drawn_about(rng, [0, axis, top + length + 0.06], (-0.01, 0.01), (-0.01, 0.01), (0, 0.03))
    head = drawn_about(rng, [0, axis, top + 0.03], (-0.01, 0.01), (-0.01, 0.01), (0, 0))
    down = [0, axis, target.shoulder_height + 0.03]
    vias = [Via(0.1, start), Via(1.2, above, rest=True), Via(2.8, head), Via(3.9, down)]
    return GripperPath(vias, _spread(garment), release=4.0, end=5.2)


def _spread(garment: Garment) -> Array:
    """Return the grips (2, 3) relative to their middle."""
    grips = garment.vertices[garment.grips]
    return np.asarray(grips - grips.mean(axis=0))


def _reach(garment: Garment) -> float:
    """Return the length of the garment before its grips, towards the target, metres."""
    return float(garment.vertices[:, 1].max() - garment.vertices[garment.grips, 1].mean())


def _opening(garment: Garment, loop: str | None = None, opening: float = 1.0) -> tuple[float, float]:
    """Return the distances of a loop, by default the first, to the right of the grips' middle, and of its top below them."""
    ids = garment.loops[0] if loop is None else garment.named_loops[loop]
    curve = garment.vertices[ids] - garment.vertices[garment.grips].mean(axis=0)
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


def _tasks() -> Iterator[Task]:
    """Yield every task of the wardrobe."""
    # Everything with a loop to hang by goes on hooks and hangers. Either loop of the backpack will do; the tote needs both.
    carry_sideways = functools.partial(carry_over_tip, opening=1.15, rest=2.0)
    for target in (Hook(), Hanger()):
        for name, make in WARDROBE.items():
            if name in ("shirt", "vest"):
                continue
            plan: PathScript = carry_sideways if name == "backpack" else carry_over_tip
            names = LOOP_NAMES.get(name, ("handle",))
            loops = names if name in ("tote2", "backpack") else names[:1]
            yield Task(f"{name}-{target.name}", make, target, plan, loops, all_loops=name == "tote2")
    # What is worn goes on a mannequin.
    dress_over = (dress, ("neck", "hem"))
    over_head = (pull_over_head, ("neck",))
    on_shoulders = (put_on_shoulders, ("strap 1", "strap 2"))
    worn = {"apron": over_head, "apron2": over_head, "backpack": on_shoulders, "shirt": dress_over, "vest": dress_over}
    for name, (plan, loops) in worn.items():
        yield Task(f"{name}-mannequin", WARDROBE[name], Mannequin(), plan, loops, all_loops=True)


TASKS: Mapping[str, Task] = {task.name: task for task in _tasks()}
"""All tasks by their names: garment, hyphen, target."""


def resolved(task: str | Task | None, garment: Garment | None, target: Target | None) -> tuple[Task, Garment, Target]:
    """Return a task, its garment and its target, given some of them; by default an apron is hung on a hook."""
    if task is None:
        task = Task.of(garment or WARDROBE["apron"](), target or Hook())
    if isinstance(task, str):
        if task not in TASKS:
            raise ValueError(f"there is no task {task!r}; there are {', '.join(TASKS)}")
        task = TASKS[task]
    garment = garment or task.garment()
    if not {*task.loops} <= {*garment.loop_names}:
        has = ", ".join(garment.loop_names) or "none"
        raise ValueError(f"{task.name} asks for the loops {', '.join(task.loops)}; the {garment.name} has {has}")
    return task, garment, target or task.target
