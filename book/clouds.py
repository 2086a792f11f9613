"""The page "Try your cloud": its samples from `data_small`, its directive, and the page as one file.

python book/clouds.py --out try_your_cloud.html
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from docutils import nodes
from docutils.parsers.rst import Directive

if TYPE_CHECKING:
    from topokit.view import HtmlFigure

ROOT = Path(__file__).resolve().parent.parent
# Name, episode and frame. The film is every second frame of the first episode.
CLOUDS = (
    ("an apron", "apron_hook_0.npz", 8),
    ("a tote bag", "dataset/00000002.npz", 8),
    ("a mask", "dataset/00000022.npz", 16),
)
FILM = "a film: an apron and its hook"
FILM_STEP = 2
FILM_POINTS = 240


def samples() -> dict[str, np.ndarray]:
    """Return the samples that are simulated cloth: clouds (n, 3), and a film (T, n, 3) of the same vertices throughout."""
    from topokit import farthest_point_sample
    from topokit.io import load_episode

    data = ROOT / "data_small"
    clouds: dict[str, np.ndarray] = {name: load_episode(data / file).points[frame] for name, file, frame in CLOUDS}
    film = load_episode(data / CLOUDS[0][1]).points[::FILM_STEP]
    clouds[FILM] = film[:, farthest_point_sample(film[0], FILM_POINTS)[0]]
    return clouds


def page() -> HtmlFigure:
    """Return the page as a figure."""
    from chapter_tools.figures import cloud

    return cloud(samples())


class Cloud(Directive):
    """Show the page that finds the loops of the reader's cloud."""

    def run(self) -> list[nodes.Node]:
        for _, file, _ in CLOUDS:
            self.state.document.settings.env.note_dependency(str(ROOT / "data_small" / file))
        return [nodes.raw("", f'<div class="topokit-cloud">{page()._repr_html_()}</div>', format="html")]


def setup(app: Any) -> dict[str, bool]:
    app.add_directive("cloud", Cloud)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    sys.path[:0] = [str(ROOT), str(ROOT / "notebooks")]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    page().save(parser.parse_args().out)
