"""The vertices that are marked as the main loops of a garment, whose convex hull is a loop's true area.

Rule. A loop is the band of cloth around an opening. Marked are the vertices of the opening's edge and those of the strap that
closes it, up to its other border. Where the strap ends, the band goes straight on over the cloth that the strap is joined to, as
wide as the strap. An opening without a strap (a hole in a sheet, the neck of a shirt) has its edge alone.

Reason. The paper marks "a subset of mesh vertices of the main loops", and their hulls are "the main area of the loops": vertices
of the loops, and not of one curve around them. The paper has no picture of them. But three of its authors published meshes with
marked vertices in the same year (DEDO, `deform_true_loop_vertices` in task_info.py), and those follow this rule. On the apron and
the backpack both borders of each strap are marked, and on the cloth where it closes a strip as wide as the strap; on the T-shirt
the border of the neck, with a few vertices beside it. The curves that garments carry as true loops are one border of such a band.
That of a waist also leaves the waist: on the front it follows edges of the mesh over the bib, 7 cm above the strap's ends.

The rule was written before any share was computed under it. Before that, pictures of 13 films were looked at, with seqPH's loops.

Source: Antonova et al. 2021, section 6.
"""

from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topokit.io import Episode
from topokit.sim import WARDROBE, Garment
from topokit.sim._surface import border_cycles

Ids = NDArray[np.int64]

# The size of a garment that is the width of the strap around each of its openings, in the order of its loops.
STRAPS = {
    "apron": ("strap_width",),
    "apron2": ("strap_width", "waist_strap_width"),
    "backpack": ("strap_width", "strap_width"),
    "belt": ("loop_width",),
    "mask": ("strap_width", "strap_width"),
    "net": ("handle_width",),
    "scarf": ("width",),
    "tote": ("handle_width",),
    "tote2": ("handle_width", "handle_width"),
}
REACH = 1.12  # widths of a strap: borders are polygons, so the far border is up to a tenth farther than the width


def marked_vertices(episode: Episode) -> tuple[Ids, ...]:
    """Return for each true loop of an episode the ids of the vertices that are marked."""
    loops = tuple(np.asarray(loop) for loop in episode.loops)
    straps = STRAPS.get(episode.garment, ())
    if not straps:
        return loops
    sizes = dict(episode.physics["garment"])
    sizes.pop("scale", None)
    garment = WARDROBE[episode.garment](**sizes)
    if not np.array_equal(garment.faces, episode.faces):
        raise ValueError(f"{episode.garment}: its faces are not those of this version's wardrobe; make its films anew")
    pairs = zip_longest(loops, straps)
    return tuple(band(garment, loop, sizes[strap]) if strap else loop for loop, strap in pairs)


def band(garment: Garment, loop: Ids, width: float) -> Ids:
    """Return the ids of the vertices of a band of cloth, `width` metres wide in the rest pose. One of its borders is the loop.

    A loop that is no border of the mesh runs along one border of its strap and then across cloth. In place of the second part a
    straight line is taken, with the band on that side of it on which the strap is.
    """
    vertices = garment.vertices
    borders = border_cycles(garment.faces)
    own = max(borders, key=lambda border: np.isin(loop, border).sum())
    is_border = bool(np.isin(loop, own).all())
    edge = loop
    if not is_border:
        others = np.concatenate([border for border in borders if border is not own])
        edge = loop[cKDTree(vertices[others]).query(vertices[loop])[0] <= REACH * width]
    curve = vertices[edge]
    inside = distances_to_curve(vertices, curve) <= REACH * width
    if not is_border:
        normal = np.linalg.svd(curve - curve.mean(axis=0))[2][-1]
        heights = (vertices - curve.mean(axis=0)) @ normal
        inside &= heights * np.sign(heights[inside].sum()) > -0.1 * width
    inside[edge] = True
    return np.flatnonzero(inside)


def distances_to_curve(points: NDArray[np.float64], curve: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances (N,) of points (N, 3) from a closed polygon (L, 3)."""
    sides = np.roll(curve, -1, axis=0) - curve
    offsets = points[:, None] - curve
    along = np.clip((offsets * sides).sum(axis=2) / (sides**2).sum(axis=1), 0, 1)
    return np.asarray(np.linalg.norm(offsets - along[..., None] * sides, axis=2).min(axis=1))
