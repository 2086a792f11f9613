"""Draw the pictures of README, of *Usage* and of the first page: python book/pictures.py"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import topokit as tk
from topokit import view
from topokit.data import Dataset
from topokit.io import Episode, load_episode
from topokit.sim import TASKS, WARDROBE, Hook

HERE = Path(__file__).parent
FRAMES = (0, 40, 62, 95)


def main() -> None:
    """Draw an apron in four frames and as a film, all tasks as a picture and as a film, and the wardrobe."""
    every_task(HERE.parent / "data_small" / "dataset")
    episode = load_episode(HERE.parent / "data_small" / "apron_hook_0.npz")
    states = tk.track(episode.points, times=episode.times)
    hook = {"centre_line": Hook().centre_line[1:], "thickness": Hook().rods[0][2]}  # the pole's foot is far below
    pictures = []
    for frame in FRAMES:
        focus = episode.points[frame].mean(axis=0) + [0, 0.06, -0.02]
        pictures.append(_tracked(episode, states, frame, **hook, size=(420, 620), zoom=0.8, focus=focus))
    _side_by_side(pictures).save(HERE / "_static" / "apron.png", optimize=True)
    focus = episode.points.reshape(-1, 3).mean(axis=0) + [0, 0.05, 0.05]
    film = [
        _tracked(episode, states, frame, **hook, size=(320, 400), focus=focus).quantize(160, Image.Quantize.FASTOCTREE)
        for frame in range(0, len(episode), 3)
    ]
    pause = round(3000 * episode.dt)
    film[0].save(
        HERE / "_static" / "apron.gif", save_all=True, append_images=film[1:], duration=pause, loop=0, optimize=True
    )
    garments = [make() for make in WARDROBE.values()]
    look = {"size": (300, 340), "view": (-65, 18), "zoom": 0.9}
    drawn = [_drawn(g.vertices, g.faces, rest=g.vertices, true_loops=g.loops, **look) for g in garments]
    _grid(drawn, 7).quantize(255).save(HERE / "_static" / "wardrobe.png", optimize=True)


def every_task(folder: Path, moments: int = 20) -> None:
    """Draw the film of all tasks with the tracked loops, and its last frame as a picture."""
    dataset = Dataset(folder)
    first = {record.task: record.episode for record in reversed(dataset.records) if record.status == "ok"}
    numbers = {task: first[task] for task in TASKS if task in first}
    columns = []
    for task in numbers:
        episode = dataset[numbers[task]]
        x, y, z = TASKS[task].target.seat
        states = dataset.states(numbers[task], "full")
        frames = np.linspace(10, len(episode) - 1, moments).astype(int)
        look = {"size": (200, 250), "zoom": 0.75, "focus": [x, y - 0.2, z - 0.25]}
        rod = {"centre_line": episode.centre_line, "thickness": TASKS[task].target.rods[0][2]}
        columns.append([_tracked(episode, states, frame, **rod, **look) for frame in frames])
        print(f"\rdrawing: task {len(columns)} of {len(numbers)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    films = [_grid([column[k] for column in columns]) for k in range(moments)]
    films[-1].quantize(255).save(HERE / "_static" / "tasks.png", optimize=True)
    small = [film.resize((film.width // 2, film.height // 2)).quantize(64) for film in films]
    pauses = [180] * (moments - 1) + [1500]
    small[0].save(
        HERE / "_static" / "tasks.gif", save_all=True, append_images=small[1:], duration=pauses, loop=0, optimize=True
    )


def _tracked(episode: Episode, states: Sequence[tk.TopologicalState], frame: int, **look: Any) -> Image.Image:
    """Return a picture of a frame of an episode with its tracked and its true loops."""
    cloth = {"rest": episode.points[0], "loops": states[frame].loops, "true_loops": episode.loops}
    return _drawn(episode.points[frame], episode.faces, **cloth, **look)


def _drawn(points: np.ndarray, faces: np.ndarray, *, size: tuple[int, int], **look: Any) -> Image.Image:
    """Return a picture of a cloth of so many pixels."""
    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    # Matplotlib draws in a square, so the axes are a square around the picture.
    width, height = (max(size) / side for side in size)
    axes = figure.add_axes(((1 - width) / 2, (1 - height) / 2, width, height), projection="3d")
    view.plot_cloth(points, faces, ax=axes, **look)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _grid(pictures: list[Image.Image], columns: int = 7) -> Image.Image:
    blank = Image.new("RGB", pictures[0].size, "white")
    pictures = [*pictures, *[blank] * (-len(pictures) % columns)]
    rows = [_side_by_side(pictures[i : i + columns]) for i in range(0, len(pictures), columns)]
    return Image.fromarray(np.concatenate([np.asarray(row) for row in rows]))


def _side_by_side(pictures: list[Image.Image]) -> Image.Image:
    return Image.fromarray(np.concatenate([np.asarray(picture.convert("RGB")) for picture in pictures], axis=1))


if __name__ == "__main__":
    main()
