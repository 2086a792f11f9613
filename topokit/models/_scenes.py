"""The windows that `Motion` learns from: scenes, and where the vertices went. They need no labels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from topokit.sampling import farthest_point_sample

from ._motion import CARRIERS, KNOTS, PAST, carried

if TYPE_CHECKING:
    from topokit.data import Dataset

Array = NDArray[np.float32]


class Scenes(torch.utils.data.Dataset[dict[str, Tensor]]):
    """Windows of the motion of vertices, for training `Motion`.

    An item is the scene of `Motion`, its plan, and `future` (13, 40, 3) with `known` (13,). Which vertices are seen is drawn at
    random for each frame, so that a cloud's order carries no information.

    Parameters
    ----------
    dataset : Dataset
    episodes : iterable of int
    n_points : int
        Points of a cloud that are read; of a smaller cloud some are read twice.
    stride : int
        Frames from one window to the next.
    """

    def __init__(self, dataset: Dataset, episodes: Iterable[int], *, n_points: int = 160, stride: int = 1) -> None:
        self.dataset = dataset
        self.episodes = np.unique(np.asarray(list(episodes), np.int64))
        self.n_points = n_points
        # A window has at least four frames before the present one, and 20 after it.
        rows = [
            (int(number), frame)
            for number in self.episodes
            for frame in range(4, dataset.record(number).frames - 20, stride)
        ]
        self.index = np.array(rows, dtype=np.int64).reshape(-1, 2)
        self._films: dict[int, dict[str, Array]] = {}

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, i: int) -> dict[str, Tensor]:
        number, frame = self.index[i].tolist()
        if number not in self._films:
            episode = self.dataset[number]
            film = {name: getattr(episode, name) for name in ("points", "grippers", "actions", "held")}
            self._films[number] = film | target_of(episode.centre_line)
        rng = np.random.default_rng((number, frame))
        return scene_at(self._films[number], frame, rng, self.n_points, self._asked(number, frame))

    def _asked(self, number: int, frame: int) -> NDArray[np.int64] | None:
        """Return the vertices (16,) whose motion from a frame of an episode is asked for; None for any, as here."""
        return None


def scene_at(
    film: dict[str, Array],
    frame: int,
    rng: np.random.Generator,
    n_points: int = 160,
    asked: NDArray[np.int64] | None = None,
) -> dict[str, Tensor]:
    """Return the window of a film whose present is that frame; `asked` (16,) are the vertices that it asks for."""
    points = film["points"]  # (T, n, 3)
    n = points.shape[1]
    last = len(points) - 1

    # In half of the windows the past is seen by a camera, which sees a part; in the others by a tracker of all vertices.
    n_past = n
    if rng.random() < 0.5:
        n_past = int(rng.integers(n // 3, n))
    seen = np.resize(rng.permutation(n), n_points)
    if asked is None:
        asked = np.resize(rng.permutation(n), 16)
    times = np.maximum(frame - np.array((0, *PAST)), 0)
    seen = seen[carriers_first(points[frame, seen])]
    past = [cKDTree(points[then, rng.permutation(n)[:n_past]]) for then in times[1:]]

    both = points[frame, np.concatenate([seen, asked])]
    grippers = film["grippers"][times]
    ahead = np.minimum(frame + np.arange(1, KNOTS[-1] + 1), last)
    knots = frame + np.array(KNOTS)
    scene = {
        "cloud": both[:n_points],
        "points": both[n_points:],
        "flow": flow(both, past, grippers),
        "grippers": grippers,
        "held": film["held"][frame],
        "target": film["target"],
        "floor": film["floor"],
        "actions": film["actions"][ahead],
        "actions_held": film["held"][ahead],
        "future": points[np.minimum(knots, last)][:, np.concatenate([seen[:CARRIERS], asked])],
        "known": knots <= last,
    }
    return {name: torch.as_tensor(np.asarray(part)) for name, part in scene.items()}


def flow(points: NDArray[np.floating], past: Sequence[cKDTree], grippers: NDArray[np.floating]) -> Array:
    """Return (n, 3, 3) how points (n, 3), carried back with the grippers (1 + 3, 2, 3), moved since each of 3 past clouds."""
    place = torch.from_numpy(np.ascontiguousarray(points, np.float64))
    hands = torch.from_numpy(np.ascontiguousarray(grippers, np.float64))
    count = len(past)
    back = carried(place.expand(count, -1, -1), hands[:1].expand(count, -1, -1), hands[1:]).numpy()  # (3, n, 3)
    moved = [then - cloud.data[cloud.query(then)[1]] for then, cloud in zip(back, past, strict=True)]
    return np.stack(moved, axis=1).astype(np.float32)


def carriers_first(cloud: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return an order (n,) of a cloud's points, a farthest-point sample first, so that handles of few points are among them."""
    carriers, _ = farthest_point_sample(cloud, min(CARRIERS, len(cloud)))
    return np.append(carriers, np.delete(np.arange(len(cloud)), carriers))


def target_of(line: NDArray[np.floating]) -> dict[str, Array]:
    """Return `target` (16, 3), the last 0.9 m of a centre line, and `floor` (), where it stands; far below without a target."""
    if not len(line):
        line = np.array([[0, 0, -1000.0]])
    length = np.append(0, np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum())
    at = np.linspace(max(length[-1] - 0.9, 0), length[-1], 16)
    places = np.stack([np.interp(at, length, axis) for axis in line.T], axis=1)
    return {"target": places.astype(np.float32), "floor": np.asarray(line[:, 2].min(), np.float32)}
