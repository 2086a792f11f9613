"""Test that the scripts of the chapters' figures, run by node, compute what the library computes.

The loops themselves are tested in test_page_kernel: figures and pages compute them by the same script.
"""

from __future__ import annotations

import base64
import json
import zipfile
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from test_figures import HOOK, RING, holed_clouds

from chapter_tools.figures.lune_plots import joined_before, lune_components
from chapter_tools.figures.pages import LOOPS
from topokit import SeqPH, lemmas, linking_number, loop_mixture, rips_persistence
from topokit.linking import close_far
from topokit.mixture import LoopMixture
from topokit.rips import reduction

from conftest import polygon
from pages import by_script, needs_node

pytestmark = needs_node
SEVEN = [[2.0, 0.0], [9.0, 0.0], [17.0, 0.0], [17.0, 9.0], [9.0, 10.0], [0.0, 9.0], [-4.0, 6.0]]


def rings(count: int, seed: int, low: int = 4, high: int = 25) -> list[np.ndarray]:
    """Return noisy rings."""
    rng = np.random.default_rng(seed)
    return [polygon(int(n), 1.5) + rng.normal(0, 0.1, (n, 2)) for n in rng.integers(low, high, count)]


def answers(scripts: list[str], call: str, clouds: list[np.ndarray]) -> list:
    return by_script(scripts, call, [cloud.tolist() for cloud in clouds])


# ---- lunes and the boundary matrix

LUNES = """(points) => {
  const complex = rips(points);
  return complex.edges.map((e, k) => [e.i, e.j, complex.does(k), e.parts]);
}"""


def acts_of_edges(cloud: np.ndarray) -> list:
    """Return each edge with what it does by the textbook's pairs, and the components of its lune."""
    reduced = reduction.reduce(reduction.filtration(cloud, 3))
    acts = {}
    for degree, (birth, death) in enumerate([("", "joins"), ("begins", "kills"), ("void", "")]):
        for pair in reduced.pairs(degree):
            if pair.birth_edge != pair.killer_edge:
                acts |= {edge: act for edge, act in ((pair.birth_edge, birth), (pair.killer_edge, death)) if act}
    rows = []
    for x, y in (simplex.vertices for simplex in reduced.simplices if len(simplex.vertices) == 2):
        components = lune_components(joined_before(cloud, x, y), x, y)
        rows.append([x, y, acts.get((x, y), "nothing"), [component.tolist() for component in components]])
    return rows


def test_every_edge_does_what_the_textbook_says():
    """Rings, clouds with ties and duplicates, and hexagons, which create voids."""
    rng = np.random.default_rng(7)
    clouds = [(polygon(6) + rng.normal(0, 0.04, (6, 2))) * (1 + 0.3 * k) for k in range(20)]
    clouds += [rng.normal(size=(int(n), 2)) for n in rng.integers(2, 14, 20)]
    clouds += [rng.integers(0, 4, (int(n), 2)).astype(float) for n in rng.integers(2, 14, 20)]
    acts = set()
    for cloud, answer in zip(clouds, answers(LOOPS, LUNES, clouds), strict=True):
        expected = acts_of_edges(cloud)
        assert [[x, y, act, sorted(map(sorted, parts))] for x, y, act, parts in answer] == expected
        acts |= {act for _, _, act, _ in expected}
        lengths = cdist(cloud, cloud)
        for x, y, _, parts in answer:  # each component begins with its apex
            for part in parts:
                assert max(lengths[part[0], [x, y]]) <= min(lengths[part][:, [x, y]].max(axis=1)) + 1e-12
    assert acts == {"joins", "begins", "kills", "void", "nothing"}


ELIMINATING = [*LOOPS, "columns.js"]
ELIMINATION = """([points, radius]) => {
  const { rows, columns, steps } = eliminate(points, radius), whole = (s) => (
    { ...s, column: s.column ? bits(s.column) : [], chain: bits(s.chain), pivot: s.column ? pivot(s.column) : null });
  return { rows: rows.map((e) => [e.i, e.j]), columns: columns.map((c) => c.ids), steps: steps.map(whole) };
}"""


def test_elimination_reduces_as_the_library_does():
    """The rows, columns, reduced columns, chains and pairs agree."""
    rng = np.random.default_rng(0)
    cases = [(np.array(SEVEN), radius) for radius in (4.0, 6.2, 99.0)]
    for n in rng.integers(1, 11, 60).tolist():
        cases.append((rng.normal(size=(n, 2)), float(rng.uniform(0.3, 2))))
        cases.append((rng.integers(0, 4, (n, 2)).astype(float), float(rng.uniform(0.3, 3))))
    given = [(cloud.tolist(), radius) for cloud, radius in cases]
    additions = 0
    for (cloud, radius), answer in zip(cases, by_script(ELIMINATING, ELIMINATION, given), strict=True):
        ours = reduction.reduce(reduction.filtration(cloud, 2, max_radius=radius))
        edges = [j for j, simplex in enumerate(ours.simplices) if len(simplex.vertices) == 2]
        triangles = [j for j, simplex in enumerate(ours.simplices) if len(simplex.vertices) == 3]
        assert answer["rows"] == [list(ours.simplices[j].vertices) for j in edges]
        assert answer["columns"] == [list(ours.simplices[j].vertices) for j in triangles]
        additions += sum(step["added"] >= 0 for step in answer["steps"])
        final = {step["k"]: step for step in answer["steps"] if step["next"] < 0}
        for k, j in enumerate(triangles):
            assert {edges[row] for row in final[k]["column"]} == ours.columns[j]
            assert {triangles[t] for t in final[k]["chain"]} == ours.chains[j]
        pairs = {edges[step["pivot"]]: triangles[k] for k, step in final.items() if step["column"]}
        assert pairs == {birth: death for birth, death in ours.killer.items() if birth in edges}
    assert additions > 100


BOUNDING = """([points, radius, cycle]) => {
  const rows = eliminate(points, radius).rows.map((e) => e.i + "," + e.j);
  return bounding(points, radius, cycle.map((ends) => rows.indexOf(ends.join())));
}"""


def sides_of(walks: list) -> set:
    """Return the edges of closed walks, modulo 2."""
    pairs = [tuple(sorted(map(int, ends))) for walk in walks for ends in zip(walk, np.roll(walk, 1), strict=True)]
    return {pair for pair in pairs if pairs.count(pair) % 2}


def test_a_cycle_goes_around_the_loops_of_which_it_is_a_sum():
    rng = np.random.default_rng(4)
    cases = []
    for shift in rng.normal(0, 0.08, (40, 12, 2)):
        cloud = np.vstack([polygon(6), polygon(6) + [2.3, 0]]) + shift
        diagram = rips_persistence(cloud)
        radius = float(rng.uniform(0.55, 0.9))
        alive = np.flatnonzero((diagram.birth <= radius) & (radius < diagram.death))
        around = [diagram.cycle(k) for k in alive[rng.random(len(alive)) < 0.6]]
        near = cdist(cloud, cloud) <= 2 * radius
        triangles = [ids for ids in combinations(range(12), 3) if near[np.ix_(ids, ids)].all()]
        cycle = sides_of([*around, *(ids for ids in triangles if rng.random() < 0.3)])
        cases.append((diagram, around, (cloud.tolist(), radius, sorted(cycle))))
    given = [case[2] for case in cases]
    for (diagram, around, case), answer in zip(cases, by_script(ELIMINATING, BOUNDING, given), strict=True):
        found = [diagram.cycle(k) for k in answer["loops"]]
        assert sides_of([*found, *around]) == set()
        assert sides_of([*found, *answer["triangles"]]) == set(case[2])
    assert {len(around) for _, around, _ in cases} == {0, 1, 2}


# ---- matching and motion

MATCH = "([a, b, oneSided]) => { const [s, o] = [rips(a).loops, rips(b).loops]; return { s, o, ...matchLoops(s, o, oneSided) }; }"


def test_matchings_have_the_bottleneck_of_the_library():
    """Random clouds that move, and samples of them; the script's own pairs reach the same cost."""
    rng = np.random.default_rng(0)
    cases = [(SEVEN, [[0, 0], [1, 0], [2, 0]], False)]
    for k in range(240):
        n = int(rng.integers(6, 26))
        cloud = polygon(n, 2.0) + rng.normal(0, 0.2, (n, 2)) if k % 2 else rng.normal(size=(n, 2))
        sample = cloud[rng.permutation(n)[: max(3, n - 4)]]
        moved = cloud + rng.uniform(-0.2, 0.2, cloud.shape)
        other = moved if k % 3 else sample
        cases.append((cloud.tolist(), other.tolist(), k % 3 == 0))
    matched = 0
    for (a, b, one_sided), answer in zip(
        cases, by_script([*LOOPS, "assign.js", "match.js"], MATCH, cases), strict=True
    ):
        ours = lemmas.match_diagrams(rips_persistence(a), rips_persistence(b), one_sided=one_sided, tolerance=1e-9)
        assert answer["bottleneck"] == pytest.approx(ours.cost, abs=1e-12)
        pairs = [(s, answer["o"][j]) for s, j in zip(answer["s"], answer["partner"], strict=True) if j >= 0]
        shifts = np.array([(o["birth"] - s["birth"], o["death"] - s["death"]) for s, o in pairs]).reshape(-1, 2)
        assert np.abs(shifts).max(initial=0) <= ours.cost + 1e-12
        assert not one_sided or shifts.min(initial=0) >= -1e-9
        alone = [s for s, j in zip(answer["s"], answer["partner"], strict=True) if j < 0]
        alone += [o for j, o in enumerate(answer["o"]) if j not in answer["partner"]]
        price = 1 if one_sided else 2
        assert all(loop["death"] - loop["birth"] <= price * ours.cost + 1e-12 for loop in alone)
        matched += len(pairs)
    assert matched > 100


# ---- critical edges: lens.js

LENS = [*LOOPS, "lens.js"]
BETAS = """([points, alpha, epsilon]) => {
  const [{ killerEdge, death }] = rips(points).loops, table = distancesOf(points);
  return [betaAll(table, killerEdge, death, alpha), betaCritical(table, killerEdge, death, alpha, epsilon)];
}"""


def test_betas_are_those_of_the_library():
    clouds = [*holed_clouds(3, 1), *rings(6, 4)]
    cases = [(cloud, alpha, epsilon) for cloud in clouds for alpha, epsilon in ((0.0, 0.0), (0.12, 0.01), (0.0, 0.05))]
    given = [(cloud.tolist(), *rest) for cloud, *rest in cases]
    for (cloud, alpha, epsilon), answer in zip(cases, by_script(LENS, BETAS, given), strict=True):
        every = lemmas.beta_all(cloud, alpha, min_lifetime=0.0).value[0]
        critical = lemmas.beta_critical(cloud, alpha, epsilon, min_lifetime=0.0).value[0]
        np.testing.assert_allclose(answer, [every, critical])


# ---- places of a loop: places.js

PLACES = [*LOOPS, "places.js"]


def test_the_places_of_a_loop_are_topokits():
    clouds = [*rings(60, 1), np.eye(2), *rings(1, 2, 3, 4)]
    seen = 0
    for cloud, answer in zip(clouds, answers(PLACES, "places", clouds), strict=True):
        diagram = rips_persistence(cloud)
        if len(diagram) == 0:
            assert answer is None
            continue
        assert (answer["birth"], answer["death"]) == (diagram.birth[0], diagram.death[0])
        np.testing.assert_array_equal(answer["edge"], cloud[diagram.killer_edge[0]])
        np.testing.assert_allclose(answer["thick"], cloud[diagram.killer_triangles[0, 0]].mean(axis=0), atol=1e-12)
        walk = cloud[diagram.cycle(0)]
        after = np.roll(walk, -1, axis=0)
        centroid = np.average((walk + after) / 2, axis=0, weights=np.linalg.norm(after - walk, axis=1))
        np.testing.assert_allclose(answer["centroid"], centroid, atol=1e-12)
        seen += 1
    assert 50 < seen < len(clouds)


# ---- which bars are loops: rules.js

RULES = """(points) => [byAlpha(points), byEvidence(points)].map(({ alpha, cloud, loops, kept }) => (
  { alpha, cloud, kept: kept.length, bars: loops.map((l) => [l.birth, l.death, l.strength, l.needed]) }))"""
RULE_SCRIPTS = [*PLACES, "assign.js", "seqph.js", "rules.js"]


def spoilt_clouds() -> list[np.ndarray]:
    """Return rings and sheets with a stray point near and far or with repeated points, and clouds of all densities."""
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(7.0)), axis=-1).reshape(-1, 2)
    two = np.vstack([polygon(24, 2.0), polygon(24, 2.1) + [5.0, 0.0]])
    clouds = [grid + rng.normal(0, 0.1, grid.shape), two + rng.normal(0, 0.05, two.shape)]
    for n in (5, 12, 30, 50):
        clouds += [polygon(n, 2.0) + rng.normal(0, 0.05, (n, 2)), rng.uniform(-2, 2, (n, 2))]
    places = [[0.0, 0.0], [2.3, 0.0], [4.0, 1.0], [7.0, -3.0], [40.0, 0.0]]
    spoilt = [np.vstack([cloud, place]) for cloud in clouds for place in places]
    spoilt += [np.vstack([cloud, cloud[:5], [[9.0, 9.0], [9.0, 9.0]]]) for cloud in clouds]
    return spoilt + [rng.standard_t(2, (30, 2)) for _ in range(20)]


def test_both_rules_keep_the_loops_that_the_tracker_keeps():
    clouds = spoilt_clouds()
    left_out = 0
    kept = set()
    for cloud, rules in zip(clouds, answers(RULE_SCRIPTS, RULES, clouds), strict=True):
        for rule, tracker in zip(rules, (SeqPH.paper(), SeqPH()), strict=True):
            state = tracker.update(cloud)
            assert rule["alpha"] == pytest.approx(state.parameters["alpha"])
            bars = sorted((birth, death) for birth, death, *_ in rule["bars"][: rule["kept"]])
            assert bars == sorted((loop.birth, loop.death) for loop in state.loops)
            for birth, death, strength, needed in rule["bars"]:  # the mark is where a bar becomes a loop
                assert birth < needed
                assert strength == pytest.approx(1) or (strength > 1) == (death > needed)
        left_out += len(rules[1]["cloud"]) < len(np.unique(cloud, axis=0))
        kept.add(tuple(rule["kept"] for rule in rules))
    assert left_out > 10
    assert {(0, 0), (0, 1), (1, 1), (0, 2), (2, 2)} <= kept


# ---- names by gates: follow.js


def ringed_film(rng: np.random.Generator) -> np.ndarray:
    """Return a film of two or three rings in space that drift, and near each other change their loops."""
    rings_of_it = []
    for _ in range(int(rng.integers(2, 4))):
        ring = np.insert(polygon(int(rng.integers(9, 16)), float(rng.uniform(0.8, 1.2))), 2, 0.0, axis=1)
        drift = rng.normal(0, 0.1, 3) * np.arange(8)[:, None, None]
        rings_of_it.append(ring + rng.normal(0, 1.2, 3) + drift)
    film_of_it = np.concatenate(rings_of_it, axis=1)
    return film_of_it + rng.normal(0, 0.05, film_of_it.shape)


def test_names_are_those_of_the_tracker_for_all_gates():
    rng = np.random.default_rng(8)
    cases = []
    expected = []
    for k in range(60):
        clouds = ringed_film(rng)
        options = dict(zip(("alpha", "beta", "epsilon"), rng.uniform(0, [0.3, 1.0, 0.2]).tolist(), strict=True))
        rule = ("paper", "proved", "near")[k % 3]
        tracker = SeqPH(**options, loops="alpha", gates=rule, identity="killer-edge", memory=0)
        expected.append([[loop.id for loop in state.loops] for state in tracker.stream(clouds)])
        frames = []
        for cloud in clouds:
            diagram = rips_persistence(cloud)
            ends = cloud[diagram.killer_edge].tolist()
            bars = zip(diagram.birth.tolist(), diagram.death.tolist(), ends, strict=True)
            frames.append([{"birth": birth, "death": death, "ends": places} for birth, death, places in bars])
        cases.append([frames, {**options, "gates": rule}])
    call = "([film, options]) => followed(film, options).map(({ names }) => names)"
    assert by_script(["assign.js", "follow.js"], call, cases) == expected
    counts = {len({name for frame in names for name in frame}) for names in expected}
    assert min(counts) < 5 < max(counts)


# ---- mixtures

MIXTURE = """({ points, most, noise, places }) => {
  const [loop] = rips(points).loops, mixture = mixtureOf(points, loop, most, noise), one = matched(mixture);
  const [found, reached] = [places.map((p) => density(mixture, p)), credibilities(mixture, places)];
  return { mixture, one, density: found, reached };
}"""


def test_mixtures_are_topokits():
    """Rings with points inside; components, noise and places at random. Credibility is compared with samples."""
    rng = np.random.default_rng(0)
    cases = []
    for k in range(40):
        ring = polygon(int(rng.integers(8, 25)), 0.2)
        cloud = np.vstack([ring + rng.normal(0, 0.02, ring.shape), rng.uniform(-0.1, 0.1, (k % 4, 2))])
        places = rng.uniform(-0.2, 0.2, (25, 2))
        noise = float(10 ** rng.uniform(-4, -2))
        cases.append({"points": cloud.tolist(), "most": 2 + k % 5, "noise": noise, "places": places.tolist()})
    sizes = set()
    for k, (case, answer) in enumerate(zip(cases, by_script([*LOOPS, "mixture.js"], MIXTURE, cases), strict=True)):
        state = SeqPH(alpha=1e-9).update(np.array(case["points"]))
        loop = max(state.loops, key=lambda candidate: candidate.lifetime)
        first = slice(case["most"] - 2)
        loop = replace(loop, neighbours=loop.neighbours[first], neighbour_values=loop.neighbour_values[first])
        ours = loop_mixture(loop, case["noise"])
        components = answer["mixture"]
        places = np.array(case["places"])
        np.testing.assert_allclose([part["mean"] for part in components], ours.means)
        np.testing.assert_allclose([part["weight"] for part in components], ours.weights)
        np.testing.assert_allclose([part["cov"] for part in components], ours.covariances.reshape(-1, 4)[:, [0, 1, 3]])
        np.testing.assert_allclose(answer["density"], np.exp(ours.log_prob(places)), atol=1e-12)
        np.testing.assert_allclose(answer["one"][0]["mean"], ours.mean)
        np.testing.assert_allclose(answer["one"][0]["cov"], ours.covariance.ravel()[[0, 1, 3]])
        if k < 8:
            plane = LoopMixture(ours.means, ours.covariances, ours.weights)
            reached = plane.credibility(places, n=100_000, rng=0)
            np.testing.assert_allclose(answer["reached"], reached, atol=0.025)  # its grid is coarse
        sizes.add(len(components))
    assert sizes == {2, 3, 4, 5, 6}


# ---- links

LINK = """([a, b]) => ({ sum: linkingSum(a, b),
  crossings: crossingsOf(a, b).map(({ place, sign, over }) => [...place, sign, over ? 1 : 0]) })"""


def curves() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return random curves, and rings about a hook, which has corners far away."""
    rng = np.random.default_rng(0)
    tangles = [(rng.normal(size=(int(n), 3)), rng.normal(size=(17, 3))) for n in rng.integers(3, 30, 80)]
    turns = zip(Rotation.random(40, rng=rng).as_matrix(), rng.integers(0, 4, 40), strict=True)
    return tangles + [(RING @ turn.T + HOOK[int(k)] + 0.2, close_far(HOOK)) for turn, k in turns]


def test_curves_are_linked_as_by_topokit():
    pairs = curves()
    numbers = set()
    given = [[a.tolist(), b.tolist()] for a, b in pairs]
    for (a, b), answer in zip(pairs, by_script(["link.js"], LINK, given), strict=True):
        number = linking_number(a, b)
        assert answer["sum"] == pytest.approx(number, abs=1e-6)
        crossings = np.array(answer["crossings"]).reshape(-1, 4)
        sign = crossings[:, 2]
        over = crossings[:, 3]
        assert (sign @ over, sign @ (1 - over)) == (number, number)
        numbers.add(number)
    assert numbers >= {-3, -2, -1, 0, 1, 2, 3}


# ---- the reader's files: files.js and cuts.js

READING = """async ([named, thickness, crop]) => {
  const files = named.map(([name, content]) => new File([Buffer.from(content, "base64")], name)), [{ name }] = files;
  const { planeOf, readFilm } = fileReaders(), asked = [{ files, name, at: 0 }, { crop, thickness }];
  const options = { crop, planes: thickness ? [await planeOf(...asked)] : [] };
  const film = Object.assign(await readFilm(files, options), { options }), clouds = film.frames.map(({ all }) => all);
  return { ...film, code: film.errors.length ? "" : pythonLines(film, 800, clouds, []), points: clouds.map((all) => [...all]) };
}"""


def read_in_page(*names: str, thickness: float = 0.0, crop: list | None = None) -> dict:
    """Return what the page "Try your cloud" reads from files; the lines of Python that it shows give the same points."""
    files = [[name, base64.b64encode(Path(name).read_bytes()).decode()] for name in names]
    [film] = by_script(["sampling.js", "cuts.js", "files.js", "out.js"], READING, [[files, thickness, crop]])
    if not film["errors"]:
        lines: dict = {}
        exec(film["code"], lines)
        ours = lines["points"]
        np.testing.assert_array_equal(np.reshape(film["points"], (-1, 3))[:, : ours.shape[1]], ours)
    return film


def test_files_are_read_as_the_lines_of_python_say(tmp_path, monkeypatch):
    """Also: a column that counts the rows is no place, and what cannot be read is named with what reads it."""
    monkeypatch.chdir(tmp_path)
    points = np.random.default_rng(0).normal(size=(60, 3))
    numbered = np.column_stack([np.arange(60), points])
    np.save("numbered.npy", numbered)
    np.savetxt("numbered.csv", numbered, fmt="%.17g", delimiter=",", header="id,a,b,c", comments="")
    np.savetxt("a.pts", points, fmt="%.17g", header="60", comments="")
    np.savetxt("a.asc", points, fmt="%.17g")
    Path("a.json").write_text(json.dumps({"points": points.tolist()}))
    with zipfile.ZipFile("a.zip", "w") as archive:
        archive.write("a.asc")
    for name in ("numbered.npy", "numbered.csv", "a.pts", "a.asc", "a.json", "a.zip"):
        np.testing.assert_array_equal(np.reshape(read_in_page(name)["points"], (60, 3)), points)
    np.save("five.npy", np.column_stack([points, points[:, :2]]))
    assert read_in_page("five.npy")["table"]["kept"] == [0, 1, 2]

    depth = np.add.outer(np.arange(12), np.arange(20) * 300 + 500).astype(np.uint16)
    Image.fromarray(depth).save("depth.png")
    Path("intrinsics.json").write_text(json.dumps({"fx": 30.5, "fy": 31, "cx": 9.5, "cy": 5.5, "depth_scale": 0.00025}))
    assert len(read_in_page("depth.png", "intrinsics.json")["points"][0]) == 3 * depth.size

    zeros = np.zeros((30_000_000, 3), dtype=np.int8)  # a small file, refused by what its list declares
    np.savez_compressed("greedy.npz", zeros, zeros, zeros)
    for name, reason in (("greedy.npz", "unpacks to 257 MB;"), ("a.las", "laspy.read"), ("a.bag", "AnyReader")):
        Path(name).touch()
        assert reason in read_in_page(name)["errors"][0]


def test_a_ring_is_left_of_a_scene_without_its_largest_plane(tmp_path, monkeypatch):
    """The plane is slanted, far from zero, and thick."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    table = np.insert(rng.uniform(-3, 3, (3000, 2)), 2, rng.normal(0, 0.01, 3000), axis=1)
    scene = np.vstack([table, np.insert(polygon(60), 2, 1.0, axis=1), [[0.0, 0.0, 9.0]]])
    turn = Rotation.from_euler("xyz", [0.3, 0.2, 0.1]).as_matrix()
    np.save("scene.npy", (scene @ turn.T + 100).astype(np.float32))
    film = read_in_page("scene.npy", thickness=0.05, crop=[[None, None, None], [None, None, 105.0]])
    left = film["frames"][0]["left"]
    assert (left["outside"], left["onPlane"]) == (1, 3000)
    assert abs(film["options"]["planes"][0]["normal"] @ turn[:, 2]) == pytest.approx(1, abs=1e-3)
    np.testing.assert_array_equal(np.reshape(film["points"], (60, 3)), np.load("scene.npy")[3000:3060])
