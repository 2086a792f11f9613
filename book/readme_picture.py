"""Draw the picture at the head of the README: python book/readme_picture.py"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import topokit as tk
from topokit import view
from topokit.io import load_episode

HERE = Path(__file__).parent
FRAMES = (0, 40, 62, 95)


def main() -> None:
    """Four frames of the first recorded episode side by side, with the tracked loop."""
    episode = load_episode(HERE.parent / "data_small" / "apron_hook_0.npz")
    states = tk.track(episode.points, times=episode.times)
    pictures = [
        view.render_cloth(
            episode.points[frame],
            episode.faces,
            loops=states[frame].loops,
            true_loops=episode.loops,
            centre_line=episode.centre_line,
            thickness=episode.physics["target"]["radius"],
            size=(420, 620),
            zoom=0.95,
            focus=episode.points[frame].mean(axis=0) + [0, 0.1, 0.12],
        )
        for frame in FRAMES
    ]
    row = np.concatenate([np.asarray(picture.convert("RGB")) for picture in pictures], axis=1)
    Image.fromarray(row).save(HERE / "_static" / "apron.png", optimize=True)


if __name__ == "__main__":
    main()
