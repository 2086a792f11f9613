"""The patterns of bags: which pieces are cut, how they are placed in space and sewn together."""

from __future__ import annotations

import numpy as np

from ._pattern import Arch, Band, chain, cut, inflate, mirror, polyline, ring, sew
from ._surface import Array
from ._wardrobe import THIRDS, Fields, check_sizes, demand, numbered


def tote(
    *,
    handles: int = 1,
    spacing: float = 0.03,
    width: float = 0.36,
    height: float = 0.38,
    depth: float = 0.10,
    handle_length: float | None = None,
    handle_width: float = 0.052,
    handle_span: float = 0.20,
) -> Fields:
    """Return a bag open at its top, whose panels bulge to `depth`, with one handle or two.

    A tote has as many classes as handles: the bag closes its open top. One handle runs over the top from side to side; of
    two, each stands on its own panel, `handle_span` between the middles of its ends. A true loop is the border of the
    opening under a handle. The grips are on the one handle, or one on each of the two. When `handle_length` is not given, one
    handle is 0.72 m long, and each of two 0.50 m.
    """
    handle_length = (0.72 if handles == 1 else 0.50) if handle_length is None else handle_length
    sizes = check_sizes(locals(), without=("handle_span",) if handles == 1 else ())
    name, half = numbered("tote", handles, "handles"), width / 2
    sides = polyline((-half, 0), (-half, -height), (half, -height), (half, 0))
    if handles == 2:
        return _tote_of_two(sizes, sides)
    fits = handle_width <= width - 2 * spacing
    demand(fits, f"handle_width {handle_width} must be less than width {width} by twice the spacing {spacing}")
    top = polyline((half, 0), (half - handle_width / 2, 0), (handle_width / 2 - half, 0), (-half, 0))
    panel = cut([*sides, *top], [], spacing)
    front = inflate(panel, (0, 1, 2), depth / 2)
    arch = Arch.of_length(width, handle_length, "handle_length")
    strap = Band.cut([handle_length], [handle_width / 2, handle_width / 2], spacing)
    grips = strap.panel.nearest(np.column_stack([handle_length * THIRDS, [-handle_width / 2] * 2]))
    over = arch.points(strap.panel.vertices[:, 0] / handle_length)
    cloth = strap.panel.placed(lambda v: np.column_stack([over[:, 0], v[:, 2] + handle_width / 2, over[:, 1]]))
    half_end = len(strap.start) // 2
    seams = [(0, panel.sides[i], 1, panel.sides[i]) for i in range(3)]
    seams += [(0, panel.sides[3][::-1], 2, strap.start[: half_end + 1]), (1, panel.sides[3], 2, strap.start[half_end:])]
    seams += [(0, panel.sides[5], 2, strap.end[: half_end + 1]), (1, panel.sides[5][::-1], 2, strap.end[half_end:])]
    vertices, faces, (a, _, c) = sew([front, front.mirrored(), cloth], seams)
    return name, vertices, faces, (ring(c[strap.low], a[panel.sides[4]]),), c[grips], sizes


def _tote_of_two(sizes: dict[str, float], sides: list[Array]) -> Fields:
    half, spacing = sizes["width"] / 2, sizes["spacing"]
    span, width = sizes["handle_span"], sizes["handle_width"]
    fits = 2 * spacing <= span - width and span + width <= 2 * half - 2 * spacing
    demand(fits, f"handle_span {span} must leave room for handles of handle_width {width} in width {2 * half}")
    arch = Arch.of_length(span, sizes["handle_length"], "handle_length")
    outer, opening, middle = arch.strap(width, spacing, sizes["handle_length"])
    top = [*polyline((half, 0), outer[0]), outer, *polyline(outer[-1], (-half, 0))]
    panel = cut([*sides, *top], [opening], spacing, middle)
    front = inflate(panel, (0, 1, 2), sizes["depth"] / 2, top=0.0)
    seams = [(0, panel.sides[i], 1, panel.sides[i]) for i in range(3)]
    vertices, faces, (a, b) = sew([front, front.mirrored()], seams)
    held = panel.nearest(arch.points(np.array([0.42, 0.58])))  # one on each handle, so that both stay up
    loops = a[panel.holes[0]], b[panel.holes[0]]
    return "tote2", vertices, faces, loops, np.array([a[held[0]], b[held[1]]]), sizes


def backpack(
    *,
    spacing: float = 0.03,
    width: float = 0.24,
    height: float = 0.60,
    depth: float = 0.12,
    box_height: float = 0.30,
    strap_length: float = 0.66,
    strap_width: float = 0.05,
    strap_angle: float = 40.0,
) -> Fields:
    """Return a backpack open at its top: a back, a box below its lower half, two straps.

    The straps join the sides of the back at its top and just above the box, and are folded by `strap_angle` from the plane
    of the back towards +y. There are two classes; each true loop is the border of the opening between a strap and the back,
    the left one (x < 0) first. There is one grip on each strap.
    """
    sizes = check_sizes(locals())
    half, low = width / 2, -height
    rim = low + box_height
    span = -rim - 2 * strap_width
    opens = span - strap_width >= 2 * spacing
    demand(opens, f"height {height} is too low for straps of strap_width {strap_width} above box_height {box_height}")
    arch = Arch.of_length(span, strap_length)

    def aside(line: Array) -> Array:
        """From above the origin to the right side of the back."""
        return line[:, ::-1] * [1, -1] + [half, rim / 2]

    outer, hole, middle = arch.strap(strap_width, spacing, strap_length)
    outer, hole, middle = aside(outer), [aside(line) for line in hole], aside(middle)
    right = [*polyline((half, low), (half, rim), outer[0]), outer, *polyline(outer[-1], (half, 0))]
    top, bottom = polyline((half, 0), (-half, 0)), polyline((-half, low), (half, low))
    outline = [*right, *top, *(mirror(line) for line in right[::-1]), *bottom]
    holes = [hole, [mirror(line) for line in hole]]
    back = cut(outline, holes, spacing, np.concatenate([middle, mirror(middle)]))
    held = aside(arch.points(np.array([0.6])))
    grips = back.nearest(np.concatenate([held * [-1, 1], held]))
    back = back.placed(lambda v: _folded(v, half, np.radians(strap_angle)))
    edge = chain(back.sides[0][::-1], back.sides[-1][::-1], back.sides[-2][::-1])
    gusset = Band.cut([box_height, width, box_height], [depth], spacing)
    way = np.array([[half, rim], [half, low], [-half, low], [-half, rim]])
    at = np.cumsum([0, box_height, width, box_height])
    x, z = (np.interp(gusset.panel.vertices[:, 0], at, way[:, i]) for i in range(2))
    sides = gusset.panel.placed(lambda v: np.column_stack([x, v[:, 2], z]))
    front = cut(polyline((-half, rim), (-half, low), (half, low), (half, rim), (-half, rim)), [], spacing)
    front_edge = chain(*(front.sides[i] for i in range(3)))[::-1]
    front = inflate(front, (0, 1, 2), depth / 4).placed(lambda v: v - [0, depth, 0])
    seams = [(2, edge, 1, gusset.high), (0, front_edge, 1, gusset.low)]
    vertices, faces, (*_, a) = sew([front, sides, back], seams)
    return "backpack", vertices, faces, (a[back.holes[1]], a[back.holes[0]]), a[grips], sizes


def _folded(vertices: Array, half: float, angle: float) -> Array:
    beyond = np.maximum(np.abs(vertices[:, 0]) - half, 0)
    x = np.sign(vertices[:, 0]) * (np.minimum(np.abs(vertices[:, 0]), half) + beyond * np.cos(angle))
    return np.column_stack([x, vertices[:, 1] + beyond * np.sin(angle), vertices[:, 2]])
