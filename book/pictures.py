"""Draw the pictures of README, of *Usage*, of the first page and of the appendix on modules: python book/pictures.py"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

import topokit as tk
from topokit import view
from topokit.data import Dataset
from topokit.io import Episode, load_episode
from topokit.lemmas import match_diagrams
from topokit.sim import TASKS, WARDROBE, Hook

HERE = Path(__file__).parent
FRAMES = (0, 40, 62, 95)


def main() -> None:
    """Draw a matching, an apron in four frames and as a film, all tasks as a picture and as a film, and the wardrobe."""
    matching(HERE / "_static" / "matching.svg")
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


def matching(path: Path) -> None:
    """Draw a planar cloud before and after a motion, and an optimal matching of the two diagrams."""
    rng = np.random.default_rng(43)
    rings = []
    for points, x, y, radius in ((14, 0.0, 0.0, 1.9), (9, 3.2, -0.3, 1.0), (6, 2.6, 1.8, 0.6)):
        angle = 2 * np.pi * np.arange(points) / points
        rings.append(np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)]))
    before = np.concatenate(rings)
    before += rng.normal(0, 0.15, before.shape)
    after = before + rng.uniform(-0.22, 0.22, before.shape)
    first, second = tk.rips_persistence(before), tk.rips_persistence(after)
    found = match_diagrams(first, second)
    cost = found.cost

    figure = Figure(figsize=(8.4, 3.9), layout="tight")
    clouds, bars = figure.subplots(1, 2)
    clouds.plot(*np.stack([before, after]).transpose(2, 0, 1), color="0.6", lw=1)
    clouds.plot(*before.T, "o", mfc="white", mec="black", ms=6, label="before")
    clouds.plot(*after.T, "o", color="black", ms=5, label="after")
    clouds.set(aspect="equal", title="a cloud before and after a motion", xticks=[], yticks=[])
    clouds.legend(loc=(0.14, 0.4), frameon=False)

    low = 0.8 * min(first.birth.min(), second.birth.min())
    high = 1.08 * max(first.death.max(), second.death.max())
    bars.plot([low, high], [low, high], color="0.6", lw=1)
    colours = [view.loop_colour(k) for k in range(len(first))]
    for birth, death, partner, colour in zip(first.birth, first.death, found.partner, colours, strict=True):
        if partner >= 0:
            other = second.birth[partner], second.death[partner]
            square = Rectangle((birth - cost, death - cost), 2 * cost, 2 * cost, fc=colour, ec=colour, alpha=0.2)
            bars.add_patch(square)
            bars.plot(*other, "o", color=colour, ms=7)
        else:
            other = ((birth + death) / 2,) * 2
        bars.plot([birth, other[0]], [death, other[1]], color=colour, lw=1.5)
        bars.plot(birth, death, "o", mfc="white", mec=colour, mew=2, ms=7)
    for k in set(range(len(second))) - set(found.partner):
        middle = (second.birth[k] + second.death[k]) / 2
        bars.plot([second.birth[k], middle], [second.death[k], middle], color="0.4", lw=1.5)
        bars.plot(second.birth[k], second.death[k], "o", color="0.4", ms=7)
    bars.set(xlim=(low, high), ylim=(low, high), aspect="equal", xlabel="birth", ylabel="death")
    bars.set_title(f"optimal matching: c = {cost:.2f}")
    with rc_context({"svg.hashsalt": "matching"}):
        figure.savefig(path, metadata={"Date": None}, bbox_inches="tight")


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
