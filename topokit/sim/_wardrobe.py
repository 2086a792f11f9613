"""The patterns of the garments: which pieces are cut, how they are placed in space and where they are sewn together.

Every function takes positive sizes in metres and returns the parts of a `Garment`: vertices, faces, loops and grips.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ._pattern import Arch, Panel, cut, inflate, sew
from ._surface import EdgeGraph, half_edges

__all__ = ["Parts", "apron", "backpack", "bag", "mask", "sheet", "shirt", "vest"]

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Sizes = Mapping[str, float]
Parts = tuple[Array, Ids, tuple[Ids, ...], Ids]
_THIRDS = np.array([1 / 3, 2 / 3])


def apron(s: Sizes, loops: int) -> Parts:
    """A bib and a skirt in one piece with the neck strap; with two loops also a strap behind the waist, sewn to the sides."""
    _demand(
        s, s["bib_width"] <= s["body_width"], f"bib_width {s['bib_width']} must not exceed body_width {s['body_width']}"
    )
    _demand(
        s,
        s["bib_width"] >= 2 * s["strap_width"] + 3 * s["spacing"],
        f"bib_width {s['bib_width']} leaves no opening between straps of strap_width {s['strap_width']}",
    )
    arch = Arch.of_length(s["bib_width"] - s["strap_width"], s["strap_length"])
    outer, inner, middle = arch.strap(s["strap_width"], s["spacing"], s["strap_length"])
    half_body, half_bib = s["body_width"] / 2, s["bib_width"] / 2
    waist, hem = -s["bib_height"], -s["bib_height"] - s["body_height"]
    # The armhole leaves the bib vertically and reaches the waist horizontally: a quarter of an ellipse.
    angle = np.pi / 2 * np.linspace(0, 1, 181)
    armhole = np.column_stack([half_body - (half_body - half_bib) * np.sin(angle), waist * np.cos(angle)])
    side = _polyline((half_body, hem), (half_body, waist))
    if loops == 2:
        _demand(
            s,
            s["waist_strap_width"] + s["spacing"] <= s["body_height"],
            f"waist_strap_width {s['waist_strap_width']} leaves nothing of body_height {s['body_height']} below it",
        )
        side = _polyline((half_body, hem), (half_body, waist - s["waist_strap_width"]), (half_body, waist))
    left = [_mirror(line) for line in [armhole, *side[::-1]]]
    outline = [*side, armhole, outer, *left, *_polyline((-half_body, hem), (half_body, hem))]
    front = cut(outline, [[inner, *_polyline(inner[-1], inner[0])]], s["spacing"], middle)
    grips = _nearest(front, arch.points(_THIRDS))
    if loops == 1:
        return front.vertices, front.faces, front.holes, grips
    length, around = (
        s["waist_strap_length"],
        Arch.of_length(s["body_width"], s["waist_strap_length"], "waist_strap_length"),
    )
    strap = _Band.cut([length], [s["waist_strap_width"]], s["spacing"])
    cloth = strap.panel.placed(lambda v: np.column_stack([around.points(v[:, 0] / length), waist + v[:, 2]]))
    ends = [(0, front.sides[1], 1, strap.start), (0, front.sides[5][::-1], 1, strap.end)]
    vertices, faces, (_, ids) = sew([front, cloth], ends)
    behind = ids[strap.high]  # from the right side to the left one
    across = EdgeGraph(vertices, half_edges(front.faces)).path(int(behind[-1]), int(behind[0]))
    return vertices, faces, (front.holes[0], np.concatenate([behind[:-1], across[:-1]])), grips


def bag(s: Sizes, handles: int) -> Parts:
    """Two panels joined at the sides and the bottom; one handle from side to side, or one on each panel."""
    half, low, length, width = s["width"] / 2, -s["height"], s["handle_length"], s["handle_width"]
    sides = _polyline((-half, 0), (-half, low), (half, low), (half, 0))
    if handles == 2:
        return _bag_of_two(s, sides)
    _demand(s, width <= s["width"] - 2 * s["spacing"], f"handle_width {width} must be less than the width {s['width']}")
    top = _polyline((half, 0), (half - width / 2, 0), (width / 2 - half, 0), (-half, 0))
    panel = cut([*sides, *top], [], s["spacing"])
    front = inflate(panel, (0, 1, 2), s["depth"] / 2)
    arch = Arch.of_length(s["width"], length, "handle_length")
    strap = _Band.cut([length], [width / 2, width / 2], s["spacing"])
    grips = _nearest(strap.panel, np.column_stack([length * _THIRDS, [-width / 2] * 2]))
    flat = strap.panel.vertices
    over = arch.points(flat[:, 0] / length)
    cloth = strap.panel.placed(lambda v: np.column_stack([over[:, 0], v[:, 2] + width / 2, over[:, 1]]))
    half_end = len(strap.start) // 2
    seams = [(0, panel.sides[i], 1, panel.sides[i]) for i in range(3)]
    seams += [(0, panel.sides[3][::-1], 2, strap.start[: half_end + 1]), (1, panel.sides[3], 2, strap.start[half_end:])]
    seams += [(0, panel.sides[5], 2, strap.end[: half_end + 1]), (1, panel.sides[5][::-1], 2, strap.end[half_end:])]
    vertices, faces, (a, _, c) = sew([front, front.mirrored(), cloth], seams)
    return vertices, faces, (_ring(c[strap.low], a[panel.sides[4]]),), c[grips]


def _bag_of_two(s: Sizes, sides: list[Array]) -> Parts:
    half, span, width = s["width"] / 2, s["handle_span"], s["handle_width"]
    _demand(
        s,
        2 * s["spacing"] <= span - width and span + width <= s["width"] - 2 * s["spacing"],
        f"handle_span {span} must leave an opening inside handles of handle_width {width} and fit the width {s['width']}",
    )
    arch = Arch.of_length(span, s["handle_length"], "handle_length")
    outer, inner, middle = arch.strap(width, s["spacing"], s["handle_length"])
    top = [*_polyline((half, 0), outer[0]), outer, *_polyline(outer[-1], (-half, 0))]
    panel = cut([*sides, *top], [[inner, *_polyline(inner[-1], inner[0])]], s["spacing"], middle)
    front = inflate(panel, (0, 1, 2), s["depth"] / 2, top=0.0)
    seams = [(0, panel.sides[i], 1, panel.sides[i]) for i in range(3)]
    vertices, faces, (a, b) = sew([front, front.mirrored()], seams)
    held = _nearest(panel, arch.points(np.array([0.42, 0.58])))  # one on each handle, so that both stay up
    return vertices, faces, (a[panel.holes[0]], b[panel.holes[0]]), np.array([a[held[0]], b[held[1]]])


def backpack(s: Sizes) -> Parts:
    """A back with a strap at each side, folded towards +y, and a box below it, open at its top."""
    half, low, width = s["width"] / 2, -s["height"], s["strap_width"]
    rim, depth, box = low + s["box_height"], s["depth"], s["box_height"]
    span = -rim - 2 * width
    _demand(
        s,
        span - width >= 2 * s["spacing"],
        f"height {s['height']} leaves no opening for straps of strap_width {width} above a box_height of {box}",
    )
    arch = Arch.of_length(span, s["strap_length"])
    turn = np.array([half, rim / 2])
    outer, inner, middle = (
        line[:, ::-1] * [1, -1] + turn for line in arch.strap(width, s["spacing"], s["strap_length"])
    )
    right = [*_polyline((half, low), (half, rim), outer[0]), outer, *_polyline(outer[-1], (half, 0))]
    top, bottom = _polyline((half, 0), (-half, 0)), _polyline((-half, low), (half, low))
    outline = [*right, *top, *(_mirror(line) for line in right[::-1]), *bottom]
    hole = [inner, *_polyline(inner[-1], inner[0])]
    back = cut(
        outline, [hole, [_mirror(line) for line in hole]], s["spacing"], np.concatenate([middle, _mirror(middle)])
    )
    held = arch.points(np.array([0.6]))[:, ::-1] * [1, -1] + turn
    grips = _nearest(back, np.concatenate([held * [-1, 1], held]))
    back = back.placed(lambda v: _folded(v, half, np.radians(s["strap_angle"])))
    edge = _chain(back.sides[0][::-1], back.sides[-1][::-1], back.sides[-2][::-1])
    gusset = _Band.cut([box, s["width"], box], [depth], s["spacing"])
    way = np.array([[half, rim], [half, low], [-half, low], [-half, rim]])
    at = np.cumsum([0, box, s["width"], box])
    sides = gusset.panel.placed(
        lambda v: np.column_stack([np.interp(v[:, 0], at, way[:, 0]), v[:, 2], np.interp(v[:, 0], at, way[:, 1])])
    )
    front = cut(_polyline((-half, rim), (-half, low), (half, low), (half, rim), (-half, rim)), [], s["spacing"])
    front_edge = _chain(*(front.sides[i] for i in range(3)))[::-1]
    front = inflate(front, (0, 1, 2), depth / 4).placed(lambda v: v - [0, depth, 0])
    seams = [(2, edge, 1, gusset.high), (0, front_edge, 1, gusset.low)]
    vertices, faces, (*_, a) = sew([front, sides, back], seams)
    return vertices, faces, (a[back.holes[1]], a[back.holes[0]]), a[grips]


def shirt(s: Sizes) -> Parts:
    """Front and back joined at the shoulders, along the sleeves and at the sides."""
    half, neck, angle = s["width"] / 2, s["neck_width"] / 2, np.radians(s["sleeve_angle"])
    along, across = np.array([np.cos(angle), -np.sin(angle)]), np.array([-np.sin(angle), -np.cos(angle)])
    _demand(s, neck + s["spacing"] <= half, f"neck_width {2 * neck} must be less than the width {2 * half}")
    top = np.array([neck, 0]) + ((half - neck) / along[0] + s["sleeve_length"]) * along
    low = top + s["sleeve_width"] * across
    underarm = low - (low[0] - half) / along[0] * along
    _demand(
        s,
        low[0] - half >= s["spacing"] and -s["length"] + s["spacing"] <= underarm[1],
        f"sleeve_length {s['sleeve_length']} is too short, or sleeve_width {s['sleeve_width']} too wide for the length "
        f"{s['length']}, at a sleeve_angle of {s['sleeve_angle']} degrees",
    )
    right = _polyline((half, -s["length"]), (half, underarm[1]), low, top, (neck, 0))
    return _tunic(s, right, (0, 1, 3), neck + 0.5 * (half - neck))


def vest(s: Sizes) -> Parts:
    """Front and back joined at the shoulders and the sides."""
    half, neck, shoulder = s["width"] / 2, s["neck_width"] / 2, s["shoulder_width"]
    tip = np.array([neck + shoulder, -0.25 * shoulder])
    _demand(
        s,
        tip[0] <= half,
        f"width {2 * half} is too narrow for two shoulders of shoulder_width {shoulder} beside the neck",
    )
    _demand(
        s,
        s["armhole_depth"] + s["spacing"] <= s["length"] and -s["armhole_depth"] < tip[1] - 2 * s["spacing"],
        f"armhole_depth {s['armhole_depth']} must be more than the shoulder's drop and less than the length {s['length']}",
    )
    bend = np.pi / 2 * np.linspace(0, 1, 181)
    hole = np.column_stack(
        [
            half - (half - tip[0]) * np.sin(bend),
            -s["armhole_depth"] + (tip[1] + s["armhole_depth"]) * (1 - np.cos(bend)),
        ]
    )
    side, shoulder_line = _polyline((half, -s["length"]), hole[0]), _polyline(tip, (neck, 0))
    return _tunic(s, [*side, hole, *shoulder_line], (0, 2), neck + shoulder / 2)


def _tunic(s: Sizes, right: list[Array], seams: Sequence[int], grip: float) -> Parts:
    """Front (towards -y) and back of the same right half, which runs from the hem to the neck, joined along its `seams`."""
    neck, hem, k = s["neck_width"] / 2, s["length"], len(right)
    angle = np.pi * np.linspace(0, 1, 181)
    panels = []
    for dip, sign in ((s["neck_depth"], 1), (s["neck_depth"] / 3, -1)):
        collar = np.column_stack([neck * np.cos(angle), -dip * np.sin(angle)])
        outline = [*right, collar, *(_mirror(line) for line in right[::-1])]
        half_width = right[0][0, 0]
        panel = cut([*outline, *_polyline((-half_width, -hem), (half_width, -hem))], [], s["spacing"])
        joined = [*seams, *(2 * k - i for i in seams)]
        panel = inflate(panel, joined, s["depth"] / 2)
        panels.append(panel if sign > 0 else panel.mirrored())
    front, back = panels
    vertices, faces, (a, b) = sew(panels, [(0, front.sides[i], 1, back.sides[i]) for i in joined])
    open_sides = [k, *(i for i in range(2 * k + 1) if i not in joined and i not in (k, 2 * k + 1)), 2 * k + 1]
    rims = tuple(_ring(a[front.sides[i]], b[back.sides[i]]) for i in open_sides)
    height = np.interp(grip, *right[-1][::-1].T)
    grips = a[_nearest(front, np.array([[-grip, height], [grip, height]]))]
    return vertices, faces, rims, grips


def mask(s: Sizes) -> Parts:
    """A cupped sheet with a strap above and one below it: a face mask hung by one of its ear loops."""
    half, low, width = s["width"] / 2, -s["height"], s["strap_width"]
    _demand(
        s,
        s["strap_span"] - width >= 2 * s["spacing"] and s["strap_span"] + width + s["spacing"] <= s["width"],
        f"strap_span {s['strap_span']} must leave an opening inside straps of strap_width {width} and fit the width {s['width']}",
    )
    arch = Arch.of_length(s["strap_span"], s["strap_length"])
    outer, inner, middle = arch.strap(width, s["spacing"], s["strap_length"])
    side = np.column_stack([half + s["bow"] * np.sin(np.pi * np.linspace(0, 1, 91)), np.linspace(low, 0, 91)])
    top = [side, *_polyline(side[-1], outer[0]), outer, *_polyline(outer[-1], (-half, 0))]
    hole = [inner, *_polyline(inner[-1], inner[0])]

    def turned(line: Array) -> Array:
        """Half a turn in the plane, which brings the upper half of the pattern to the lower one."""
        return np.array([0, low]) - line

    outline = [*top, *map(turned, top)]
    panel = cut(
        outline, [hole, [turned(line) for line in hole]], s["spacing"], np.concatenate([middle, turned(middle)])
    )
    grips = _nearest(panel, arch.points(_THIRDS))
    x, _, z = panel.vertices.T
    dome = np.clip(1 - (x / half) ** 2, 0, 1) * np.clip(1 - (2 * z / low - 1) ** 2, 0, 1)
    return panel.vertices - s["depth"] * dome[:, None] * [0, 1, 0], panel.faces, panel.holes, grips


def sheet(s: Sizes, holes: int) -> Parts:
    """A rectangle with round holes below the middle of its upper edge."""
    half, low, radius, drop = s["width"] / 2, -s["height"], s["hole_radius"], s["hole_drop"]
    places = [0.0] if holes == 1 else [-s["hole_distance"] / 2, s["hole_distance"] / 2]
    room = radius + s["spacing"]
    _demand(s, radius >= 1.2 * s["spacing"], f"hole_radius {radius} is too small for a spacing of {s['spacing']}")
    _demand(
        s, room <= drop <= s["height"] - room, f"hole_drop {drop} puts a hole of hole_radius {radius} over the border"
    )
    _demand(
        s, places[-1] + room <= half, f"width {s['width']} has no room for holes of hole_radius {radius} at {places}"
    )
    _demand(
        s, holes == 1 or places[-1] >= room, f"hole_distance {2 * places[-1]} makes holes of hole_radius {radius} meet"
    )
    angle = np.linspace(0, 2 * np.pi, 361)
    rings = [[np.column_stack([x + radius * np.cos(angle), -drop + radius * np.sin(angle)])] for x in places]
    panel = cut(_polyline((-half, low), (half, low), (half, 0), (-half, 0), (-half, low)), rings, s["spacing"])
    return panel.vertices, panel.faces, panel.holes, np.array([panel.sides[3][0], panel.sides[2][0]])


@dataclass(frozen=True)
class _Band:
    """A straight strip in x from 0 to its length and in z from minus its width to 0, and the ids along its borders."""

    panel: Panel
    low: Ids  # along z = -width, x growing
    high: Ids  # along z = 0, x growing
    start: Ids  # along x = 0, z growing
    end: Ids

    @classmethod
    def cut(cls, lengths: Sequence[float], widths: Sequence[float], spacing: float) -> _Band:
        """Cut a band whose borders have joints after these lengths and widths."""
        x, z = np.cumsum([0.0, *lengths]), np.cumsum([-sum(widths), *widths])
        z[-1] = 0.0
        corners = [(x0, z[0]) for x0 in x] + [(x[-1], z0) for z0 in z[1:]] + [(x0, 0) for x0 in x[-2::-1]]
        outline = _polyline(*corners, *((0, z0) for z0 in z[-2::-1]))
        panel = cut(outline, [], spacing)
        m, k = len(lengths), len(widths)
        low, end, high, start = (
            _chain(*panel.sides[a:b]) for a, b in ((0, m), (m, m + k), (m + k, 2 * m + k), (2 * m + k, None))
        )
        return cls(panel, low, high[::-1], start[::-1], end)


def _polyline(*corners: Sequence[float] | Array) -> list[Array]:
    """The straight lines between consecutive corners."""
    return [np.array([a, b], dtype=np.float64) for a, b in itertools.pairwise(corners)]


def _mirror(line: Array) -> Array:
    """The other side of x = 0, run through backwards."""
    return (line * [-1, 1])[::-1]


def _chain(*ids: Ids) -> Ids:
    """Ids along consecutive sides, each joint once."""
    return np.concatenate([ids[0], *(side[1:] for side in ids[1:])])


def _ring(one: Ids, other: Ids) -> Ids:
    """The cycle of two paths between the same ends."""
    return np.concatenate([one[:-1], other[:0:-1]])


def _nearest(panel: Panel, places: Array) -> Ids:
    """Vertices of a panel nearest to places in its pattern."""
    return np.asarray(cKDTree(panel.vertices[:, [0, 2]]).query(places)[1], dtype=np.int64)


def _folded(vertices: Array, half: float, angle: float) -> Array:
    """Turn what lies beyond x = +-half towards +y."""
    beyond = np.maximum(np.abs(vertices[:, 0]) - half, 0)
    x = np.sign(vertices[:, 0]) * (np.minimum(np.abs(vertices[:, 0]), half) + beyond * np.cos(angle))
    return np.column_stack([x, vertices[:, 1] + beyond * np.sin(angle), vertices[:, 2]])


def _demand(s: Sizes, holds: bool, otherwise: str) -> None:
    if not holds:
        raise ValueError(f"{otherwise} (metres, at a spacing of {s['spacing']})")
