"""Cloth looks like cloth: light and shade, the check that folds with it, seams, the shadow; in stills and in the player."""

import json
import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from scipy.spatial.distance import pdist

import topokit as tk
from topokit import view
from topokit.io import Episode
from topokit.sim import WARDROBE
from topokit.view import _looks, _plots, _render
from topokit.view._plots import CLOTH, LINING, Scene, direction

from pages import needs_node, page_data

ROWS, COLUMNS, STEP = 13, 9, 0.05


def sheet(depth=lambda along: 0 * along):
    """A hanging sheet of 0.4 by 0.6 m as a grid, moved towards or from the eye along its width: (N, 3) and (F, 3)."""
    i, j = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    x, z = i.ravel() * STEP, 1 - j.ravel() * STEP
    a = (np.arange(ROWS - 1)[:, None] * COLUMNS + np.arange(COLUMNS - 1)).ravel()
    b, c, d = a + COLUMNS, a + 1, a + COLUMNS + 1
    even = ((a // COLUMNS + a % COLUMNS) % 2 == 0)[:, None]  # the diagonals alternate
    one = np.where(even, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    other = np.where(even, np.column_stack([c, b, d]), np.column_stack([a, d, c]))
    faces = np.concatenate([one, other])
    return np.column_stack([x, depth(x), z]), faces


def roof():
    """The sheet folded at 90 degrees along its vertical middle, which is nearest to an eye at azimuth -90."""
    points, faces = sheet()
    far = points[:, 0] - 0.2
    return np.column_stack([far / np.sqrt(2), abs(far) / np.sqrt(2), points[:, 2]]), faces


def episode(points, faces, frames=2):
    many = np.repeat(points[None].astype(np.float32), frames, axis=0)
    ends = many[:, :2]
    return Episode(
        points=many,
        observed=many,
        actions=ends,
        grippers=ends,
        held=np.ones(frames, bool),
        faces=faces.astype(np.int32),
        loops=(),
        centre_line=np.zeros((0, 3), np.float32),
        garment="sheet",
        target="nothing",
        success=False,
        seed=0,
        dt=0.04,
    )


# ---- what is drawn on the cloth


def checks(points, faces):
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return _looks.checks(points, np.unique(edges, axis=0))


def test_the_check_of_a_flat_sheet_is_nearly_its_pattern():
    points, faces = sheet()
    places = checks(points, faces)
    ratio = pdist(places) / pdist(points)
    assert np.quantile(ratio, 0.95) < 1.35 * np.quantile(ratio, 0.05)  # ways along edges are longer, most of all across
    assert np.corrcoef(places[:, 0], points[:, 2])[0, 1] ** 2 > 0.98  # its longest way is down
    assert np.corrcoef(places[:, 1], points[:, 0])[0, 1] ** 2 > 0.98


def test_the_check_stays_on_the_cloth_when_it_folds():
    flat, faces = sheet()
    folded, _ = roof()
    before, after = checks(flat, faces), checks(folded, faces)
    np.testing.assert_allclose(pdist(after), pdist(before), rtol=0.05, atol=0.1)


@pytest.mark.parametrize("name", ["vest", "tote2"])
def test_the_check_of_a_bag_runs_up_and_across_on_both_sides(name):
    garment = WARDROBE[name]()
    places, points = checks(garment.vertices, garment.faces), garment.vertices
    assert abs(np.corrcoef(places[:, 0], points[:, 2])[0, 1]) > 0.95
    assert abs(np.corrcoef(places[:, 1], points[:, 0])[0, 1]) > 0.95


def test_a_line_of_the_print_crosses_a_face_where_it_should():
    points, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]]), np.array([[0, 1, 2]])
    face, ends = _looks.print_lines(np.array([[0.5], [1.5], [0.5]]), faces)
    assert face.tolist() == [0]
    assert sorted((ends @ points[faces[face]])[0].tolist()) == [[0.5, 0.0, 0.0], [0.5, 1.0, 0.0]]
    assert len(_looks.print_lines(np.array([[0.2], [0.4], [0.6]]), faces)[0]) == 0


def test_seams_are_the_border_and_the_sharp_folds_of_cloth_at_rest():
    points, faces = roof()
    border = 2 * (ROWS - 1) + 2 * (COLUMNS - 1)
    assert [len(_looks.cloth_marks(points, faces, smooth=smooth)[1][0]) for smooth in (False, True)] == [
        border,
        border + ROWS - 1,
    ]
    face, ends, _ = _looks.cloth_marks(points, faces, smooth=True)[1]
    lines = ends @ points[faces[face]]
    np.testing.assert_allclose(np.linalg.norm(np.diff(lines, axis=1), axis=-1), STEP)
    assert (np.abs(lines[..., 0]).max(axis=1) < 1e-9).sum() == ROWS - 1
    assert len(_looks.cloth_marks(sheet()[0], faces, smooth=True)[1][0]) == border


def test_a_mesh_of_no_size_has_no_check():
    faces = np.array([[0, 1, 2]])
    for points in (np.zeros((3, 3)), np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2]])):
        (face, ends, _), _ = _looks.cloth_marks(points, faces, smooth=True)
        assert np.isfinite(ends).all()
        assert len(face) < 3


def test_smooth_normals_are_nearer_to_those_of_a_cylinder():
    points, faces = sheet(lambda x: -np.sqrt(0.06 - (x - 0.2) ** 2))
    corners = points[faces]
    flat = _looks.face_normals(corners)
    middle = corners.mean(axis=1)[:, :2] - [0.2, 0.0]
    inner = abs(middle[:, 0]) < 0.14  # a face at the border has neighbours on one side
    true = (middle / np.linalg.norm(middle, axis=1, keepdims=True))[inner]
    off = [1 - abs((normals[inner, :2] * true).sum(axis=1)).mean() for normals in (flat, _looks.smoothed(flat, faces))]
    assert off[1] < 0.5 * off[0]


# ---- the shadow


def test_a_shadow_lies_below_the_cloth_fainter_and_wider_the_higher_it_hangs():
    points, _ = sheet()
    (low, dark), (high, faint) = (_looks.shadow(points + [3, 0, z - 0.4]) for z in (0.0, 0.5))
    np.testing.assert_allclose(low.mean(axis=(0, 1)), [3.2, 0, 0], atol=1e-9)
    assert dark > 1.5 * faint > 0
    sizes = np.ptp(low[0], axis=0), np.ptp(high[0], axis=0)
    assert (sizes[1] > sizes[0])[:2].all()
    assert sizes[0][0] > 0.4  # the sheet's width
    assert (np.diff(np.ptp(low, axis=1)[:, :2], axis=0) < 0).all()  # each in the one before
    assert not len(_looks.shadow(points - [0, 0, 1])[0])  # z = 0 is no floor of this one
    assert not len(_looks.shadow(np.zeros((0, 3)))[0])


# ---- stills


def test_what_faces_the_lamp_is_lighter_and_the_inner_side_a_shade_darker():
    look = (-90.0, 0.0)
    turned = np.array([direction(azimuth, 20) for azimuth in (-125, -90, -20)])
    colours = _plots._shaded(turned, CLOTH, look).sum(axis=1)
    assert colours[0] > colours[1] > colours[2] + 0.3
    points, faces = sheet()
    (_, front), (_, back) = (next(_plots._cloth(Scene(points, order, view=look))) for order in (faces, faces[:, ::-1]))
    ratio = sorted(to_rgb(colour) for colour in (LINING, CLOTH))
    np.testing.assert_allclose(
        np.minimum(front, back) / np.maximum(front, back), np.tile(np.divide(*ratio), (len(faces), 1))
    )
    assert sum(to_rgb(LINING)) < sum(to_rgb(CLOTH))


def test_lines_on_the_cloth_are_darker_than_the_face_they_lie_on():
    points, faces = sheet()
    scene = Scene(points, faces, view=(-90.0, 0.0))
    (corners, colours), *lines = _plots._cloth(scene)
    np.testing.assert_allclose(corners, points[faces])
    for (drawn, ink), (face, _, bright) in zip(lines, scene.marks, strict=True):
        assert len(drawn) == len(ink) == len(face) > 30
        np.testing.assert_allclose(ink, bright * colours[face])
        assert bright < 0.9


@pytest.mark.parametrize("way", ["matplotlib", "pyvista"])
def test_a_fold_is_light_on_the_lamp_s_side_and_dark_on_the_other(way, monkeypatch):
    works, reason = view.pyvista_works()
    if way == "pyvista" and not works:
        pytest.skip(reason)
    monkeypatch.setattr(_render, "pyvista_works", lambda: (way == "pyvista", "not asked for"))
    points, faces = roof()
    pixels = np.asarray(view.render_cloth(points, faces, size=(200, 240), view=(-90.0, 0.0))).astype(float).mean(axis=2)
    left, right = (np.median(pixels[90:150, columns]) for columns in (slice(60, 95), slice(105, 140)))
    assert left > right + 10
    assert np.quantile(pixels[90:150, 60:95], 0.02) < left - 10  # the check


def test_the_cloth_at_rest_has_as_many_points():
    points, faces = sheet()
    with pytest.raises(ValueError, match="rest has 116 points where the cloth has 117"):
        Scene(points, faces, rest=points[1:])


def test_the_floor_s_shadow_is_drawn_first_and_only_on_a_floor():
    points, faces = sheet()
    for down, expected in ((0.0, 2), (2.0, 1)):
        axes = Figure().add_subplot(projection="3d")
        view.plot_cloth(points - [0, 0, down], faces, ax=axes)
        assert len(axes.collections) == expected
        if expected == 2:
            assert axes.collections[0].get_zorder() < axes.collections[1].get_zorder()


# ---- the player

FAKE = """
const fills = [], shadows = [];
const gradient = (kind) => {
  const made = { stops: [], addColorStop(at, colour) { made.stops.push(colour); } };
  if (kind === "radial") shadows.push(made);
  return made;
};
const idle = "scale stroke closePath rect arc fillRect fillText save restore transform setLineDash".split(" ");
const context = () => {
  let path = [];
  return {
    ...Object.fromEntries(idle.map((name) => [name, () => {}])),
    measureText: () => ({ width: 30 }),
    beginPath() { path = []; },
    moveTo(x, y) { path.push([x, y]); },
    lineTo(x, y) { path.push([x, y]); },
    fill() { fills.push([this.fillStyle, path]); },
    createLinearGradient: () => gradient("linear"),
    createRadialGradient: () => gradient("radial"),
  };
};
const nodes = {};
const node = (id) => (nodes[id] ??= {
  style: {}, classList: { toggle() {}, add() {} }, dataset: {}, clientWidth: 400, clientHeight: 400, drawing: context(),
  setAttribute() {}, getAttribute: () => "", before() {},
  addEventListener() {}, closest: () => ({}), getContext() { return this.drawing; },
});
node("data").textContent = TEXT;
globalThis.document = {
  getElementById: node, documentElement: node("root"), body: node("body"), querySelector: () => node("caption"),
  createElement: node,
};
globalThis.parent = globalThis.window = globalThis;
globalThis.matchMedia = () => ({ matches: DARK, addEventListener() {} });
globalThis.getComputedStyle = () => ({ font: "", getPropertyValue: () => "#123456" });
globalThis.ResizeObserver = class { observe() {} };
globalThis.MutationObserver = class { observe() {} };
globalThis.devicePixelRatio = 1;
globalThis.addEventListener = () => {};
globalThis.requestAnimationFrame = setImmediate;
process.on("exit", () => console.log(JSON.stringify({ fills, shadows })));
"""


def drawn(points, faces, dark=False):
    """The triangles that the player fills in its first frame, each a colour (3,) and corners (3, 2); and its shadows."""
    one = episode(points, faces)
    page = view.player(one, [tk.TopologicalState(t, 0.0) for t in range(2)], view=(-90.0, 0.5)).page
    script = re.search(r"<script>(.*)</script>", page, re.DOTALL).group(1)
    data = re.search(r'<script id="data"[^>]*>(.*?)</script>', page, re.DOTALL).group(1)
    code = FAKE.replace("TEXT", json.dumps(data)).replace("DARK", json.dumps(dark)) + script
    out = json.loads(subprocess.run(["node", "-"], input=code, capture_output=True, text=True, check=True).stdout)
    triangles = []
    for style, path in out["fills"]:
        if len(path) == 3:
            inks = [style] if isinstance(style, str) else style["stops"]
            mean = np.mean([[int(v) for v in re.findall(r"\d+", ink)] for ink in inks], axis=0)
            triangles.append((mean, np.array(path, dtype=float)))
    return triangles, out["shadows"]


@needs_node
@pytest.mark.parametrize("dark", [False, True])
def test_the_player_lights_the_side_of_a_fold_that_faces_the_lamp(dark):
    points, faces = roof()
    triangles, shadows = drawn(points, faces, dark)
    assert len(triangles) == len(faces)
    colours, corners = (np.array(part) for part in zip(*triangles, strict=True))
    assert np.isfinite(corners).all()
    x = corners[..., 0].mean(axis=1)
    left, right = colours[x < x.mean() - 20], colours[x > x.mean() + 20]
    assert np.median(left.sum(axis=1)) > np.median(right.sum(axis=1)) + 30
    assert len(shadows) == 1  # 40 cm above the floor
    assert not drawn(points - [0, 0, 2], faces)[1]
    inner = np.array([colour for colour, _ in drawn(points, faces[:, ::-1], dark)[0]])
    outer_light, inner_light = (part.sum(axis=1).max() for part in (colours, inner))
    assert abs(outer_light - inner_light) > 20


def test_the_player_holds_the_lines_of_the_first_frame():
    points, faces = sheet()
    one = episode(points, faces)
    marks = page_data(view.player(one, [tk.TopologicalState(t, 0.0) for t in range(2)]))["marks"]
    known = _looks.cloth_marks(one.points[0].astype(float), faces, smooth=True)
    assert [part["face"]["shape"] for part in marks] == [[len(face)] for face, _, _ in known]
    assert [part["ends"]["shape"] for part in marks] == [[len(face), 2, 3] for face, _, _ in known]
    assert [part["bright"] for part in marks] == [bright for _, _, bright in known]
    bare = replace(one, faces=np.zeros((0, 3), np.int32))
    assert page_data(view.player(bare, [tk.TopologicalState(t, 0.0) for t in range(2)]))["marks"] == []
