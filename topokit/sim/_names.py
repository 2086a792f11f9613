"""What the loops of a stranger's garment are called, by their place and size on the mesh as it stands, z up.

A border low down and wide is a hem, and then the garment is a tube: what lies aside of it is for an arm, what is on top for the
neck. A border that goes around another loop is the edge of the cloth. Of the rest, those of a flat cloth (an apron) are a neck at
the top, a waist or holes; those of a bag are handles at the top, or straps.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from topokit.linking import side_lengths

from ._surface import Array, Ids, border_cycles

_TOP = 0.12  # of the height, as far below the highest vertex as a strap is wide at most
_SLACK = np.array([0.05, 0.15, 0.05])  # by which a loop may stand out of the one around it
_OUTSIDE = ("edge", "hem", "waist", "rim", "leg", "mesh")  # nobody hangs a garment by these


def kind(name: str) -> str:
    """What a name is without its number: that of "handle 2" is "handle"."""
    word, _, number = name.rpartition(" ")
    return word if word and number.isdigit() else name


def to_hang_by(names: Iterable[str]) -> list[str]:
    """Those of the names by which one would hang a garment, the neck first."""
    return sorted((name for name in names if kind(name) not in _OUTSIDE), key=lambda name: kind(name) != "neck")


def numbered(kinds: Sequence[str]) -> tuple[str, ...]:
    """Names that differ: of several loops of a kind each gets a number, from 1 on."""
    many = {one: kinds.count(one) > 1 for one in kinds}
    return tuple(f"{one} {kinds[: i + 1].count(one)}" if many[one] else one for i, one in enumerate(kinds))


def named(vertices: Array, faces: Ids, loops: Sequence[Ids]) -> tuple[str, ...]:
    """Names of the loops, each its own."""
    outlines = border_cycles(faces)
    boxes, borders = ([_box(vertices, cycle) for cycle in cycles] for cycles in (loops, outlines))
    outer = [any(set(loop.tolist()) == set(border.tolist()) for border in outlines) for loop in loops]
    flat = is_flat(vertices, faces)
    if not flat and any(_is_hem(box) for box in borders):
        others = ["arm" if np.linalg.norm(box[:, :2].mean(axis=0)) > 0.2 else "neck" for box in boxes]
        return numbered(["hem" if _is_hem(box) else other for box, other in zip(boxes, others, strict=True)])
    lengths = [side_lengths(vertices[loop]).sum() for loop in loops]
    edges = [len(borders) == len(boxes) == 1] * len(boxes)
    for (i, box), (j, other) in itertools.permutations(enumerate(boxes), 2):
        inside = (box[0] < other[0] + _SLACK).all() and (box[1] > other[1] - _SLACK).all()
        edges[i] |= bool(outer[i] and inside and lengths[i] > 1.3 * lengths[j])
    inner = [box for box, edge in zip(boxes, edges, strict=True) if not edge]
    if flat and len(inner) == 2 and np.abs(inner[0] + inner[1][::-1] - [0, 0, 1])[:, [0, 2]].max() < 0.1:
        kinds = ["ear"] * len(boxes)  # one is above, and the other is its mirror image
    else:
        tops = sum(box[1, 2] > 1 - _TOP for box in inner)
        kinds = [_kind(box, flat, tops) for box in boxes]
    return numbered(["edge" if edge else one for edge, one in zip(edges, kinds, strict=True)])


def _box(vertices: Array, loop: Ids) -> Array:
    """(2, 3) lowest and highest x, y and z of a loop: z from 0 to 1, x and y from the middle in shares of the width."""
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    unit = np.maximum([size[:2].max(), size[:2].max(), size[2]], 1e-12)
    places = (vertices[loop] - low - size / 2 * [1, 1, 0]) / unit
    return np.array([places.min(axis=0), places.max(axis=0)])


def _is_hem(box: Array) -> bool:
    return bool(box[1, 2] < 0.35 and np.ptp(box[:, :2], axis=0).max() > 0.3)


def is_flat(vertices: Array, faces: Ids) -> bool:
    """Whether most of the surface faces one way; the sides of a bag cancel."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normal = np.cross(b - a, c - a)
    return bool(np.linalg.norm(normal.sum(axis=0)) > 0.6 * np.linalg.norm(normal, axis=1).sum())


def _kind(box: Array, flat: bool, tops: int) -> str:
    if not flat:
        return "strap" if abs(box[:, 0].mean()) > 0.15 else "handle"
    if box[1, 2] > 1 - _TOP:
        return "neck" if tops == 1 else "strap"
    return "waist" if np.ptp(box[:, 0]) > 0.5 else "hole"
