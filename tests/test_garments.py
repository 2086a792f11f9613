"""The wardrobe: what every garment is as a surface, its true loops, its sizes, and that it hangs still."""

from __future__ import annotations

import functools
import itertools

import gudhi
import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("pybullet")

from topokit import rips_persistence
from topokit.sim import WARDROBE, Garment, SimulationConfig, World

from conftest import polygon

CLASSES = {"apron": 1, "apron2": 2, "tote": 1, "tote2": 2, "backpack": 2, "shirt": 3, "vest": 3, "mask": 2, "sheet": 1}
CLASSES |= {"sheet2": 2, "sheet0": 0, "sheet3": 3, "scarf": 1, "belt": 1, "net": 19}
CUTS = ("shirt", "vest", "net")  # whose loops are one more than their classes
SPACINGS = {"tote": 0.045, "tote2": 0.04, "backpack": 0.045, "mask": 0.025, "belt": 0.024, "net": 0.03}


def coarse(name: str) -> Garment:
    """A garment of the wardrobe at about half its resolution."""
    sizes = {"strap_width": 0.05} if name.startswith("apron") else {}
    return WARDROBE[name](spacing=SPACINGS.get(name, 0.05), **sizes)


def betti(garment: Garment, *filled: np.ndarray) -> list[int]:
    """Betti numbers of a garment after a disc is glued into some of its loops."""
    tree = gudhi.SimplexTree()
    for face in garment.faces.tolist():
        tree.insert(face)
    for i, loop in enumerate(filled):
        for edge in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True):
            tree.insert([*edge, len(garment.vertices) + i])
    tree.compute_persistence(persistence_dim_max=True)
    return tree.betti_numbers()[:3]


@pytest.mark.parametrize("name", WARDROBE)
def test_garment_is_one_two_sided_surface_with_its_classes(name):
    garment = WARDROBE[name]()
    assert garment.name == name
    assert 250 <= len(garment.vertices) <= 1200
    assert betti(garment) == [1, CLASSES[name], 0]
    # Manifold, every pair of neighbours running through its edge in opposite directions.
    directed = garment.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)
    assert np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)[1].max() <= 2


@pytest.mark.parametrize("name", WARDROBE)
def test_triangles_are_of_the_spacing_and_grips_near_the_top(name):
    garment = WARDROBE[name]()
    for cloth in (garment, coarse(name)):
        spacing = cloth.parameters["spacing"]
        assert 0.4 * spacing < cloth.edge_lengths.min() <= cloth.edge_lengths.max() < 2.1 * spacing
        nearest = cKDTree(cloth.vertices).query(cloth.vertices, k=2)[0][:, 1]
        assert nearest.min() > 0.4 * spacing  # nothing starts in contact
    left, right = sorted(garment.vertices[garment.grips].tolist())
    low, high = garment.vertices[:, 2].min(), garment.vertices[:, 2].max()
    assert min(left[2], right[2]) > low + 0.7 * (high - low)
    np.testing.assert_allclose(left * np.array([-1, 0, 1]), right * np.array([1, 0, 1]), atol=0.02)


@pytest.mark.parametrize("name", WARDROBE)
def test_loops_are_the_classes(name):
    """Discs in all loops leave no class; discs in fewer than there are classes leave some."""
    garment = WARDROBE[name]()
    loops = garment.loops
    assert len(loops) == CLASSES[name] + (name in CUTS)
    assert betti(garment, *loops)[1] == 0
    if name in ("shirt", "vest"):  # four openings, any three of them independent
        assert all(betti(garment, *three)[1] == 0 for three in itertools.combinations(loops, 3))
    elif name in CUTS:
        assert betti(garment, *loops[2:])[1] == 1  # without the handle and the rim
        assert betti(garment, loops[0], *loops[2:])[1] == 0  # without the rim


@pytest.mark.parametrize("name", [name for name in WARDROBE if name not in (*CUTS, "belt")])
def test_loops_are_what_persistence_finds(name):
    """As many long bars as classes; a shirt's sleeves are too flat at rest for that."""
    lifetime = rips_persistence(coarse(name).vertices).lifetime
    assert lifetime[CLASSES[name] - 1] > 1.5 * lifetime[CLASSES[name]]


EXTREMES = [
    ("apron", {"spacing": 0.02, "bib_width": 0.5, "body_width": 0.5, "strap_width": 0.03}),
    ("apron2", {"body_height": 0.1, "waist_strap_length": 0.75}),
    ("tote", {"width": 0.8, "height": 0.1, "depth": 0.02, "handle_length": 1.1}),
    ("tote2", {"width": 0.9, "handle_span": 0.7, "handle_length": 1.0, "handle_width": 0.1}),
    ("backpack", {"strap_angle": 80.0, "depth": 0.3, "height": 0.9}),
    ("shirt", {"sleeve_angle": 60.0, "sleeve_length": 0.5, "length": 1.2, "neck_depth": 0.02}),
    ("vest", {"neck_depth": 0.3, "armhole_depth": 0.5, "depth": 0.4}),
    ("mask", {"width": 0.6, "height": 0.1, "strap_span": 0.5, "strap_length": 0.8}),
    ("sheet", {"hole_radius": 0.2, "hole_drop": 0.25}),
    ("sheet3", {"width": 1.0}),
    ("sheet0", {"width": 0.3, "height": 1.4}),  # an open scarf
    ("scarf", {"length": 0.6, "width": 0.1}),
    ("belt", {"length": 0.3, "loop_radius": 0.12, "width": 0.04}),
    ("net", {"width": 0.6, "height": 0.5, "mesh_radius": 0.06, "handle_length": 1.0}),
]
MAKE = {**WARDROBE, **{f"sheet{holes}": functools.partial(WARDROBE["sheet"], holes=holes) for holes in (0, 3)}}


@pytest.mark.parametrize(("name", "sizes"), EXTREMES)
def test_unusual_sizes_keep_the_classes(name, sizes):
    garment = MAKE[name](**sizes)
    assert betti(garment) == [1, CLASSES[name], 0]
    assert betti(garment, *garment.loops)[1] == 0
    assert garment.name == name
    assert garment.edge_lengths.min() > 0.15 * garment.parameters["spacing"]
    assert garment.parameters.items() >= sizes.items()


def test_sizes_are_what_is_measured():
    tote = WARDROBE["tote"](width=0.5, height=0.3, depth=0.12)
    np.testing.assert_allclose(np.ptp(tote.vertices, axis=0)[:2], [0.5, 0.12], atol=0.01)
    assert tote.vertices[:, 2].min() == pytest.approx(-0.3)
    sheet = WARDROBE["sheet"](hole_radius=0.1, hole_drop=0.2)
    np.testing.assert_allclose(np.linalg.norm(sheet.vertices[sheet.loops[0]] + [0, 0, 0.2], axis=1), 0.1, atol=1e-3)


# A pattern and sizes that do not fit; the last is named.
BAD = [
    ("apron", {"bib_width": 0.9}),
    ("apron", {"strap_length": 0.1}),
    ("apron", {"loops": 3}),
    ("apron", {"spacing": 0}),
    ("apron2", {"waist_strap_width": 0.5}),
    ("tote", {"handle_width": 0.34}),
    ("tote2", {"handle_span": 0.35}),
    ("tote", {"width": "wide"}),
    ("tote", {"spacing": 0.3}),
    ("shirt", {"sleeve_length": 0.01}),
    ("sheet", {"hole_radius": 0.02}),
    ("sheet2", {"hole_distance": 0.5, "width": 0.6}),
]


@pytest.mark.parametrize(("name", "sizes"), BAD)
def test_sizes_that_do_not_fit_are_named(name, sizes):
    with pytest.raises((ValueError, TypeError), match=[*sizes][-1]):
        WARDROBE[name](**sizes)


def square(**changes):
    """Two triangles and a loop around them."""
    parts = {
        "name": "square",
        "vertices": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float),
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        "loops": (np.array([0, 1, 2, 3]),),
        "grips": np.array([0, 1]),
    }
    return Garment(**{**parts, **changes})


TWO_PARTS = np.column_stack([np.vstack([polygon(3), polygon(3) + 5]), np.zeros(6)])


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"faces": np.array([[0, 1, 2], [0, 2, 4]])}, "vertex 4"),
        ({"faces": np.array([[0, 1, 2], [0, 2, 2]])}, r"edge \[2, 2\]"),
        ({"faces": np.array([[0, 1, 2]])}, "2 components"),
        ({"vertices": np.zeros((4, 2))}, "vertices"),
        ({"vertices": np.array([[0, 0, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], float)}, r"edge \[0, 1\]"),
        ({"vertices": TWO_PARTS, "faces": np.array([[0, 1, 2], [3, 4, 5]]), "loops": ()}, "2 components"),
        ({"loops": (np.array([0, 1, 3]),)}, r"loops\[0\].*\[0, 1, 3\]"),
        ({"grips": np.array([1, 1])}, "grips"),
        ({"loop_names": ("neck", "hem")}, "loop_names"),
        ({"loops": (np.arange(4), np.arange(4)), "loop_names": ("neck", "neck")}, "loop_names"),
    ],
)
def test_meshes_that_are_no_garment_are_refused(changes, named):
    with pytest.raises(ValueError, match=named):
        square(**changes)


@pytest.mark.parametrize("name", WARDROBE)
def test_garment_hangs_still_between_the_grippers(name):
    garment = coarse(name)
    lift = np.array([0.0, 0.0, 1.5])
    with World(garment, lift, SimulationConfig()) as world:
        for _ in range(400):
            world.step(garment.vertices[garment.grips] + lift)
        points = world.vertices()
        np.testing.assert_allclose(world.grippers(), garment.vertices[garment.grips] + lift, atol=0.02)
    ends = points[garment.edges]
    stretch = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / garment.edge_lengths
    assert np.percentile(stretch, 99) < 1.3
    assert points[:, 2].max() < 1.5 + garment.vertices[:, 2].max() + 0.05
