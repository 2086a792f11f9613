"""`Garment.from_mesh` on meshes as they come: what is repaired and reported, where loops and grips land, what is refused."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

pytest.importorskip("pybullet")
pytest.importorskip("trimesh")

import trimesh
from strangers import strangers

import topokit as tk
from topokit.evaluate import summarise_tracks, true_loops
from topokit.sim import TASKS, WARDROBE, Garment, Hook, Mannequin, SimulationConfig, Task, World

APRON = WARDROBE["apron"](spacing=0.05, strap_width=0.05)
TOTE = WARDROBE["tote"](handles=2, spacing=0.04)
VEST = WARDROBE["vest"](spacing=0.05)


def written(path: Path, vertices: ArrayLike, polygons: ArrayLike) -> Path:
    """An OBJ file with these vertices and polygons."""
    lines = ["v {:.17g} {:.17g} {:.17g}".format(*row) for row in vertices]
    lines += ["f " + " ".join(str(i + 1) for i in polygon) for polygon in polygons]
    path.write_text("\n".join(lines) + "\n")
    return path


class Mesh:
    """A mesh on its way into a file: rows of vertices, polygons, and the ids that are to be carried."""

    def __init__(self, garment: Garment, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.vertices = garment.vertices.copy()
        self.polygons = garment.faces.tolist()
        self.loops = [loop.copy() for loop in garment.loops]
        self.grips = garment.grips.copy()

    def places(self) -> list[np.ndarray]:
        return [self.vertices[ids].copy() for ids in (*self.loops, self.grips)]

    def obj(self, path: Path) -> Path:
        return written(path, self.vertices, self.polygons)

    def cut_seams(self, share: float = 0.3) -> None:
        """Give each face of a share of them corners of its own, as at UV seams, and let the loops name the copies."""
        for polygon in self.polygons:
            if self.rng.random() < share:
                copies = len(self.vertices) + np.arange(len(polygon))
                self.vertices = np.vstack([self.vertices, self.vertices[polygon]])
                for loop in self.loops:
                    for old, new in zip(polygon, copies, strict=True):
                        if self.rng.random() < 0.5:
                            loop[loop == old] = new
                polygon[:] = copies.tolist()

    def shuffle(self) -> None:
        """Number the vertices anew, and turn polygons and their order about."""
        new = self.rng.permutation(len(self.vertices))
        self.vertices[new] = self.vertices.copy()
        self.polygons = [np.roll(new[p], self.rng.integers(3)).tolist() for p in self.polygons]
        self.rng.shuffle(self.polygons)
        self.loops, self.grips = [new[loop] for loop in self.loops], new[self.grips]

    def strew(self, count: int = 7) -> None:
        """Put vertices that are in no face between the others, one of them not a number."""
        at = np.sort(self.rng.integers(0, len(self.vertices), count))
        new = np.arange(len(self.vertices)) + np.searchsorted(at, np.arange(len(self.vertices)), side="right")
        stray = self.rng.normal(size=(count, 3))
        stray[0, 1] = np.nan
        self.vertices = np.insert(self.vertices, at, stray, axis=0)
        self.polygons = [new[p].tolist() for p in self.polygons]
        self.loops, self.grips = [new[loop] for loop in self.loops], new[self.grips]

    def merge_to_polygons(self, corners: int = 4) -> None:
        """Join neighbouring faces to polygons, where that keeps them flat and simple."""
        merged, used = [], set()
        by_edge = {(p[k], p[(k + 1) % 3]): i for i, p in enumerate(self.polygons) for k in range(3)}
        for i, polygon in enumerate(self.polygons):
            if i in used:
                continue
            whole = list(polygon)
            for k in range(len(whole)):
                j = by_edge.get((whole[(k + 1) % len(whole)], whole[k]))
                if j is None or j in used or j <= i or len(whole) >= corners or len(set(self.polygons[j])) < 3:
                    continue
                (apex,) = set(self.polygons[j]) - set(whole[k : k + 2]) - {whole[(k + 1) % len(whole)]}
                if apex not in whole:
                    whole.insert(k + 1, apex)
                    used.add(j)
            merged.append(whole)
        self.polygons = merged

    def add_button(self) -> None:
        """A second component, first in the file."""
        ring = 0.01 * np.column_stack([np.cos(np.arange(6)), 1 + 0 * np.arange(6), np.sin(np.arange(6))])
        self.vertices = np.vstack([ring, self.vertices])
        self.polygons = [[0, k, k + 1] for k in range(1, 5)] + [[i + 6 for i in p] for p in self.polygons]
        self.loops, self.grips = [loop + 6 for loop in self.loops], self.grips + 6

    def add_fans(self) -> None:
        """Two more faces on some inner edges."""
        for a, b, _ in [self.polygons[k] for k in (20, 40, 60)]:
            for lift in (0.01, 0.02):
                apex = (self.vertices[a] + self.vertices[b]) / 2 + [0, lift, 0.01]
                self.vertices = np.vstack([self.vertices, apex])
                self.polygons.append([a, b, len(self.vertices) - 1])

    def add_empty_faces(self) -> None:
        a, b = self.polygons[3][:2]
        self.polygons[5:5] = [[a, a, b], [b, b, b]]

    def add_double_faces(self) -> None:
        self.polygons += [p[::-1] for p in self.polygons[::3]] + [list(p) for p in self.polygons[::5]]

    def flip_some(self) -> None:
        self.polygons = [p[::-1] if self.rng.random() < 0.4 else p for p in self.polygons]

    def shake(self, noise: float = 1e-6) -> None:
        self.vertices = self.vertices + self.rng.uniform(-noise, noise, self.vertices.shape)

    def add_slivers(self) -> None:
        """Split border edges in the middle, with a face without area along each."""
        for k in (0, 4, 8):
            a, b = self.loops[0][k : k + 2]
            self.vertices = np.vstack([self.vertices, (self.vertices[a] + self.vertices[b]) / 2])
            self.polygons.append([int(a), len(self.vertices) - 1, int(b)])


def load(path: Path, mesh: Mesh, **options: object) -> Garment:
    return Garment.from_mesh(path, loops=[loop.tolist() for loop in mesh.loops], grips=mesh.grips.tolist(), **options)


def assert_lands(garment: Garment, places: list[np.ndarray], atol: float = 5e-6) -> None:
    """Loops and grips are where they were, in their order."""
    for ids, place in zip((*garment.loops, garment.grips), places, strict=True):
        assert len(ids) == len(place)
        np.testing.assert_allclose(garment.vertices[ids], place, atol=atol)


NASTY = {
    "cut_seams": "welded",
    "shuffle": "",
    "strew": "7 vertices in none of the faces",
    "merge_to_polygons": "cut into triangles",
    "add_button": "1 smaller components",
    "add_fans": "3 edges in more than two faces",
    "add_empty_faces": "2 faces without area",
    "add_double_faces": "faces that lay on another one",
    "flip_some": "turned round",
    "shake": "",
    "add_slivers": "3 faces were turned round",
}
SHAPES_FIRST = sorted(NASTY, key=lambda name: name not in ("add_fans", "add_slivers"))


@pytest.mark.parametrize("garment", [APRON, TOTE], ids=["apron", "tote2"])
@pytest.mark.parametrize("nasty", NASTY)
def test_each_defect_is_repaired_and_said_and_loops_land_where_they_were(tmp_path, nasty, garment):
    mesh = Mesh(garment)
    getattr(mesh, nasty)()
    loaded = load(mesh.obj(tmp_path / "cloth.obj"), mesh)
    assert_lands(loaded, mesh.places())
    assert loaded.name == "cloth"
    assert NASTY[nasty] in "; ".join(loaded.repairs)
    assert bool(loaded.repairs) == bool(NASTY[nasty])
    if nasty not in ("add_fans", "add_slivers"):
        assert len(loaded.vertices) == len(garment.vertices)
        assert len(loaded.faces) == len(garment.faces)


@pytest.mark.parametrize("seed", range(12))
def test_defects_together(tmp_path, seed):
    rng = np.random.default_rng(seed)
    mesh = Mesh((APRON, TOTE)[seed % 2], seed)
    for name in SHAPES_FIRST:
        if rng.random() < 0.6:
            getattr(mesh, name)()
    mesh.shuffle()
    assert_lands(load(mesh.obj(tmp_path / "cloth.obj"), mesh), mesh.places())


def in_faces(text: str, write: Callable[[int, int], str]) -> str:
    """The file with each corner of a face, its place in the face and its vertex, written anew."""
    lines = text.splitlines()
    for number, line in enumerate(lines):
        if line.startswith("f "):
            lines[number] = "f " + " ".join(write(k, int(i)) for k, i in enumerate(line.split()[1:]))
    return "\n".join(lines) + "\n"


def with_groups(text: str) -> str:
    lines = text.splitlines()
    for at in (-50, len(TOTE.vertices)):
        lines[at:at] = ["o cloth", "g front", "usemtl cotton", "s off", "# a comment", "l 1 2", "p 1"]
    return "# made by hand\nmtllib lost.mtl\n" + "\n".join(f"{line} # why" for line in lines) + "\n\n"


OBJ_WAYS = {
    "crlf": lambda text: text.replace("\n", "\r\n"),
    "negative ids": lambda text: in_faces(text, lambda _, i: str(i - len(TOTE.vertices) - 1)),
    "comments, groups and a lost material": with_groups,
    "texture and normals": lambda text: (
        "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n" + in_faces(text, lambda k, i: f"{i}/{k + 1}/1")
    ),
    "normals only, mixed": lambda text: "vn 0 0 1\n" + in_faces(text, lambda k, i: f"{i}//1" if k else f"{i}"),
    "colours": lambda text: text.replace("\nv ", " 0.5 0.5 1\nv "),
    "tabs and continued lines": lambda text: text.replace(" ", "\t").replace("f\t", "  f \\\n\t"),
    "faces first": lambda text: "f " + text.split("\nf ", 1)[1] + text.split("\nf ", 1)[0],
    "latin-1": lambda text: "# caf\xe9\n" + text,
}


@pytest.mark.parametrize("way", OBJ_WAYS)
def test_obj_as_programs_write_it(tmp_path, way):
    mesh = Mesh(TOTE)
    path = mesh.obj(tmp_path / "tote.obj")
    path.write_bytes(OBJ_WAYS[way](path.read_text()).encode("latin-1"))
    loaded = load(path, mesh)
    assert_lands(loaded, mesh.places(), atol=1e-12)
    np.testing.assert_array_equal(loaded.faces, TOTE.faces)
    assert loaded.repairs == ()


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_stl_as_trimesh_writes_it(tmp_path, kind, noise):
    corners = APRON.vertices[APRON.faces] + np.random.default_rng(0).uniform(-noise, noise, (*APRON.faces.shape, 3))
    soup = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(APRON.faces.size).reshape(-1, 3), process=False)
    path = tmp_path / "apron.STL"
    data = soup.export(file_type=kind)
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    of = {int(vertex): corner for corner, vertex in enumerate(APRON.faces.ravel())}
    loop, grips = [of[int(v)] for v in APRON.loops[0]], [of[int(v)] for v in APRON.grips]
    loaded = Garment.from_mesh(path, loops=[loop], grips=grips)
    assert_lands(loaded, [APRON.vertices[APRON.loops[0]], APRON.vertices[APRON.grips]])
    assert len(loaded.vertices) == len(APRON.vertices)
    assert len(loaded.faces) == len(APRON.faces)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_ply_as_trimesh_writes_it(tmp_path, encoding):
    mesh = Mesh(TOTE)
    cloth = trimesh.Trimesh(TOTE.vertices, TOTE.faces, vertex_colors=np.full((len(TOTE.vertices), 4), 9), process=False)
    path = tmp_path / "tote.ply"
    path.write_bytes(cloth.export(file_type="ply", encoding="ascii" if encoding == "ascii" else "binary"))
    assert_lands(load(path, mesh), mesh.places())


def ply(mesh: Mesh, order: str) -> bytes:
    """PLY with polygons of several sizes, an element before the faces and properties beside the places."""
    kind = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = f"""ply
format {kind} 1.0
comment property list nothing
element vertex {len(mesh.vertices)}
property uchar red
property double x
property double y
property double z
element camera 2
property list uchar short numbers
element face {len(mesh.polygons)}
property float quality
property list uint8 int32 vertex_index
property list uchar float texcoord
end_header
"""
    rows = [[(9, "u1"), *((x, "f8") for x in row)] for row in mesh.vertices.tolist()]
    rows += [[(3, "u1"), (1, "i2"), (2, "i2"), (3, "i2")], [(0, "u1")]]
    rows += [[(0.5, "f4"), (len(p), "u1"), *((i, "i4") for i in p), (1, "u1"), (0.5, "f4")] for p in mesh.polygons]
    if not order:
        return (header + "\n".join(" ".join(repr(x) for x, _ in row) for row in rows) + "\n").encode()
    return header.encode() + b"".join(np.array(x, order + code).tobytes() for row in rows for x, code in row)


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_ply_with_mixed_polygons_and_other_elements(tmp_path, order):
    mesh = Mesh(APRON)
    mesh.merge_to_polygons(5)
    assert {len(p) for p in mesh.polygons} >= {3, 4, 5}
    path = tmp_path / "apron.ply"
    path.write_bytes(ply(mesh, order))
    loaded = load(path, mesh)
    assert_lands(loaded, mesh.places(), atol=1e-12)
    assert len(loaded.faces) == len(APRON.faces)
    path.write_bytes(ply(mesh, order)[:-40])
    with pytest.raises(ValueError, match=r"apron.ply: cut off or damaged among the \d+ rows of its element 'face'"):
        load(path, mesh)


def test_polygons_are_cut_along_short_diagonals(tmp_path):
    """An L of six corners has one inner corner; no triangle may lie outside it."""
    corners = np.array([[0, 0, 0], [0.4, 0, 0], [0.4, 0, 0.1], [0.1, 0, 0.1], [0.1, 0, 0.4], [0, 0, 0.4]])
    loaded = Garment.from_mesh(written(tmp_path / "l.obj", corners, [range(6)]))
    ends = loaded.vertices[loaded.faces]
    area = np.linalg.norm(np.cross(ends[:, 1] - ends[:, 0], ends[:, 2] - ends[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(0.07)
    assert len(loaded.faces) == 4


@pytest.mark.parametrize(
    ("factor", "options", "extent", "says"),
    [
        (1, {}, 1.0, None),
        (100, {}, 1.0, "centimetres"),
        (1000, {}, 1.0, "millimetres"),
        (10, {}, 1 / 1.05, "no unit"),
        (0.01, {}, 1 / 1.05, "no unit"),
        (10, {"size": 0.8}, 0.8 / 1.05, None),
        (39.37, {"scale": 0.0254}, 1.0, None),
    ],
)
def test_units(tmp_path, factor, options, extent, says):
    mesh = Mesh(APRON)
    height = np.ptp(APRON.vertices[:, 2])
    mesh.vertices *= factor
    loaded = load(mesh.obj(tmp_path / "apron.obj"), mesh, **options)
    expected = extent * height if extent == 1.0 else extent * 1.05
    assert np.ptp(loaded.vertices[:, 2]) == pytest.approx(expected, rel=1e-3)
    assert loaded.parameters["scale"] == pytest.approx(np.ptp(loaded.vertices[:, 2]) / (factor * height))
    assert [says in repair for repair in loaded.repairs] == ([] if says is None else [True])


def test_up_is_found(tmp_path):
    mesh = Mesh(APRON)
    mesh.vertices = mesh.vertices[:, [0, 2, 1]] * [1, 1, -1]  # z up to y up
    path = mesh.obj(tmp_path / "apron.obj")
    for turned in (load(path, mesh), Garment.from_mesh(path)):
        np.testing.assert_allclose(turned.vertices, APRON.vertices, atol=1e-12)
    np.testing.assert_allclose(load(path, mesh, up="z").vertices, mesh.vertices, atol=1e-12)


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_any_axis_may_be_up(tmp_path, up):
    """z of the garment becomes that axis of the file, and comes back; no turn mirrors."""
    axis, sign = "xyz".index(up[-1]), -1 if up[0] == "-" else 1
    turn = np.eye(3)
    turn[[axis, 2]] = turn[[2, axis]]
    turn[axis] *= sign
    turn[2 if axis != 2 else 0] *= np.linalg.det(turn)
    assert np.linalg.det(turn) == pytest.approx(1)
    loaded = Garment.from_mesh(written(tmp_path / "m.obj", VEST.vertices @ turn.T, VEST.faces), up=up)
    np.testing.assert_allclose(loaded.vertices[:, 2], VEST.vertices[:, 2], atol=1e-9)
    after, before = (np.linalg.det(vest.vertices[vest.faces]).sum() for vest in (loaded, VEST))
    assert after * before > 0


def test_grips_at_the_floor_are_refused_and_a_lying_mesh_is_reported(tmp_path):
    path = written(tmp_path / "m.obj", VEST.vertices * [1, 1, -1], VEST.faces)
    with pytest.raises(ValueError, match=r"grips.*up"):
        Garment.from_mesh(path, grips=VEST.grips, up="z")
    assert Garment.from_mesh(path, grips=VEST.grips, up="-z").loops == ()
    low = written(tmp_path / "low.obj", TOTE.vertices * [1, 3, 0.3], TOTE.faces)
    for options, lies in (({}, True), ({"up": "z"}, False)):
        assert any("lie" in repair for repair in Garment.from_mesh(low, **options).repairs) == lies


def tube(widths: list[float], height: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a tube around z of rings of some half widths, from the floor up; half as deep as it is wide."""
    n = 24
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(angle), 0.5 * np.sin(angle), 0 * angle])
    levels = np.linspace(0, height, len(widths))
    vertices = np.concatenate([width * ring + [0, 0, z] for width, z in zip(widths, levels, strict=True)])
    faces = []
    for row in range(len(widths) - 1):
        for i in range(n):
            a, b = row * n + i, row * n + (i + 1) % n
            faces += [[a, b, b + n], [a, b + n, a + n]]
    return vertices, np.array(faces)


Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # z of the garment becomes y of the file


def test_a_short_skirt_stands_by_its_hem_and_has_a_waist(tmp_path):
    vertices, faces = tube([0.4, 0.35, 0.3, 0.25], 0.3)
    for turn in (np.eye(3), Y_UP):
        skirt = Garment.from_mesh(written(tmp_path / "m.obj", vertices @ turn.T, faces), loops="auto")
        np.testing.assert_allclose(skirt.vertices, vertices, atol=1e-9)
        assert set(skirt.loop_names) == {"waist", "hem"}
        assert skirt.vertices[skirt.named_loops["waist"], 2].min() == pytest.approx(0.3)
        assert not any("lie" in words for words in skirt.repairs)


@pytest.mark.parametrize(
    ("widths", "deeper", "height"), [([0.5, 0.4, 0.3, 0.2], 1.9, 0.3), ([0.25, 0.235, 0.22], 1.0, 0.35)]
)
def test_a_flared_skirt_and_a_narrow_one_stand_upright(tmp_path, widths, deeper, height):
    """Most of the first one faces up. The borders of the second one are nearly alike."""
    vertices, faces = tube(widths, height)
    vertices = vertices * [1, deeper, 1]
    for turn in (np.eye(3), Y_UP):
        skirt = Garment.from_mesh(written(tmp_path / "m.obj", vertices @ turn.T, faces), loops="auto")
        np.testing.assert_allclose(skirt.vertices, vertices, atol=1e-9)
        assert set(skirt.loop_names) == {"waist", "hem"}


def test_a_flat_garment_stands_upright_in_any_plane_and_what_is_unclear_is_asked(tmp_path):
    apron = WARDROBE["apron"]()
    low = apron.vertices * [1, 1, 0.8]  # 0.56 by 0.84 m
    sideways = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for turn in (np.eye(3), sideways, Y_UP, Y_UP @ sideways):
        loaded = Garment.from_mesh(written(tmp_path / "m.obj", low @ turn.T, apron.faces), loops="auto")
        assert loaded.loop_names == ("neck",)
        np.testing.assert_allclose(np.ptp(loaded.vertices, axis=0), np.ptp(low, axis=0), atol=1e-9)
    vertices, faces = tube([0.25, 0.25, 0.25], 0.3)
    straight = Garment.from_mesh(written(tmp_path / "m.obj", vertices, faces), loops="auto")
    assert any("its y or its z axis" in words for words in straight.repairs)


@pytest.mark.parametrize("name", ["vest", "apron", "backpack"])
def test_a_fine_mesh_is_simplified_and_keeps_its_loops(tmp_path, name):
    fine = WARDROBE[name](spacing=0.015)
    path = written(tmp_path / "m.obj", fine.vertices, fine.faces)
    for loops in ("auto", fine.named_loops):
        coarse = Garment.from_mesh(path, loops=loops, grips=fine.grips, max_vertices=600)
        assert 300 <= len(coarse.vertices) <= 600
        assert any("simplified" in words for words in coarse.repairs)
        assert set(coarse.loop_names) == set(fine.loop_names)
        for curve in coarse.loops:
            away = min(tk.hausdorff(coarse.vertices[curve], fine.vertices[true]) for true in fine.loops)
            assert away < 3 * np.median(coarse.edge_lengths)
        assert np.linalg.norm(coarse.vertices[coarse.grips] - fine.vertices[fine.grips], axis=1).max() < 0.06


@pytest.mark.parametrize("name", ["apron", "mask", "shirt", "backpack", "tote2", "scarf"])
def test_a_mesh_turned_about_the_vertical_gets_the_same_names_and_grips(tmp_path, name):
    garment = WARDROBE[name](spacing=0.025 if name == "mask" else 0.05)
    if name == "scarf":  # as deep as it is wide, but for a hair
        garment = replace(garment, vertices=garment.vertices * [1, 1.02, 1])
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    found = []
    for vertices in (garment.vertices, garment.vertices @ turn.T):
        loaded = Garment.from_mesh(written(tmp_path / "m.obj", vertices, garment.faces), loops="auto")
        found.append((set(loaded.grips.tolist()), {key: cyclic(loop) for key, loop in loaded.named_loops.items()}))
    assert found[0] == found[1]


def test_a_sack_has_no_loop_and_is_told_why(tmp_path):
    vertices, faces = tube([0.1, 0.4, 0.4, 0.3], 0.5)
    bottom = np.array([[0, (i + 1) % 24, i] for i in range(1, 23)])
    sack = Garment.from_mesh(written(tmp_path / "m.obj", vertices, np.concatenate([faces, bottom])), loops="auto")
    assert sack.loops == ()
    assert any("no rod can go through it" in words for words in sack.repairs)


def test_a_missing_face_is_no_loop(tmp_path):
    path = written(tmp_path / "m.obj", VEST.vertices, np.delete(VEST.faces, len(VEST.faces) // 2, axis=0))
    vest = Garment.from_mesh(path, loops="auto")
    assert set(vest.loop_names) == {"hem", "neck", "arm 1", "arm 2"}
    assert any("too small for a rod" in words for words in vest.repairs)
    assert len(Garment.from_mesh(path, loops="borders").loops) == 5


def test_missing_faces_make_no_outline_of_a_disc_and_no_tube_of_a_ring_a_loop(tmp_path):
    """A disc and a ring without a face, and an apron without the faces around a vertex."""
    vertices, faces = tube([0.01, 0.1, 0.2, 0.3, 0.4], 0.05)
    bottom = np.array([[0, (i + 1) % 24, i] for i in range(1, 23)])
    disc = np.delete(np.concatenate([faces, bottom]), 70, axis=0)
    hat = Garment.from_mesh(written(tmp_path / "disc.obj", vertices, disc), loops="auto")
    assert hat.loops == ()
    assert any("no rod can go through it" in words for words in hat.repairs)

    ring = trimesh.creation.torus(0.2, 0.03, major_sections=24, minor_sections=8)
    path = written(tmp_path / "ring.obj", ring.vertices, np.delete(ring.faces, 50, axis=0))
    assert len(Garment.from_mesh(path, loops="auto").loops) == 1

    apron = WARDROBE["apron"]()
    away = np.linalg.norm(apron.vertices - apron.vertices.mean(axis=0), axis=1)
    star = (apron.faces == np.argmin(away)).any(axis=1)
    path = written(tmp_path / "apron.obj", apron.vertices, apron.faces[~star])
    assert Garment.from_mesh(path, loops="auto").loop_names == ("neck",)


def test_an_open_front_is_reported(tmp_path):
    middle = VEST.vertices[VEST.faces].mean(axis=1)
    strip = (np.abs(middle[:, 0]) < 0.05) & (middle[:, 1] < 0)
    path = written(tmp_path / "waistcoat.obj", VEST.vertices, VEST.faces[~strip])
    waistcoat = Garment.from_mesh(path, loops="auto")
    assert any("open front" in words for words in waistcoat.repairs)
    assert waistcoat.loop_names == ("arm 1", "arm 2")
    whole = written(tmp_path / "vest.obj", VEST.vertices, VEST.faces)
    assert not any("open front" in words for words in Garment.from_mesh(whole, loops="auto").repairs)


def test_far_from_the_origin(tmp_path):
    mesh = Mesh(APRON)
    mesh.vertices += [3e5, -2e5, 1e4]
    loaded = load(mesh.obj(tmp_path / "apron.obj"), mesh)
    assert np.abs(loaded.vertices).max() < 1
    np.testing.assert_allclose(loaded.edge_lengths, APRON.edge_lengths, atol=1e-8)
    assert "from the origin" in loaded.repairs[-1]


def test_a_moebius_strip_is_said_to_have_one_side(tmp_path):
    n, width = 60, 5
    angle = 2 * np.pi * np.arange(n) / n
    across = np.linspace(-0.1, 0.1, width)
    radius = 0.4 + across * np.cos(angle / 2)[:, None]
    rows = np.stack(
        [radius * np.cos(angle)[:, None], across * np.sin(angle / 2)[:, None], radius * np.sin(angle)[:, None]]
    )
    number = np.arange(n * width).reshape(n, width)
    after = np.vstack([number[1:], number[:1, ::-1]])
    faces = [
        [a, b, c, d] for x, y in zip(number, after, strict=True) for a, b, c, d in zip(x, x[1:], y[1:], y, strict=False)
    ]
    mesh = Mesh(APRON)
    mesh.vertices, mesh.polygons = rows.reshape(3, -1).T, faces
    loaded = Garment.from_mesh(mesh.obj(tmp_path / "strip.obj"), loops=[number[:, 2]])
    assert any("one side" in repair for repair in loaded.repairs)
    assert len(loaded.loops[0]) == n


def cyclic(ids: np.ndarray) -> list[int]:
    """A cycle from its smallest vertex on, in the direction of the smaller neighbour."""
    at = int(np.argmin(ids))
    one = np.roll(ids, -at).tolist()
    return min(one, [one[0], *one[:0:-1]])


def test_loops_in_disorder_or_with_gaps_become_the_cycle(tmp_path):
    path = Mesh(TOTE).obj(tmp_path / "tote.obj")
    true, rng = TOTE.loops[0], np.random.default_rng(1)
    shuffled = Garment.from_mesh(path, loops=[rng.permutation(true)])
    assert cyclic(shuffled.loops[0]) == cyclic(true)
    assert "found by persistence" in shuffled.repairs[-2]
    gaps = Garment.from_mesh(path, loops=[np.delete(true, [3, 4, 10])])
    assert cyclic(gaps.loops[0]) == cyclic(true)
    assert "2 gaps" in gaps.repairs[-2]
    doubled = Garment.from_mesh(path, loops=[np.repeat(true, 2)])
    assert cyclic(doubled.loops[0]) == cyclic(true)
    # A band of vertices on both sides of the loop, as some data sets give it: the cycle runs within it.
    edges = TOTE.edges
    near = np.unique(edges[np.isin(edges, true).any(axis=1)])
    band = near[TOTE.vertices[near, 1] < 0]
    cycle = Garment.from_mesh(path, loops=[band]).loops[0]
    assert set(cycle.tolist()) <= set(band.tolist())
    curve, through = TOTE.vertices[cycle], TOTE.vertices[true].mean(axis=0)
    needle = np.array([through + [0, -1, 0], through + [0, 1, 0], through + [3, 1, 0], through + [3, -1, 0]])
    assert abs(tk.linking_number(curve, needle)) == 1


def test_borders_are_loops_on_request(tmp_path):
    shirt = WARDROBE["shirt"](spacing=0.05)
    loaded = Garment.from_mesh(Mesh(shirt).obj(tmp_path / "shirt.obj"), loops="borders")
    assert sorted(map(cyclic, loaded.loops)) == sorted(map(cyclic, shirt.loops))
    assert cyclic(loaded.loops[0]) == cyclic(shirt.loops[3])  # the hem is the longest


NAMED = {
    "apron": ["neck"],
    "apron2": ["waist", "neck"],
    "tote": ["handle 1", "handle 2"],  # the two borders of a ring: either is around its hole
    "tote2": ["handle 1", "handle 2"],
    "backpack": ["strap 1", "strap 2"],
    "shirt": ["hem", "neck", "arm 1", "arm 2"],
    "vest": ["hem", "neck", "arm 1", "arm 2"],
    "mask": ["ear 1", "ear 2"],
    "sheet": ["hole"],
    "sheet2": ["hole 1", "hole 2"],
    "trousers": ["leg 1", "leg 2", "loop", "waist"],
}


@pytest.mark.parametrize("name", NAMED)
def test_loops_that_nobody_marked_are_found_and_named(tmp_path, name):
    """By place and size alone: the name of the file says nothing."""
    garment = WARDROBE[name](spacing=0.025 if name == "mask" else 0.05)
    path = Mesh(garment).obj(tmp_path / "mesh.obj")
    loaded = Garment.from_mesh(path, loops="auto")
    assert sorted(loaded.loop_names) == sorted(NAMED[name])
    borders = Garment.from_mesh(path, loops="borders")
    assert sorted(set(borders.loop_names) - set(NAMED[name])) in ([], ["edge"])


def plate(rows: int, columns: int, *empty: tuple[slice, slice]) -> tuple[np.ndarray, list[list[int]]]:
    """A grid of squares of 4 cm in the plane y = 0, the top row first, without some of them."""
    filled = np.ones((rows, columns), bool)
    for cells in empty:
        filled[cells] = False
    corners = np.argwhere(filled)[:, None] + [[0, 0], [1, 0], [1, 1], [0, 1]]
    ids, faces = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    return np.column_stack([0.04 * ids[:, 1], np.zeros(len(ids)), -0.04 * ids[:, 0]]), faces.reshape(-1, 4).tolist()


@pytest.mark.parametrize(
    ("mesh", "names"),
    [
        (plate(12, 12, np.s_[1:11, 1:11]), ["loop"]),  # a ring
        (plate(30, 12, np.s_[1:11, 1:11], np.s_[12:, :5], np.s_[12:, 7:]), ["loop"]),  # a noose on a rope
        (plate(14, 14, np.s_[1:3, 2:4], np.s_[1:3, 10:12], np.s_[11:13, 6:8]), ["hole 1", "hole 2", "hole 3"]),
        (plate(20, 12, np.s_[1:8, 4:8]), ["neck"]),
    ],
)
def test_what_is_no_part_of_a_garment_gets_a_neutral_name(mesh, names, tmp_path):
    path = written(tmp_path / "mesh.obj", *mesh)
    assert sorted(Garment.from_mesh(path, loops="auto", up="z").loop_names) == names


SEEN = {  # what a person sees, or a name that says nothing
    "summer dress": ["arm 1", "arm 2", "hem", "neck"],
    "tank top of cubes": ["arm 1", "arm 2", "hem", "neck"],
    "towel": ["loop"],
    "rope ring": ["loop"],
    "decimated scarf": ["loop 1", "loop 2"],
    "solid apron": ["loop"],
    "apron of few quads": ["neck"],
    "backpack of few quads": ["strap 1", "strap 2"],
}


@pytest.mark.parametrize("name", SEEN)
def test_garments_of_others_get_no_false_name(name, tmp_path):
    (stranger,) = (stranger for stranger in strangers() if stranger.name == name)
    assert sorted(Garment.from_mesh(stranger.write(tmp_path), loops="auto").loop_names) == SEEN[name]


@pytest.mark.parametrize("name", ["shirt", "vest"])
def test_a_dressed_shirt_is_judged_by_names_and_not_by_the_order_of_its_borders(tmp_path, name):
    dummy = Mannequin()
    loaded = Garment.from_mesh(Mesh(WARDROBE[name]()).obj(tmp_path / "my_top.obj"), loops="borders")
    assert loaded.loop_names[0] == "hem"
    worn = loaded.vertices + [0, dummy.distance, dummy.shoulder_height + 0.05]
    task = TASKS[f"{name}-mannequin"]
    assert task.needed(loaded.named_loops) == 2
    assert task.succeeds(worn, loaded.named_loops)
    assert not task.succeeds(worn - [0, 0.5, 0], loaded.named_loops)  # before the mannequin


def test_a_bag_whose_rim_is_the_longest_border_hangs_by_its_handles(tmp_path):
    hook = Hook()
    bag = Garment.from_mesh(Mesh(WARDROBE["tote"](handles=2)).obj(tmp_path / "bag.obj"), loops="borders")
    assert bag.loop_names[0] == "edge"
    over = hook.seat - bag.vertices[bag.loops[1]].mean(axis=0)
    for task in (TASKS["tote2-hook"], Task.of(bag, hook, ("handle 1", "handle 2"))):
        assert task.succeeds(bag.vertices + over, bag.named_loops)
        moved = bag.vertices + over - [0, 0.12, 0]  # one handle beyond the tip
        assert task.succeeds(moved, bag.named_loops) == (task.name != "tote2-hook")
        assert not task.succeeds(bag.vertices + over + [0.6, 0, 0], bag.named_loops)


def test_loops_may_be_given_by_name(tmp_path):
    mesh = Mesh(TOTE)
    front, back = mesh.loops
    loaded = Garment.from_mesh(mesh.obj(tmp_path / "bag.obj"), loops={"handle 2": back, "handle 1": front[::2]})
    assert loaded.loop_names == ("handle 2", "handle 1")
    assert cyclic(loaded.named_loops["handle 1"]) == cyclic(front)
    with pytest.raises(ValueError, match=r"loops\['strap'\] names vertex 99999"):
        Garment.from_mesh(tmp_path / "bag.obj", loops={"strap": [0, 1, 99999]})


def closed(path: Path, tube: float) -> Path:
    """A ring of that tube without any border, or a ball when it has none."""
    solid = trimesh.creation.torus(0.3, tube, 40, 12) if tube else trimesh.creation.icosphere(2, 0.3)
    path.write_bytes(solid.export(file_type="stl"))
    return path


def test_closed_solids_are_refused_and_closed_straps_are_not(tmp_path):
    ball, ring = closed(tmp_path / "ball.stl", 0), closed(tmp_path / "ring.stl", 0.06)
    for path, loops in ((ball, ()), (ball, "auto"), (ball, "borders"), (ring, "borders")):
        with pytest.raises(ValueError, match="closed solid"):
            Garment.from_mesh(path, loops=loops)
    # The loop around its tube has no way through: only the one around its hole is left.
    found = Garment.from_mesh(ring, loops="auto", up="z")
    (loop,) = found.loops
    axis = [[0, 0, -1], [0, 0, 1], [5, 0, 1], [5, 0, -1]]
    assert abs(tk.linking_number(found.vertices[loop], axis)) == 1


def test_borders_that_touch_are_taken_apart(tmp_path):
    """Two faces that meet at an inner vertex are cut out: two triangular holes."""
    sheet = WARDROBE["sheet"](spacing=0.05)
    inner = int(np.argmin(np.linalg.norm(sheet.vertices - [0, 0, -0.37], axis=1)))
    around = [face for face in sheet.faces.tolist() if inner in face]
    other = next(face for face in around if set(face) & set(around[0]) == {inner})
    mesh = Mesh(sheet)
    mesh.polygons = [face for face in mesh.polygons if face not in (around[0], other)]
    loops = Garment.from_mesh(mesh.obj(tmp_path / "sheet.obj"), loops="borders").loops
    assert {frozenset(around[0]), frozenset(other)} <= {frozenset(loop.tolist()) for loop in loops}
    assert len(loops) == 4


def test_grips_are_chosen_near_the_top_and_said(tmp_path):
    sheet = WARDROBE["sheet"](spacing=0.05)
    loaded = Garment.from_mesh(Mesh(sheet).obj(tmp_path / "sheet.obj"))
    assert set(loaded.grips.tolist()) == set(sheet.grips.tolist())
    assert any("taken for grips" in repair for repair in loaded.repairs)
    triangle = written(tmp_path / "triangle.obj", [[0, 0, 0], [0, 0, 1], [0, 0.1, 0.5]], [[0, 1, 2]])
    assert len(set(Garment.from_mesh(triangle).grips.tolist())) == 2


def test_repairs_are_logged(tmp_path, caplog):
    mesh = Mesh(APRON)
    mesh.add_button()
    with caplog.at_level(logging.WARNING, logger="topokit"):
        path = mesh.obj(tmp_path / "apron.obj")
        loaded = load(path, mesh)
        load(path, mesh)  # as each film of a dataset does: nothing is said twice
    assert [record.getMessage().split(": ", 1)[1] for record in caplog.records] == list(loaded.repairs)


def test_a_wider_weld_joins_what_a_gap_parts(tmp_path):
    left = np.array([[0, 0, 0], [0.5, 0, 0], [0.5, 0, 0.5], [0, 0, 0.5]])
    path = written(tmp_path / "two.obj", [*left, *(left + [0.501, 0, 0])], [range(4), range(4, 8)])
    with pytest.raises(ValueError, match=r"2 components"):
        Garment.from_mesh(path)
    assert len(Garment.from_mesh(path, weld=0.002).vertices) == 6


def test_what_hangs_by_a_vertex_is_not_part_of_the_garment(tmp_path):
    """PyBullet would never return from loading it."""
    mesh = Mesh(APRON)
    tip = int(np.argmax(APRON.vertices[:, 2]))
    mesh.vertices = np.vstack([mesh.vertices, mesh.vertices[tip] + [[0.02, 0, 0.02], [-0.02, 0, 0.02]]])
    mesh.polygons.append([tip, len(mesh.vertices) - 2, len(mesh.vertices) - 1])
    loaded = load(mesh.obj(tmp_path / "apron.obj"), mesh)
    assert len(loaded.vertices) == len(APRON.vertices)
    assert "1 smaller components" in loaded.repairs[0]
    with pytest.raises(ValueError, match="2 components"):
        Garment("apron", mesh.vertices, np.array(mesh.polygons), (), APRON.grips)


def test_a_vertex_far_off_does_not_weld_the_rest(tmp_path):
    mesh = Mesh(APRON)
    mesh.vertices[0] = [1e6, 0, 0]
    assert len(load(mesh.obj(tmp_path / "apron.obj"), mesh).vertices) == len(APRON.vertices)


def test_a_very_short_edge_is_said(tmp_path):
    mesh = Mesh(APRON)
    a, b = mesh.polygons[30][:2]
    mesh.vertices[a] = mesh.vertices[b] + [0, 1e-4, 0]
    assert f"vertices {min(a, b)} and {max(a, b)}" in load(mesh.obj(tmp_path / "a.obj"), mesh).repairs[-1]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"loops": [[0, 1, 99999]]}, r"loops\[0\] names vertex 99999"),
        ({"loops": [[0, 1, -1]]}, r"loops\[0\] names vertex -1"),
        ({"loops": [[0.5, 1, 2]]}, r"loops\[0\]"),
        ({"loops": [[]]}, r"loops\[0\]"),
        ({"loops": [0, 1, 2]}, "list of lists"),
        ({"loops": [[6, 7, 6]]}, r"loops\[0\] .* 2 different vertices"),
        ({"loops": [[0, 1, 2]]}, r"loops\[0\] names vertex 0"),
        ({"loops": "holes"}, "'borders'"),
        ({"grips": [0, 20]}, "grips names vertex 0"),
        ({"grips": [20]}, "two vertex ids"),
        ({"grips": [20, 20]}, "one vertex"),
        ({"up": "w"}, "up"),
        ({"size": 1.0, "scale": 1.0}, "size or scale"),
        ({"size": -1.0}, "size"),
        ({"weld": 0.0}, "weld"),
        ({"max_vertices": 12}, "12 vertices are not enough"),
    ],
)
def test_options_that_are_refused(tmp_path, options, says):
    mesh = Mesh(APRON)
    mesh.add_button()
    with pytest.raises((TypeError, ValueError), match=says):
        Garment.from_mesh(mesh.obj(tmp_path / "apron.obj"), **options)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
def test_a_file_of_far_too_many_vertices_is_refused_before_it_is_cleaned(tmp_path, suffix):
    path = tmp_path / f"dense{suffix}"
    trimesh.Trimesh(APRON.vertices, APRON.faces, process=False).export(path)
    with pytest.raises(ValueError, match="more than 60 vertices"):
        Garment.from_mesh(path, max_vertices=2)


def test_a_loop_with_a_wide_gap_is_refused_naming_its_ends(tmp_path):
    path = Mesh(APRON).obj(tmp_path / "apron.obj")
    half = APRON.loops[0][: len(APRON.loops[0]) // 2]
    with pytest.raises(ValueError, match=rf"loops\[0\].* {half[-1]} and {half[0]} follow each other"):
        Garment.from_mesh(path, loops=[half])
    nowhere = [int(np.argmin(APRON.vertices @ way)) for way in ([1, 0, 1], [-1, 0, 1], [0, 0, 1])]
    with pytest.raises(ValueError, match=r"loops\[0\] cannot be followed"):
        Garment.from_mesh(path, loops=[nowhere])


def hold(garment: Garment, steps: int) -> np.ndarray:
    """Frames of a garment held by its grips, one in 50 steps."""
    lift = np.array([0.0, 0.0, 3.0])
    frames = []
    with World(garment, lift, SimulationConfig()) as world:
        for step in range(steps):
            world.step(garment.vertices[garment.grips] + lift)
            if step % 50 == 49:
                frames.append(world.vertices())
    return np.array(frames)


def stretch(garment: Garment, points: np.ndarray) -> float:
    """99th percentile of edge length over rest length."""
    ends = points[garment.edges]
    return float(np.percentile(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / garment.edge_lengths, 99))


def test_what_is_let_through_does_not_make_the_engine_hang_or_explode(tmp_path):
    mesh = Mesh(TOTE)
    for name in SHAPES_FIRST:
        getattr(mesh, name)()
    loaded = load(mesh.obj(tmp_path / "tote.obj"), mesh)
    assert stretch(loaded, hold(loaded, 300)[-1]) < 1.3


MESHES = os.environ.get("TOPOKIT_MESHES", "")


@pytest.mark.skipif(not MESHES, reason="TOPOKIT_MESHES does not name a folder with meshes and their loops.json")
def test_meshes_of_others_load_hang_and_are_tracked():
    for name, about in json.loads((Path(MESHES) / "loops.json").read_text()).items():
        grips = np.ravel(about["anchors"])
        garment = Garment.from_mesh(Path(MESHES) / name, loops=about["loops"], grips=grips)
        frames = hold(garment, 2000)
        assert stretch(garment, frames[-1]) < 1.3
        present = np.sum([truth.present for truth in true_loops(frames, garment.loops)], axis=0)  # straps draw together
        tracks = [track for track in summarise_tracks(tk.track(frames), frames, garment.loops) if track.distance < 0.15]
        found = {track.true_loop for track in tracks if track.frames >= 0.8 * present[track.true_loop]}
        assert found == set(np.flatnonzero(present).tolist()) == set(range(len(garment.loops))), name


def test_ear_loops_and_straps_are_held_in_their_middle(tmp_path):
    backpack = WARDROBE["backpack"](spacing=0.05)
    loaded = Garment.from_mesh(written(tmp_path / "b.obj", backpack.vertices, backpack.faces), loops="auto")
    assert set(loaded.loop_names) == {"strap 1", "strap 2"}
    for grip in loaded.vertices[loaded.grips]:  # as far out as the straps go, within an edge
        assert abs(grip[0]) > np.abs(backpack.vertices[:, 0]).max() - 0.08
    # A mask whose ear loops are above each other is held at its upper one.
    mask = WARDROBE["mask"](spacing=0.025)
    loaded = Garment.from_mesh(written(tmp_path / "m.obj", mask.vertices, mask.faces), loops="auto")
    assert (loaded.vertices[loaded.grips, 2] > mask.vertices[:, 2].max() - 0.12).all()


def test_a_bag_is_held_above_the_middle_of_each_strap(tmp_path):
    strap = [[-0.3, 0], [-0.29, 0.31], [-0.1, 0.3], [0.0, 0.3], [0.1, 0.3], [0.3, 0.3], [0.3, 0]]
    vertices = [[side, y, z] for side in (-0.2, 0.2) for y, z in strap]
    polygons = [[k, (k + 1) % 7, (k + 1) % 7 + 7, k + 7] for k in range(7)]
    path = written(tmp_path / "bag.obj", vertices, polygons)
    bag = Garment.from_mesh(path, loops={"strap 1": range(7), "strap 2": range(7, 14)}, up="z")
    assert bag.grips.tolist() == [3, 10]  # not the corner, though that is a centimetre higher
