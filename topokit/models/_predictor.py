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
from torch import Tensor

from topokit._validate import as_points
from topokit.sampling import farthest_point_sample, inliers
from topokit.seqph import Loop, SeqPH, TopologicalState, follow

from ._checkpoint import Model, load_model
from ._motion import KNOTS, PAST, Codes, Motion, world
from ._scenes import carriers_first, flow, target_of
from ._states import NOISE, TRIANGLES, StateTensors, Window, past_of

Array = NDArray[np.float32]


class Predictor:
    """Forecasts of the topological state from a stream of point clouds.

    Parameters
    ----------
    model : PredictiveModel
        For a `Motion` use `Predictor.of`, which chooses a `MotionPredictor`.
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
        history = self.model.shape.history
        self._frames: deque[dict[str, NDArray[np.float64]]] = deque(maxlen=history)
        self._states: deque[TopologicalState] = deque(maxlen=history)
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

        Raises
        ------
        ValueError
            When an array is not one of points, or the model needs the grippers.
        """
        cloud = as_points(points)
        if self.model.tracked:
            self._frames.append({"grippers": as_grippers(grippers)})
            self._states.append(self._tracker.update(cloud))
        else:
            # Choose as many points as the model reads; repeat points when there are fewer.
            n = self.model.shape.points
            if len(cloud) > n:
                cloud = cloud[farthest_point_sample(cloud, n, None)[0]]
            self._frames.append({"clouds": np.resize(cloud, (n, 3))})
        self._context = None

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None) -> StateTensors:
        """Forecast the states of the next frames; the first observed frame also stands for the frames before it.

        Parameters
        ----------
        actions : (60, 2, 3) or (C, 60, 2, 3) array_like
            Planned places of the two grippers at each of the next frames, metres; or C such plans.
        held : (60,) or (C, 60) array_like of bool, optional
            Whether the grippers hold the garment at each of these frames; when not given, at all of them.

        Returns
        -------
        StateTensors
            Of shape (60, S), or (C, 60, S) for C plans.
        """
        chunks = self._plans(actions, held)
        if self._context is None:
            self._context = self.model.encode(self._window())
        parts = [vars(self.model.decode(self._context, *chunk)).values() for chunk in chunks]
        states = StateTensors(*(torch.cat(part) for part in zip(*parts, strict=True)))
        return states if np.ndim(actions) == 4 else states[0]

    def _window(self) -> Window:
        """Return the history as a batch of one window."""
        if not self._frames:
            raise ValueError("no frame has been observed yet: call observe first")
        missing = self.model.shape.history - len(self._frames)
        frames = [self._frames[0]] * missing + list(self._frames)
        window = {name: torch.tensor(np.stack([frame[name] for frame in frames])[None]).float() for name in frames[0]}
        if self.model.tracked:
            window |= past_of([self._states[0]] * missing + list(self._states), self.model.shape.slots)
        return window

    def _plans(self, actions: ArrayLike, held: ArrayLike | None) -> list[tuple[Tensor, Tensor]]:
        """Return plans (C, 60, 2, 3) and holds (C, 60), 250 at once: for more, activations do not stay in the cache."""
        plans = torch.as_tensor(np.asarray(actions, np.float32))
        steps = self.model.shape.horizon
        if plans.shape[-3:] != (steps, 2, 3):
            raise ValueError(f"actions must be ({steps}, 2, 3) or (plans, {steps}, 2, 3), not {tuple(plans.shape)}")
        holds = torch.ones(plans.shape[:-2], dtype=torch.bool)
        if held is not None:
            holds = torch.as_tensor(np.asarray(held, bool)).expand(holds.shape)
        some_plans = plans.reshape(-1, steps, 2, 3).split(250)
        some_holds = holds.reshape(-1, steps).split(250)
        return list(zip(some_plans, some_holds, strict=True))


class MotionPredictor(Predictor):
    """Forecasts by a `Motion`: of the cloud, and of the loops that the tracker sees in the present cloud.

    There are two tiers. The fast one, for many plans, moves the corners of each loop's triangles and no other points. The exact
    one moves the whole cloud under one plan. At the frames that `exact` names it finds each loop's killer anew in the moved
    cloud (`topokit.follow`), and the loops that open there.

    Parameters
    ----------
    model : Motion
    """

    model: Motion

    def reset(self) -> None:
        """Forget everything observed."""
        self._clouds: deque[cKDTree] = deque(maxlen=PAST[-1] + 1)
        self._hands: deque[NDArray[np.float64]] = deque(maxlen=PAST[-1] + 1)
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
        self._hands.append(as_grippers(grippers))
        if target is not None:
            self._target = as_points(target, "target", copy=True)
        self._clouds.append(cKDTree(cloud))
        self._untracked.append(cloud)
        self._held = bool(held)
        self._codes = {}

    @torch.inference_mode()
    def predict(self, actions: ArrayLike, held: ArrayLike | None = None, exact: Sequence[int] = ()) -> StateTensors:
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
        """
        self.track()
        ids = np.array([_corners(loop)[0] for loop in self.loops], dtype=np.int64)  # (S, 8)
        plans = np.asarray(actions, np.float32).reshape(-1, *np.shape(actions)[-3:])

        # Move the corners alone, or the whole cloud when loops are read off it.
        if not len(exact):
            points = self._clouds[-1].data[ids.ravel()] if self._clouds else None
            places, scales = self.move(plans, held, points)  # (C, 60, 8 S, 3), (C, 60, 8 S)
            states = self._states_of(places, scales)
            return states if np.ndim(actions) == 4 else states[0]
        if np.ndim(actions) == 4:
            raise ValueError("exact frames are for a single plan")
        places, scales = self.move(plans, held)
        states = self._states_of(places[:, :, ids.ravel()], scales[:, :, ids.ravel()])[0]

        # Empty slots for loops that are born; those that stay empty are cut off again.
        n_free = self.model.shape.slots - len(ids)
        states = states.map(lambda part: torch.cat([part, part.new_zeros(60, n_free, *part.shape[2:])], dim=1))
        states.presence[:, len(ids) :] = -20
        states.noise[:, len(ids) :] = NOISE
        loops = list(self.loops)
        for step in sorted(exact):
            self._read_loops(states, step, loops, places[0, step - 1], scales[0, step - 1])
        return states[:, : len(loops)]

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
        chunks = self._plans(actions, held)
        if not self._clouds:
            raise ValueError("no frame has been observed yet: call observe first")
        codes = self._encode(self._clouds[-1].data if points is None else np.asarray(points, np.float64))
        parts = [self.model.under(codes, *chunk) for chunk in chunks]
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

    def _states_of(self, places: Array, scales: Array) -> StateTensors:
        """Return the states (C, 60, S) of the tracked loops, from their corners (C, 60, 8 S, 3) and scales of errors."""
        corners = places.reshape(*places.shape[:2], -1, 8, 3)
        edges = corners[..., :2, :]  # (C, 60, S, 2, 3) the killer edges
        present_edges = np.array([loop.killer_edge_points for loop in self.loops], np.float32).reshape(-1, 2, 3)
        first = np.broadcast_to(present_edges, edges[:, :1].shape)
        before = np.concatenate([first, edges[:, :-1]], axis=1)
        # The Hausdorff distance between a killer edge and that of the frame before.
        gaps = np.linalg.norm(edges[..., :, None, :] - before[..., None, :, :], axis=-1)  # (C, 60, S, 2, 2)
        shift = np.maximum(gaps.min(axis=-1).max(axis=-1), gaps.min(axis=-2).max(axis=-1))

        birth = np.broadcast_to(np.array([loop.birth for loop in self.loops], np.float32), corners.shape[:3])
        death = np.linalg.norm(edges[..., 0, :] - edges[..., 1, :], axis=-1) / 2
        has_neighbour = np.array([_corners(loop)[1] for loop in self.loops], bool).reshape(-1, 4)
        parts = {
            "corners": corners,
            "neighbour_values": _neighbour_values(corners) * has_neighbour,
            "birth": birth,
            "death": death,
            "killer_shift": shift,
            "noise": _noise(death, scales.reshape(corners.shape[:-1])),
        }
        tensors = {name: torch.tensor(part) for name, part in parts.items()}
        return StateTensors(**tensors, presence=self._presence(birth, death, np.arange(1, 61)[:, None]))

    def _presence(self, birth: ArrayLike, death: ArrayLike, ahead: ArrayLike) -> Tensor:
        """Return the logits that the tracker counts loops as present so many frames ahead."""
        start = np.asarray(birth, np.float64)
        end = np.maximum(start, np.asarray(death, np.float64))
        return torch.from_numpy(np.asarray(self.tracker.presence(start, end, ahead))).logit(1e-6).float()

    def _read_loops(self, states: StateTensors, step: int, loops: list[Loop], cloud: Array, scales: Array) -> None:
        """Write into states (60, S) what is read off the moved cloud at a step; loops born there are added to the list."""
        found = {loop.id: loop for loop in follow(loops, cloud, self.tracker)}
        known_ids = {loop.id for loop in loops}
        born = [loop for loop in found.values() if loop.id not in known_ids]
        loops += born[: states.birth.shape[1] - len(loops)]
        row = states[step - 1]
        row.presence[: len(loops)] = -20
        for slot, loop in enumerate(loops):
            if loop.id not in found:
                continue
            now = found[loop.id]
            ids, has_neighbour = _corners(now)
            row.corners[slot] = torch.from_numpy(cloud[ids])
            row.neighbour_values[slot] = torch.from_numpy(_neighbour_values(cloud[ids]) * has_neighbour)
            row.birth[slot] = now.birth
            row.death[slot] = now.death
            row.noise[slot] = float(_noise(now.death, scales[ids]))
            # The tracker remembers a loop that it has seen; one that is born there it has not.
            ahead = float(step) if slot < len(self.loops) else np.inf
            row.presence[slot] = self._presence(now.birth, now.death, ahead)


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


def _noise(death: Array | float, scales: Array) -> Array:
    """Return the mixtures' noise: the opening squared, and four times the squared scales of the corners: an error's variance."""
    return np.asarray(NOISE + np.square(death) + 4 * (scales**2).mean(axis=-1))


def _neighbour_values(corners: Array) -> Array:
    """Return (..., 4) filtration values of the neighbours: half the longest side."""
    triangles = corners[..., np.array(TRIANGLES[2:]), :]  # (..., 4, 3, 3)
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=-2), axis=-1)
    return np.asarray(sides.max(axis=-1) / 2)
