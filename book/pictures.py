"""Draw the pictures of README, of *Usage* and of the first page: python book/pictures.py"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import topokit as tk
from topokit import view
from topokit.data import Dataset
from topokit.io import load_episode
from topokit.sim import TASKS, WARDROBE, Hook

HERE = Path(__file__).parent
FRAMES = (0, 40, 62, 95)


def main() -> None:
    """Draw an apron in four frames and as a film, all tasks as a picture and as a film, and the wardrobe."""
    every_task(HERE.parent / "data_small" / "dataset")
    episode = load_episode(HERE.parent / "data_small" / "apron_hook_0.npz")
    states = tk.track(episode.points, times=episode.times)
    rods = Hook().rods
    pictures = [
        view.render_cloth(
            episode.points[frame],
            episode.faces,
            rest=episode.points[0],
            loops=states[frame].loops,
            true_loops=episode.loops,
            rods=rods[1:],  # the pole's foot is far below
            size=(420, 620),
            zoom=0.8,
            focus=episode.points[frame].mean(axis=0) + [0, 0.06, -0.02],
        )
        for frame in FRAMES
    ]
    _side_by_side(pictures).save(HERE / "_static" / "apron.png", optimize=True)
    view.save_animation(
        HERE / "_static" / "apron.gif",
        episode,
        states,
        rods=rods[1:],
        every=3,
        size=(320, 400),
        focus=episode.points.reshape(-1, 3).mean(axis=0) + [0, 0.05, 0.05],
    )
    garments = [make() for make in WARDROBE.values()]
    look = {"size": (300, 340), "view": (-65, 18), "zoom": 0.9}
    drawn = [view.render_cloth(g.vertices, g.faces, rest=g.vertices, true_loops=g.loops, **look) for g in garments]
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
        rods = [rod for rod in TASKS[task].target.rods if min(rod[0][2], rod[1][2]) > 0]  # without feet on the floor
        columns.append(
            [
                view.render_cloth(
                    episode.points[frame],
                    episode.faces,
                    rest=episode.points[0],
                    loops=states[frame].loops,
                    true_loops=episode.loops,
                    rods=rods,
                    size=(200, 250),
                    zoom=0.75,
                    focus=[x, y - 0.2, z - 0.25],
                )
                for frame in frames
            ]
        )
        print(f"\rdrawing: task {len(columns)} of {len(numbers)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    films = [_grid([column[k] for column in columns]) for k in range(moments)]
    films[-1].quantize(255).save(HERE / "_static" / "tasks.png", optimize=True)
    small = [film.resize((film.width // 2, film.height // 2)).quantize(64) for film in films]
    pauses = [180] * (moments - 1) + [1500]
    small[0].save(
        HERE / "_static" / "tasks.gif", save_all=True, append_images=small[1:], duration=pauses, loop=0, optimize=True
    )


def _grid(pictures: list[Image.Image], columns: int = 7) -> Image.Image:
    blank = Image.new("RGB", pictures[0].size, "white")
    pictures = [*pictures, *[blank] * (-len(pictures) % columns)]
    rows = [_side_by_side(pictures[i : i + columns]) for i in range(0, len(pictures), columns)]
    return Image.fromarray(np.concatenate([np.asarray(row) for row in rows]))


def _side_by_side(pictures: list[Image.Image]) -> Image.Image:
    return Image.fromarray(np.concatenate([np.asarray(picture.convert("RGB")) for picture in pictures], axis=1))


if __name__ == "__main__":
    main()
