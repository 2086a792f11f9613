"""The patterns of what is carried or slung, as those of `_wardrobe` of what is worn: bags, a scarf, a belt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ._pattern import Arch, arc_length, band, chain, cut, ellipse, inflate, mirror, points_at, polyline, ring, sew
from ._surface import Array, Ids, demand
from ._wardrobe import THIRDS, Fields, check_sizes, numbered


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
    vertices, faces, (handle, *_), grips = _tote_of_one(sizes, sides, [])
    return name, vertices, faces, (handle,), grips, sizes


def _tote_of_one(
    sizes: Mapping[str, float], sides: list[Array], holes: Sequence[Sequence[Array]]
) -> tuple[Array, Ids, list[Ids], Ids]:
    """Vertices, faces, loops (handle, rim, the holes of the front, those of the back) and grips of a bag with one handle."""
    half, spacing, width = sizes["width"] / 2, sizes["spacing"], sizes["width"]
    handle_length, handle_width = sizes["handle_length"], sizes["handle_width"]
    fits = handle_width <= width - 2 * spacing
    demand(fits, f"handle_width {handle_width} must be less than width {width} by twice the spacing {spacing}")
    top = polyline((half, 0), (half - handle_width / 2, 0), (handle_width / 2 - half, 0), (-half, 0))
    panel = cut([*sides, *top], holes, spacing)
    front = inflate(panel, (0, 1, 2), sizes["depth"] / 2)
    arch = Arch.of_length(width, handle_length, "handle_length")
    strap, low, _, start, end = band([handle_length], [handle_width / 2, handle_width / 2], spacing)
    grips = strap.nearest(np.column_stack([handle_length * THIRDS, [-handle_width / 2] * 2]))
    over = arch.points(strap.vertices[:, 0] / handle_length)
    cloth = strap.placed(lambda v: np.column_stack([over[:, 0], v[:, 2] + handle_width / 2, over[:, 1]]))
    half_end = len(start) // 2
    seams = [(0, panel.sides[i], 1, panel.sides[i]) for i in range(3)]
    seams += [(0, panel.sides[3][::-1], 2, start[: half_end + 1]), (1, panel.sides[3], 2, start[half_end:])]
    seams += [(0, panel.sides[5], 2, end[: half_end + 1]), (1, panel.sides[5][::-1], 2, end[half_end:])]
    vertices, faces, (a, b, c) = sew([front, front.mirrored(), cloth], seams)
    rim = chain(*panel.sides[3:6])
    loops = [ring(c[low], a[panel.sides[4]]), ring(a[rim], b[rim])]
    return vertices, faces, [*loops, *(ids[hole] for ids in (a, b) for hole in panel.holes)], c[grips]


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
    gusset, low_edge, high_edge, *_ = band([box_height, width, box_height], [depth], spacing)
    way = np.array([[half, rim], [half, low], [-half, low], [-half, rim]])
    at = np.cumsum([0, box_height, width, box_height])
    x, z = (np.interp(gusset.vertices[:, 0], at, way[:, i]) for i in range(2))
    sides = gusset.placed(lambda v: np.column_stack([x, v[:, 2], z]))
    front = cut(polyline((-half, rim), (-half, low), (half, low), (half, rim), (-half, rim)), [], spacing)
    front_edge = chain(*(front.sides[i] for i in range(3)))[::-1]
    front = inflate(front, (0, 1, 2), depth / 4).placed(lambda v: v - [0, depth, 0])
    seams = [(2, edge, 1, high_edge), (0, front_edge, 1, low_edge)]
    vertices, faces, (*_, a) = sew([front, sides, back], seams)
    return "backpack", vertices, faces, (a[back.holes[1]], a[back.holes[0]]), a[grips], sizes


def _folded(vertices: Array, half: float, angle: float) -> Array:
    beyond = np.maximum(np.abs(vertices[:, 0]) - half, 0)
    x = np.sign(vertices[:, 0]) * (np.minimum(np.abs(vertices[:, 0]), half) + beyond * np.cos(angle))
    return np.column_stack([x, vertices[:, 1] + beyond * np.sin(angle), vertices[:, 2]])


def net(
    *,
    rows: int = 3,
    columns: int = 3,
    spacing: float = 0.025,
    width: float = 0.40,
    height: float = 0.42,
    depth: float = 0.10,
    mesh_radius: float = 0.042,
    handle_length: float = 0.72,
    handle_width: float = 0.05,
) -> Fields:
    """Return a net bag with one handle from side to side: each panel has `rows` times `columns` round meshes in even steps.

    The true loops are the opening under the handle, the rim, and every mesh of the front, then of the back, row by row from
    the lower left. The rim's class is the sum of the meshes'. The grips are on the handle.
    """
    sizes = check_sizes(locals())
    for name, count in (("rows", rows), ("columns", columns)):
        whole = isinstance(count, int) and not isinstance(count, bool) and 1 <= count <= 12
        demand(whole, f"{name} must be a whole number from 1 to 12, not {count!r}")
    demand(mesh_radius >= 1.2 * spacing, f"mesh_radius {mesh_radius} is too small for the spacing {spacing}")
    across, down = width / columns, height / rows
    fits = min(across, down) >= 2 * mesh_radius + spacing
    demand(fits, f"mesh_radius {mesh_radius} leaves no cord in {rows} rows and {columns} columns")
    places = [((i + 0.5) * across - width / 2, (j + 0.5) * down - height) for j in range(rows) for i in range(columns)]
    meshes = [ellipse(x, z, mesh_radius, mesh_radius) for x, z in places]
    sides = polyline((-width / 2, 0), (-width / 2, -height), (width / 2, -height), (width / 2, 0))
    vertices, faces, loops, grips = _tote_of_one(sizes, sides, meshes)
    names = "handle", "rim", *(f"mesh {i + 1}" for i in range(2 * len(places)))
    return "net", vertices, faces, tuple(loops), grips, sizes, (), names


def scarf(*, spacing: float = 0.03, length: float = 1.3, width: float = 0.26) -> Fields:
    """Return an endless scarf (a snood): a band of that `width`, `length` around, as an ellipse twice as high as wide.

    There is one class; the true loop is the front border of the band.
    The grips are on that border, near its top. An open scarf has no loops: a `sheet` without holes.
    """
    sizes = check_sizes(locals())
    demand(length >= 8 * spacing, f"length {length} is too short for spacing {spacing}")
    panel, low, _, start, end = band([length], [width], spacing)
    angle = np.linspace(0, 2 * np.pi, 2881)
    oval = np.column_stack([-np.sin(angle), 2 * (np.cos(angle) - 1)])
    oval *= length / arc_length(oval)[-1]
    way = points_at(oval, panel.vertices[:, 0])
    cloth = panel.placed(lambda v: np.column_stack([way[:, 0], v[:, 2] + width / 2, way[:, 1]]))
    vertices, faces, (ids,) = sew([cloth], [(0, start, 0, end)])
    held = [int(np.argmin(np.abs(panel.vertices[low, 0] / length - at))) for at in (1 / 16, 15 / 16)]
    return "scarf", vertices, faces, (ids[low[:-1]],), ids[low[held]], sizes


def belt(
    *,
    spacing: float = 0.016,
    length: float = 0.7,
    width: float = 0.06,
    loop_radius: float = 0.07,
    loop_width: float = 0.035,
) -> Fields:
    """Return a strap of cloth with a loop at its upper end, a ring of `loop_radius` inside and `loop_width`.

    The true loop is the inner border of the ring. The grips are on the ring, left and right of its top.
    """
    sizes = check_sizes(locals())
    outer = loop_radius + loop_width
    demand(loop_radius >= 1.2 * spacing, f"loop_radius {loop_radius} is too small for the spacing {spacing}")
    demand(loop_width >= 1.2 * spacing, f"loop_width {loop_width} is too small for the spacing {spacing}")
    demand(2 * spacing <= width <= 1.6 * outer, f"width {width} must be {2 * spacing:g} to {1.6 * outer:g}")
    foot = np.arcsin(width / 2 / outer)
    angle = np.linspace(foot - np.pi / 2, 3 * np.pi / 2 - foot, 361)
    around = outer * np.column_stack([np.cos(angle), np.sin(angle)])
    low = -outer - length
    strap, back = polyline((-width / 2, low), (width / 2, low), around[0]), polyline(around[-1], (-width / 2, low))
    panel = cut([*strap, around, *back], [ellipse(0, 0, loop_radius, loop_radius)], spacing)
    held = (loop_radius + loop_width / 2) * np.array([[-0.5, 0.75**0.5], [0.5, 0.75**0.5]])
    return "belt", panel.vertices, panel.faces, panel.holes, panel.nearest(held), sizes
