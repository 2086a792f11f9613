"""The motion of the cloth under a plan, and the loops read off it; all of it in NumPy."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from topokit._validate import as_points
from topokit.sampling import inliers
from topokit.seqph import Frame, Loop, SeqPH, belief_after, follow_all

from ._motion import KNOTS, PAST, Codes, Motion, world
from ._predictor import Array, Forecast, Predictor, as_cloud, as_grippers
from ._scenes import carriers_first, flow, target_of
from ._states import NOISE, TRIANGLES

_UNTRACKED = 16  # clouds that are kept until their loops are asked for


class MotionPredictor(Predictor):
    """Forecasts by a `Motion`: of the cloud, and of the loops that the tracker sees in the present one.

    Two tiers. For many plans, the corners of each loop's triangles are moved, and no others. For one plan, `exact` names frames
    at which the whole cloud is moved, each loop's killer is sought there anew (`topokit.follow`), and so are loops that open.

    Parameters
    ----------
    model : Motion
    description : mapping, optional
        What a checkpoint says of it.
    """

    model: Motion

    def reset(self) -> None:
        """Forget everything observed."""
        self._clouds: deque[cKDTree] = deque(maxlen=PAST[-1] + 1)
        self._hands: deque[NDArray[np.float64]] = deque(maxlen=PAST[-1] + 1)
        self._held, self._target = True, np.zeros((0, 3))
        self._seqph, self._loops = SeqPH(), tuple[Loop, ...]()
        self._untracked: deque[NDArray[np.float64]] = deque(maxlen=_UNTRACKED)
        self._codes: dict[bytes, Codes] = {}

    def _take(self, cloud: NDArray[np.float64], grippers: Any, held: bool, target: Any) -> None:
        place = as_grippers(grippers)
        if target is not None:
            line = as_points(target, "target", copy=True)
            if line.shape[1] != 3:
                raise ValueError(f"target must be an (L, 3) array, not of shape {line.shape}")
            self._target = line
        self._clouds.append(cKDTree(cloud))
        self._untracked.append(cloud)
        self._hands.append(place)
        self._held, self._codes = held, {}

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None, exact: Sequence[int] = ()) -> Forecast:
        """Forecast the states of the next frames.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            Where the two grippers are told to be at each of the next frames, metres; or C such plans.
        held : (60,) or (C, 60) array_like of bool, optional
            Whether they hold the garment then; throughout, when not given.
        exact : sequence of int
            Frames ahead, 1 to 60, at which the loops are sought in the moved cloud; of a single plan alone. A loop that is born
            there has a slot after those of the tracked ones, and is there at these frames alone.

        Raises
        ------
        ValueError
            When nothing was observed, or plans or frames cannot be meant.
        """
        if len(exact) and (np.ndim(actions) == 4 or not all(1 <= step <= KNOTS[-1] for step in exact)):
            raise ValueError(f"exact names frames from 1 to {KNOTS[-1]} of a single plan, not {list(exact)}")
        self._track()
        ids = np.array([_corners(loop)[0] for loop in self._loops], dtype=np.int64)  # (S, 8)
        corners = None if len(exact) or not self._clouds else self._clouds[-1].data[ids.ravel()]
        places, scales = self._moved(actions, held, corners)
        whole = places[0], scales[0]
        if len(exact):
            places, scales = places[:, :, ids.ravel()], scales[:, :, ids.ravel()]
        sizes = *places.shape[:2], len(ids), 8
        forecast = _forecast(places.reshape(*sizes, 3), scales.reshape(sizes), self._loops, self._frame)
        if np.ndim(actions) == 4:
            return forecast
        parts, loops = vars(forecast.plan(0)).values(), list(self._loops)
        if not len(exact):
            return Forecast(*parts)
        free = 0, self.model.shape.slots - len(loops)  # for those that are born
        forecast = Forecast(*(np.pad(part, [(0, 0), free, *[(0, 0)] * (part.ndim - 2)]) for part in parts))
        for step in sorted(exact):
            _read(forecast, step - 1, loops, len(ids), [part[step - 1] for part in whole], self._frame)
        return Forecast(*(part[:, : len(loops)] for part in vars(forecast).values()))

    @torch.inference_mode()
    def move(
        self, actions: ArrayLike, held: ArrayLike | None = None, points: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return where points of the cloth will be (60, n, 3), metres, and the scale (60, n) of the error there.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            A plan, or C plans: then the answers have another axis, the first.
        held : (60,) or (C, 60) array_like of bool, optional
        points : (n, 3) array_like, optional
            Where they are now; those of the last cloud when not given.
        """
        places, scales = self._moved(actions, held, None if points is None else as_cloud(points))
        return (places, scales) if np.ndim(actions) == 4 else (places[0], scales[0])

    def _track(self) -> None:
        """Track the loops of the clouds that came since; a forecast of points alone does not need them."""
        while self._untracked:
            self._loops = self._seqph.update(self._untracked.popleft()).loops[: self.model.shape.slots]
            self._frame: Any = self._seqph._before  # the one that this was

    def _moved(self, actions: ArrayLike, held: ArrayLike | None, asked: NDArray[Any] | None) -> tuple[Array, Array]:
        """(C, 60, n, 3) places and (C, 60, n) scales of some points, or of the last cloud's."""
        chunks = self._plans(actions, held)
        if not self._clouds:
            raise ValueError("nothing was observed yet: call observe(points, grippers) first")
        codes = self._encode(self._clouds[-1].data if asked is None else asked)
        parts = [self.model.under(codes, *chunk) for chunk in chunks]
        places, scales = (torch.cat(part)[:, :, codes.carriers :].numpy() for part in zip(*parts, strict=True))
        start = world(codes.place[:, codes.carriers :], codes.origin, codes.axes)
        first = np.broadcast_to(start.numpy()[:, None], (len(places), 1, *places.shape[2:]))
        ends = [first, places], [scales[:, :1], scales]
        return _between(np.concatenate(ends[0], axis=1)), _between(np.concatenate(ends[1], axis=1))

    def _encode(self, asked: NDArray[np.float64]) -> Codes:
        """What points know; made once for all plans until the next frame."""
        key = asked.tobytes()
        if key not in self._codes:
            cloud, last = self._clouds[-1].data, len(self._clouds) - 1
            then = [max(last - ago, 0) for ago in (0, *PAST)]
            kept = cloud[inliers(self._clouds[-1])]  # strays are no cloth: the tracker leaves them out, too
            seen = np.random.default_rng(0).permutation(kept)[: self.model.shape.points]  # mixed, the same each time
            seen = seen[carriers_first(seen)]
            hands = np.stack([self._hands[i] for i in then])
            scene = {
                "cloud": seen,
                "points": asked,
                "flow": flow(np.concatenate([seen, asked]), [self._clouds[i] for i in then[1:]], hands),
                "grippers": hands,
                **target_of(self._target),
            }
            tensors = {name: torch.from_numpy(np.asarray(part, np.float32))[None] for name, part in scene.items()}
            tensors["held"] = torch.tensor([self._held])
            self._codes[key] = self.model.encode(tensors)
        return self._codes[key]


def _between(values: Array) -> Array:
    """Of values (C, 1 + 13, ...) now and at the knots those at each of the 60 frames, along straight lines."""
    knots, frames = np.array((0, *KNOTS)), np.arange(1, KNOTS[-1] + 1)
    after = np.searchsorted(knots, frames)
    share = ((frames - knots[after - 1]) / np.diff(knots)[after - 1]).astype(np.float32)
    share = share.reshape(-1, *[1] * (values.ndim - 2))
    return np.asarray(values[:, after - 1] * (1 - share) + values[:, after] * share)


def _corners(loop: Loop) -> tuple[list[int], list[bool]]:
    """The vertices of a loop's eight corners, in the order of `StateTensors.corners`; of its four neighbours which there are."""
    edge, triangles = loop.killer_edge.tolist(), loop.killer_triangle_ids.tolist()
    corners = [*edge, *(next(v for v in triangle if v not in edge) for triangle in triangles)]
    apexes = {frozenset(outer): apex for *outer, apex in loop.neighbour_ids.tolist()}
    outer = [frozenset((corners[a], corners[b])) for a, b, _ in TRIANGLES[2:]]
    return [*corners, *(apexes.get(one, corners[2]) for one in outer)], [one in apexes for one in outer]


def _forecast(corners: Array, scales: Array, loops: Sequence[Loop], frame: Frame) -> Forecast:
    """StateTensors (C, 60, S) of loops of a frame, whose corners (C, 60, S, 8, 3) are where these are, to those scales."""
    now = np.array([loop.killer_edge_points for loop in loops], np.float32).reshape(-1, 2, 3)
    birth = np.broadcast_to(np.array([loop.birth for loop in loops], np.float32), corners.shape[:3])
    ends = corners[..., :2, :]
    before = np.concatenate([np.broadcast_to(now, ends[:, :1].shape), ends[:, :-1]], axis=1)
    gaps = np.linalg.norm(ends[..., :, None, :] - before[..., None, :, :], axis=-1)
    shift = np.maximum(gaps.min(axis=-1).max(axis=-1), gaps.min(axis=-2).max(axis=-1))
    values = _values(corners)
    present = np.array([_corners(loop)[1] for loop in loops], bool).reshape(-1, 4)
    death = np.linalg.norm(ends[..., 0, :] - ends[..., 1, :], axis=-1) / 2
    presence = _presence(birth, death, np.arange(1, KNOTS[-1] + 1)[:, None], frame)
    return Forecast(corners, values * present, birth.copy(), death, shift, presence, _noise(death, scales))


def _noise(death: Array | float, scales: Array) -> Array:
    """Of mixtures: as wide as openings, and four times the squares of the corners' scales (..., 8), an error's variance."""
    return np.asarray(NOISE + np.square(death) + 4 * (scales**2).mean(axis=-1))


def _presence(birth: ArrayLike, death: ArrayLike, ahead: ArrayLike, frame: Frame) -> Array:
    """The probability that the tracker believes in loops so many frames ahead: by what it sees there and what it remembers."""
    start, end = np.asarray(birth, np.float64), np.asarray(death, np.float64)
    odds = frame.loop_evidence(start, np.maximum(start, end)) + belief_after(np.asarray(ahead, np.float64))
    return np.asarray(1 / (1 + np.exp(-odds)), np.float32)


def _values(corners: Array) -> Array:
    """(..., 4) filtration values of the neighbours."""
    triangles = corners[..., np.array(TRIANGLES[2:]), :]
    return np.asarray(np.linalg.norm(triangles - np.roll(triangles, 1, axis=-2), axis=-1).max(axis=-1) / 2)


def _read(forecast: Forecast, index: int, loops: list[Loop], tracked: int, moved: list[Array], frame: Frame) -> None:
    """Write into a forecast what is read off a moved cloud at one of its steps; loops born there join those followed."""
    cloud, scales = moved
    followed, born = follow_all(loops, cloud, frame)
    there = {loop.id: loop for loop in followed + born}
    loops += born[: forecast.birth.shape[1] - len(loops)]
    for slot, loop in enumerate(loops):
        forecast.presence[index, slot] = 0.0
        if (now := there.get(loop.id)) is None:
            continue
        ids, present = _corners(now)
        forecast.corners[index, slot] = cloud[ids]
        forecast.neighbour_values[index, slot] = _values(cloud[ids]) * present
        forecast.birth[index, slot], forecast.death[index, slot] = now.birth, now.death
        forecast.noise[index, slot] = _noise(now.death, scales[ids])
        ahead = index + 1 if slot < tracked else np.inf  # one that is born there was not seen yet
        forecast.presence[index, slot] = _presence(now.birth, now.death, ahead, frame)
