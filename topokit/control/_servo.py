"""The loop servo: hang a garment by its tracked loops, without a forecast.

Idea: in the frame of the grippers a hanging garment hardly changes. So a loop that was seen in this frame a moment ago is still
at the same place. Its *rim* is the part that will lie on the arm, so where the rim should be determines where the grippers should
be. The rim follows a rail of stops along the target's centre line: up to the tip, over it, half the arm in, down. A loop that is
not seen is carried along with the nearest cloth. The grippers let go when the loop's cycle has been around the centre line for
five frames. Otherwise they lift, back off, and try again. A garment that shows no loop is turned.

Source: visual servoing is from Hutchinson, Hager and Corke 1996, *A tutorial on visual servo control*.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial import cKDTree

from topokit._geometry import angle, turned
from topokit._validate import Array
from topokit.rips import rips_persistence
from topokit.sampling import as_tree
from topokit.seqph import SeqPH

from ._arm import Arm
from ._opening import Opening, lies_flat

# The stops of the rail: metres before the tip (-1: the stop is above the seat), and the speed as a share of the largest step.
_RAIL = {"far": (0.35, 0.5), "near": (0.13, 0.3), "over": (-1, 0.2)}
_RAIL |= {"down": (-1, 0.25), "lift": (-1, 0.2), "back": (0.13, 0.3)}


@dataclass(frozen=True)
class ServoOptions:
    """Sizes and thresholds of the servo. They suit the garments of the wardrobe, at 36 ms a frame, on hooks and hangers."""

    radius: float = 0.02  #: radius of the target's rods, metres
    max_step: float = 0.0432  #: metres that a gripper's goal moves along an axis for an action of 1: 1.2 m/s in 36 ms
    #: Frames by which clouds are late. A late cloud is placed by where the grippers were when it was taken.
    cloud_delay: int = 0
    first_looks: int = 6  #: frames in which loops are tracked before anything moves
    sure: int = 5  #: frames in a row in which the loops must be around the target before the grippers let go
    #: Frames at most until a stop is reached, and until a loop is seen; slower grippers get more frames for a stop.
    patience: int = 60
    quarter: int = 45  #: frames in which a garment that shows no loop is turned by 90 degrees
    tries: int = 4  #: runs along the rail before the servo gives up
    near: float = 0.025  #: metres that are near enough to a stop
    facing: float = 7.0  #: degrees between the opening and the arm that are near enough
    new_weight: float = 0.3  #: weight of a new measurement of an opening
    same_loop: float = 0.08  #: metres between the openings of one loop in two frames, at most
    gain: float = 0.15  #: share of the remaining move and turn that is made in a frame
    turn: float = 3.5  #: degrees in a frame, at most
    leash: float = 0.2  #: metres by which a goal may lead its gripper along an axis


class _Frame(NamedTuple):
    """A frame, and the frame of reference of its grippers: from their middle, with x towards the second one."""

    grippers: Array  # (2, 3)
    line: Array  # (K, 3) centre line of the target
    goals: Array  # (2, 3) goals of the grippers that led to this frame
    middle: Array  # (3,) place midway between the grippers
    yaw: float  # degrees from the x axis to the line from the first gripper to the second

    def to_grippers(self, points: Array) -> Array:
        return turned(points - self.middle, -self.yaw)

    def to_world(self, points: Array) -> Array:
        return turned(points, self.yaw) + self.middle


@dataclass(eq=False)
class _KnownLoop:
    """A loop that was seen, in the frame of the grippers."""

    #: the tracker's cycle, whose linking number counts; the same array as `curve` while the loop is not seen
    cycle: Array
    #: a tighter curve of the same class; while the loop is not seen, the curve is carried along with the cloth
    curve: Array
    last_seen: Array  # the curve when the loop was last seen
    opening: Opening
    times_seen: int = 1  # frames in which the loop was seen
    around: int = 0  # frames in a row in which the loop was around the target

    @property
    def is_seen(self) -> bool:
        return self.cycle is not self.curve

    def carry(self, cloth: cKDTree, new_weight: float) -> None:
        """Move the curve evenly to the cloth within 6 cm, and a little to its place when last seen."""
        distance, nearest = cloth.query(self.curve)
        pull = np.where((distance < 0.06)[:, None], cloth.data[nearest] - self.curve, 0)
        pull = uniform_filter1d(pull, max(3, len(self.curve) // 3), axis=0, mode="wrap")
        self.curve = np.asarray(0.9 * (self.curve + pull / 2) + 0.1 * self.last_seen)
        self.cycle = self.curve
        self.opening = self.opening.blended(Opening.of(self.curve) or self.opening, new_weight)


class Servo:
    """Hang a garment by its tracked loops, without a forecast.

    A controller has three members: `reset(observation)`, `act(observation)`, and `reason`, which says in words why it has given
    up and is empty while it goes on. An observation is that of `topokit.sim.HangEnv`, or of a robot, in one frame of reference
    with z up, in metres: `points` (n, 3) of the garment; `grippers` (2, 3); `target` (K, 3), its centre line from the floor to
    the tip; and `held`, 1 until the grippers let go.

    Parameters
    ----------
    n_loops : int
        How many loops are to hang at once: those that are easiest to reach.
    **options
        Fields of `ServoOptions`: `radius` of the target's rods, `max_step` and `cloud_delay`, and thresholds.
    """

    Options: ClassVar[type[ServoOptions]] = ServoOptions
    options: ServoOptions

    def __init__(self, n_loops: int = 1, **options: Any) -> None:
        self.options = self.Options(**options)
        self.n_loops = n_loops
        self.max_step = self.options.max_step
        self._patience = self.options.patience * max(1.0, ServoOptions.max_step / self.max_step)

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation."""
        self.reason = ""
        self._tracker = SeqPH()
        self._goals = np.array(observation["grippers"], np.float64)
        # The loops that were seen, those that are to hang, and whether too few of the loops have an upright opening.
        self._known_loops: list[_KnownLoop] = []
        self._chosen: list[_KnownLoop] = []
        self._no_opening_seen = False
        # The number of frames, the stop on the rail, the frames spent on the way to it, and the runs that failed.
        self._frame = 0
        self._stop = "far"
        self._waited = 0
        self._tries = 0
        # The last cloud, its age in frames, and the last frames.
        self._cloud = np.zeros((0, 3))
        self._age = 0
        self._frames = deque[_Frame](maxlen=31 + self.options.cloud_delay)

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the next action (7,): a share of `max_step` along each axis for both grippers; above 0.5 the last lets go."""
        points = np.array(observation["points"], np.float64)
        grippers = np.array(observation["grippers"], np.float64)
        line = np.array(observation["target"], np.float64)
        arm = Arm.of(line)
        if arm is None:
            self.reason = "the target has no arm that runs sideways"
        if arm is None or self.reason or not observation["held"]:
            return np.zeros(7, np.float32)
        self._follow(points, grippers, line)
        # Choose the loops once they have been tracked for some frames.
        if not self._chosen and self._frame >= self.options.first_looks:
            self._choose(arm, self._cloud_frame.to_grippers(points))
        if not self._chosen:
            return self._turn_to_show(grippers)
        # Count the frames in which each chosen loop is around the target. The count of a loop that is out of sight on the way
        # down is kept: the cloth that carries its curve may be pressed through the arm.
        for loop in self._chosen:
            if arm.holds(self._to_world(loop.cycle)):
                loop.around += 1
            elif loop.is_seen or self._stop in ("far", "near", "over"):
                loop.around = 0
        return self._next_action(arm, grippers)

    @property
    def goals(self) -> Array:
        """Return the places (2, 3) to which the last action moves the grippers, metres; a robot is sent there."""
        return self._goals.copy()

    # -- what is seen

    def _follow(self, points: Array, grippers: Array, line: Array) -> None:
        """Take in a frame: the age of its cloud, and the loops of a new cloud."""
        # A cloud is new when it differs from the last one. It also counts as new when the grippers stand still, for then its age
        # does not matter.
        new = not np.array_equal(points, self._cloud)
        if self._frames:
            new |= np.array_equal(grippers, self._frames[-1].grippers)
        yaw = angle(np.eye(3)[0], grippers[1] - grippers[0])
        self._now = _Frame(grippers, line, self._goals, grippers.mean(axis=0), yaw)
        self._frame += 1
        self._frames.append(self._now)
        # The cloud was taken in an earlier frame, by its age.
        self._age = min(self.options.cloud_delay if new else self._age + 1, len(self._frames) - 1)
        self._cloud_frame = self._frames[-1 - self._age]
        self._cloud = points
        if new:
            self._observe_cloud(points)

    def _to_world(self, points: Array) -> Array:
        """Return the present places of points in the grippers' frame of reference."""
        return self._now.to_world(points)

    def _observe_cloud(self, points: Array) -> None:
        """Update the known loops by a new cloud; carry a loop that is not seen along with the cloth near it."""
        options = self.options
        to_grippers = self._cloud_frame.to_grippers
        unseen = list(self._known_loops)
        points = np.unique(points, axis=0)
        diagram = rips_persistence(points)
        for loop in self._tracker.update(points).loops:
            # A cycle that passes a point twice is two rings and a bridge between them, which is no opening.
            if len(np.unique(loop.cycle)) < len(loop.cycle):
                continue
            cycle = to_grippers(loop.cycle_points)
            # Once loops are chosen, skip the loops far from them: tightening takes time.
            gaps = [np.linalg.norm(known.curve.mean(axis=0) - cycle.mean(axis=0)) for known in self._chosen]
            if min(gaps, default=0.0) > 2 * options.same_loop:
                continue
            tight = diagram.tighten(loop.cycle, radius=loop.birth + loop.lifetime / 4)
            curve = to_grippers(points[tight])
            opening = Opening.of(curve)
            if opening is None:
                continue
            # Identify it with the known loop whose opening is nearest, or add it as a new one.
            nearest = min(unseen, key=lambda known: known.opening.gap(opening), default=None)
            if nearest is None or nearest.opening.gap(opening) > options.same_loop:
                self._known_loops.append(_KnownLoop(cycle, curve, curve, opening))
                continue
            nearest.cycle = cycle
            nearest.curve = curve
            nearest.last_seen = curve
            nearest.times_seen += 1
            nearest.opening = nearest.opening.blended(opening, options.new_weight)
            unseen.remove(nearest)
        cloth = as_tree(to_grippers(points))
        for known in unseen:
            known.carry(cloth, options.new_weight)

    # -- which loops hang

    def _choose(self, arm: Arm, cloud: Array) -> None:
        """Choose the loops to hang, and the side from which the arm goes through them."""
        if self.n_loops > 1:
            self._add_twins()
        # A loop can hang when it was seen twice, does not lie flat, and is large enough.
        needed = self._needed_size(arm)
        seen = [loop for loop in self._known_loops if loop.times_seen > 1]
        upright = [loop for loop in seen if not lies_flat(loop.curve)]
        fit = [loop for loop in upright if loop.opening.size.sum() >= needed]
        if len(fit) < self.n_loops:
            self._no_opening_seen = len(upright) < self.n_loops
            patience = self.options.patience
            if self._no_opening_seen:
                patience = patience // 2 + 3 * self.options.quarter  # until the garment has been turned to both sides
            if self._frame >= patience:
                counts = f"{len(seen)} loops are seen, {len(upright)} of them do not lie flat"
                self.reason = (
                    f"{counts}, {len(fit)} of these are as large as this target needs, {2 * needed:.2f} m around"
                )
            return
        half = float(np.linalg.norm(self._goals[1] - self._goals[0])) / 2
        front = turned(arm.out, -self._now.yaw)

        def effort(opening: Opening) -> float:
            """Return the cost of going in from a side: the turn to face the arm, and the cloth in the way."""
            return abs(angle(opening.normal, front)) / 1800 + 0.02 * opening.blocked(cloud, arm.reach / 2)

        def distance(loop: _KnownLoop) -> float:
            """Return how far a loop is from the line between the grippers, with the effort."""
            nearest = [np.clip(loop.opening.rim[0], -half, half), 0, 0]
            return float(np.linalg.norm(loop.opening.rim - nearest)) + effort(loop.opening)

        for loop in fit:
            loop.opening = min(loop.opening, loop.opening.along(-loop.opening.normal), key=effort)
        self._chosen = sorted(fit, key=distance)[: self.n_loops]
        self._across = self._chosen[0].opening.normal * [1, 0, 0]

    def _add_twins(self) -> None:
        """Add the mirror image of each known loop, since often only one of two handles is seen."""
        mirror = np.array([-1, 1, 1])
        for loop in list(self._known_loops):
            twin = Opening(loop.opening.rim * mirror, loop.opening.normal * mirror, loop.opening.size)
            if min(known.opening.gap(twin) for known in self._known_loops) > self.options.same_loop / 2:
                curve = loop.curve * mirror
                self._known_loops.append(_KnownLoop(curve, curve, curve, twin, loop.times_seen))

    def _turn_to_show(self, grippers: Array) -> NDArray[np.float32]:
        """Wait for a loop, and after a while turn the garment to both sides: an opening seen edge-on is a line."""
        quarter = self.options.quarter
        turns = (self._frame - self.options.patience // 2) // quarter
        if turns < 0 or not self._no_opening_seen:
            return np.zeros(7, np.float32)
        middle = self._now.middle
        step = (-90 if turns else 90) / quarter
        return self._action_towards(turned(self._goals - middle, step) + middle, grippers)

    # -- where the grippers go

    def _next_action(self, arm: Arm, grippers: Array) -> NDArray[np.float32]:
        """Return the action that brings the rim nearer to its stop and turns the opening to the arm, or that lets go."""
        stop = self._stop
        rim = self._rim(arm, grippers)
        if stop == "down":  # the grippers themselves go down to the seat, so that the cloth cannot fall any more
            rim[2] = self._now.middle[2]
        gap = self._rim_goal(stop, arm, rim) - rim
        facing = angle(self._loop_direction(), arm.out)
        arrived = self._is_near(gap, facing)
        # Let go, go on to the next stop, or begin again at the second one.
        sure = min(loop.around for loop in self._chosen) >= self.options.sure
        self._waited += 1
        if stop == "down" and sure and (arrived or self._waited > self._patience / 2):
            return np.eye(7, dtype=np.float32)[6]
        if (arrived and stop != "down") or self._waited > self._patience:
            self._go_on()
        return self._approach(rim, gap, facing, _RAIL[stop][1], grippers)

    def _go_on(self) -> None:
        """Go on to the next stop, or begin again at the second one."""
        self._waited = 0
        stops = list(_RAIL)
        if self._stop != stops[-1]:
            self._stop = stops[stops.index(self._stop) + 1]
            return
        self._stop = "near"
        self._tries += 1
        for loop in self._chosen:
            loop.around = 0
        if self._tries == self.options.tries:
            self.reason = f"the loop did not come around the target in {self._tries} tries"

    def _loop_direction(self) -> Array:
        """Return the level direction in which the arm should go through the loops."""
        # Several loops hang side by side between the grippers: the arm goes through all of them along that line.
        direction = self._chosen[0].opening.normal if len(self._chosen) == 1 else self._across
        return turned(direction, self._now.yaw)

    def _rim(self, arm: Arm, grippers: Array) -> Array:
        """Return one rim for all chosen loops: as low as the lowest, and as far out as the loop that passes the tip last."""
        rims = self._to_world(np.array([loop.opening.rim for loop in self._chosen]))
        # With several loops each gripper holds one of them, and must pass the tip, too.
        passing = rims if len(rims) == 1 else np.concatenate([rims, grippers])
        rim = np.array([*rims.mean(axis=0)[:2], rims[:, 2].min()])
        return np.asarray(rim + ((passing @ arm.out).max() - rim @ arm.out) * arm.out)

    def _rim_goal(self, stop: str, arm: Arm, rim: Array) -> Array:
        """Return where the rim should be at a stop."""
        if stop == "down":
            return arm.seat + [0, 0, self.options.radius]
        before = _RAIL[stop][0]
        if stop == "far":
            place = arm.before(rim, before)
        elif before > 0:
            place = arm.tip + before * arm.out
        else:
            place = arm.seat
        return np.array([*place[:2], arm.tip[2] + self._clearance(arm) + 0.02 * self._tries])

    def _needed_size(self, arm: Arm) -> float:
        """Return half the length around what a loop must pass over, metres: the arm with its tip."""
        return float(arm.tip[2] - arm.end[2] + 4 * self.options.radius)

    def _clearance(self, arm: Arm) -> float:
        """Return how far above the tip the rim should pass, metres, so that the tip goes through the middle of the opening."""
        radius = self.options.radius
        opening = min(loop.opening.size[0] for loop in self._chosen)
        return float(radius + np.clip((opening - arm.tip[2] + arm.end[2]) / 2 - radius, 0.015, 0.06))

    def _is_near(self, gap: Array, facing: float) -> bool:
        """Return whether a missing move (3,) and a missing turn, in degrees, are small."""
        return bool(np.linalg.norm(gap) < self.options.near and abs(facing) < self.options.facing)

    def _approach(self, pivot: Array, gap: Array, facing: float, pace: float, grippers: Array) -> NDArray[np.float32]:
        """Return the action that makes a missing move and turn; `pace` is the largest move, as a share of the largest step."""
        options = self.options
        move = options.gain * gap
        move *= min(1.0, pace * self.max_step / max(float(np.linalg.norm(move)), 1e-9))
        turn = np.clip(options.gain * facing, -options.turn, options.turn)
        return self._action_towards(pivot + turned(self._goals - pivot, turn) + move, grippers)

    def _action_towards(self, goals: Array, grippers: Array) -> NDArray[np.float32]:
        """Return the action that moves the grippers' goals to the given ones, or as near as a step allows."""
        leash = self.options.leash
        move = np.clip((goals - self._goals) / self.max_step, -1, 1)
        self._goals = np.clip(self._goals + self.max_step * move, grippers - leash, grippers + leash)
        return np.append(move.ravel(), 0.0).astype(np.float32)
