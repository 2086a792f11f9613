"""Name the loops of a stranger's garment by their place and size on the mesh as it stands, z up.

A border low down and wide is a hem, and then the garment is a tube: a loop aside of it is for an arm, one on top for the neck.
A tube of two wide borders is a skirt, of a waist and a hem. Two low borders side by side, and one on top, are those of trousers.
A border that goes around another loop is the edge of the cloth. Of the rest, the loops of a flat cloth (an apron) are a neck
at the top, a waist or holes; those of a bag are handles at the top, or straps. What is none of these is a "loop": a small tab, a
ring, either end of a tube without a hem, a loop of two layers of which nobody knows whether they are an empty bag.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from topokit.linking import side_lengths

from ._surface import Array, Ids, border_cycles

_TOP = 0.12  # of the height: a strap is at most as wide
_TALL = 0.2  # of the height: a strap is taller
_HEAD = 0.2  # of the width or of the height: a neck is larger, a tab to hang by is not
_WHOLE = 0.9  # of the height: a loop that is taller is an end of a tube
_THIN = 0.05  # of the width: what is not as deep may be a cloth of two layers or an empty bag
_SLACK = np.array([0.05, 0.15, 0.05])  # by which a loop may stand out of the one around it
# Of the largest extent: a level border rises less, and two that are twice as far apart are those of a skirt.
_LEVEL = 0.07
_OUTSIDE = ("edge", "hem", "waist", "rim", "leg", "mesh")  # a garment is not hung by these


def kind(name: str) -> str:
    """Return a name without its number: "handle" for "handle 2"."""
    word, _, number = name.rpartition(" ")
    if word and number.isdigit():
        return word
    return name


def to_hang_by(names: Iterable[str]) -> list[str]:
    """Return the names of the loops by which one would hang a garment, the neck first."""
    return sorted((name for name in names if kind(name) not in _OUTSIDE), key=lambda name: kind(name) != "neck")


def numbered(kinds: Sequence[str]) -> tuple[str, ...]:
    """Return names that differ: several loops of a kind get a number each, from 1 on."""
    names = []
    for i, word in enumerate(kinds):
        if kinds.count(word) > 1:
            word = f"{word} {kinds[: i + 1].count(word)}"
        names.append(word)
    return tuple(names)


def named(vertices: Array, faces: Ids, loops: Sequence[Ids]) -> tuple[str, ...]:
    """Return a name for each loop, all different."""
    outlines = border_cycles(faces)
    boxes = [_box(vertices, loop) for loop in loops]
    borders = [_box(vertices, border) for border in outlines]
    flat = is_flat(vertices, faces)
    # An open front is an edge of the cloth.
    fronts = [is_open_front(vertices, faces, loop) for loop in loops]
    if any(fronts):
        others = [loop for loop, front in zip(loops, fronts, strict=True) if not front]
        rest = iter(numbered(_kinds_on_tube([_box(vertices, loop) for loop in others])))
        return numbered(["edge" if front else next(rest) for front in fronts])
    lower_body = None if flat else _kinds_of_skirt_or_trousers(boxes)
    if lower_body is not None:
        return numbered(lower_body)
    # A tube: hem, arms and neck.
    if not flat and any(_is_hem(box) for box in borders):
        return numbered(_kinds_on_tube(boxes))
    # A border that goes around a clearly shorter loop is the edge of the cloth, in a flat cloth around any shorter loop; so is
    # the only border of the only loop.
    longer = 1.05 if flat else 1.3
    lengths = [side_lengths(vertices[loop]).sum() for loop in loops]
    is_border = [any(set(loop.tolist()) == set(border.tolist()) for border in outlines) for loop in loops]
    is_edge = [len(borders) == len(boxes) == 1 and is_border[0]] * len(boxes)
    for (i, box), (j, other) in itertools.permutations(enumerate(boxes), 2):
        around = (box[0] < other[0] + _SLACK).all() and (box[1] > other[1] - _SLACK).all()
        is_edge[i] |= bool(is_border[i] and around and lengths[i] > longer * lengths[j])
    inner = [box for box, edge in zip(boxes, is_edge, strict=True) if not edge]
    # A mask: one loop is above, and the other is its mirror image.
    if flat and len(inner) == 2 and np.abs(inner[0] + inner[1][::-1] - [0, 0, 1])[:, [0, 2]].max() < 0.1:
        kinds = ["ear"] * len(boxes)
    else:
        tops = sum(box[1, 2] > 1 - _TOP for box in inner)
        kinds = [_kind(vertices, box, flat, tops) for box in boxes]
    return numbered(["edge" if edge else word for edge, word in zip(is_edge, kinds, strict=True)])


def _box(vertices: Array, loop: Ids) -> Array:
    """Return (2, 3) lowest and highest x, y and z of a loop: z from 0 to 1, x and y from the middle in shares of the width."""
    low = vertices.min(axis=0)
    size = np.ptp(vertices, axis=0)
    width = size[:2].max()
    unit = np.maximum([width, width, size[2]], 1e-12)
    places = (vertices[loop] - low - size / 2 * [1, 1, 0]) / unit
    return np.array([places.min(axis=0), places.max(axis=0)])


def _heights(vertices: Array) -> Array:
    """Return the heights (n,) of vertices, from 0 to 1."""
    low = vertices[:, 2].min()
    return (vertices[:, 2] - low) / max(np.ptp(vertices[:, 2]), 1e-12)


def _is_hem(box: Array) -> bool:
    """Return True for a border low down and wide."""
    return bool(box[1, 2] < 0.35 and np.ptp(box[:, :2], axis=0).max() > 0.3)


def is_open_front(vertices: Array, faces: Ids, border: Ids) -> bool:
    """Return True for a border that runs from the top to the bottom of a garment that is not flat, and is not plane itself."""
    height = _heights(vertices)[border]
    extents = np.linalg.svd(vertices[border] - vertices[border].mean(axis=0), compute_uv=False)
    plane = extents[2] < 0.12 * extents[0]
    return bool(height.min() < 0.1 and height.max() > 0.8 and not plane and not is_flat(vertices, faces))


def _kinds_of_skirt_or_trousers(boxes: Sequence[Array]) -> list[str] | None:
    """Return the kinds of the loops of a skirt or of trousers, or None for another garment."""
    low = [i for i, box in enumerate(boxes) if box[1, 2] < 0.35]
    high = [i for i, box in enumerate(boxes) if box[0, 2] > 0.65]
    if not high or len(low) + len(high) != len(boxes) or len(low) > 2:
        return None
    widths = [float(np.ptp(box[:, :2], axis=0).max()) for box in boxes]
    waist = max(high, key=lambda i: widths[i])
    sides = [float(boxes[i][:, 0].mean()) for i in low]
    if len(low) == 2 and min(sides) < -0.1 and max(sides) > 0.1:
        below = "leg"
    elif len(boxes) == 2 and len(low) == 1 and widths[waist] > 0.3 * widths[low[0]]:
        below = "hem"
    else:
        return None
    kinds = ["loop"] * len(boxes)
    kinds[waist] = "waist"
    for i in low:
        kinds[i] = below
    return kinds


def is_flat(vertices: Array, faces: Ids) -> bool:
    """Return True when most of the surface faces one way; the sides of a bag cancel.

    A wide skirt also faces one way, along its axis. But its two borders are level, and one is above the other.
    """
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normal = np.cross(b - a, c - a)
    total = normal.sum(axis=0)
    length = float(np.linalg.norm(total))
    if length <= 0.6 * np.linalg.norm(normal, axis=1).sum():
        return False
    height = vertices @ total / length
    size = np.ptp(vertices, axis=0).max()
    longest = sorted(border_cycles(faces), key=lambda border: -side_lengths(vertices[border]).sum())[:2]
    level = [np.ptp(height[border]) < _LEVEL * size for border in longest]
    apart = len(longest) == 2 and abs(height[longest[0]].mean() - height[longest[1]].mean()) > 2 * _LEVEL * size
    return not (apart and all(level))


def _kinds_on_tube(boxes: Sequence[Array]) -> list[str]:
    """Return the kinds of the loops of a tube: hem, or arm when it lies aside, or neck.

    Of three openings at the top of a narrow garment, those left and right are for the arms.
    """
    kinds = []
    for box in boxes:
        aside = np.linalg.norm(box[:, :2].mean(axis=0)) > 0.2
        kinds.append("hem" if _is_hem(box) else "arm" if aside else "neck")
    necks = sorted((i for i, word in enumerate(kinds) if word == "neck"), key=lambda i: boxes[i][:, 0].mean())
    if len(necks) > 1:
        words = ["arm", "neck", "arm"] if len(necks) == 3 else ["loop"] * len(necks)
        for i, word in zip(necks, words, strict=True):
            kinds[i] = word
    return kinds


def _width_below(vertices: Array, box: Array) -> float:
    """Return how wide the cloth is well below a loop, in the unit of its box: nothing below a ring, little below a noose."""
    if box[0, 2] < _TOP:
        return 0.0
    cloth = np.flatnonzero(_heights(vertices) < 0.8 * box[0, 2])
    return float(np.ptp(_box(vertices, cloth)[:, 0]))


def _kind(vertices: Array, box: Array, flat: bool, tops: int) -> str:
    """Return the kind of a loop of a garment that is no tube; `tops` is the number of loops that reach its top."""
    size = np.ptp(box, axis=0)
    at_top = box[1, 2] > 1 - _TOP
    if at_top and _width_below(vertices, box) < 0.5 * size[0]:
        return "loop"  # a ring or a noose
    if not flat:
        width, depth, _ = np.ptp(vertices, axis=0)
        if depth < _THIN * width or size[2] > _WHOLE:
            return "loop"
        if abs(box[:, 0].mean()) > 0.15 and size[2] > _TALL:
            return "strap"
        return "handle" if at_top else "loop"
    if at_top and tops == 1:
        return "neck" if size.max() > _HEAD else "loop"
    if at_top and size[2] > _TALL:
        return "strap"
    return "waist" if size[0] > 0.5 else "hole"
