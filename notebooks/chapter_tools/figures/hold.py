"""A live figure of an apron that the reader holds: simulated, tracked and linked with the hook in the browser."""

from __future__ import annotations

import numpy as np

from topokit.io import Episode
from topokit.linking import close_far
from topokit.sim import WARDROBE, Hook
from topokit.view import HtmlFigure

from .garments import CLOTH_SCRIPTS
from .pages import HERE

SCRIPTS = (
    "sampling.js",
    "rips.js",
    "assign.js",
    "seqph.js",
    "worker.js",
    "live.js",
    *CLOTH_SCRIPTS,
    "link.js",
    "planar.js",
    "out.js",
    "cloth.js",
)
PIECES = 24  # of each rod: each is drawn before or behind the cloth


def hold(episode: Episode) -> HtmlFigure:
    """Return an interactive figure in which the reader carries an apron with two hands and hangs it on a hook.

    The loops of a sample of its vertices are found and followed while it moves. A ready script repeats the grippers' moves of the
    episode; the figure then says how far the neck is from where it was in the episode.

    Parameters
    ----------
    episode : Episode
        An apron of `topokit.sim.WARDROBE` with default sizes and the default `topokit.sim.Hook`.
    """
    apron = WARDROBE["apron"]()
    if not np.array_equal(apron.faces, episode.faces):
        raise ValueError(f"the figure shows the apron of the wardrobe, and the episode has another {episode.garment}")
    rods = Hook().rods
    share = np.linspace(0, 1, PIECES + 1)[:, None]
    pieces = []
    for start, end, _ in rods:
        places = start + share * (end - start)
        pieces += np.stack([places[:-1], places[1:]], axis=1).round(4).tolist()
    start = episode.points[:1].astype(np.float64)
    look = HtmlFigure.cloth(start, episode.faces)
    data = {
        "cloth": {key: look[key] for key in ("centre", "radius", "marks")} | {"centre": [0.0, 0.0, 0.75]},
        "arrays": {
            "rest": apron.vertices,
            "faces": apron.faces,
            "began": start[0],
            "actions": episode.grippers,
            "neckThen": episode.points[:, episode.loops[0]].mean(axis=1),
        },
        "held": episode.held.astype(int).tolist(),
        "grips": apron.grips.tolist(),
        "neck": apron.loops[0].tolist(),
        "rods": [[begin.tolist(), end.tolist(), radius] for begin, end, radius in rods],
        "pieces": pieces,
        "line": close_far(episode.centre_line).tolist(),
        "box": [[-0.3, -0.3, 0.2], [0.3, 0.35, 1.52], [0.3, -0.3, 0.8], [-0.3, 0.35, 0.8]],
        "reach": [[-0.6, 0.6], [-0.7, 0.6], [0.05, 1.55]],
        "view": [-32.0, 12.0],
    }
    return HtmlFigure.from_parts(
        "hold",
        data,
        scripts=SCRIPTS,
        folder=HERE,
        height=620,
        caption="drag the upper dot: it moves both hands",
        title="An apron to hang on a hook",
    )
