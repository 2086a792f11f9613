"""A trained model on a stream of clouds: observe, then predict under one plan or many."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.special import logit
from torch import Tensor

from topokit._validate import as_points
from topokit.sampling import farthest_point_sample, inliers
from topokit.seqph import Loop, SeqPH, follow

from ._baselines import Model
from ._checkpoint import load_model
from ._motion import KNOTS, PAST, Codes, Motion, world
from ._scenes import carriers_first, flow, target_of
from ._states import NOISE, TRIANGLES, StateTensors, Window, past_of

Array = NDArray[np.float32]


class Predictor:
    """Forecasts of the topological state from a stream of point clouds, by a model of `build` that reads windows.

    For a model of motion use `Predictor.of`, which chooses a `MotionPredictor`.
    """

    def __init__(self, model: Model) -> None:
        self.model: Any = model.eval()
        self.description: dict[str, Any] = {}  #: the description in the model's checkpoint
        self.reset()

    @staticmethod
    def of(model: Model) -> Predictor:
        """Return the predictor of a model that `build` made: of a model of motion it is a `MotionPredictor`."""
        return MotionPredictor(model) if isinstance(model, Motion) else Predictor(model)

    @classmethod
    def load(cls, path: str | Path) -> Predictor:
        """Read a checkpoint; a model of motion gives a `MotionPredictor`."""
        model, description = load_model(path)
        predictor = cls.of(model)
        predictor.description = description
        return predictor

    def reset(self) -> None:
        """Forget everything observed."""
        self._frames: deque[Any] = deque(maxlen=self.model.shape.history)  # grippers and state; or a cloud
        self._tracker = SeqPH()
        self._context: dict[str, Tensor] | None = None

    def observe(
        self, points: ArrayLike, grippers: ArrayLike | None = None, held: bool = True, target: ArrayLike | None = None
    ) -> None:
        """Take in the next frame.

        Parameters
        ----------
        points : (n, 3) array_like
            Metres.
        grippers : (2, 3) array_like, optional
            Places of the grippers, metres. A model whose input is clouds alone does not need them.
        held : bool
            Whether the grippers hold the garment.
        target : (L, 3) array_like, optional
            Centre line of the target, from the floor to its tip, for a `MotionPredictor`; the last one when not given.
        """
        cloud = as_points(points)
        if self.model.tracked:
            self._frames.append((as_grippers(grippers), self._tracker.update(cloud)))
        else:
            # Choose as many points as the model reads; repeat points when there are fewer.
            n = self.model.shape.points
            if len(cloud) > n:
                cloud = cloud[farthest_point_sample(cloud, n, None)[0]]
            self._frames.append(np.resize(cloud, (n, 3)))
        self._context = None

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None) -> StateTensors:
        """Forecast the states (60, S) of the next frames; the first observed frame also stands for the frames before it.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            Planned places of the two grippers at each of the next frames, metres; or C such plans, for states (C, 60, S).
        held : (60,) or (C, 60) array_like of bool, optional
            Whether the grippers hold the garment at each of these frames; when not given, at all of them.
        """
        chunks = self._plans(actions, held)
        if self._context is None:
            self._context = self.model.encode(self._window())
        parts = [vars(self.model.decode(self._context, *chunk)).values() for chunk in chunks]
        states = StateTensors(*(torch.cat(part) for part in zip(*parts, strict=True)))
        return states if np.ndim(actions) == 4 else states[0]

    def _window(self) -> Window:
        """Return the history as a batch of one window."""
        frames = self._history()
        if not self.model.tracked:
            return {"clouds": torch.tensor(np.array([frames])).float()}
        grippers, states = zip(*frames, strict=True)
        past = past_of(states, self.model.shape.slots)
        return {"grippers": torch.tensor(np.array([grippers])).float(), **past}

    def _history(self) -> list[Any]:
        """Return the last frames, the newest one last; the first observed frame also stands for the frames before it."""
        if not self._frames:
            raise ValueError("no frame has been observed yet: call observe first")
        missing = (self._frames.maxlen or 0) - len(self._frames)
        return [self._frames[0]] * missing + list(self._frames)

    def _plans(self, actions: ArrayLike, held: ArrayLike | None) -> list[tuple[Tensor, Tensor]]:
        """Return plans (C, 60, 2, 3) and holds (C, 60), 128 at once: for more, activations do not stay in the cache."""
        plans = torch.as_tensor(np.asarray(actions, np.float32))
        steps = self.model.shape.horizon
        if plans.shape[-3:] != (steps, 2, 3):
            raise ValueError(f"actions must be ({steps}, 2, 3) or (plans, {steps}, 2, 3), not {tuple(plans.shape)}")
        plans = plans.reshape(-1, steps, 2, 3)
        holds = torch.as_tensor(np.asarray(True if held is None else held, bool)).expand(plans.shape[:2])
        return list(zip(plans.split(128), holds.split(128), strict=True))


class MotionPredictor(Predictor):
    """Forecasts by a `Motion`: of the cloud, and of the loops that the tracker sees in the present cloud.

    There are two tiers. The fast one, for many plans, moves the corners of each loop's triangles alone. The exact one moves the
    whole cloud under one plan and finds each loop's killer anew, and the loops that open (`topokit.follow`).
    """

    model: Motion

    def reset(self) -> None:
        """Forget everything observed."""
        self._frames = deque(maxlen=PAST[-1] + 1)  # cloud, as a tree of its points, and grippers
        self._held = True
        self._target = np.zeros((0, 3))
        self._untracked: deque[NDArray[np.float64]] = deque(maxlen=self.model.shape.history)
        self._codes: dict[bytes, Codes] = {}
        self.tracker = SeqPH()  #: the tracker of the clouds observed
        self.loops: tuple[Loop, ...] = ()  #: the loops of the last cloud that was tracked

    def observe(
        self, points: ArrayLike, grippers: ArrayLike | None = None, held: bool = True, target: ArrayLike | None = None
    ) -> None:
        """Take in the next frame, as `Predictor.observe` does."""
        cloud = as_points(points, copy=True)
        hands = as_grippers(grippers)
        if target is not None:
            self._target = as_points(target, "target", copy=True)
        self._frames.append((cKDTree(cloud), hands))
        self._untracked.append(cloud)
        self._held = bool(held)
        self._codes = {}

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None, exact: Sequence[int] = ()) -> StateTensors:
        """Forecast the states of the next frames under a plan, or under C plans, as `Predictor.predict` does.

        At the frames ahead, 1 to 60, in `exact`, loops are read off the moved cloud; for a single plan only. A loop that is
        born there has a slot after those of the tracked loops, and is present at these frames only.
        """
        many = np.ndim(actions) == 4
        if many and len(exact):
            raise ValueError("exact frames are for a single plan")
        self.track()
        ids, _ = _corners(self.loops)
        plans = np.asarray(actions, np.float32).reshape(-1, *np.shape(actions)[-3:])

        # Move the corners alone, or the whole cloud when loops are read off it.
        points = None
        if not len(exact):
            points = self._history()[-1][0].data[ids.ravel()]
            ids = np.arange(ids.size).reshape(ids.shape)
        places, scales = self.move(plans, held, points)
        corners = places[:, :, ids]  # (C, 60, S, 8, 3)
        ahead = np.arange(1, 61)[:, None]
        states = self._states_of(self.loops, corners, scales[:, :, ids], _shifts(self.loops, corners), ahead)
        if len(exact):
            return self._read_loops(states[0], exact, places[0], scales[0])
        return states if many else states[0]

    @torch.inference_mode()
    def move(
        self, actions: ArrayLike, held: ArrayLike | None = None, points: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return where points (n, 3) of the cloth will be (60, n, 3), metres, and the scale (60, n) of the error there.

        Plans are those of `predict`; C of them give a leading axis of C. By default the points are the last cloud.
        """
        chunks = self._plans(actions, held)
        codes = self._encode(self._history()[-1][0].data if points is None else np.asarray(points, np.float64))
        # Many plans are compared, so their products may be of bfloat16: it is some mm off where a processor multiplies so.
        precision = torch.get_float32_matmul_precision()
        if len(chunks[0][0]) > 1:
            torch.set_float32_matmul_precision("medium")
        try:
            parts = [self.model.under(codes, *chunk) for chunk in chunks]
        finally:
            torch.set_float32_matmul_precision(precision)
        places, scales = (torch.cat(part)[:, :, codes.carriers :].numpy() for part in zip(*parts, strict=True))

        # Between the knots, along straight lines from the present places on.
        start = world(codes.place[:, codes.carriers :], codes.origin, codes.axes).numpy()
        start = np.broadcast_to(start[:, None], (len(places), 1, *places.shape[2:]))
        places = _at_all_frames(np.concatenate([start, places], axis=1))
        scales = _at_all_frames(np.concatenate([scales[:, :1], scales], axis=1))
        return (places, scales) if np.ndim(actions) == 4 else (places[0], scales[0])

    def track(self) -> None:
        """Track the loops of the clouds observed since; a forecast of points alone does not need them."""
        while self._untracked:
            self.loops = self.tracker.update(self._untracked.popleft()).loops[: self.model.shape.slots]

    def _encode(self, points: NDArray[np.float64]) -> Codes:
        """Return the codes of points; they are made once for all plans until the next frame."""
        key = points.tobytes()
        if key not in self._codes:
            past, grippers = zip(*(self._history()[-1 - ago] for ago in (0, *PAST)), strict=True)
            # Strays are no cloth: the tracker leaves them out, too. The others are mixed, in the same way each time.
            kept = past[0].data[inliers(past[0])]
            cloud = np.random.default_rng(0).permutation(kept)[: self.model.shape.points]
            cloud = cloud[carriers_first(cloud)]
            scene = {
                "cloud": cloud,
                "points": points,
                "flow": flow(np.concatenate([cloud, points]), past[1:], np.array(grippers)),
                "grippers": grippers,
                **target_of(self._target),
            }
            tensors = {name: torch.from_numpy(np.asarray(part, np.float32))[None] for name, part in scene.items()}
            tensors["held"] = torch.tensor([self._held])
            self._codes[key] = self.model.encode(tensors)
        return self._codes[key]

    def _states_of(
        self, loops: Sequence[Loop], corners: Array, scales: Array, shifts: ArrayLike, ahead: ArrayLike
    ) -> StateTensors:
        """Return the states (..., S) of loops, so many frames ahead, from their corners (..., S, 8, 3) and scales of errors."""
        birth = np.broadcast_to(np.array([loop.birth for loop in loops], np.float32), corners.shape[:-2])
        death = np.linalg.norm(corners[..., 0, :] - corners[..., 1, :], axis=-1) / 2
        # A neighbour's filtration value is half its longest side.
        triangles = corners[..., np.array(TRIANGLES[2:]), :]  # (..., S, 4, 3, 3)
        sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=-2), axis=-1)
        parts = {
            "corners": corners,
            "neighbour_values": sides.max(axis=-1) / 2 * _corners(loops)[1],
            "birth": birth,
            "death": death,
            "killer_shift": shifts,
            # The logits that the tracker counts the loops as present then.
            "presence": logit(self.tracker.presence(birth, np.maximum(birth, death), ahead).clip(1e-6, 1 - 1e-6)),
            # The opening squared, and four times the squared scales of the corners: an error's variance.
            "noise": NOISE + np.square(death) + 4 * (scales**2).mean(axis=-1),
        }
        return StateTensors(**{name: torch.tensor(np.asarray(part, np.float32)) for name, part in parts.items()})

    def _read_loops(self, states: StateTensors, steps: Sequence[int], clouds: Array, scales: Array) -> StateTensors:
        """Return states (60, S) with what is read off the moved clouds (60, n, 3) at some steps; loops are born there."""
        # Loops that are born get slots after the others; those that stay empty are cut off again.
        states = states.padded(self.model.shape.slots)
        loops = list(self.loops)
        for step in sorted(steps):
            followed = {loop.id: loop for loop in follow(loops, clouds[step - 1], self.tracker)}
            known_ids = {loop.id for loop in loops}
            born = [loop for loop in followed.values() if loop.id not in known_ids]
            loops += born[: self.model.shape.slots - len(loops)]
            slots = [slot for slot, loop in enumerate(loops) if loop.id in followed]
            now = [followed[loops[slot].id] for slot in slots]
            ids, _ = _corners(now)
            # The tracker remembers a loop that it has seen; one that is born there it has not.
            ahead = [step if slot < len(self.loops) else np.inf for slot in slots]
            row = states[step - 1]
            read = self._states_of(now, clouds[step - 1, ids], scales[step - 1, ids], row.killer_shift[slots], ahead)
            row.presence[:] = -20
            for part, values in zip(vars(row).values(), vars(read).values(), strict=True):
                part[slots] = values
        return states[:, : len(loops)]


def as_grippers(grippers: ArrayLike | None) -> NDArray[np.float64]:
    """Return the places (2, 3) of the grippers, checked and copied."""
    if grippers is None or np.shape(grippers) != (2, 3):
        raise ValueError(f"this model needs the places (2, 3) of the grippers, not {grippers!r}")
    return as_points(grippers, "grippers", copy=True)


def _at_all_frames(values: Array) -> Array:
    """Return (C, 60, ...) values at each of the next frames, from those (C, 1 + 13, ...) at present and at the knots."""
    knots = np.array((0, *KNOTS))
    frames = np.arange(1, KNOTS[-1] + 1)
    after = np.searchsorted(knots, frames)
    share = ((frames - knots[after - 1]) / np.diff(knots)[after - 1]).astype(np.float32)
    share = share.reshape(-1, *[1] * (values.ndim - 2))
    return np.asarray(values[:, after - 1] * (1 - share) + values[:, after] * share)


def _shifts(loops: Sequence[Loop], corners: Array) -> Array:
    """Return (C, 60, S) the Hausdorff distances between killer edges and those of the frame before, from corners of loops."""
    edges = corners[..., :2, :]  # (C, 60, S, 2, 3)
    present = np.array([loop.killer_edge_points for loop in loops], np.float32).reshape(-1, 2, 3)
    before = np.concatenate([np.broadcast_to(present, edges[:, :1].shape), edges[:, :-1]], axis=1)
    gaps = np.linalg.norm(edges[..., :, None, :] - before[..., None, :, :], axis=-1)  # (C, 60, S, 2, 2)
    return np.maximum(gaps.min(axis=-1).max(axis=-1), gaps.min(axis=-2).max(axis=-1))


def _corners(loops: Sequence[Loop]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the vertices (S, 8) of loops' corners, in the order of `StateTensors.corners`, and (S, 4) which neighbours exist."""
    ids = []
    present = []
    for loop in loops:
        edge = loop.killer_edge.tolist()
        corners = list(edge)
        for triangle in loop.killer_triangle_ids.tolist():
            corners += [vertex for vertex in triangle if vertex not in edge]
        apex_at = {frozenset(outer): apex for *outer, apex in loop.neighbour_ids.tolist()}
        edges = [frozenset((corners[a], corners[b])) for a, b, _ in TRIANGLES[2:]]
        present.append([outer in apex_at for outer in edges])
        ids.append(corners + [apex_at.get(outer, corners[2]) for outer in edges])
    return np.array(ids, np.int64).reshape(-1, 8), np.array(present, bool).reshape(-1, 4)
