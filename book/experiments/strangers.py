"""Garments as other programs make them, to tune readers and simulators of meshes on: book/experiments/garments.py hangs them.

None of them is a pattern of topokit as it is. Some are drawn here: by marching cubes (irregular triangles), or from few quads
with straps one quad wide. The others are patterns of topokit after what other programs do to a mesh: decimated, subdivided, with
moved vertices, with pinholes, folded, made a solid of two layers, turned about the vertical. Files are in metres, centimetres,
millimetres, inches or no unit, with y or z up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista as pv
import trimesh
from numpy.typing import NDArray

from topokit._geometry import turned
from topokit.sim import WARDROBE, Garment

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.int64]]
UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0, "in": 1 / 0.0254, "none": 0.37}  # what a metre is in the file


@dataclass(frozen=True)
class Stranger:
    """A mesh as another program writes it."""

    name: str
    target: str  #: what it fits: hook, hanger or mannequin
    make: Callable[[], Mesh]
    unit: str
    up: str

    def write(self, folder: Path) -> Path:
        """Write the mesh into a folder and return the file."""
        vertices, faces = self.make()
        if self.up == "y":
            vertices = vertices[:, [0, 2, 1]] * [1, 1, -1]
        path = folder / f"{self.name.replace(' ', '_')}.obj"
        trimesh.Trimesh(UNITS[self.unit] * vertices, faces, process=False).export(path)
        return path


# -- shapes -------------------------------------------------------------------------------------------------------------------


def capsule(
    places: Array, start: Sequence[float], end: Sequence[float], first: float, last: float | None = None
) -> Array:
    """Return the signed distance of places (N, 3) from a capsule whose radius goes from `first` to `last`."""
    last = first if last is None else last
    axis = np.subtract(end, start)
    share = np.clip((places - start) @ axis / (axis @ axis), 0, 1)
    nearest = start + share[:, None] * axis
    return np.asarray(np.linalg.norm(places - nearest, axis=1) - first - share * (last - first))


def triangles(mesh: pv.PolyData) -> Mesh:
    """Return the triangles of a surface, without lines and vertices that filters leave behind."""
    whole = mesh.triangulate().clean()
    rows = whole.faces
    faces = []
    i = 0
    while i < len(rows):
        if rows[i] == 3 and len({*rows[i + 1 : i + 4].tolist()}) == 3:
            faces.append(rows[i + 1 : i + 4])
        i += rows[i] + 1
    used, flat = np.unique(np.array(faces), return_inverse=True)
    return np.asarray(whole.points, float)[used], flat.reshape(-1, 3)


def of_cubes(field: Callable[[Array], Array], low: Sequence[float], high: Sequence[float], step: float) -> pv.PolyData:
    """Return the surface where a field is zero, by marching cubes."""
    counts = np.ceil(np.subtract(high, low) / step).astype(int) + 1
    grid = pv.ImageData(dimensions=counts, spacing=(step,) * 3, origin=low)
    grid["field"] = field(np.asarray(grid.points))
    return grid.contour([0.0], scalars="field")


def t_shirt(sleeve: float = 0.2, slope: float = 0.35, step: float = 0.03, keep: float = 0.5) -> Mesh:
    """Return a T-shirt of marching cubes, open at neck, hem and sleeves, of which a share of the triangles is kept."""

    def field(places: Array) -> Array:
        trunk = capsule(places * [1, 1.6, 1], (0, 0, 0.05), (0, 0, 0.5), 0.25, 0.2)
        hand = [0.6, 0, 0.55 - slope * 0.45]
        arms = [capsule(places * [side, 1, 1], (0.15, 0, 0.55), hand, 0.1, 0.08) for side in (-1, 1)]
        neck = capsule(places, (0, 0, 0.55), (0, 0, 0.9), 0.1)
        return np.minimum.reduce([trunk, *arms, neck])

    body = of_cubes(field, (-0.75, -0.4, -0.35), (0.75, 0.4, 1.1), step)
    body = body.clip("z", origin=(0, 0, 0.7)).clip("-z", origin=(0, 0, 0))
    body = body.clip("-x", origin=(-0.2 - sleeve, 0, 0)).clip("x", origin=(0.2 + sleeve, 0, 0))
    return decimated(triangles(body), 1 - keep) if keep < 1 else triangles(body)


def tank_top(step: float = 0.03) -> Mesh:
    """Return a tank top: a capsule of marching cubes with holes cut out for the neck and both arms."""

    def field(places: Array) -> Array:
        return capsule(places * [1, 1.6, 1], (0, 0, 0.05), (0, 0, 0.5), 0.22, 0.2)

    body = of_cubes(field, (-0.4, -0.4, -0.35), (0.4, 0.4, 0.9), step).clip("-z", origin=(0, 0, 0))
    for side in (-1, 1):
        arm = pv.Cylinder(center=(side * 0.22, 0, 0.55), direction=(1, 0, 0), radius=0.11, height=0.2)
        body = body.clip_surface(arm.triangulate(), invert=False)
    body = body.clip_surface(pv.Sphere(center=(0, 0, 0.72), radius=0.12), invert=False)
    return decimated(triangles(body.triangulate().clean().connectivity("largest")), 0.4)


def strip(line: Array, across: Array) -> Mesh:
    """Return a band of quads along a line (k, 3), one quad wide, whose width is the vectors `across` (k, 3)."""
    k = len(line)
    faces = [[[i, i + 1, i + k], [i + 1, i + k + 1, i + k]] for i in range(k - 1)]
    return np.concatenate([line - across / 2, line + across / 2]), np.reshape(faces, (-1, 3))


def grid(columns: int, rows: int, width: float, height: float, low: float, y: float = 0.0) -> Mesh:
    """Return an upright rectangle of quads whose lower edge is at the height `low`."""
    x, z = np.meshgrid(np.linspace(-width / 2, width / 2, columns), np.linspace(low, low + height, rows))
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    quads = corner[:, None] + [0, 1, columns + 1, columns]
    return np.column_stack([x.ravel(), np.full(x.size, y), z.ravel()]), quads[:, [[0, 1, 3], [1, 2, 3]]].reshape(-1, 3)


def together(*parts: Mesh) -> Mesh:
    """Return parts as one mesh; vertices at one place are one."""
    mesh = trimesh.util.concatenate([trimesh.Trimesh(*part, process=False) for part in parts])
    mesh.merge_vertices(digits_vertex=5)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def arch(half: float, low: float, high: float, width: float, y: float = 0.0) -> Mesh:
    """Return a handle one quad wide, from -`half` to `half`."""
    angle = np.linspace(0, np.pi, 9)
    out = np.column_stack([-np.cos(angle), 0 * angle, np.sin(angle)])
    return strip(out * [half, 0, high] + [0, y, low], width * out)


def few_quads_apron() -> Mesh:
    """Return an apron of 6 cm quads with a neck strap one quad wide and two open ties."""
    ties = []
    for side in (-1, 1):
        line = np.array([[side * (0.24 + 0.06 * i), 0, -0.03 - 0.01 * i] for i in range(4)])
        ties.append(strip(line, np.tile([0, 0, 0.06], (4, 1))))
    return together(grid(9, 9, 0.48, 0.48, -0.48), grid(5, 5, 0.24, 0.24, 0), arch(0.09, 0.24, 0.3, 0.06), *ties)


def box(width: float, depth: float, height: float, columns: int, rows: int) -> list[Mesh]:
    """Return the sides and the bottom of an open box of quads: front, back, left, right, bottom."""
    front = grid(columns, rows, width, height, -height, -depth / 2)
    back = grid(columns, rows, width, height, -height, depth / 2)
    side, quads = grid(3, rows, depth, height, -height)
    sides = [(np.column_stack([x + 0 * side[:, 0], side[:, 0], side[:, 2]]), quads) for x in (-width / 2, width / 2)]
    floor, tiles = grid(columns, 3, width, depth, -depth / 2)
    return [front, back, *sides, (np.column_stack([floor[:, 0], floor[:, 2], floor[:, 1] - height]), tiles)]


def few_quads_bag() -> Mesh:
    """Return a box bag with two handles one quad wide."""
    return together(*box(0.36, 0.12, 0.36, 7, 7), *(arch(0.09, 0, 0.2, 0.06, y) for y in (-0.06, 0.06)))


def few_quads_backpack() -> Mesh:
    """Return a box backpack whose straps are sewn on in the middle of its back: edges of three faces."""
    angle = np.linspace(0, np.pi, 13)
    straps = []
    for side in (-1, 1):
        line = np.column_stack([np.full(13, side * 0.125), 0.075 + 0.2 * np.sin(angle), 0.18 * np.cos(angle) - 0.18])
        straps.append(strip(line, np.tile([0.05, 0, 0], (13, 1))))
    return together(*box(0.3, 0.15, 0.42, 7, 8), *straps)


def towel() -> Mesh:
    """Return a towel with a loop of tape at its upper edge."""
    return together(grid(13, 17, 0.48, 0.64, -0.64), arch(0.06, 0, 0.09, 0.04))


def rope_ring() -> Mesh:
    """Return a ring of rope: a closed solid."""
    mesh = trimesh.creation.torus(0.12, 0.012, major_sections=24, minor_sections=5)
    return np.asarray(mesh.vertices)[:, [0, 2, 1]], np.asarray(mesh.faces)


def summer_dress() -> Mesh:
    """Return a cone of quads with two shoulder straps one quad wide."""
    n = 24
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    down = np.repeat(np.linspace(0, 1, 14), n)
    around = np.tile(angle, 14)
    cone = np.column_stack([(0.17 + 0.18 * down) * np.cos(around), (0.12 + 0.18 * down) * np.sin(around), -0.75 * down])
    corner = np.arange(13)[:, None] * n + np.arange(n)
    beside = np.arange(13)[:, None] * n + (np.arange(n) + 1) % n
    quads = np.stack([corner, beside, beside + n, corner + n], axis=-1).reshape(-1, 4)
    straps = []
    for front, back in (((4, 5), (20, 19)), ((7, 8), (17, 16))):
        share = np.linspace(0, 1, 9)[:, None]
        lines = [(1 - share) * cone[a] + share * cone[b] for a, b in zip(front, back, strict=True)]
        middle = (lines[0] + lines[1]) / 2 + [0, 0, 0.16] * np.sin(np.pi * share)
        straps.append(strip(middle, lines[1] - lines[0]))
    return together((cone, quads[:, [[0, 1, 3], [1, 2, 3]]].reshape(-1, 3)), *straps)


# -- what other programs do to a mesh ------------------------------------------------------------------------------------------


def plain(garment: Garment) -> Mesh:
    return garment.vertices.copy(), garment.faces.astype(np.int64)


def decimated(mesh: Mesh, share: float) -> Mesh:
    """Return a mesh without a share of its triangles."""
    return triangles(pv.make_tri_mesh(*mesh).decimate_pro(share, preserve_topology=True))


def irregular(mesh: Mesh, share: float = 0.33) -> Mesh:
    """Return a mesh whose inner vertices are moved at random along the surface, by a share of an edge at most."""
    vertices, faces = mesh
    whole = trimesh.Trimesh(vertices, faces, process=False)
    move = np.random.default_rng(0).uniform(-share, share, vertices.shape) * np.median(whole.edges_unique_length)
    normals = np.asarray(whole.vertex_normals)
    move -= (move * normals).sum(axis=1, keepdims=True) * normals
    move[on_border(whole)] = 0
    return vertices + move, faces


def on_border(mesh: trimesh.Trimesh) -> NDArray[np.int64]:
    """Return the vertices of borders."""
    return np.unique(mesh.edges_sorted[trimesh.grouping.group_rows(mesh.edges_sorted, require_count=1)])


def with_pinholes(mesh: Mesh, count: int = 12) -> Mesh:
    """Return a mesh without some faces, none of them at a border."""
    vertices, faces = mesh
    inner = np.flatnonzero(~np.isin(faces, on_border(trimesh.Trimesh(vertices, faces, process=False))).any(axis=1))
    return vertices, np.delete(faces, np.random.default_rng(0).choice(inner, count, replace=False), axis=0)


def subdivided(mesh: Mesh, times: int) -> Mesh:
    """Return a mesh each of whose faces is cut into four, so many times."""
    for _ in range(times):
        mesh = trimesh.remesh.subdivide(*mesh)
    return mesh


def folded(mesh: Mesh, height: float, degrees: float = 150.0) -> Mesh:
    """Return a mesh whose part above a height is folded down to the front."""
    vertices, faces = mesh
    above = np.maximum(vertices[:, 2] - height, 0)
    angle = np.radians(degrees) * np.clip(above / 0.05, 0, 1)
    low = np.minimum(vertices[:, 2], height)
    return np.column_stack([vertices[:, 0], vertices[:, 1] - above * np.sin(angle), low + above * np.cos(angle)]), faces


def solid(mesh: Mesh, thickness: float = 0.004) -> Mesh:
    """Return a mesh as a solid of two layers and a wall along its borders."""
    vertices, faces = mesh
    whole = trimesh.Trimesh(vertices, faces, process=False)
    trimesh.repair.fix_winding(whole)
    n = len(vertices)
    border = whole.edges[trimesh.grouping.group_rows(whole.edges_sorted, require_count=1)]
    a, b = border.T
    wall = np.concatenate([np.column_stack([b, a, a + n]), np.column_stack([b, a + n, b + n])])
    inner = vertices - thickness * np.asarray(whole.vertex_normals)
    return np.concatenate([vertices, inner]), np.concatenate([whole.faces, whole.faces[:, ::-1] + n, wall])


def quarter_turn(mesh: Mesh) -> Mesh:
    """Return a mesh turned by 90 degrees about the vertical."""
    return turned(mesh[0], 90), mesh[1]


def strangers() -> Iterator[Stranger]:
    """Yield the garments, in an order that never changes."""
    yield Stranger("T-shirt of cubes", "mannequin", t_shirt, "cm", "y")
    yield Stranger("T-shirt of fine cubes", "mannequin", lambda: t_shirt(step=0.015, keep=1), "m", "y")
    yield Stranger("long-sleeved shirt of cubes", "mannequin", lambda: t_shirt(0.38, 0.9), "m", "z")
    yield Stranger("tank top of cubes", "mannequin", tank_top, "mm", "y")
    yield Stranger("summer dress", "mannequin", summer_dress, "m", "y")
    yield Stranger("decimated shirt", "mannequin", lambda: decimated(plain(WARDROBE["shirt"]()), 0.6), "m", "y")
    yield Stranger("turned shirt", "mannequin", lambda: quarter_turn(plain(WARDROBE["shirt"]())), "m", "z")
    yield Stranger("subdivided vest", "mannequin", lambda: subdivided(plain(WARDROBE["vest"]()), 1), "in", "z")
    yield Stranger("irregular vest", "mannequin", lambda: irregular(plain(WARDROBE["vest"]())), "cm", "y")
    yield Stranger("apron of few quads to wear", "mannequin", few_quads_apron, "m", "y")
    yield Stranger("apron of few quads", "hook", few_quads_apron, "m", "z")
    yield Stranger("bag of few quads", "hook", few_quads_bag, "cm", "y")
    yield Stranger("backpack of few quads", "hook", few_quads_backpack, "m", "z")
    yield Stranger("rope ring", "hook", rope_ring, "m", "z")
    yield Stranger("towel", "hook", towel, "cm", "z")
    yield Stranger("decimated apron", "hook", lambda: decimated(plain(WARDROBE["apron"]()), 0.75), "m", "y")
    yield Stranger("folded apron", "hook", lambda: folded(plain(WARDROBE["apron"]()), 0.02), "m", "z")
    yield Stranger("irregular apron", "hook", lambda: irregular(plain(WARDROBE["apron"]())), "mm", "y")
    yield Stranger("solid apron", "hook", lambda: solid(plain(WARDROBE["apron"](spacing=0.04))), "m", "z")
    yield Stranger("decimated tote", "hook", lambda: decimated(plain(WARDROBE["tote"]()), 0.7), "in", "z")
    yield Stranger("subdivided tote", "hook", lambda: subdivided(plain(WARDROBE["tote"]()), 2), "m", "y")
    yield Stranger("tote with pinholes", "hook", lambda: with_pinholes(plain(WARDROBE["tote"](handles=2))), "cm", "z")
    yield Stranger("turned tote", "hook", lambda: quarter_turn(plain(WARDROBE["tote"](handles=2))), "m", "y")
    yield Stranger("solid tote", "hook", lambda: solid(plain(WARDROBE["tote"](spacing=0.04))), "m", "z")
    yield Stranger("decimated mask", "hook", lambda: decimated(plain(WARDROBE["mask"]()), 0.6), "cm", "z")
    yield Stranger("irregular backpack", "hook", lambda: irregular(plain(WARDROBE["backpack"]())), "cm", "z")
    yield Stranger("decimated sheet", "hook", lambda: decimated(plain(WARDROBE["sheet"]()), 0.8), "m", "z")
    yield Stranger("belt without a unit", "hook", lambda: plain(WARDROBE["belt"]()), "none", "y")
    yield Stranger("decimated scarf", "hook", lambda: decimated(plain(WARDROBE["scarf"]()), 0.6), "m", "z")
    yield Stranger("vest on a hook", "hook", lambda: plain(WARDROBE["vest"]()), "m", "y")
