"""The statements of the paper: the measures and matchings against independent answers, the counterexamples, the search."""

from __future__ import annotations

import itertools

import gudhi
import lemmas_on_cloth
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist, directed_hausdorff

from topokit import farthest_point_sample, hausdorff, lemmas, rips_persistence
from topokit.io import load_episode
from topokit.lemmas import COUNTEREXAMPLES, match_diagrams

import lemma_search
from conftest import DATA


def bars(diagram):
    return np.column_stack([diagram.birth, diagram.death])


def shape(seed, n=14):
    """A noisy ring: a few loops, one of them long."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * rng.random(n)
    return np.column_stack([np.cos(angle), np.sin(angle)]) + 0.15 * rng.normal(size=(n, 2))


def some(seed, n, least=3):
    """Some of n vertices."""
    rng = np.random.default_rng([seed, 1])
    return np.sort(rng.choice(n, int(rng.integers(least, n + 1)), replace=False))


# Matchings


@pytest.mark.parametrize("seed", range(20))
def test_bottleneck_distance_is_gudhis_and_the_matching_reaches_it(seed):
    a, b = (rips_persistence(shape(s, 25)) for s in (seed, seed + 1000))
    match = match_diagrams(a, b)
    assert match.cost == pytest.approx(gudhi.bottleneck_distance(bars(a), bars(b)), abs=1e-12)
    matched = match.partner >= 0
    partners = match.partner[matched]
    assert len(set(partners)) == len(partners)
    shifts = np.abs(bars(a)[matched] - bars(b)[partners]).max(axis=1)
    alone = [*a.lifetime[~matched] / 2, *np.delete(b.lifetime, partners) / 2]
    assert max([*shifts, *alone], default=0.0) == pytest.approx(match.cost, abs=1e-15)


@pytest.mark.parametrize("seed", range(20))
def test_one_sided_matching_is_a_bottleneck_matching_of_a_shifted_diagram(seed):
    points = shape(seed, 25)
    s, o = rips_persistence(points), rips_persistence(points[some(seed, 25, 10)])
    c = match_diagrams(s, o, one_sided=True).cost
    for limit, enough in ((c * 1.0001 + 1e-9, True), (c * 0.999, False)):
        distance = gudhi.bottleneck_distance(bars(s) + limit / 2, bars(o))
        assert (distance <= limit / 2) == enough or c == 0


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("one_sided", [False, True])
def test_the_longest_loop_without_a_counterpart_is_what_no_matching_avoids(seed, one_sided):
    """The papers' Lemmas 2 and 3, against all ways of matching."""
    points = shape(seed, 11)
    if one_sided:
        ids = some(seed, 11, 6)
        other = points[ids]
        check = lemmas.observability(points, ids)
        shift = check.alpha
    else:
        other = points + 0.1 * np.random.default_rng(seed).normal(size=points.shape)
        check = lemmas.temporal_persistence(points, other)
        shift = check.epsilon
    a, b = rips_persistence(points), rips_persistence(other)
    low = 0.0 if one_sided else -shift
    shifts = bars(b)[None] - bars(a)[:, None]
    allowed = ((shifts >= low - 1e-9) & (shifts <= shift + 1e-9)).all(axis=2)
    least = np.inf
    for places in itertools.product(range(-1, len(b)), repeat=len(a)):  # -1: unmatched
        used = [j for j in places if j >= 0]
        if len(set(used)) == len(used) and all(j < 0 or allowed[i, j] for i, j in enumerate(places)):
            least = min(least, max((a.lifetime[i] for i, j in enumerate(places) if j < 0), default=0.0))
    assert check.paper.statistic == least


def test_a_greedy_matching_would_be_wrong():
    """The nearest partner of one bar is the only one of another."""

    def diagram(*pairs):
        birth, death = np.array(pairs, float).T
        edge = np.zeros((len(pairs), 2), np.int64)
        return type(rips_persistence(shape(0)))(
            birth, death, edge, edge, np.zeros((len(pairs), 2, 3), np.int64), 9, np.inf, None, None
        )

    a, b = diagram((1, 9), (2, 9.5)), diagram((1.9, 9.4), (0, 8.2))
    match = match_diagrams(a, b)
    assert match.partner.tolist() == [1, 0]
    assert match.cost == pytest.approx(1.0)


# Measures


def critical_by_definition(points, x, y, alpha, epsilon):
    """The definition, word for word, by a graph."""
    d = cdist(points, points)
    length = d[x, y]
    lens = [z for z in range(len(points)) if z not in (x, y) and max(d[z, x], d[z, y]) <= length + 4 * epsilon]
    carriers = [z for z in range(len(points)) if max(d[z, x], d[z, y]) < length - alpha - 4 * epsilon]
    for a, b in itertools.combinations(lens, 2):
        if d[a, b] < length - 4 * epsilon:
            continue
        nodes = [("end", a), ("end", b), *(("inner", z) for z in carriers)]
        joined = np.zeros((len(nodes),) * 2)
        for i, j in itertools.combinations(range(len(nodes)), 2):
            kinds = {nodes[i][0], nodes[j][0]}
            limit = {1: length - 2 * alpha - 4 * epsilon, 2: length - alpha - 4 * epsilon}[len(kinds)]
            joined[i, j] = kinds != {"end"} and d[nodes[i][1], nodes[j][1]] < limit
        # A path ends at a and b and uses them nowhere else, so that a carrier may be a or b itself only as a carrier.
        _, label = connected_components(joined, directed=False)
        if label[0] != label[1]:
            return True
    return False


@pytest.mark.parametrize("seed", range(12))
def test_betas_are_the_farthest_rivals(seed):
    rng = np.random.default_rng(seed)
    points = shape(seed, 18)
    alpha, epsilon = rng.choice([0.0, 0.05, 0.2, 0.5]), rng.choice([0.0, 0.01, 0.05])
    diagram = rips_persistence(points)
    everywhere = lemmas.beta_all(points, alpha, min_lifetime=0.0)
    critical = lemmas.beta_critical(points, alpha, epsilon, min_lifetime=0.0)
    nearest = lemmas.beta_critical(points, alpha, epsilon, min_lifetime=0.0, nearest=True)
    edges = list(itertools.combinations(range(18), 2))
    half = {e: np.linalg.norm(points[e[0]] - points[e[1]]) / 2 for e in edges}
    for i, (death, killer) in enumerate(zip(diagram.death, diagram.killer_edge, strict=True)):

        def from_killer(edge, killers=(killer,)):
            return min(hausdorff(points[list(edge)], points[k]) for k in killers)

        rivals = [e for e in edges if abs(half[e] - death) <= alpha + 1e-12]
        assert everywhere.value[i] == pytest.approx(max(map(from_killer, rivals)))
        low, high = death - 2 * epsilon - 1e-12, death + alpha + 2 * epsilon + 1e-12
        rivals = [e for e in edges if low <= half[e] <= high and critical_by_definition(points, *e, alpha, epsilon)]
        assert critical.value[i] == pytest.approx(max(map(from_killer, rivals)))
        assert nearest.value[i] == pytest.approx(max(from_killer(e, diagram.killer_edge) for e in rivals))
        assert from_killer(critical.edge[i]) == pytest.approx(critical.value[i])


def test_the_constants_of_a_step_are_those_of_the_definitions():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(20, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    assert lemmas.temporal_persistence(points, points @ turn + 5).distortion == pytest.approx(0, abs=1e-12)
    moved = points + 0.1 * rng.normal(size=points.shape)
    check = lemmas.temporal_persistence(points, moved)
    assert check.distortion == pytest.approx(np.abs(cdist(moved, moved) - cdist(points, points)).max() / 2)
    assert check.epsilon == pytest.approx(np.linalg.norm(moved - points, axis=1).max())
    ids = some(3, 20, 8)
    assert lemmas.observability(points, ids).alpha == pytest.approx(directed_hausdorff(points, points[ids])[0])


# Statements


@pytest.mark.parametrize("seed", range(20))
def test_rank_inequality_against_counting(seed):
    points = shape(seed, 24)
    ids = some(seed, 24, 8)
    s, o = rips_persistence(points), rips_persistence(points[ids])
    least = lemmas.feature_approximation(points, ids).corrected.statistic
    events = np.unique(np.concatenate([s.birth, s.death, o.birth, o.death]))
    values = np.concatenate([events, (events[1:] + events[:-1]) / 2, events - 1e-9])

    def violated(c):
        return any(((s.birth <= v - c) & (s.death > v)).sum() > ((o.birth <= v) & (o.death > v)).sum() for v in values)

    assert not violated(least + 1e-12)
    assert least == 0 or violated(least - 1e-8)


def test_constants_are_sharp():
    """A loop of lifetime 0.9996 alpha goes unseen, and a birth moves by alpha + epsilon."""
    unseen = COUNTEREXAMPLES["a loop that goes unseen"].check()
    assert 0.9996 < unseen.corrected.statistic / unseen.alpha < 1
    gate = COUNTEREXAMPLES["a gate that is tight"].check()
    assert (gate.alpha, gate.epsilon) == pytest.approx((0.25, 0.05))
    assert gate.corrected.statistic == pytest.approx(gate.corrected.bound)


@pytest.mark.parametrize("name", [name for name, example in COUNTEREXAMPLES.items() if example.refutes])
def test_counterexamples_refute_the_paper_and_not_the_correction(name):
    example = COUNTEREXAMPLES[name]
    check = example.check()
    assert check.statement == example.statement
    assert check.paper.applies  # the hypotheses hold, there is a loop to speak about
    assert not check.paper.holds
    assert check.paper.bound < check.paper.statistic
    assert "FAILS" in str(check)
    assert all(v.holds for version, v in check.versions.items() if version != "paper")


@pytest.mark.parametrize("seed", range(5))
def test_two_loops_of_any_size_contradict_assumption_3(seed):
    """Two holes of different widths in a sheet, whose deaths are more than alpha apart."""
    rng = np.random.default_rng(seed)
    sheet = np.array([(x, y) for x in range(31) for y in range(13)], dtype=float)
    for middle, radius in ((7, 2), (21, rng.uniform(3.2, 4))):
        sheet = sheet[np.linalg.norm(sheet - [middle, 6], axis=1) > radius]
    sheet = sheet + rng.uniform(-0.05, 0.05, sheet.shape)
    loops = rips_persistence(sheet)
    for alpha in (0.3, 0.5):  # the grid is connected in steps of 4 alpha
        assert loops.death[0] - loops.death[1] > alpha
        assert loops.lifetime[1] > alpha
        assert lemmas.beta_all(sheet, alpha).max >= hausdorff(*sheet[loops.killer_edge[:2]])


def test_converse_speaks_about_two_similar_loops():
    angle = 2 * np.pi * np.arange(24) / 24
    rings = np.vstack([np.column_stack([np.cos(angle) + x, np.sin(angle)]) for x in (0, 25)])
    check = lemmas.converse(rings, np.arange(48), 1.001 * rings, np.arange(0, 48, 2))
    assert check.corrected.applies
    assert check.corrected.holds
    assert not check.paper.applies


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda s: lemmas.observability(s, [99]), "vertex 99"),
        (lambda s: lemmas.gates(s, [0, 1], s, [0, 77]), "observed_after names vertex 77"),
        (lambda s: lemmas.temporal_persistence(s, s[:-1]), "after"),
    ],
)
def test_bad_input_is_refused(call, names):
    with pytest.raises(ValueError, match=names):
        call(shape(0))


# Episodes and the search


def test_verify_episode_is_verify_step_by_step():
    episode = load_episode(DATA / "apron_hook_0.npz")
    points = episode.points[60:63, ::2].astype(float)
    observed = points[:, farthest_point_sample(points[0], 200)[0]]
    steps = lemmas_on_cloth.verify_episode(points, observed)
    assert len(steps) == 2
    for t, checks in enumerate(steps):
        ids, ids_then = (lemmas_on_cloth.observed_ids(points[i], observed, i) for i in (t, t + 1))
        assert checks == lemmas.verify_step(points[t], ids, points[t + 1], ids_then)
        assert all(v.holds for c in checks.values() for name, v in c.versions.items() if name != "paper")
        row = lemmas_on_cloth.row("apron", points[t], checks)
        assert row["distortion"] < row["epsilon"] / 5  # cloth in the air moves almost rigidly
        beta_all = lemmas_on_cloth.largest_bound(checks["recovering killers"], "paper")
        assert row["beta_intrinsic"] < beta_all / 4  # the killer's rivals are around the loop
        assert row["lifetime"] == rips_persistence(points[t]).lifetime[0]
    assert len(lemmas_on_cloth.verify_episode(points, observed, stride=2)) == 1


def test_the_search_finds_no_violation_and_would_find_one(monkeypatch):
    search = lemma_search.Search(seed=5, steps=30)
    search.run(60, len(lemma_search.TRUE_VERSIONS), progress=False)
    assert search.news == []
    rows = {(r["instances"], r["statement"], r["version"]): r for r in search.table()}
    assert all(rows["random", name, "corrected"]["tried"] == 60 for name in lemma_search.CHECKS)
    assert rows["random", "feature approximation", "paper"]["violated"] > 10
    # Were a false statement taken for a true one, the search would say so.
    monkeypatch.setattr(lemma_search, "TRUE_VERSIONS", [("feature approximation", "paper")])
    fooled = lemma_search.Search(seed=5, steps=30)
    fooled.run(10, 0, progress=False)
    assert fooled.news
    news = fooled.news[0]
    instance = lemma_search.Instance(*(np.array(news[key]) for key in ("before", "after", "seen", "seen_after")))
    assert lemmas.feature_approximation(instance.before, instance.seen).paper.violated
