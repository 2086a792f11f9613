"""Garments of mesh files, measured on surfaces known by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pybullet")

import trimesh

from topokit.linking import close_far, linking_number, side_lengths
from topokit.sim import WARDROBE, Garment, Hook

from conftest import polygon

SHEET = WARDROBE["sheet"]()  # 0.6 by 0.5 m, with a round hole of radius 0.08
CORNERS = SHEET.grips.tolist()


def area_of_polygon(n: int, radius: float) -> float:
    return n / 2 * radius**2 * np.sin(2 * np.pi / n)


def mesh_of(garment: Garment, turn: np.ndarray | None = None) -> trimesh.Trimesh:
    """The mesh of a garment, with its places multiplied by a matrix (3, 3)."""
    vertices = garment.vertices if turn is None else garment.vertices @ turn.T
    return trimesh.Trimesh(vertices, garment.faces, process=False)


def euler(garment: Garment) -> int:
    return len(garment.vertices) - len(garment.edges) + len(garment.faces)


def annulus(n: int, inner: float, outer: float) -> trimesh.Trimesh:
    """A flat ring between two regular polygons."""
    around = np.arange(n)
    after = (around + 1) % n
    flat = np.vstack([outer * polygon(n), inner * polygon(n)])
    faces = np.vstack([np.column_stack([around, after, n + around]), np.column_stack([after, n + after, n + around])])
    return trimesh.Trimesh(np.column_stack([flat, np.zeros(2 * n)]), faces, process=False)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl"])
def test_a_file_in_inches_with_y_up_becomes_the_garment(tmp_path, suffix):
    from_z_to_y = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) / 0.0254
    path = tmp_path / f"cloth{suffix}"
    mesh_of(SHEET, from_z_to_y).export(path)
    # The ids of the two upper corners as the file is read.
    read = trimesh.load_mesh(path)
    grips = [int(np.argmin(np.linalg.norm(read.vertices - from_z_to_y @ SHEET.vertices[i], axis=1))) for i in CORNERS]
    own = Garment.from_mesh(path, up="y", unit=0.0254, grips=grips, loops={"hole": "loop 2"})
    assert own.name == "cloth"
    assert own.loop_names == ("hole",)
    # One vertex at each place, and the same Euler characteristic: a disc with a hole.
    assert len(own.vertices) == len(SHEET.vertices)
    assert euler(own) == 0
    hole = len(SHEET.loops[0])
    assert len(own.loops[0]) == hole
    assert own.area == pytest.approx(0.6 * 0.5 - area_of_polygon(hole, 0.08), rel=1e-3)
    curve = own.vertices[own.loops[0]]
    assert side_lengths(curve).sum() == pytest.approx(2 * hole * 0.08 * np.sin(np.pi / hole), rel=1e-3)
    # The hole is below the middle of the grips, which are as far apart as the sheet is wide.
    np.testing.assert_allclose(curve.mean(axis=0), [0, 0, -0.16], atol=1e-3)
    np.testing.assert_allclose(own.vertices[own.grips], [[-0.3, 0, 0], [0.3, 0, 0]], atol=1e-5)
    assert own.length == pytest.approx(0.5 - 0.16 + 0.08, abs=1e-3)


@pytest.mark.parametrize("sign", ["", "-"])
@pytest.mark.parametrize("axis", range(3))
def test_any_axis_may_be_up(sign, axis):
    turn = np.zeros((3, 3))
    turn[[(axis + 1) % 3, (axis + 2) % 3, axis], range(3)] = 1  # z becomes the axis, without a reflection
    if sign:
        turn = turn @ np.diag([1, -1, -1])
    vest = WARDROBE["vest"](spacing=0.06)
    own = Garment.from_mesh(mesh_of(vest, turn), up=sign + "xyz"[axis], unit=1.0, grips=vest.grips)
    moved = vest.vertices - vest.vertices[vest.grips].mean(axis=0)
    np.testing.assert_allclose(own.vertices, moved, atol=1e-12)


def test_the_first_grip_is_on_the_left_and_the_size_is_the_largest_extent():
    quarter_turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    own = Garment.from_mesh(mesh_of(SHEET, quarter_turn), up="z", size=1.2, grips=CORNERS[::-1], loops={})
    np.testing.assert_allclose(own.vertices[own.grips], [[-0.6, 0, 0], [0.6, 0, 0]], atol=1e-12)
    assert own.parameters == {"scale": pytest.approx(2.0)}
    assert own.length == 0.0  # it has no loop
    assert own.area == pytest.approx(4 * SHEET.area)


def test_vertices_at_one_place_become_one_and_loops_may_name_any_of_them():
    whole = mesh_of(SHEET)
    pieces = whole.copy()
    pieces.unmerge_vertices()  # every face has vertices of its own, and there is twice the first face
    pieces = trimesh.util.concatenate([pieces, trimesh.Trimesh(whole.vertices[whole.faces[0]], [[0, 1, 2]])])
    copies = np.argsort(SHEET.faces.ravel(), kind="stable")[::-1]
    last = dict(zip(SHEET.faces.ravel()[copies[::-1]].tolist(), copies[::-1].tolist(), strict=True))
    own = Garment.from_mesh(
        pieces,
        up="z",
        unit=1.0,
        grips=[last[i] for i in CORNERS],
        loops={"hole": [last[i] for i in SHEET.loops[0].tolist()]},
    )
    assert (len(own.vertices), len(own.faces)) == (len(SHEET.vertices), len(SHEET.faces))
    np.testing.assert_allclose(own.vertices[own.loops[0]], SHEET.vertices[SHEET.loops[0]], atol=1e-12)


def test_loops_are_the_borders_the_longest_first():
    loops = Garment.find_loops(annulus(12, 1.0, 3.0))
    assert [*loops] == ["loop 1", "loop 2"]
    assert [sorted(loop.tolist()) for loop in loops.values()] == [[*range(12)], [*range(12, 24)]]
    shirt = WARDROBE["shirt"]()
    found = Garment.find_loops(mesh_of(shirt))
    assert {frozenset(loop.tolist()) for loop in found.values()} == {frozenset(loop.tolist()) for loop in shirt.loops}
    lengths = [side_lengths(shirt.vertices[loop]).sum() for loop in found.values()]
    assert lengths == sorted(lengths, reverse=True)


def test_loops_of_a_closed_surface_are_those_of_persistence():
    assert Garment.find_loops(trimesh.creation.icosphere(subdivisions=2)) == {}
    torus = trimesh.creation.torus(0.3, 0.1, major_sections=32, minor_sections=16)
    along, around = (torus.vertices[loop] for loop in Garment.find_loops(torus).values())
    # One goes once around the axis and the other once around the core.
    axis = close_far(np.array([[0, 0, -1.0], [0, 0, 1.0]]))
    core = 0.3 * np.column_stack([polygon(64), np.zeros(64)])
    assert [abs(linking_number(along, line)) for line in (axis, core)] == [1, 0]
    assert [abs(linking_number(around, line)) for line in (axis, core)] == [0, 1]
    assert side_lengths(along).sum() == pytest.approx(2 * np.pi * 0.2, rel=0.02)  # the shortest way is inside
    assert side_lengths(around).sum() == pytest.approx(2 * np.pi * 0.1, rel=0.02)


@pytest.mark.parametrize(
    ("changes", "error", "named"),
    [
        ({"loops": {"hole": "loop 9"}}, KeyError, "loop 9"),
        ({"loops": {"hole": [0, 1, 10**6]}}, ValueError, "hole"),
        ({"loops": {"hole": SHEET.loops[0][::2]}}, ValueError, "closed cycle"),
        ({"grips": [1, 1]}, ValueError, "grips"),
        ({"unit": 0.0}, ValueError, "unit"),
        ({"unit": None}, TypeError, "unit"),
        (
            {"mesh": trimesh.util.concatenate([annulus(6, 1, 2), annulus(6, 3, 4)]), "grips": [0, 3]},
            ValueError,
            "2 components",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(changes, error, named):
    arguments = {"mesh": mesh_of(SHEET), "up": "z", "unit": 1.0, "grips": CORNERS, **changes}
    with pytest.raises(error, match=named):
        Garment.from_mesh(arguments.pop("mesh"), **arguments)


def test_a_mesh_of_others_hangs_on_a_hook(tmp_path: Path):
    from topokit.sim import simulate

    path = tmp_path / "cloth.obj"
    sheet = WARDROBE["sheet"](spacing=0.06)
    mesh_of(sheet).export(path)
    own = Garment.from_mesh(path, up="z", unit=1.0, grips=sheet.grips, loops={"hole": "loop 2"})
    assert simulate(own, Hook(), seed=1).success
