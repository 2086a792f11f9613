"""The motion of the cloth under a plan, and the loops read off it, as NumPy arrays."""

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
from topokit.seqph import Loop, SeqPH, follow

from ._motion import KNOTS, PAST, Codes, Motion, world
from ._predictor import Array, Forecast, Predictor, as_cloud, as_grippers
from ._scenes import carriers_first, flow, target_of
from ._states import NOISE, TRIANGLES

_UNTRACKED = 16  # clouds that are kept until their loops are asked for


class MotionPredictor(Predictor):
    """Forecasts by a `Motion`: of the cloud, and of the loops that the tracker sees in the present cloud.

    There are two tiers. The fast one, for many plans, moves the corners of each loop's triangles and no other points. The exact
    one moves the whole cloud under one plan. At the frames that `exact` names it finds each loop's killer anew in the moved
    cloud (`topokit.follow`), and the loops that open there.

    Parameters
    ----------
    model : Motion
    description : mapping, optional
        The description in its checkpoint.
    """

    model: Motion

    def reset(self) -> None:
        """Forget everything observed."""
        self._clouds: deque[cKDTree] = deque(maxlen=PAST[-1] + 1)
        self._hands: deque[NDArray[np.float64]] = deque(maxlen=PAST[-1] + 1)
        self._held = True
        self._target = np.zeros((0, 3))
        self._seqph = SeqPH()
        self._loops: tuple[Loop, ...] = ()
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
        self._held = held
        self._codes = {}

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None, exact: Sequence[int] = ()) -> Forecast:
        """Forecast the states of the next frames.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            Planned places of the two grippers at each of the next frames, metres; or C such plans.
        held : (60,) or (C, 60) array_like of bool, optional
            Whether they hold the garment then; throughout, when not given.
        exact : sequence of int
            Frames ahead, 1 to 60, at which loops are read off the moved cloud; for a single plan only. A loop that is born there
            has a slot after those of the tracked loops, and is present at these frames only.

        Raises
        ------
        ValueError
            When nothing was observed, or plans or frames cannot be meant.
        """
        if len(exact) and (np.ndim(actions) == 4 or not all(1 <= step <= KNOTS[-1] for step in exact)):
            raise ValueError(f"exact names frames from 1 to {KNOTS[-1]} of a single plan, not {list(exact)}")
        self._track()
        ids = np.array([_corners(loop)[0] for loop in self._loops], dtype=np.int64)  # (S, 8)

        # Move the corners alone, or the whole cloud when loops are read off it.
        points = None
        if not len(exact) and self._clouds:
            points = self._clouds[-1].data[ids.ravel()]
        places, scales = self._moved(actions, held, points)  # (C, 60, n, 3), (C, 60, n)
        cloud_places = places[0]
        cloud_scales = scales[0]
        if len(exact):
            places = places[:, :, ids.ravel()]
            scales = scales[:, :, ids.ravel()]
        corners = places.reshape(*places.shape[:2], len(ids), 8, 3)
        scales = scales.reshape(*places.shape[:2], len(ids), 8)
        forecast = _forecast(corners, scales, self._loops, self._seqph)
        if np.ndim(actions) == 4:
            return forecast
        forecast = forecast.plan(0)
        if not len(exact):
            return forecast

        # Empty slots for loops that are born; those that stay empty are cut off again.
        loops = list(self._loops)
        n_free = self.model.shape.slots - len(loops)
        padded = [np.pad(part, [(0, 0), (0, n_free)] + [(0, 0)] * (part.ndim - 2)) for part in vars(forecast).values()]
        forecast = Forecast(*padded)
        for step in sorted(exact):
            _read_loops(forecast, step, loops, len(ids), cloud_places[step - 1], cloud_scales[step - 1], self._seqph)
        return Forecast(*(part[:, : len(loops)] for part in vars(forecast).values()))

    @torch.inference_mode()
    def move(
        self, actions: ArrayLike, held: ArrayLike | None = None, points: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return where points of the cloth will be (60, n, 3), metres, and the scale (60, n) of the error there.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            A plan; or C plans, and the answers have a leading axis of C.
        held : (60,) or (C, 60) array_like of bool, optional
        points : (n, 3) array_like, optional
            Their present places; the last cloud when not given.
        """
        if points is not None:
            points = as_cloud(points)
        places, scales = self._moved(actions, held, points)
        if np.ndim(actions) == 4:
            return places, scales
        return places[0], scales[0]

    def _track(self) -> None:
        """Track the loops of the clouds observed since; a forecast of points alone does not need them."""
        while self._untracked:
            self._loops = self._seqph.update(self._untracked.popleft()).loops[: self.model.shape.slots]

    def _moved(self, actions: ArrayLike, held: ArrayLike | None, points: Any) -> tuple[Array, Array]:
        """Return (C, 60, n, 3) places and (C, 60, n) scales of some points, or of the last cloud's."""
        chunks = self._plans(actions, held)
        if not self._clouds:
            raise ValueError("nothing was observed yet: call observe(points, grippers) first")
        if points is None:
            points = self._clouds[-1].data
        codes = self._encode(points)
        parts = [self.model.under(codes, *chunk) for chunk in chunks]
        places, scales = (torch.cat(part)[:, :, codes.carriers :].numpy() for part in zip(*parts, strict=True))

        # Between the knots, along straight lines from the present places on.
        start = world(codes.place[:, codes.carriers :], codes.origin, codes.axes).numpy()
        start = np.broadcast_to(start[:, None], (len(places), 1, *places.shape[2:]))
        places = _at_all_frames(np.concatenate([start, places], axis=1))
        scales = _at_all_frames(np.concatenate([scales[:, :1], scales], axis=1))
        return places, scales

    def _encode(self, points: NDArray[np.float64]) -> Codes:
        """Return the codes of points; they are made once for all plans until the next frame."""
        key = points.tobytes()
        if key not in self._codes:
            # Strays are no cloth: the tracker leaves them out, too. The others are mixed, in the same way each time.
            kept = self._clouds[-1].data[inliers(self._clouds[-1])]
            cloud = np.random.default_rng(0).permutation(kept)[: self.model.shape.points]
            cloud = cloud[carriers_first(cloud)]
            last = len(self._clouds) - 1
            times = [max(last - ago, 0) for ago in (0, *PAST)]
            grippers = np.stack([self._hands[i] for i in times])
            past = [self._clouds[i] for i in times[1:]]
            scene = {
                "cloud": cloud,
                "points": points,
                "flow": flow(np.concatenate([cloud, points]), past, grippers),
                "grippers": grippers,
                **target_of(self._target),
            }
            tensors = {name: torch.from_numpy(np.asarray(part, np.float32))[None] for name, part in scene.items()}
            tensors["held"] = torch.tensor([self._held])
            self._codes[key] = self.model.encode(tensors)
        return self._codes[key]


def _at_all_frames(values: Array) -> Array:
    """Return (C, 60, ...) values at each of the next frames, from those (C, 1 + 13, ...) at present and at the knots."""
    knots = np.array((0, *KNOTS))
    frames = np.arange(1, KNOTS[-1] + 1)
    after = np.searchsorted(knots, frames)
    share = ((frames - knots[after - 1]) / np.diff(knots)[after - 1]).astype(np.float32)
    share = share.reshape(-1, *[1] * (values.ndim - 2))
    return np.asarray(values[:, after - 1] * (1 - share) + values[:, after] * share)


def _corners(loop: Loop) -> tuple[list[int], list[bool]]:
    """Return the vertices of a loop's eight corners, in the order of `StateTensors.corners`, and which neighbours it has."""
    edge = loop.killer_edge.tolist()
    corners = list(edge)
    for triangle in loop.killer_triangle_ids.tolist():
        corners += [vertex for vertex in triangle if vertex not in edge]
    apex_at = {frozenset(outer): apex for *outer, apex in loop.neighbour_ids.tolist()}
    edges = [frozenset((corners[a], corners[b])) for a, b, _ in TRIANGLES[2:]]
    present = [outer in apex_at for outer in edges]
    apexes = [apex_at.get(outer, corners[2]) for outer in edges]
    return corners + apexes, present


def _forecast(corners: Array, scales: Array, loops: Sequence[Loop], seqph: SeqPH) -> Forecast:
    """Return the states (C, 60, S) of tracked loops whose corners (C, 60, S, 8, 3) are moved, with errors of these scales."""
    edges = corners[..., :2, :]  # (C, 60, S, 2, 3) the killer edges
    present_edges = np.array([loop.killer_edge_points for loop in loops], np.float32).reshape(-1, 2, 3)
    first = np.broadcast_to(present_edges, edges[:, :1].shape)
    before = np.concatenate([first, edges[:, :-1]], axis=1)
    # The Hausdorff distance between a killer edge and that of the frame before.
    gaps = np.linalg.norm(edges[..., :, None, :] - before[..., None, :, :], axis=-1)  # (C, 60, S, 2, 2)
    shift = np.maximum(gaps.min(axis=-1).max(axis=-1), gaps.min(axis=-2).max(axis=-1))

    birth = np.broadcast_to(np.array([loop.birth for loop in loops], np.float32), corners.shape[:3]).copy()
    death = np.linalg.norm(edges[..., 0, :] - edges[..., 1, :], axis=-1) / 2
    has_neighbour = np.array([_corners(loop)[1] for loop in loops], bool).reshape(-1, 4)
    return Forecast(
        corners=corners,
        neighbour_values=_neighbour_values(corners) * has_neighbour,
        birth=birth,
        death=death,
        killer_shift=shift,
        presence=_presence(birth, death, np.arange(1, KNOTS[-1] + 1)[:, None], seqph),
        noise=_noise(death, scales),
    )


def _noise(death: Array | float, scales: Array) -> Array:
    """Return the mixtures' noise: the opening squared, and four times the squared scales of the corners: an error's variance."""
    return np.asarray(NOISE + np.square(death) + 4 * (scales**2).mean(axis=-1))


def _presence(birth: ArrayLike, death: ArrayLike, ahead: ArrayLike, seqph: SeqPH) -> Array:
    """Return the probability that the tracker counts loops as present so many frames ahead."""
    start = np.asarray(birth, np.float64)
    end = np.maximum(start, np.asarray(death, np.float64))
    return seqph.presence(start, end, ahead).astype(np.float32)


def _neighbour_values(corners: Array) -> Array:
    """Return (..., 4) filtration values of the neighbours: half the longest side."""
    triangles = corners[..., np.array(TRIANGLES[2:]), :]  # (..., 4, 3, 3)
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=-2), axis=-1)
    return np.asarray(sides.max(axis=-1) / 2)


def _read_loops(
    forecast: Forecast, step: int, loops: list[Loop], n_tracked: int, cloud: Array, scales: Array, seqph: SeqPH
) -> None:
    """Write into a forecast what is read off the moved cloud at one of its steps; loops born there are added to the list."""
    found = {loop.id: loop for loop in follow(loops, cloud, seqph)}
    known_ids = {loop.id for loop in loops}
    born = [loop for loop in found.values() if loop.id not in known_ids]
    loops += born[: forecast.birth.shape[1] - len(loops)]
    row = step - 1
    for slot, loop in enumerate(loops):
        forecast.presence[row, slot] = 0.0
        if loop.id not in found:
            continue
        now = found[loop.id]
        ids, has_neighbour = _corners(now)
        forecast.corners[row, slot] = cloud[ids]
        forecast.neighbour_values[row, slot] = _neighbour_values(cloud[ids]) * has_neighbour
        forecast.birth[row, slot] = now.birth
        forecast.death[row, slot] = now.death
        forecast.noise[row, slot] = _noise(now.death, scales[ids])
        # The tracker remembers a loop that it has seen; one that is born there it has not.
        ahead = float(step) if slot < n_tracked else np.inf
        forecast.presence[row, slot] = _presence(now.birth, now.death, ahead, seqph)
