"""Draw the pictures of the README: python book/pictures.py"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import topokit as tk
from topokit import view
from topokit.io import load_episode
from topokit.sim import WARDROBE, Hook

HERE = Path(__file__).parent
FRAMES = (0, 40, 62, 95)


def main() -> None:
    """An apron in four frames, the same as a film, and the wardrobe."""
    episode = load_episode(HERE.parent / "data_small" / "apron_hook_0.npz")
    states = tk.track(episode.points, times=episode.times)
    rods = Hook().rods
    pictures = [
        view.render_cloth(
            episode.points[frame],
            episode.faces,
            loops=states[frame].loops,
            true_loops=episode.loops,
            rods=rods[1:],  # the pole's foot is far below
            size=(420, 620),
            zoom=0.9,
            focus=episode.points[frame].mean(axis=0) + [0, 0.06, 0.08],
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
        progress=True,
    )
    garments = [make() for make in WARDROBE.values()]
    rows = [
        np.asarray(
            _side_by_side(
                [
                    view.render_cloth(
                        g.vertices, g.faces, true_loops=g.loops, size=(300, 340), view=(-65, 18), zoom=0.9
                    )
                    for g in row
                ]
            )
        )
        for row in (garments[:5], garments[5:])
    ]
    Image.fromarray(np.concatenate(rows)).quantize(255).save(HERE / "_static" / "wardrobe.png", optimize=True)


def _side_by_side(pictures: list[Image.Image]) -> Image.Image:
    return Image.fromarray(np.concatenate([np.asarray(picture.convert("RGB")) for picture in pictures], axis=1))


if __name__ == "__main__":
    main()
