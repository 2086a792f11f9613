"""The figures of chapters 3 and 4: what their pages hold, and that their script matches diagrams as topokit.lemmas does."""

from __future__ import annotations

import numpy as np
import pytest

from topokit import lemmas, rips_persistence, view
from topokit.sampling import spacing

from conftest import polygon
from pages import NETWORK, by_script, needs_node, page_data

SQUARE = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]


# ---- the pages


def test_coverage_holds_the_scene_and_who_is_observed():
    points = np.random.default_rng(0).normal(size=(30, 2)) / 3
    data = page_data(view.coverage(points, [4, 2, 4, 0], title="thirty </script> points"))
    np.testing.assert_array_equal(data["points"], points)
    assert (data["observed"], data["title"]) == ([0, 2, 4], "thirty </script> points")
    assert "hand" not in data
    assert page_data(view.coverage(points, [0], hand=(1, 0.5, 2)))["hand"] == [1.0, 0.5, 2.0]


def test_motion_holds_the_points_the_leash_and_who_is_seen():
    data = page_data(view.motion(SQUARE, 0.25, [2, 0, 1]))
    assert (data["points"], data["observed"], data["epsilon"]) == (SQUARE, [0, 1, 2], 0.25)
    assert page_data(view.motion(SQUARE, 1))["observed"] is None


@pytest.mark.parametrize("figure", [view.coverage(SQUARE, [0, 1, 2]), view.motion(SQUARE, 0.1, [0, 1])])
def test_pages_are_whole_small_and_ask_nothing_of_the_network(figure, tmp_path):
    page = figure.save(tmp_path / "figure.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>")
    assert page.rstrip().endswith("</html>")
    assert not NETWORK.search(page)
    assert "__" not in page  # nothing left to fill in
    assert len(page) < 40_000
    assert figure._repr_html_().count('"') == 8  # srcdoc, title, loading, style


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: view.coverage(np.zeros((5, 3)), [0]), ValueError, "points must lie in the plane, not in 3 dimensions"),
        (lambda: view.coverage(np.zeros((61, 2)), [0]), ValueError, "points must be 1 to 60 points, not 61"),
        (lambda: view.coverage(SQUARE, []), ValueError, "observed is empty"),
        (lambda: view.coverage(SQUARE, [0.5]), TypeError, "observed must hold whole numbers"),
        (lambda: view.coverage(SQUARE, [1, 4]), ValueError, "observed names vertex 4; there are 4"),
        (lambda: view.coverage(SQUARE, [0], hand=(0, 0, 0)), ValueError, "hand's radius must be more than zero"),
        (lambda: view.coverage(SQUARE, [0], hand=(np.nan, 0, 1)), ValueError, "hand has 1 of 1 points with a NaN"),
        (lambda: view.motion(np.zeros((5, 3)), 1), ValueError, "points must lie in the plane"),
        (lambda: view.motion(SQUARE, 0), ValueError, "epsilon must be more than zero"),
        (lambda: view.motion(SQUARE, 1, [4]), ValueError, "observed names vertex 4; there are 4"),
    ],
)
def test_refuses_what_it_cannot_show(call, error, message):
    with pytest.raises(error, match=message):
        call()


# ---- the script, run by node


SCRIPTS = ["rips.js", "match.js"]
MATCH = "([a, b, oneSided]) => { const [s, o] = [rips(a).loops, rips(b).loops]; return { s, o, ...matchLoops(s, o, oneSided) }; }"


@needs_node
def test_matchings_are_those_of_the_library():
    """The same bottleneck, reached by the script's own pairs, for random clouds that move and for samples of them."""
    rng = np.random.default_rng(0)
    cases = []
    for k in range(240):
        n = int(rng.integers(6, 26))
        cloud = polygon(n, 2.0) + rng.normal(0, 0.2, (n, 2)) if k % 2 else rng.normal(size=(n, 2))
        if k % 3:
            cases.append((cloud, cloud + rng.uniform(-0.2, 0.2, cloud.shape), False))
        else:
            cases.append((cloud, cloud[rng.permutation(n)[: max(3, n - 4)]], True))
    found = by_script(SCRIPTS, MATCH, [(a.tolist(), b.tolist(), one_sided) for a, b, one_sided in cases])
    matched = 0
    for (a, b, one_sided), theirs in zip(cases, found, strict=True):
        ours = lemmas.match_diagrams(rips_persistence(a), rips_persistence(b), one_sided=one_sided, tolerance=1e-9)
        assert theirs["bottleneck"] == pytest.approx(ours.cost, abs=1e-12)
        pairs = [(s, theirs["o"][j]) for s, j in zip(theirs["s"], theirs["partner"], strict=True) if j >= 0]
        shifts = np.array([(o["birth"] - s["birth"], o["death"] - s["death"]) for s, o in pairs]).reshape(-1, 2)
        assert np.abs(shifts).max(initial=0) <= ours.cost + 1e-12
        assert not one_sided or shifts.min(initial=0) >= -1e-9
        alone = [s for s, j in zip(theirs["s"], theirs["partner"], strict=True) if j < 0]
        alone += [o for j, o in enumerate(theirs["o"]) if j not in theirs["partner"]]
        price = 1 if one_sided else 2
        assert all(loop["death"] - loop["birth"] <= price * ours.cost + 1e-12 for loop in alone)
        matched += len(pairs)
    assert matched > 100


@needs_node
def test_assignments_are_cheapest():
    from scipy.optimize import linear_sum_assignment

    rng = np.random.default_rng(1)
    costs = [rng.integers(0, 9, (n, n)).astype(float) for n in rng.integers(1, 12, 60)]
    for cost, columns in zip(
        costs, by_script(SCRIPTS, "(cost) => assign(cost)", [c.tolist() for c in costs]), strict=True
    ):
        assert sorted(columns) == list(range(len(cost)))
        least = cost[linear_sum_assignment(cost)].sum()
        assert cost[np.arange(len(cost)), columns].sum() == least


@needs_node
def test_matching_with_an_empty_diagram():
    square, line = SQUARE, [[0, 0], [1, 0], [2, 0]]
    for a, b, partner in ((square, line, [-1]), (line, square, []), (line, line, [])):
        [found] = by_script(SCRIPTS, MATCH, [(a, b, False)])
        assert found["partner"] == partner
        assert found["bottleneck"] == pytest.approx(0 if not (found["s"] or found["o"]) else (np.sqrt(2) - 1) / 2)


@needs_node
def test_script_guesses_alpha_as_topokit_does():
    rng = np.random.default_rng(7)
    clouds = [rng.normal(size=(int(n), 2)).round(int(digits)) for n, digits in rng.integers([1, 0], [30, 4], (60, 2))]
    clouds += [np.ones((1, 2)), np.ones((3, 2)), np.array(SQUARE)[[0, 0, 1]]]
    guessed = by_script(["rips.js"], "(points) => spacing(points)", [cloud.tolist() for cloud in clouds])
    np.testing.assert_allclose(guessed, [spacing(cloud) for cloud in clouds])
    assert guessed[-3:] == [0, 0, 1]


ATTACK = """([points, epsilon]) => {
  const lives = [];
  let moved = points, loops;
  for (let k = 0; k < 150 && (loops = rips(moved).loops).length; k++) {
    lives.push(loops[0].death - loops[0].birth);
    moved = push(moved, points, loops[0], epsilon, 1 - k / 150);
  }
  return { lives, moved };
}"""


def attack(points: np.ndarray, epsilon: float) -> list[float]:
    """The longest life before each round of chapter 4's adversary."""
    moved, lives = points.copy(), []
    for k in range(150):
        found = rips_persistence(moved)
        if not len(found):
            break
        lives.append(found.lifetime[0])
        for edge, way in ((found.birth_edge[0], -1), (found.killer_edge[0], 1)):
            step = moved[edge[1]] - moved[edge[0]]
            step *= way * epsilon * (0.02 + 0.4 * (1 - k / 150)) / np.linalg.norm(step)
            moved[edge[0]] += step
            moved[edge[1]] -= step
        off = moved - points
        moved = points + off / np.maximum(np.linalg.norm(off, axis=1, keepdims=True) / epsilon, 1)
    return lives


@needs_node
def test_the_adversary_is_the_chapters_and_never_beats_the_bound():
    """Round by round until rounding decides a tie; and whatever it does is within epsilon, and leaves LT - 2 epsilon."""
    rng = np.random.default_rng(3)
    five = lemmas.COUNTEREXAMPLES["a loop that five points lose"].before
    clouds = [five, *(polygon(n, 1.5) + rng.normal(0, 0.1, (n, 2)) for n in (8, 15, 30))]
    given = [(cloud, share * rips_persistence(cloud).lifetime[0]) for cloud in clouds for share in (0.2, 0.4, 0.505)]
    scripts = ["rips.js", "adversary.js"]
    for (cloud, epsilon), theirs in zip(
        given, by_script(scripts, ATTACK, [(c.tolist(), e) for c, e in given]), strict=True
    ):
        ours = attack(cloud, epsilon)
        np.testing.assert_allclose(theirs["lives"][:10], ours[:10], rtol=1e-9)
        assert min(theirs["lives"]) == pytest.approx(min(ours), abs=0.02 * ours[0])
        assert min(theirs["lives"]) >= ours[0] - 2 * epsilon - 1e-12
        assert lemmas.max_displacement(cloud, np.array(theirs["moved"])) <= epsilon * (1 + 1e-12)
        if cloud is five:  # the bound is reached
            assert len(theirs["lives"]) < 150 if epsilon > 0.1 else min(theirs["lives"]) < ours[0] - 1.9 * epsilon
