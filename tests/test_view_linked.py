"""The figure of chapter 14: what its page holds, and that its script links curves as topokit.linking does."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from topokit import linking_number, view
from topokit.linking import close_far

from conftest import polygon
from pages import by_script, check_small_and_whole, needs_node, page_data

RING = np.insert(polygon(8), 2, 0.0, axis=1)
HOOK = np.array([[0.0, 3, -2], [0, 3, 1], [0, 0, 1], [0, 0, 2]])
WAY = [[0.0, 0, 1 / 3], [0, 0, 3]]


def test_linked_holds_curve_hook_and_way_to_the_last_digit():
    data = page_data(view.linked(RING, HOOK, WAY))
    np.testing.assert_array_equal(data["curve"], RING)
    np.testing.assert_array_equal(data["line"], close_far(HOOK))
    assert data["way"] == WAY


def test_linked_is_whole_small_and_asks_nothing_of_the_network():
    figure = view.linked(RING, HOOK, WAY)
    check_small_and_whole(figure)
    assert repr(figure).startswith("Framed('A curve and a hook, linking number 0'")
    around = view.linked(RING + [0, 0, 1.5], HOOK, WAY)
    assert "linking number 1" in around.title


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((RING[:, :2], HOOK, WAY), r"curve_a must be an \(n, 3\) array"),
        ((RING, HOOK[:1], WAY), r"curve must be an \(n, 3\) array of at least 2 corners"),
        ((RING, HOOK, WAY[:1]), r"way \(2, 3\) at least, not 8, 4 and \(1, 3\)"),
        ((RING, HOOK, np.zeros((25, 3))), r"at most 24 rows.* not 8, 4 and \(25, 3\)"),
        ((RING, HOOK, [[0, 0], [1, 1]]), r"not 8, 4 and \(2, 2\)"),
        ((RING, HOOK, [[0, 0, 0], [0, 0, np.nan]]), "way has 1 of 2 points with a NaN"),
        ((np.insert(polygon(25), 2, 0.0, axis=1), HOOK, WAY), "at most 24 rows.* not 25, 4 and"),
        ((RING, np.linspace(HOOK[0], HOOK[1], 25), WAY), "not 8, 25 and"),
        ((RING + HOOK[1] - RING[0], HOOK, WAY), "the curves touch"),
    ],
)
def test_linked_refuses_what_it_cannot_show(arguments, message):
    with pytest.raises(ValueError, match=message):
        view.linked(*arguments)


# ---- its script, run by node

CALL = """([a, b]) => ({ sum: linkingSum(a, b), gap: gapOf(a, b),
  crossings: crossingsOf(a, b).map(({ place, sign, over }) => [...place, sign, over ? 1 : 0]) })"""


def pairs() -> list[tuple[np.ndarray, np.ndarray]]:
    """Random curves, with numbers from -3 to 3 at least; and rings about a hook, which has corners far away."""
    rng = np.random.default_rng(0)
    tangles = [(rng.normal(size=(int(n), 3)), rng.normal(size=(17, 3))) for n in rng.integers(3, 30, 80)]
    hook = close_far(HOOK)
    turns = zip(Rotation.random(40, rng=rng).as_matrix(), rng.integers(0, 4, 40), strict=True)
    turned = [RING @ turn.T + HOOK[int(k)] + 0.2 for turn, k in turns]
    return tangles + [(ring, hook) for ring in turned]


@needs_node
def test_script_links_what_topokit_links():
    two = pairs()
    seen = set()
    for (a, b), told in zip(two, by_script(["link.js"], CALL, [[a.tolist(), b.tolist()] for a, b in two]), strict=True):
        number = linking_number(a, b)
        assert told["sum"] == pytest.approx(number, abs=1e-6)
        signs = np.array(told["crossings"]).reshape(-1, 4)
        assert signs[:, 2].sum() / 2 == number
        assert (signs[:, 2] @ signs[:, 3], signs[:, 2] @ (1 - signs[:, 3])) == (number, number)
        seen.add(number)
    assert seen >= {-3, -2, -1, 0, 1, 2, 3}


@needs_node
def test_script_finds_crossings_where_they_are():
    """A square of side two and an upright one that stands through its right side: seen from above, a line across it."""
    square = [[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]
    upright = [[0, 0.25, -1], [2, 0.5, -1], [2, 0.5, 1], [0, 0.25, 1]]
    [told] = by_script(["link.js"], CALL, [[square, upright]])
    assert sorted(told["crossings"]) == [[1, 0.375, -1, 0], [1, 0.375, -1, 1]]
    assert linking_number(square, upright) == -1


@needs_node
def test_script_measures_the_distance_of_two_curves():
    """Against a fine grid on both, which is never nearer and hardly farther."""
    two = pairs()[:12]
    share = np.arange(40)[:, None, None] / 40
    for (a, b), told in zip(two, by_script(["link.js"], CALL, [[a.tolist(), b.tolist()] for a, b in two]), strict=True):
        fine = [(c + share * (np.roll(c, -1, 0) - c)).reshape(-1, 3) for c in (a, b)]
        grid = np.linalg.norm(fine[0][:, None] - fine[1], axis=-1).min()
        assert told["gap"] <= grid + 1e-9
        assert told["gap"] > grid - 0.15
    crossed = [[[0, 0, 0], [2, 0, 0], [1, 9, 9]], [[1, -1, 0.25], [1, 1, 0.25], [1, 0, 7]]]
    [told] = by_script(["link.js"], CALL, [crossed])
    assert told["gap"] == pytest.approx(0.25)


@needs_node
def test_the_smooth_curve_runs_through_its_handles():
    [curve] = by_script(["link.js"], "(handles) => smooth(handles, 6)", [RING.tolist()])
    curve = np.array(curve)
    assert len(curve) == 6 * len(RING)
    np.testing.assert_allclose(curve[::6], RING)
    np.testing.assert_allclose(np.linalg.norm(curve, axis=1), 1, atol=0.01)  # nearly the circle
