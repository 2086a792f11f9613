"""The growing complex: what the page holds, and that its script finds the loops that topokit finds."""

from __future__ import annotations

import re
from itertools import combinations

import numpy as np
import pytest

from topokit import rips_persistence, view

from clouds import gudhi_pairs, sorted_pairs
from conftest import polygon
from pages import NETWORK, by_script, needs_node, page_data

SQUARE = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]


# ---- the page


def test_holds_the_points_to_the_last_digit():
    points = np.random.default_rng(0).normal(size=(30, 2)) / 3
    np.testing.assert_array_equal(page_data(view.growth(points))["points"], points)


def test_holds_its_options():
    data = page_data(view.growth(SQUARE, start=1, max_radius=3, height=321, title="four </script> corners"))
    assert (data["start"], data["end"], data["height"]) == (1.0, 3.0, 321)
    assert data["title"] == "four </script> corners"
    assert data["palette"] == [view.loop_colour(number) for number in range(6)]
    plain = page_data(view.growth(SQUARE))
    assert (plain["start"], plain["end"]) == (None, None)


def test_asks_nothing_of_the_network():
    page = view.growth(SQUARE).page
    assert not NETWORK.search(page)
    assert "__" not in re.sub(r"__proto__", "", page)  # nothing left to fill in


def test_is_a_frame_that_text_cannot_break_out_of():
    figure = view.growth(SQUARE, title='"</script><b>', height=400)
    markup = figure._repr_html_()
    assert markup.startswith("<iframe srcdoc=")
    assert "height:400px" in markup
    assert markup.count('"') == 8  # srcdoc, title, loading, style: nothing inside is unescaped
    assert figure.page.count("</script>") == 2
    assert repr(figure).startswith("Framed('Rips complex of 4 points'")


def test_saves_a_small_whole_page(tmp_path):
    path = view.growth(np.random.default_rng(0).normal(size=(60, 2))).save(tmp_path / "growth.html")
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert text.rstrip().endswith("</html>")
    assert len(text) < 40_000


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        (np.zeros((5, 3)), {}, r"points must lie in the plane, not in 3 dimensions"),
        (np.zeros((61, 2)), {}, "points must be 1 to 60 points, not 61; see topokit.farthest_point_sample"),
        (np.zeros((0, 2)), {}, "points must be 1 to 60 points, not 0"),
        ([[0.0, np.nan]], {}, "NaN or infinite"),
        (SQUARE, {"max_radius": 0}, "max_radius must be more than zero"),
        (SQUARE, {"start": -1}, "start must be zero or more"),
        (SQUARE, {"start": 2, "max_radius": 1}, "start must be at most max_radius, 1.0, not 2.0"),
        (np.zeros((17, 3, 3)), {}, r"at most 16 frames of 160 points of space, not \(17, 3, 3\)"),
        (np.zeros((2, 161, 3)), {}, "of 160 points of space, not"),
        (np.zeros((2, 9, 2)), {}, "of 160 points of space, not"),
        (np.full((1, 9, 3), np.nan), {}, "NaN or infinite"),
    ],
)
def test_refuses_what_it_cannot_show(points, options, message):
    with pytest.raises(ValueError, match=message):
        view.growth(points, **options)


# ---- a film of space

FILM = """({ film, told: rows }) => {
  const all = unpack(film), n = all.length / 3 / rows.length;
  return rows.map((row, t) => {
    const points = Array.from({ length: n }, (_, v) => [...all.subarray(3 * (n * t + v), 3 * (n * t + v + 1))]);
    const read = told(points, unpack(row)), own = rips(points);
    return { points, merges: [read.merges, own.merges],
      loops: [read, own].map((found) => found.loops.map(({ cycle, ...rest }) => ({ ...rest, cycle }))) };
  });
}"""


def film_of_space() -> np.ndarray:
    """A ring in space that tilts and shrinks, with points beside it."""
    rng = np.random.default_rng(6)
    ring, beside = np.insert(polygon(24, 30.0), 2, 0.0, axis=1), rng.normal(0, 20, (16, 3)) + [40, 0, 9]
    shaken = np.vstack([ring, beside]) + rng.normal(0, 0.5, (40, 3))
    return np.stack([shaken * [1, 1 - 0.2 * t, 1] + [0, 3 * t, 0] for t in range(3)])


@needs_node
def test_a_film_is_told_as_topokit_finds_it_on_the_points_of_the_page():
    film = film_of_space()
    [frames] = by_script(["orbit.js", "rips.js"], FILM, [page_data(view.growth(film))])
    for cloud, frame in zip(film, frames, strict=True):
        points = np.array(frame["points"])
        np.testing.assert_allclose(points, cloud, atol=1.1e-3)  # of a span of 130, kept in 16 bits
        diagram = rips_persistence(points)
        told, own = frame["loops"]
        assert len(told) == len(diagram) > 0
        for i, loop in enumerate(told):
            assert (loop["birth"], loop["death"]) == pytest.approx((diagram.birth[i], diagram.death[i]), rel=1e-12)
            assert loop["birthEdge"] == diagram.birth_edge[i].tolist()
            assert loop["killerEdge"] == diagram.killer_edge[i].tolist()
            assert loop["triangles"] == diagram.killer_triangles[i].tolist()
            assert loop["cycle"] == diagram.cycle(i).tolist()
            assert {loop["cycle"][0], loop["cycle"][-1]} == set(loop["birthEdge"])
        pairs = [sorted((x["birthEdge"], x["killerEdge"]) for x in found) for found in (told, own)]
        assert pairs[0] == pairs[1]  # and the page's own reduction finds them in space too
        np.testing.assert_allclose(*frame["merges"])
        assert len(frame["merges"][0]) == len(points) - 1


def test_a_film_opens_in_its_middle_and_ends_after_the_last_death_of_all():
    film = film_of_space()
    data = page_data(view.growth(film))
    assert (data["frame"], len(data["told"]), "points" in data) == (1, 3, False)
    last = max(rips_persistence(cloud).death.max() for cloud in film)
    assert data["end"] == pytest.approx(1.15 * last, rel=1e-4)
    assert page_data(view.growth(film, max_radius=7))["end"] == 7.0
    page = view.growth(film).page
    assert not NETWORK.search(page)
    assert "__" not in page
    assert len(page) < 50_000


def test_a_film_without_loops_is_shown():
    data = page_data(view.growth([np.eye(3)]))
    assert (data["told"][0]["values"], data["end"]) == ("", 1.0)


# ---- its script, run by node

RIPS = """(points) => {
  const { loops, merges, cone, edges } = rips(points);
  return { merges, cone, edges: edges.length, loops: loops.map((l) => ({ ...l, cycle: l.cycle })) };
}"""


def rips_by_script(clouds: list[np.ndarray]) -> list[dict]:
    """What `rips.js` finds in every cloud."""
    return by_script(["rips.js"], RIPS, [np.asarray(cloud).tolist() for cloud in clouds])


def planar_clouds(n_clouds: int, most: int, seed: int) -> list[np.ndarray]:
    """Clouds of the plane, generic and with as many ties as the plane allows."""
    rng = np.random.default_rng(seed)
    circles = [(a, b) for a in range(-8, 9) for b in range(-8, 9) if a * a + b * b in (25, 50, 65)]
    families = [
        lambda n: rng.normal(size=(n, 2)),
        lambda n: polygon(n, 1.7) + rng.normal(0, 0.1, (n, 2)),  # one wide loop
        lambda n: rng.integers(0, 7, size=(n, 2)).astype(float),  # grid: ties and duplicates
        lambda n: polygon(n),  # ties up to rounding
        lambda n: rng.normal(size=(n, 2))[rng.integers(0, n, n)],  # duplicates
        lambda n: rng.permutation(np.array(circles, float))[:n],  # cocircular: exact ties
    ]
    return [families[k % len(families)](int(rng.integers(1, most + 1))) for k in range(n_clouds)]


@needs_node
def test_script_finds_what_topokit_finds():
    """The same births and deaths to the last bit, the same birth edges, killer edges and killer triangles."""
    clouds = planar_clouds(600, 40, seed=1)
    found = 0
    for cloud, theirs in zip(clouds, rips_by_script(clouds), strict=True):
        diagram = rips_persistence(cloud)
        ours = zip(
            diagram.birth.tolist(),
            diagram.death.tolist(),
            diagram.birth_edge.tolist(),
            diagram.killer_edge.tolist(),
            [[sorted(t) for t in pair] for pair in diagram.killer_triangles.tolist()],  # the thick one first
            strict=True,
        )
        loops = [
            (x["birth"], x["death"], x["birthEdge"], x["killerEdge"], [sorted(t) for t in x["triangles"]])
            for x in theirs["loops"]
        ]
        assert sorted(ours) == sorted(loops), cloud.tolist()
        found += len(loops)
    assert found > 1000


@needs_node
def test_script_agrees_with_gudhi():
    clouds = planar_clouds(60, 20, seed=2)
    for cloud, theirs in zip(clouds, rips_by_script(clouds), strict=True):
        bars = np.array([(loop["birth"], loop["death"]) for loop in theirs["loops"]]).reshape(-1, 2)
        np.testing.assert_allclose(sorted_pairs(bars), gudhi_pairs(cloud), atol=1e-9, err_msg=str(cloud.tolist()))


def bounds(cycle_edges, edges) -> bool:
    """Whether a sum of edges bounds triangles of the complex whose edges, in order, are `edges`; Z/2."""
    bit = {edge: 1 << k for k, edge in enumerate(edges)}
    pivots: dict[int, int] = {}
    for i, j, k in combinations(sorted({v for edge in edges for v in edge}), 3):
        if (i, j) in bit and (i, k) in bit and (j, k) in bit:
            rest = reduced(bit[i, j] ^ bit[i, k] ^ bit[j, k], pivots)
            if rest:
                pivots[rest.bit_length()] = rest
    return reduced(sum(bit[edge] for edge in cycle_edges), pivots) == 0


def reduced(column: int, pivots: dict[int, int]) -> int:
    while column and column.bit_length() in pivots:
        column ^= pivots[column.bit_length()]
    return column


@needs_node
def test_cycles_are_born_with_their_bars_and_bound_at_death_and_not_before():
    clouds = planar_clouds(120, 16, seed=3)
    seen = 0
    for cloud, theirs in zip(clouds, rips_by_script(clouds), strict=True):
        square = ((cloud[:, None] - cloud[None, :]) ** 2).sum(axis=-1)
        order = sorted(combinations(range(len(cloud)), 2), key=lambda edge: (square[edge], edge))
        for loop in theirs["loops"]:
            walk = loop["cycle"]
            steps = [tuple(sorted(edge)) for edge in zip(walk, walk[1:] + walk[:1], strict=True)]
            assert len(set(steps)) == len(steps) >= 4
            assert max(steps, key=order.index) == tuple(loop["birthEdge"])
            killer = order.index(tuple(loop["killerEdge"]))
            assert bounds(steps, order[: killer + 1]), cloud.tolist()
            assert not bounds(steps, order[:killer]), cloud.tolist()
            seen += 1
    assert seen > 60


@needs_node
def test_the_cycle_of_a_slot_does_not_run_around_the_ring_beside_it():
    """The birth edge closes the mouth of a slot that opens into a ring. The shortest way back is around the ring, whose
    loop lives on; the loop that was born there and dies soon is the slot's."""
    angle = np.arcsin(0.5 / 1.5) + np.linspace(0, 2 * (np.pi - np.arcsin(0.5 / 1.5)), 19)
    ring = 1.5 * np.column_stack([np.cos(angle), np.sin(angle)])  # its ends are 1 apart: the mouth
    along = ring[0, 0] + 0.5 * np.arange(1, 13)
    slot = np.vstack([np.column_stack([along, np.full(12, side)]) for side in (0.6, -0.6)] + [[[along[-1] + 0.3, 0.0]]])
    cloud = np.vstack([ring, slot])
    [found] = rips_by_script([cloud])
    [mouth] = [loop for loop in found["loops"] if loop["birthEdge"] == [0, 18]]
    assert mouth["birth"] == pytest.approx(0.5)
    assert 0.5 < mouth["death"] < 1.0
    assert set(mouth["cycle"]) >= {0, 18, len(cloud) - 1}  # to the far end of the slot and back
    assert not set(mouth["cycle"]) & set(range(4, 15))
    assert found["loops"][0]["death"] > 1.2


@needs_node
def test_components_merge_along_a_spanning_tree():
    from scipy.sparse.csgraph import minimum_spanning_tree
    from scipy.spatial.distance import cdist

    cloud = np.random.default_rng(4).normal(size=(35, 2))
    [found] = rips_by_script([cloud])
    np.testing.assert_allclose(found["merges"], np.sort(minimum_spanning_tree(cdist(cloud, cloud)).data) / 2)
    assert found["edges"] == 35 * 34 // 2
    assert found["cone"] == pytest.approx(cdist(cloud, cloud).max(axis=1).min() / 2)
