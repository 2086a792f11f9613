"""What episodes of `HangEnv` vary in: where the target stands, where the garment starts, what disturbs and what blurs."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from topokit._config import NotNegative, as_tuple, checked

from ._off_script import from_elsewhere
from ._placed import Moving, Placed, Travelling
from ._surface import Array
from ._targets import Target
from ._tasks import PathScript

_AWAY = (0.4, 0.4, 0.1, 180.0)  # metres along x, y and z, and degrees: as far at most is "anywhere"
_SOON = (0.3, 1.5)  # seconds after the first frame between which a target sets off and a push begins
_MOVING, _PUSHING = 0.6, 0.1  # seconds that they take


def _somewhere(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    try:
        return check(as_tuple(value))
    except ValidationError as error:
        raise ValueError("must be 'anywhere', or x, y and z in metres and a yaw in degrees") from error


@checked
class Options:
    """What `HangEnv` takes as keywords for all its episodes, and `reset` as options for one."""

    place: Annotated[tuple[float, float, float, float] | Literal["anywhere"] | None, WrapValidator(_somewhere)] = None
    start: Literal["anywhere"] | None = None
    target_shift: NotNegative = 0.0
    shove: NotNegative = 0.0
    cloud_delay: Annotated[int, Field(ge=0)] = 0
    noise: NotNegative = 0.0
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.0
    outliers: Annotated[float, Field(ge=0, le=1)] = 0.0
    release_after: NotNegative = 0.0
    swing: NotNegative = 0.0
    target_speed: NotNegative = 0.0
    fence: NotNegative = 0.0
    n_grippers: Annotated[int, Field(ge=1, le=2)] = 2
    cloud_interval: Annotated[int, Field(ge=1)] = 1

    def scene(self, target: Target, frame_time: float, rng: np.random.Generator) -> tuple[Target, range, Array, Array]:
        """The target, the frames and the acceleration (x, y) of the push, and that of the swing, which takes as many frames.

        All is drawn, whether or not it is asked for.
        """
        place, way = rng.uniform(-1, 1, 4) * _AWAY, rng.normal(size=3)
        way *= self.target_shift * np.cbrt(rng.random()) / np.linalg.norm(way)  # anywhere in a ball
        sets_off, begins = rng.uniform(*_SOON, 2).tolist()
        pushed, swung, gone = (np.array([np.cos(a), np.sin(a)]) for a in rng.uniform(-np.pi, np.pi, 3))
        if self.target_shift:  # to where it stands otherwise: what is planned stays as it is
            x, y, z = way.tolist()
            target = Moving(Placed(target, -x, -y, -z), x, y, z, start=sets_off, seconds=_MOVING)
        if self.target_speed:
            vx, vy = (self.target_speed * gone).tolist()
            target = Travelling(target, vx=vx, vy=vy)
        if self.place is not None:
            target = Placed(target, *(place.tolist() if self.place == "anywhere" else self.place))
        first, frames = round(begins / frame_time), max(1, round(_PUSHING / frame_time))
        push, swing = self.shove * pushed, self.swing * swung
        return target, range(first, first + frames), push / (frames * frame_time), swing / (frames * frame_time)

    def before_fence(self, goal: Array, before: Array, target: Target) -> Array:
        """A goal (2, 3) of the grippers, or the nearest one before the fence; who was behind it already may not go on."""
        if not self.fence:
            return goal
        tip = target.centre_line[-1]
        out = (tip - target.seat) * [1, 1, 0]
        far = float(np.linalg.norm(out))
        if far < 1e-6:
            raise ValueError("fence: it stands before an arm, and this target has none that runs sideways")
        here, there = ((hands - tip) @ out / far for hands in (before, goal))
        return np.asarray(goal + np.maximum(np.minimum(here, self.fence) - there, 0)[:, None] * out / far)

    def plan(self, plan: PathScript, rng: np.random.Generator) -> PathScript:
        """A task's plan, from the start that is asked for."""
        return plan if self.start is None else lambda g, t, own: from_elsewhere(plan(g, t, own), g, t, rng)
