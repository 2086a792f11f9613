"""Put a shirt or a vest on a mannequin, over its head from above. Taught in chapter 16.

Idea: cloth that two grippers hold moves with them. So a fixed row of stops suffices, relative to the body and to the observed
size of the cloth. A shirt hangs below the grippers as an open tube: its flat loops show where the middle of the tube is, and its
lowest point shows how high it must be lifted. The grippers let go when a loop is seen around the neck; otherwise they try again.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topokit._geometry import angle
from topokit.control import Servo
from topokit.control._opening import lies_flat
from topokit.linking import close_far, curve_centroid, linking_number

Array = NDArray[np.float64]


class PullOver(Servo):
    """Put a garment over the head of a mannequin, with the observations and the tracker of `Servo`."""

    # The stops, and the shares of the largest step on the way to them.
    SPEEDS = {"up": 0.5, "above": 0.45, "down": 0.35, "lift": 0.4}  # noqa: RUF012

    def reset(self, observation: Mapping[str, Any]) -> None:
        """Forget everything, and begin with a first observation."""
        super().reset(observation)
        self._stop = "up"
        self._loops: list[Array] = []  # the loops of the last cloud, in the frame of the grippers
        self._centre = np.zeros(3)  # the middle of the tube, in that frame
        self._length = 0.0  # how far the garment hangs below the grippers, metres
        self._around = 0  # frames in a row in which a loop was around the neck

    def act(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the next action; nothing moves once there is a `reason` to give up."""
        points, grippers, line = (np.array(observation[name], np.float64) for name in ("points", "grippers", "target"))
        rods = np.array(observation["rods"], np.float64)
        if self.reason or not observation["held"]:
            return np.zeros(7, np.float32)
        self._follow(points, grippers, line)
        # The head is the highest rod, and the shoulders are the two that reach farthest sideways.
        head = rods[rods[:, 5].argmax()]
        wide = np.linalg.norm(rods[:, 3:5] - rods[:, :2], axis=1)
        left, right = rods[np.argsort(-wide, kind="stable")[:2], 3:6]
        return self._onward(line, float(head[[2, 5]].mean()), right - left, grippers)

    def _observe_cloud(self, points: Array) -> None:
        """Track the loops of a new cloud, and measure the cloth."""
        loops = self._tracker.update(np.unique(points, axis=0)).loops
        self._loops = [self._cloud_frame.to_grippers(loop.cycle_points) for loop in loops]
        self._length = -float(self._cloud_frame.to_grippers(points)[:, 2].min())
        for loop in self._loops:
            if lies_flat(loop):
                self._centre = 0.9 * self._centre + 0.1 * curve_centroid(loop) * [1, 1, 0]

    def _onward(self, line: Array, head: float, shoulders: Array, grippers: Array) -> NDArray[np.float32]:
        """Return the action that brings the middle of the tube nearer to its stop, or that lets go."""
        stop = self._stop
        here = self._to_world(self._centre[None])[0]
        gap = self._place_of(stop, here, line) - here
        # The line of the grippers turns to that of the shoulders, either way round.
        facing = 0.0
        if stop != "up":
            facing = (angle(grippers[1] - grippers[0], shoulders) + 90) % 180 - 90
        arrived = self._is_near(gap, facing)
        # Let go, go on to the next stop, or begin again at the first one.
        worn = any(_is_around_neck(self._to_world(loop), line, head) for loop in self._loops)
        self._around = self._around + 1 if worn else 0
        self._waited += 1
        if stop == "down" and self._around >= self.options.sure and (arrived or self._waited > self._patience):
            return np.eye(7, dtype=np.float32)[6]
        if (arrived and stop != "down") or self._waited > 2 * self._patience:
            self._go_on()
        return self._approach(here, gap, facing, self.SPEEDS[stop], grippers)

    def _go_on(self) -> None:
        """Go on to the next stop, or begin again at the first one."""
        self._waited = 0
        stops = [*self.SPEEDS, "up"]
        self._stop = stops[stops.index(self._stop) + 1]
        self._tries += self._stop == "up"
        if self._tries == self.options.tries:
            self.reason = f"in {self._tries} tries the garment was not seen to be worn"

    def _place_of(self, stop: str, here: Array, line: Array) -> Array:
        """Return where the middle of the tube should be at a stop."""
        top = line[-1]
        above = top[2] + 0.06 + self._length  # 6 cm between the head and the cloth
        if stop == "up":
            return np.array([*here[:2], max(above, here[2])])
        if stop == "above":
            return np.array([*top[:2], above])
        if stop == "down":
            return np.array([*top[:2], line[-2][2] + 0.03])  # 3 cm above the shoulders
        return np.array([*here[:2], above])


def _is_around_neck(curve: Array, line: Array, head: float) -> bool:
    """Return whether a curve winds around the axis below the middle of the head; one that touches the axis does not."""
    try:
        return linking_number(curve, close_far(line)) != 0 and curve[:, 2].mean() < head
    except ValueError:
        return False
