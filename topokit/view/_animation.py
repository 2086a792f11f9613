"""Films of recorded episodes as files: GIF, for a README or a slide."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._archive import atomic_file
from topokit._validate import positive
from topokit.io import Episode
from topokit.state import TopologicalState
from topokit.view._render import render_cloth

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["save_animation"]


def save_animation(
    path: str | Path,
    episode: Episode,
    states: Sequence[TopologicalState] = (),
    *,
    rods: Iterable[tuple[ArrayLike, ArrayLike, float]] = (),
    every: int = 2,
    speed: float = 1.0,
    size: tuple[int, int] = (420, 520),
    progress: bool = False,
    **look: Any,
) -> Path:
    """Render an episode and write it as an animated GIF, in one piece.

    Parameters
    ----------
    path : str or Path
        Ends in .gif.
    episode : Episode
    states : sequence of TopologicalState, optional
        One a frame, as `topokit.track` gives: their killer triangles are drawn.
    rods : iterable of (start, end, radius)
        The target's capsules (`Target.rods`); its centre line is drawn when there are none.
    every : int
        Every how many frames one is drawn.
    speed : float
        Seconds of the episode in a second of the film.
    size : (2,) int
        Width and height in pixels.
    progress : bool
        Count the pictures on stderr.
    **look
        Other options of `render_cloth`: view, zoom, focus.

    Returns
    -------
    Path

    Raises
    ------
    ValueError
        When `path` does not end in .gif, `every` is not a positive whole number, or the states are not one a frame.
    """
    from PIL.Image import Quantize

    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise ValueError(f"{path}: an animation ends in .gif")
    if every != int(every) or every < 1:
        raise ValueError(f"every must be a whole number of frames, 1 or more, not {every}")
    if states and len(states) != len(episode):
        raise ValueError(f"there are {len(states)} states for {len(episode)} frames")
    positive(speed, "speed", zero=False)
    frames, rods = range(0, len(episode), int(every)), list(rods)
    if "focus" not in look:  # a camera that stands still
        corners = np.concatenate([episode.points.reshape(-1, 3), episode.centre_line])
        look["focus"] = (corners.min(axis=0) + corners.max(axis=0)) / 2
    pictures: list[Image] = []
    for number, frame in enumerate(frames):
        picture = render_cloth(
            episode.points[frame],
            episode.faces,
            loops=states[frame].loops if states else (),
            true_loops=episode.loops,
            centre_line=episode.centre_line,
            rods=rods,
            size=size,
            **look,
        )
        pictures.append(picture.quantize(160, Quantize.FASTOCTREE))  # a median cut loses small patches of colour
        if progress:
            end = "\n" if number + 1 == len(frames) else ""
            print(f"\rdrawing: picture {number + 1} of {len(frames)}", end=end, file=sys.stderr, flush=True)
    pause = max(20, round(1000 * episode.dt * every / speed))  # milliseconds; browsers slow down what is faster
    with atomic_file(path) as file:
        pictures[0].save(
            file, format="GIF", save_all=True, append_images=pictures[1:], duration=pause, loop=0, optimize=True
        )
    return path
