"""What `Motion` learns from: scenes and where the vertices went, of a dataset without labels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from topokit.data import Dataset
from topokit.sampling import farthest_point_sample

from ._motion import CARRIERS, KNOTS, PAST, carried

Array = NDArray[np.float32]
ASKED = 16  # points of a cloud that are asked for
TARGET = 16  # points of a target's line
FIRST, AHEAD = 4, 20  # frames that a window has at least before the present one, and after it


class Scenes(torch.utils.data.Dataset[dict[str, Tensor]]):
    """Windows of the motion of vertices: an item is the scene of `Motion`, its plan, and `future` (13, 40, 3) with `known` (13,).

    Which vertices are seen is drawn at random for each frame, so that a cloud's order says nothing.

    Parameters
    ----------
    dataset : Dataset
    episodes : iterable of int
    n_points : int
        Points of a cloud that are looked at; where there are fewer, some of them twice.
    stride : int
        Frames from one window to the next.
    """

    def __init__(self, dataset: Dataset, episodes: Iterable[int], *, n_points: int = 160, stride: int = 1) -> None:
        self.dataset, self.episodes, self.n_points = dataset, np.unique([*map(int, episodes)]), n_points
        lengths = [dataset.record(i).frames for i in self.episodes]
        frames = [np.arange(FIRST, length - AHEAD, stride) for length in lengths]
        self.index = np.column_stack([np.repeat(self.episodes, [*map(len, frames)]), np.concatenate(frames)])
        self._known: dict[int, dict[str, Array]] = {}

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, i: int) -> dict[str, Tensor]:
        number, frame = self.index[i].tolist()
        if number not in self._known:
            film, names = self.dataset[number], ("points", "grippers", "actions", "held")
            self._known[number] = {name: getattr(film, name) for name in names}
            self._known[number] |= target_of(film.centre_line)
        return scene_at(self._known[number], frame, np.random.default_rng((number, frame)), self.n_points)


def scene_at(parts: dict[str, Array], frame: int, rng: np.random.Generator, n_points: int = 160) -> dict[str, Tensor]:
    """The window of an episode whose present is that frame."""
    points, n = parts["points"], parts["points"].shape[1]

    def some(count: int, most: int = n) -> NDArray[np.int64]:
        return np.resize(rng.permutation(n)[:most], count)

    thin = int(rng.integers(n // 3, n)) if rng.random() < 0.5 else n  # a camera sees a part, a tracker on vertices all
    seen, asked, ago = some(n_points), some(ASKED), np.maximum(frame - np.array((0, *PAST)), 0)
    seen = seen[carriers_first(points[frame, seen])]
    both, hands = points[frame, np.concatenate([seen, asked])], parts["grippers"][ago]
    knots, ahead = frame + np.array(KNOTS), frame + np.arange(1, KNOTS[-1] + 1)
    last = len(points) - 1
    scene = {
        "cloud": both[:n_points],
        "points": both[n_points:],
        "flow": flow(both, [cKDTree(points[then, some(n, thin)]) for then in ago[1:]], hands),
        "grippers": hands,
        "held": parts["held"][frame],
        "target": parts["target"],
        "floor": parts["floor"],
        "actions": parts["actions"][np.minimum(ahead, last)],
        "actions_held": parts["held"][np.minimum(ahead, last)],
        "future": points[np.minimum(knots, last)][:, np.concatenate([seen[:CARRIERS], asked])],
        "known": knots <= last,
    }
    return {name: torch.as_tensor(np.asarray(part)) for name, part in scene.items()}


def flow(points: NDArray[np.floating], past: Sequence[cKDTree], hands: NDArray[np.floating]) -> Array:
    """How points (n, 3) moved, more than the grippers (1 + 3, 2, 3) did, since each of 3 clouds before: (n, 3, 3), metres.

    Taken back with the grippers, a point has its nearest neighbour in the cloud of then; that is where it came from.
    """
    place, now = (torch.from_numpy(np.ascontiguousarray(part, np.float64)) for part in (points, hands))
    back = carried(place.expand(len(past), -1, -1), now[:1].expand(len(past), -1, -1), now[1:]).numpy()
    found = [then - cloud.data[cloud.query(then)[1]] for then, cloud in zip(back, past, strict=True)]
    return np.stack(found, axis=1).astype(np.float32)


def carriers_first(cloud: NDArray[np.floating]) -> NDArray[np.int64]:
    """(n,) the order of a cloud's points in which a farthest-point sample comes first: handles have few points, and matter."""
    few, _ = farthest_point_sample(cloud, min(CARRIERS, len(cloud)))
    return np.append(few, np.delete(np.arange(len(cloud)), few))


def target_of(line: NDArray[np.floating], n: int = TARGET) -> dict[str, Array]:
    """What is told of a target: `target` (n, 3), places along the last 0.9 m of its centre line, and `floor` (), where it stands.

    Corners of the line are among the places as near as may be. Of no target both are far below.
    """
    if not len(line):
        line = np.array([[0, 0, -1000.0]])
    length = np.append(0, np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum())
    at = np.linspace(max(length[-1] - 0.9, 0), length[-1], n)
    places = np.stack([np.interp(at, length, axis) for axis in line.T], axis=1)
    return {"target": places.astype(np.float32), "floor": np.asarray(line[:, 2].min(), np.float32)}
