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
from topokit.view._scene import one_a_frame

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
    **scene: Any,
) -> Path:
    """Render an episode and write it as an animated GIF, in one piece.

    Parameters
    ----------
    path : str or Path
        Ends in .gif.
    episode : Episode
        Its cloth and its target are drawn.
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
    **scene
        The view, zoom and focus of `Scene`.

    Raises
    ------
    ValueError
        When `path` does not end in .gif, `every` is not a positive whole number, or the states are not one a frame.
    """
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise ValueError(f"{path}: an animation ends in .gif")
    if every != int(every) or every < 1:
        raise ValueError(f"every must be a whole number of frames, 1 or more, not {every}")
    positive(speed, "speed", zero=False)
    if states:
        one_a_frame(episode, states)
    if "focus" not in scene:  # a camera that stands still
        corners = np.concatenate([episode.points.reshape(-1, 3), episode.centre_line])
        scene["focus"] = (corners.min(axis=0) + corners.max(axis=0)) / 2
    scene |= {"true_loops": episode.loops, "centre_line": episode.centre_line, "rods": list(rods)}
    frames = range(0, len(episode), int(every))
    pictures: list[Image] = []
    for number, frame in enumerate(frames, 1):
        loops = states[frame].loops if states else ()
        picture = render_cloth(episode.points[frame], episode.faces, size=size, loops=loops, **scene)
        pictures.append(_quantized(picture))
        if progress:
            end = "\n" if number == len(frames) else ""
            print(f"\rdrawing: picture {number} of {len(frames)}", end=end, file=sys.stderr, flush=True)
    pause = max(20, round(1000 * episode.dt * every / speed))  # milliseconds; browsers slow down what is faster
    options: dict[str, Any] = {"save_all": True, "duration": pause, "loop": 0, "optimize": True}
    with atomic_file(path) as file:
        pictures[0].save(file, format="GIF", append_images=pictures[1:], **options)
    return path


def _quantized(picture: Image) -> Image:
    from PIL.Image import Quantize

    return picture.quantize(160, Quantize.FASTOCTREE)  # a median cut loses small patches of colour
