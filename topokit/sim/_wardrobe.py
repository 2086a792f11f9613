"""The wardrobe: garments that are cut from flat patterns, placed in space and sewn together.

Idea: a pattern is drawn as polylines and curves in the plane (x, z). `cut` fills it with triangles, which are bent or inflated
into space, and `sew` joins pieces along their seams. A border keeps the order in which it is drawn: the border of an opening
is a true loop. Sizes are in metres, angles in degrees; sizes that do not fit each other are refused before anything is cut.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from topokit._validate import positive

from ._garments import Garment
from ._pattern import (
    Arch,
    arc_length,
    band,
    chain,
    circle,
    cut,
    demand,
    inflate,
    mirror,
    points_at,
    polyline,
    ring,
    sew,
)
from ._surface import Array, EdgeGraph, Ids, half_edges

Sizes = dict[str, float]


def apron(
    *,
    loops: int = 1,
    spacing: float = 0.03,
    body_width: float = 0.56,
    body_height: float = 0.46,
    bib_width: float = 0.28,
    bib_height: float = 0.30,
    strap_length: float = 0.62,
    strap_width: float = 0.052,
    waist_strap_length: float = 0.90,
    waist_strap_width: float = 0.06,
) -> Garment:
    """Return an apron with one loop, its neck strap, or with two, in the plane y = 0 with the top of its bib at z = 0.

    With `loops=2` a second strap closes behind the waist (towards +y), and the second true loop runs along its upper border and
    across the apron. The grips are on the neck strap, at a third of its length from either end.
    """
    sizes = _sizes(locals(), "loops", *(("waist_strap_length", "waist_strap_width") if loops == 1 else ()))
    demand(loops in (1, 2), "loops must be 1 or 2")
    demand(bib_width <= body_width, "bib_width must not exceed body_width")
    demand(bib_width >= 2 * strap_width + 3 * spacing, "bib_width is too narrow for two straps of strap_width")
    # The neck strap is an arch over the bib.
    arch = Arch.of_length(bib_width - strap_width, strap_length)
    outer, opening, middle = arch.strap(strap_width, spacing, strap_length)
    half_body = body_width / 2
    half_bib = bib_width / 2
    waist = -bib_height
    hem = waist - body_height
    # The armhole leaves the bib vertically and reaches the waist horizontally: a quarter of an ellipse.
    angle = np.pi / 2 * np.linspace(0, 1, 181)
    armhole = np.column_stack([half_body - (half_body - half_bib) * np.sin(angle), waist * np.cos(angle)])
    side = polyline((half_body, hem), (half_body, waist))
    if loops == 2:
        demand(waist_strap_width + spacing <= body_height, "waist_strap_width is too wide for body_height")
        side = polyline((half_body, hem), (half_body, waist - waist_strap_width), (half_body, waist))
    front = cut(_symmetric([*side, armhole], [outer]), [opening], spacing, [middle])
    grips = front.nearest(arch.points([1 / 3, 2 / 3]))
    if loops == 1:
        return Garment("apron", front.vertices, front.faces, front.holes, grips, sizes, ("neck",))
    # The waist strap closes behind. Its loop runs along the strap from the right to the left, and back across the apron.
    around = Arch.of_length(body_width, waist_strap_length, "waist_strap_length")
    strap, _, high, start, end = band([waist_strap_length], [waist_strap_width], spacing)
    x, y = around.points(strap.vertices[:, 0] / waist_strap_length).T
    cloth = replace(strap, vertices=np.column_stack([x, y, waist + strap.vertices[:, 2]]))
    ends = [(0, front.sides[1], 1, start), (0, front.sides[5][::-1], 1, end)]
    vertices, faces, (_, ids) = sew([front, cloth], ends)
    behind = ids[high]
    across = EdgeGraph(vertices, half_edges(front.faces)).path(int(behind[-1]), int(behind[0]))
    true_loops = (front.holes[0], np.concatenate([behind[:-1], across[:-1]]))
    return Garment("apron2", vertices, faces, true_loops, grips, sizes, ("neck", "waist"))


def shirt(
    *,
    spacing: float = 0.035,
    width: float = 0.52,
    length: float = 0.60,
    depth: float = 0.16,
    neck_width: float = 0.24,
    neck_depth: float = 0.09,
    sleeve_length: float = 0.16,
    sleeve_width: float = 0.17,
    sleeve_angle: float = 25.0,
) -> Garment:
    """Return a shirt with short sleeves that fall by `sleeve_angle`, front towards -y, inflated to `depth`.

    The loops are its four openings: neck, right sleeve (x > 0), left sleeve, hem. They make three classes: any three are
    independent, the fourth is their sum. The grips are on the shoulders of the front.
    """
    sizes = _sizes(locals())
    half = width / 2
    neck = neck_width / 2
    # Directions along the sleeve, which falls by the angle, and across it downwards.
    angle = np.radians(sleeve_angle)
    along = np.array([np.cos(angle), -np.sin(angle)])
    across = np.array([-np.sin(angle), -np.cos(angle)])
    demand(neck + spacing <= half, "neck_width must be less than width")
    top = np.array([neck, 0]) + ((half - neck) / along[0] + sleeve_length) * along
    low = top + sleeve_width * across
    underarm = low - (low[0] - half) / along[0] * along
    fits = low[0] - half >= spacing and -length + spacing <= underarm[1]
    demand(fits, "sleeve_length is too short, or sleeve_width too wide")
    right = polyline((half, -length), (half, underarm[1]), low, top, (neck, 0))
    return _tunic("shirt", sizes, right, (0, 1, 3), neck + 0.5 * (half - neck))


def vest(
    *,
    spacing: float = 0.035,
    width: float = 0.52,
    length: float = 0.58,
    depth: float = 0.16,
    neck_width: float = 0.24,
    neck_depth: float = 0.12,
    shoulder_width: float = 0.08,
    armhole_depth: float = 0.24,
) -> Garment:
    """Return a vest without sleeves, front towards -y, inflated to `depth`; loops and grips are those of a shirt."""
    sizes = _sizes(locals())
    half = width / 2
    neck = neck_width / 2
    tip = np.array([neck + shoulder_width, -0.25 * shoulder_width])
    demand(tip[0] <= half, "width is too narrow for the neck and two times shoulder_width")
    fits = armhole_depth + spacing <= length and -armhole_depth < tip[1] - 2 * spacing
    demand(fits, "armhole_depth must lie between the drop of the shoulder and length")
    # The armhole is a quarter of an ellipse from the side up to the tip of the shoulder.
    bend = np.pi / 2 * np.linspace(0, 1, 181)
    across = half - (half - tip[0]) * np.sin(bend)
    down = (tip[1] + armhole_depth) * (1 - np.cos(bend))
    hole = np.column_stack([across, -armhole_depth + down])
    right = [*polyline((half, -length), hole[0]), hole, *polyline(tip, (neck, 0))]
    return _tunic("vest", sizes, right, (0, 2), neck + shoulder_width / 2)


def _tunic(name: str, sizes: Sizes, right: list[Array], seams: Sequence[int], grip: float) -> Garment:
    """Return a front and a back of the same right half, drawn from the hem to the neck, joined along its `seams`."""
    neck = sizes["neck_width"] / 2
    k = len(right)  # the side of the collar; the mirrored sides follow it
    angle = np.pi * np.linspace(0, 1, 181)
    joined = [*seams, *(2 * k - i for i in seams)]
    # The collar of the back dips a third as deep as that of the front.
    panels = []
    for dip in (sizes["neck_depth"], sizes["neck_depth"] / 3):
        collar = np.column_stack([neck * np.cos(angle), -dip * np.sin(angle)])
        panel = cut(_symmetric(right, [collar]), [], sizes["spacing"])
        panels.append(inflate(panel, joined, sizes["depth"] / 2))
    front = panels[0]
    back = panels[1].mirrored()
    vertices, faces, (a, b) = sew([front, back], [(0, front.sides[i], 1, back.sides[i]) for i in joined])
    # The loops are the sides that are not sewn: the collar, the arms, the hem.
    open_sides = [k, *(i for i in range(2 * k + 1) if i not in joined and i not in (k, 2 * k + 1)), 2 * k + 1]
    rims = tuple(ring(a[front.sides[i]], b[back.sides[i]]) for i in open_sides)
    height = np.interp(grip, *right[-1][::-1].T)
    grips = a[front.nearest(np.array([[-grip, height], [grip, height]]))]
    return Garment(name, vertices, faces, rims, grips, sizes, ("neck", "arm 1", "arm 2", "hem"))


def mask(
    *,
    spacing: float = 0.016,
    width: float = 0.18,
    height: float = 0.20,
    depth: float = 0.04,
    bow: float = 0.02,
    strap_length: float = 0.34,
    strap_width: float = 0.03,
    strap_span: float = 0.12,
) -> Garment:
    """Return a face mask with two ear loops, hung by the upper one.

    The cloth is cupped by `depth` towards -y and its sides bow out by `bow`; `strap_span` lies between the middles of a
    strap's ends. The true loops are the borders of the openings, the upper one first.
    """
    sizes = _sizes(locals())
    half = width / 2
    low = -height
    fits = strap_span - strap_width >= 2 * spacing and strap_span + strap_width + spacing <= width
    demand(fits, "strap_span must leave room for straps of strap_width in width")
    arch = Arch.of_length(strap_span, strap_length)
    outer, hole, middle = arch.strap(strap_width, spacing, strap_length)
    side = np.column_stack([half + bow * np.sin(np.pi * np.linspace(0, 1, 91)), np.linspace(low, 0, 91)])
    top = [side, *polyline(side[-1], outer[0]), outer, *polyline(outer[-1], (-half, 0))]

    def opposite(line: Array) -> Array:
        """Return a line of the upper half of the pattern after half a turn in the plane: a line of the lower half."""
        return np.array([0, low]) - line

    holes = [hole, [opposite(line) for line in hole]]
    panel = cut([*top, *map(opposite, top)], holes, spacing, [middle, opposite(middle)])
    # A dome that is 1 in the middle and 0 along the border.
    x, _, z = panel.vertices.T
    dome = np.clip(1 - (x / half) ** 2, 0, 1) * np.clip(1 - (2 * z / low - 1) ** 2, 0, 1)
    vertices = panel.vertices - depth * dome[:, None] * [0, 1, 0]
    grips = panel.nearest(arch.points([1 / 3, 2 / 3]))
    return Garment("mask", vertices, panel.faces, panel.holes, grips, sizes, ("ear 1", "ear 2"))


def sheet(
    *,
    holes: int = 1,
    spacing: float = 0.03,
    width: float = 0.60,
    height: float = 0.50,
    hole_radius: float = 0.08,
    hole_drop: float = 0.16,
    hole_distance: float = 0.26,
) -> Garment:
    """Return a rectangle of cloth below z = 0 with round holes side by side, or with none; the grips are its upper corners."""
    sizes = _sizes(locals(), "holes", *(("hole_distance",) if holes == 1 else ()))
    half = width / 2
    low = -height
    gap = hole_distance / 2
    places = [(2 * i - holes + 1) * gap for i in range(holes)]
    room = hole_radius + spacing
    if holes:
        demand(hole_radius >= 1.2 * spacing, "hole_radius is too small for the spacing")
        demand(room <= hole_drop <= height - room, "hole_drop puts a hole over the border")
        demand(places[-1] + room <= half, "width has no room for the holes")
        demand(holes == 1 or gap >= room, "hole_distance makes holes meet")
    rings = [circle(place, -hole_drop, hole_radius) for place in places]
    panel = cut(polyline((-half, low), (half, low), (half, 0), (-half, 0), (-half, low)), rings, spacing)
    grips = np.array([panel.sides[3][0], panel.sides[2][0]])
    name = "sheet" if holes == 1 else f"sheet{holes}"
    names = ("hole",) if holes == 1 else tuple(f"hole {i + 1}" for i in range(holes))
    return Garment(name, panel.vertices, panel.faces, panel.holes, grips, sizes, names)


def tote(
    *,
    handles: int = 1,
    spacing: float = 0.03,
    width: float = 0.36,
    height: float = 0.38,
    depth: float = 0.10,
    handle_length: float = 0.72,
    handle_width: float = 0.052,
    handle_span: float = 0.20,
) -> Garment:
    """Return a bag open at its top, whose panels bulge to `depth`, with one handle or two, and as many classes of loops.

    One handle runs over the top from side to side; of two, each stands on its own panel, `handle_span` between the middles of
    its ends. A true loop is the border of the opening under a handle.
    """
    demand(handles in (1, 2), "handles must be 1 or 2")
    sizes = _sizes(locals(), "handles", *(("handle_span",) if handles == 1 else ()))
    if handles == 1:
        vertices, faces, (handle, *_), grips = _bag(sizes, [])
        return Garment("tote", vertices, faces, (handle,), grips, sizes, ("handle",))
    # Each handle is cut in one piece with its panel.
    half = width / 2
    ends = handle_span + handle_width
    fits = 2 * spacing <= handle_span - handle_width and ends <= width - 2 * spacing
    demand(fits, "handle_span must leave room for handles of handle_width in width")
    arch = Arch.of_length(handle_span, handle_length, "handle_length")
    outer, opening, middle = arch.strap(handle_width, spacing, handle_length)
    top = [*polyline((half, 0), outer[0]), outer, *polyline(outer[-1], (-half, 0))]
    panel = cut([*_three_sides(width, height), *top], [opening], spacing, [middle])
    front = inflate(panel, (0, 1, 2), depth / 2, top=0.0)
    seams = [(0, panel.sides[i], 1, panel.sides[i]) for i in range(3)]
    vertices, faces, (a, b) = sew([front, front.mirrored()], seams)
    held = panel.nearest(arch.points([0.42, 0.58]))  # one on each handle, so that both stay up
    loops = (a[panel.holes[0]], b[panel.holes[0]])
    return Garment("tote2", vertices, faces, loops, np.array([a[held[0]], b[held[1]]]), sizes, ("handle 1", "handle 2"))


def _three_sides(width: float, height: float) -> list[Array]:
    """Return the left side, the bottom and the right side of a panel with its top at z = 0."""
    half = width / 2
    return polyline((-half, 0), (-half, -height), (half, -height), (half, 0))


def _bag(sizes: Sizes, holes: Sequence[Sequence[Array]]) -> tuple[Array, Ids, list[Ids], Ids]:
    """Return vertices, faces, loops (handle, rim, the holes of the front and of the back) and grips of a bag with one handle."""
    spacing = sizes["spacing"]
    width = sizes["width"]
    half = width / 2
    handle_length = sizes["handle_length"]
    handle_width = sizes["handle_width"]
    demand(handle_width <= width - 2 * spacing, "handle_width must be less than width by twice the spacing")
    # The panels: the ends of the handle stand in the upper corners, half of each on either panel.
    top = polyline((half, 0), (half - handle_width / 2, 0), (handle_width / 2 - half, 0), (-half, 0))
    panel = cut([*_three_sides(width, sizes["height"]), *top], holes, spacing)
    front = inflate(panel, (0, 1, 2), sizes["depth"] / 2)
    # The handle: a straight band bent along an arch from side to side.
    arch = Arch.of_length(width, handle_length, "handle_length")
    strap, low, _, start, end = band([handle_length], [handle_width / 2, handle_width / 2], spacing)
    grips = strap.nearest(np.column_stack([handle_length * np.array([1 / 3, 2 / 3]), [-handle_width / 2] * 2]))
    x, z = arch.points(strap.vertices[:, 0] / handle_length).T
    cloth = replace(strap, vertices=np.column_stack([x, strap.vertices[:, 2] + handle_width / 2, z]))
    # Sew the panels along sides and bottom, and half of each end of the handle to either panel.
    half_end = len(start) // 2
    seams = [(0, panel.sides[i], 1, panel.sides[i]) for i in range(3)]
    seams += [(0, panel.sides[3][::-1], 2, start[: half_end + 1]), (1, panel.sides[3], 2, start[half_end:])]
    seams += [(0, panel.sides[5], 2, end[: half_end + 1]), (1, panel.sides[5][::-1], 2, end[half_end:])]
    vertices, faces, (a, b, c) = sew([front, front.mirrored(), cloth], seams)
    rim = chain(*panel.sides[3:6])
    loops = [ring(c[low], a[panel.sides[4]]), ring(a[rim], b[rim])]
    return vertices, faces, [*loops, *(ids[hole] for ids in (a, b) for hole in panel.holes)], c[grips]


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
) -> Garment:
    """Return a backpack open at its top: a back, a box below its lower half, two straps with a grip on each.

    The straps join the sides of the back at its top and just above the box, and are folded by `strap_angle` from the plane
    of the back towards +y. Each true loop is the border of the opening between a strap and the back, the left one (x < 0) first.
    """
    sizes = _sizes(locals())
    half = width / 2
    low = -height
    rim = low + box_height
    span = -rim - 2 * strap_width
    demand(span - strap_width >= 2 * spacing, "height is too low for straps of strap_width above box_height")
    arch = Arch.of_length(span, strap_length)

    def to_the_right(line: Array) -> Array:
        """Return a line drawn above the origin, moved to the right side of the back."""
        return line[:, ::-1] * [1, -1] + [half, rim / 2]

    # The back, with a strap on either side, is cut flat; then the straps are folded away from its plane.
    outer, hole, middle = arch.strap(strap_width, spacing, strap_length)
    outer = to_the_right(outer)
    hole = [to_the_right(line) for line in hole]
    middle = to_the_right(middle)
    right = [*polyline((half, low), (half, rim), outer[0]), outer, *polyline(outer[-1], (half, 0))]
    outline = _symmetric(right, polyline((half, 0), (-half, 0)))
    back = cut(outline, [hole, [mirror(line) for line in hole]], spacing, [middle, mirror(middle)])
    held = to_the_right(arch.points([0.6]))
    grips = back.nearest(np.concatenate([held * [-1, 1], held]))
    # What lies beyond the sides of the back is folded.
    x, y, z = back.vertices.T
    beyond = np.maximum(np.abs(x) - half, 0)
    x = np.sign(x) * (np.minimum(np.abs(x), half) + beyond * np.cos(np.radians(strap_angle)))
    back = replace(back, vertices=np.column_stack([x, y + beyond * np.sin(np.radians(strap_angle)), z]))
    # The gusset, a band around three sides of the box, stands upright between back and front.
    edge = chain(back.sides[0][::-1], back.sides[-1][::-1], back.sides[-2][::-1])
    gusset, low_edge, high_edge, *_ = band([box_height, width, box_height], [depth], spacing)
    corners = np.array([[half, rim], [half, low], [-half, low], [-half, rim]])
    at = np.cumsum([0, box_height, width, box_height])
    x, z = (np.interp(gusset.vertices[:, 0], at, corners[:, i]) for i in range(2))
    sides = replace(gusset, vertices=np.column_stack([x, gusset.vertices[:, 2], z]))
    front = cut(polyline((-half, rim), (-half, low), (half, low), (half, rim), (-half, rim)), [], spacing)
    front_edge = chain(*(front.sides[i] for i in range(3)))[::-1]
    front = inflate(front, (0, 1, 2), depth / 4)
    front = replace(front, vertices=front.vertices - [0, depth, 0])
    seams = [(2, edge, 1, high_edge), (0, front_edge, 1, low_edge)]
    vertices, faces, (*_, a) = sew([front, sides, back], seams)
    straps = (a[back.holes[1]], a[back.holes[0]])
    return Garment("backpack", vertices, faces, straps, a[grips], sizes, ("strap 1", "strap 2"))


def net(
    *,
    spacing: float = 0.025,
    width: float = 0.40,
    height: float = 0.42,
    depth: float = 0.10,
    mesh_radius: float = 0.042,
    handle_length: float = 0.72,
    handle_width: float = 0.05,
) -> Garment:
    """Return a net bag with one handle from side to side; each panel has three rows of three round meshes.

    The true loops are the opening under the handle, the rim, and every mesh of the front, then of the back, row by row from
    the lower left. The class of the rim is the sum of those of the meshes. The grips are on the handle.
    """
    sizes = _sizes(locals())
    demand(mesh_radius >= 1.2 * spacing, "mesh_radius is too small for the spacing")
    across = width / 3
    down = height / 3
    demand(min(across, down) >= 2 * mesh_radius + spacing, "mesh_radius leaves no cord between the meshes")
    places = [((i + 0.5) * across - width / 2, (j + 0.5) * down - height) for j in range(3) for i in range(3)]
    meshes = [circle(x, z, mesh_radius) for x, z in places]
    vertices, faces, loops, grips = _bag(sizes, meshes)
    names = ("handle", "rim", *(f"mesh {i + 1}" for i in range(18)))
    return Garment("net", vertices, faces, tuple(loops), grips, sizes, names)


def scarf(*, spacing: float = 0.03, length: float = 1.3, width: float = 0.26) -> Garment:
    """Return an endless scarf: a band `length` around, as an ellipse twice as high as wide, held by its front border."""
    sizes = _sizes(locals())
    demand(length >= 8 * spacing, "length is too short for the spacing")
    panel, low, _, start, end = band([length], [width], spacing)
    # The band is bent along an ellipse of its own length.
    angle = np.linspace(0, 2 * np.pi, 2881)
    oval = np.column_stack([-np.sin(angle), 2 * (np.cos(angle) - 1)])
    oval *= length / arc_length(oval)[-1]
    x, z = points_at(oval, panel.vertices[:, 0]).T
    cloth = replace(panel, vertices=np.column_stack([x, panel.vertices[:, 2] + width / 2, z]))
    vertices, faces, (ids,) = sew([cloth], [(0, start, 0, end)])
    held = [int(np.argmin(np.abs(panel.vertices[low, 0] / length - at))) for at in (1 / 16, 15 / 16)]
    return Garment("scarf", vertices, faces, (ids[low[:-1]],), ids[low[held]], sizes, ("neck",))


def belt(
    *,
    spacing: float = 0.016,
    length: float = 0.7,
    width: float = 0.06,
    loop_radius: float = 0.07,
    loop_width: float = 0.035,
) -> Garment:
    """Return a strap of cloth with a loop at its upper end, a ring of `loop_radius` inside, by whose inner border it hangs."""
    sizes = _sizes(locals())
    outer = loop_radius + loop_width
    demand(loop_radius >= 1.2 * spacing, "loop_radius is too small for the spacing")
    demand(loop_width >= 1.2 * spacing, "loop_width is too small for the spacing")
    demand(2 * spacing <= width <= 1.6 * outer, f"width must be {2 * spacing:g} to {1.6 * outer:g}")
    # The outer border of the ring begins and ends where it meets the strap.
    foot = np.arcsin(width / 2 / outer)
    angle = np.linspace(foot - np.pi / 2, 3 * np.pi / 2 - foot, 361)
    around = outer * np.column_stack([np.cos(angle), np.sin(angle)])
    low = -outer - length
    strap = polyline((-width / 2, low), (width / 2, low), around[0])
    back = polyline(around[-1], (-width / 2, low))
    panel = cut([*strap, around, *back], [circle(0, 0, loop_radius)], spacing)
    held = (loop_radius + loop_width / 2) * np.array([[-0.5, 0.75**0.5], [0.5, 0.75**0.5]])
    return Garment("belt", panel.vertices, panel.faces, panel.holes, panel.nearest(held), sizes, ("loop",))


def _symmetric(right: list[Array], top: list[Array]) -> list[Array]:
    """Return an outline that runs up the right side, over the top, down the left side and straight back along the hem."""
    left = [mirror(line) for line in right[::-1]]
    return [*right, *top, *left, *polyline(left[-1][-1], right[0][0])]


def _sizes(given: Mapping[str, Any], *left_out: str) -> Sizes:
    """Return the sizes among the arguments of a function, each a positive number; an angle may be 0."""
    names = [name for name in given if name not in left_out]
    return {name: positive(given[name], name, zero=name.endswith("_angle")) for name in names}


WARDROBE: Mapping[str, Callable[..., Garment]] = {
    "apron": apron,
    "apron2": functools.partial(apron, loops=2),
    "tote": tote,
    "tote2": functools.partial(tote, handles=2, handle_length=0.50),
    "backpack": backpack,
    "shirt": shirt,
    "vest": vest,
    "mask": mask,
    "sheet": sheet,
    "sheet2": functools.partial(sheet, holes=2),
    "scarf": scarf,
    "belt": belt,
    "net": net,
}
"""Functions that make the garments, by the names that episodes record: ``WARDROBE["apron"](spacing=0.04)``."""
