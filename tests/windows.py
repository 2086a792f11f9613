"""Synthetic training windows: a ring of points that hangs between two grippers, goes with them, and stays when they let go."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from topokit.models._scenes import scene_at, target_of

HISTORY, HORIZON, POINTS, SLOTS = 16, 60, 24, 4


class Items(Dataset[dict[str, Tensor]]):
    """Items in memory."""

    def __init__(self, items: list[dict[str, Tensor]]) -> None:
        self.items = items

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, i: int) -> dict[str, Tensor]:
        return self.items[i]


def ring_windows(n: int, seed: int = 0) -> Items:
    """`n` windows with the fields of `topokit.data.WindowDataset`; slot 0 holds the ring, slot 1 a ghost at times."""
    rng = np.random.default_rng(seed)
    return Items([window(rng, i) for i in range(n)])


def ring_scenes(n: int, seed: int = 0) -> Items:
    """`n` scenes of `topokit.models.Scenes`: a ring between two grippers that swings behind them, about a pin that stands."""
    rng = np.random.default_rng(seed)
    return Items([scene_at(film(rng), int(rng.integers(12, 30)), rng) for _ in range(n)])


def film(rng: np.random.Generator, frames: int = 80) -> dict[str, np.ndarray]:
    """What `scene_at` cuts scenes from: each point follows the grippers, the later the farther below them it is."""
    time, angle = np.arange(frames), rng.uniform(0, 2 * np.pi, 360)  # as many as are looked at: none stands twice
    way = rng.normal(0, 0.3, 3) * np.array([1, 1, 0.2])
    middle = way * (1 - np.cos(time / 20))[:, None] / 2 + [0, 0, 1]
    grippers = middle[:, None] + 0.1 * np.array([[-1, 0, 0], [1, 0, 0]])
    ring = 0.1 * np.stack([np.cos(angle), rng.normal(0, 0.1, 360), np.sin(angle) - 1.2], axis=1)
    late = np.clip(time[:, None] - np.round(-60 * ring[:, 2]).astype(int), 0, None)  # (frames, 360)
    parts = {"points": middle[late] + ring, "grippers": grippers, "actions": grippers}
    return {name: part.astype(np.float32) for name, part in parts.items()} | {
        "held": np.ones(frames, bool),
        **target_of(np.array([[0.3, 0.2, 0], [0.3, 0.2, 1]])),
    }


def window(rng: np.random.Generator, index: int) -> dict[str, Tensor]:
    """One window."""
    frames = HISTORY + HORIZON
    time = np.arange(frames) - HISTORY + 1
    radius, release = rng.uniform(0.08, 0.12), rng.integers(20, 200)
    middle = rng.uniform(-0.1, 0.1, 3) + [0, 0, 1] + np.outer(time, rng.normal(0, 0.004, 3))
    apart = np.array([0.12, 0, 0])
    grippers = np.stack([middle - apart, middle + apart], axis=1)
    held = time <= release
    rests = middle[min(release + HISTORY - 1, frames - 1)]
    centre = np.where(held[:, None], middle, rests) - [0, 0, 0.15]
    angle = np.linspace(0, 2 * np.pi, POINTS, endpoint=False)
    ring = radius * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    clouds = centre[:, None] + ring + rng.normal(0, 0.002, (frames, POINTS, 3))
    clouds = np.take_along_axis(
        clouds, rng.permuted(np.tile(np.arange(POINTS), (frames, 1)), axis=1)[..., None], axis=1
    )

    turn = rng.uniform(0, 2 * np.pi) + np.array([0, 2, 4, 1, 3, 5]) * np.pi / 3  # x, y, z1, the apexes between
    corner = radius * np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    x, y, z1, _, b, c = corner
    z2 = (x + y) / 2 - [0, 0.01, 0]
    one = np.array([[x, y, z1], [x, y, z2], [z1, y, b], [x, z1, c], [x, y, z1], [x, y, z1]])
    triangles = np.zeros((frames, SLOTS, 6, 3, 3))
    triangles[:, 0] = one + centre[:, None, None]
    values = np.zeros((frames, SLOTS, 6))
    values[:, 0, :4] = 0.866 * radius * np.array([1, 1, 0.6, 0.5])
    labels = {
        "birth": np.zeros((frames, SLOTS)),
        "death": np.zeros((frames, SLOTS)),
        "killer_shift": np.zeros((frames, SLOTS)),
        "present": np.zeros((frames, SLOTS), bool),
    }
    labels["birth"][:, 0], labels["death"][:, 0], labels["killer_shift"][:, 0] = 0.02, 0.866 * radius, 0.004
    labels["present"][:, 0] = True
    if index % 2:  # a ghost of short life that goes away
        ghost = time < 10
        triangles[ghost, 1] = 0.3 * one + centre[ghost, None, None] + [0, 0, -0.2]
        values[ghost, 1, :2], labels["death"][ghost, 1], labels["birth"][ghost, 1] = 0.03, 0.03, 0.02
        labels["present"][ghost, 1] = True
    labels |= {"triangles": triangles, "values": values}
    past, future = slice(0, HISTORY), slice(HISTORY, frames)
    item = {"clouds": clouds[past], "grippers": grippers[past], "held": held[past]}
    item |= {"actions": grippers[future], "actions_held": held[future]}
    item |= {name: part[future] for name, part in labels.items()}
    item |= {f"past_{name}": part[past] for name, part in labels.items()}
    tensors = {
        name: torch.as_tensor(part, dtype=None if part.dtype == bool else torch.float32) for name, part in item.items()
    }
    return tensors | {
        name: torch.tensor(number) for name, number in (("episode", index), ("frame", 15), ("garment", 0))
    }
