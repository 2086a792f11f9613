"""A mesh that is made anew for a simulation: its edges are alike, and it is the same surface with the same loops."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("pybullet")
pytest.importorskip("trimesh")

import trimesh

import topokit as tk
from topokit.linking import side_lengths
from topokit.sim import WARDROBE, Garment


def borders(garment: Garment) -> int:
    """Return the number of borders; each is a component of the edges that are in one face."""
    edges = np.sort(garment.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    single = edges[trimesh.grouping.group_rows(edges, require_count=1)]
    return len(trimesh.graph.connected_components(single, nodes=np.unique(single)))


def euler(garment: Garment) -> int:
    return len(garment.vertices) - len(garment.edges) + len(garment.faces)


def shuffled_places(garment: Garment, rng: np.random.Generator) -> Garment:
    """Return a garment whose inner vertices are moved at random: long and thin triangles."""
    vertices = garment.vertices + rng.uniform(-0.33, 0.33, garment.vertices.shape) * np.median(garment.edge_lengths)
    return dataclasses.replace(garment, vertices=vertices)


def finer(garment: Garment) -> Garment:
    """Return a garment each of whose faces is cut into four; its loops name every second vertex of the new borders."""
    vertices, faces = trimesh.remesh.subdivide(garment.vertices, garment.faces)
    middle = {tuple(place): i for i, place in enumerate(vertices.tolist())}
    loops = []
    for loop in garment.loops:
        between = (garment.vertices[loop] + garment.vertices[np.roll(loop, -1)]) / 2
        loops.append(np.column_stack([loop, [middle[tuple(place)] for place in between.tolist()]]).ravel())
    return dataclasses.replace(garment, vertices=vertices, faces=faces, loops=tuple(loops))


CASES = {
    "coarse apron": WARDROBE["apron"](spacing=0.06, strap_width=0.06, bib_width=0.34),
    "coarse vest": WARDROBE["vest"](spacing=0.075),
    "thin triangles": shuffled_places(WARDROBE["apron"](loops=2), np.random.default_rng(1)),
    "fine tote": finer(finer(WARDROBE["tote"](handles=2, spacing=0.045))),
    "narrow handle": WARDROBE["tote"](spacing=0.045, handle_width=0.01),
}


@pytest.mark.parametrize("name", CASES)
def test_a_mesh_made_anew_is_even_and_the_same_surface(name):
    garment = CASES[name]
    even = garment.evened()
    assert even is not garment
    assert (euler(even), borders(even)) == (euler(garment), borders(garment))
    lengths = even.edge_lengths / np.median(even.edge_lengths)
    assert lengths.max() < 2.5
    assert lengths.min() > (0.15 if name == "narrow handle" else 0.35)
    assert len(even.vertices) < 1000
    # The surface, its loops and its grips are where they were, by less than an edge.
    usual = float(np.median(even.edge_lengths))
    assert tk.hausdorff(even.vertices, trimesh.Trimesh(garment.vertices, garment.faces).sample(3000)) < 1.5 * usual
    assert even.loop_names == garment.loop_names
    for loop, old in zip(even.loops, garment.loops, strict=True):
        curve, true = even.vertices[loop], garment.vertices[old]
        assert tk.hausdorff(curve, true) < max(2 * usual, side_lengths(true).max())
    assert np.linalg.norm(even.vertices[even.grips] - garment.vertices[garment.grips], axis=1).max() < usual


def test_the_wardrobe_needs_no_other_mesh():
    for make in WARDROBE.values():
        garment = make()
        assert garment.evened() is garment
