"""Test that the kernel of the pages computes what the library computes, by node."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from topokit import farthest_point_sample, rips_persistence, track
from topokit.io import load_episode
from topokit.sim import WARDROBE

from clouds import FAMILIES, random_cloud
from pages import by_script, needs_node

pytestmark = needs_node
DATA = Path(__file__).parents[1] / "data_small"
SCRIPTS = ["sampling.js", "rips.js", "assign.js", "seqph.js"]

LOOPS = """({ points, d, maxRadius }) => {
  const { persistence, cycle } = ripsKernel(), flat = Float64Array.from(points), n = points.length / d;
  const loops = persistence(flat, n, d, { maxRadius: maxRadius ?? Infinity }), list = (name) => [...loops[name]];
  return { birth: list("births"), death: list("deaths").map((r) => (r === Infinity ? null : r)), birth_edge: list("birthEdges"),
    killer_edge: list("killerEdges"), killer_triangles: list("killerTriangles"),
    cycles: list("births").map((_, i) => [...cycle(flat, n, d, loops, i)]) };
}"""


def pipe() -> np.ndarray:
    """Return two rings of which neither is the one that dies when the pipe between them is filled."""
    turns = np.exp(2j * np.pi * np.arange(16) / 16), 0.8 * np.exp(2j * np.pi * np.arange(12) / 12)
    return np.vstack(
        [np.column_stack([ring.real, ring.imag, np.full(len(ring), 0.6 * k)]) for k, ring in enumerate(turns)]
    )


def clouds_of_all_kinds() -> list[np.ndarray]:
    """Return 500 clouds: ties, repeated points, lines, garments with and without noise, a pipe."""
    rng = np.random.default_rng(11)
    clouds = [pipe()]
    for name, make in WARDROBE.items():
        vertices = make().vertices
        sample = vertices[farthest_point_sample(vertices, 40 + 8 * len(name))[0]]
        clouds += [sample, sample + rng.normal(0, 0.004, sample.shape), rng.permutation(vertices)[:60]]
    while len(clouds) < 500:
        clouds.append(random_cloud(rng, FAMILIES[len(clouds) % len(FAMILIES)], 40)[:, :3])
    return clouds


def given(cloud: np.ndarray, **more: object) -> dict:
    return {"points": cloud.ravel().tolist(), "d": cloud.shape[1], **more}


def test_loops_and_cycles_are_those_of_rips_persistence_to_the_last_bit():
    cases = []
    for k, cloud in enumerate(clouds_of_all_kinds()):
        radius = None
        diagram = rips_persistence(cloud)
        if k % 3 == 0 and len(diagram):  # the filtration stops at a loop's birth or death, or just before
            radius = float([diagram.birth, diagram.death][k % 2][len(diagram) // 2])
            radius = float(np.nextafter(radius, 0)) if k % 4 < 2 else radius
        cases.append((cloud, radius))
    found = by_script(SCRIPTS, LOOPS, [given(cloud, maxRadius=radius) for cloud, radius in cases])
    ended = 0
    for (cloud, radius), answer in zip(cases, found, strict=True):
        diagram = rips_persistence(cloud, max_radius=np.inf if radius is None else radius)
        answer["death"] = [np.inf if death is None else death for death in answer["death"]]
        for name in ("birth", "death", "birth_edge", "killer_edge", "killer_triangles"):
            np.testing.assert_array_equal(
                answer[name], getattr(diagram, name).ravel(), err_msg=f"{name} of {cloud.tolist()}"
            )
        assert answer["cycles"] == [diagram.cycle(i).tolist() for i in range(len(diagram))]
        ended += int(np.isfinite(diagram.death).sum())
    assert ended > 1500


SAMPLE = """({ points, d, k, start }) => {
  const { ids, radii } = farthestPoints(Float64Array.from(points), points.length / d, d, k, start);
  return [[...ids], radii[k - 1]];
}"""


def test_farthest_points_are_those_of_the_library():
    rng = np.random.default_rng(0)
    clouds = [random_cloud(rng, FAMILIES[k % len(FAMILIES)], 60)[:, :3] for k in range(100)]
    cases = [given(cloud, k=int(rng.integers(1, len(cloud) + 1)), start=-(k % 2)) for k, cloud in enumerate(clouds)]
    for cloud, case, answer in zip(clouds, cases, by_script(SCRIPTS, SAMPLE, cases), strict=True):
        ids, radius = farthest_point_sample(cloud, case["k"], None if case["start"] else 0)
        assert answer == [ids.tolist(), radius]


TRACK = """({ frames, d }) => {
  const states = seqphKernel(ripsKernel(), assign).track(frames.map((frame) => Float64Array.from(frame)), d);
  return states.map(({ alpha, epsilon, diagram, loops }) => ({ alpha, epsilon, loops: loops.map(({ id, bar }) => (
    [id, diagram.births[bar], diagram.deaths[bar], ...diagram.killerTriangles.subarray(6 * bar, 6 * bar + 6)])) }));
}"""


def films() -> list[list[np.ndarray]]:
    """Return the films of `data_small`, one with half the points, and some that are made."""
    recorded = [load_episode(DATA / f"apron_hook_{k}.npz").observed.astype(float) for k in range(3)]
    recorded.append(recorded[2][:, ::2])
    rng = np.random.default_rng(2)
    made = []  # rings that come and go beside points that are alone
    for t in range(40):
        turns = np.exp(2j * np.pi * np.arange(30) / 30)
        rings = [
            np.column_stack([turns.real, turns.imag, 0 * turns.real]) + [4 * k + 0.1 * t, 0, 0]
            for k in range(3)
            if (t + 9 * k) % 27
        ]
        noise = rng.uniform(-20, 20, (t % 3, 3))
        made.append(np.vstack([*rings, rings[0][: t % 5], noise]) + rng.normal(0, 0.02, (1, 3)))
    # A hole that is too small for long, and then is a loop; and points strewn around a hole.
    grid = np.stack(np.meshgrid(np.arange(12) - 5.5, np.arange(12) - 5.5), -1).reshape(-1, 2)
    away = np.linalg.norm(grid, axis=1, keepdims=True)
    opened = [grid * (1 + width * np.exp(-away) / away) for width in [0.1] * 12 + [0.6] * 6]
    strewn = np.random.default_rng(1).uniform(-2, 2, (250, 2))
    strewn = strewn[np.linalg.norm(strewn, axis=1) > 0.7]
    return [*map(list, recorded), made, opened, [strewn + 0.01 * t for t in range(4)]]


@pytest.mark.parametrize(("k", "ids"), [(0, 1), (1, 1), (2, 1), (3, 3), (4, 3), (5, 1), (6, 1)])
def test_a_film_is_tracked_as_by_the_library(k, ids):
    film = films()[k]
    [answer] = by_script(
        SCRIPTS, TRACK, [{"frames": [cloud.ravel().tolist() for cloud in film], "d": film[0].shape[1]}]
    )
    seen = set()
    for state, found in zip(track(film), answer, strict=True):
        expected = [
            [loop.id, loop.birth, loop.death, *loop.killer_triangle_ids.ravel().tolist()] for loop in state.loops
        ]
        assert found["loops"] == expected
        assert (found["alpha"], found["epsilon"]) == pytest.approx(
            [state.parameters[name] for name in ("alpha", "epsilon")]
        )
        seen |= {loop.id for loop in state.loops}
    assert len(seen) == ids


def test_the_page_refuses_a_film_with_an_empty_frame():
    cloud = np.random.default_rng(0).normal(size=(20, 3))
    call = f"(film) => {{ try {{ return ({TRACK})(film).length; }} catch (error) {{ return error.message; }} }}"
    films = [[cloud, cloud[:0]], [cloud, 1000 * cloud]]
    cases = [{"frames": [frame.ravel().tolist() for frame in film], "d": 3} for film in films]
    refused, kept = by_script(SCRIPTS, call, cases)
    assert "frame 1" in refused
    assert kept == len(track(films[1])) == 2
