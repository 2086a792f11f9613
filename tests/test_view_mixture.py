"""The figure of a loop's mixture: what its page holds, and that its script makes the mixture that topokit makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from topokit import SeqPH, loop_mixture, view
from topokit.mixture import LoopMixture

from conftest import polygon
from pages import by_script, check_small_and_whole, needs_node, page_data

RING = polygon(20, 0.2)
CALL = """({ points, most, noise, places }) => {
  const [loop] = rips(points).loops, mixture = mixtureOf(points, loop, most, noise), one = matched(mixture);
  const [found, reached] = [places.map((p) => density(mixture, p)), credibilities(mixture, places)];
  return { death: loop.death, mixture, one, density: found, reached };
}"""


def test_mixture_holds_the_cloud_to_the_last_digit():
    figure = view.mixture(RING, 15)
    data = page_data(figure)
    assert (data["points"], data["border"]) == (RING.tolist(), 15)
    check_small_and_whole(figure)
    assert repr(figure).startswith("Framed('Mixture of 20 points'")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((61, 2)), 5), "points must be 1 to 60 points, not 61"),
        ((np.zeros((5, 3)), 5), "points must lie in the plane"),
        ((RING, 2), "border must be 3 to 20"),
        ((RING, 21), "border must be 3 to 20, a whole number, not 21"),
    ],
)
def test_mixture_refuses_what_it_cannot_show(arguments, message):
    with pytest.raises(ValueError, match=message):
        view.mixture(*arguments)


def asked() -> list[dict]:
    """Noisy rings of several sizes with a few points inside; components, noise and places at random."""
    rng, cases = np.random.default_rng(0), []
    for k in range(40):
        cloud = polygon(int(rng.integers(8, 25)), 0.2) + rng.normal(0, 0.01, (1, 2))
        cloud = np.vstack([cloud + rng.normal(0, 0.02, cloud.shape), rng.uniform(-0.1, 0.1, (k % 4, 2))])
        places = rng.uniform(-0.2, 0.2, (25, 2))
        noise = float(10 ** rng.uniform(-4, -2))
        cases.append({"points": cloud.tolist(), "most": 2 + k % 5, "noise": noise, "places": places.tolist()})
    return cases


@needs_node
def test_script_makes_the_mixtures_that_topokit_makes():
    cases, numbers = asked(), set()
    for case, told in zip(cases, by_script(["rips.js", "mixture.js"], CALL, cases), strict=True):
        state = SeqPH(alpha=1e-9).update(np.array(case["points"]))
        loop = max(state.loops, key=lambda found: found.death - found.birth)
        assert told["death"] == pytest.approx(loop.death)
        first = slice(case["most"] - 2)
        loop = replace(loop, neighbours=loop.neighbours[first], neighbour_values=loop.neighbour_values[first])
        ours = loop_mixture(loop, case["noise"])
        theirs = told["mixture"]
        np.testing.assert_allclose([part["mean"] for part in theirs], ours.means)
        np.testing.assert_allclose([part["weight"] for part in theirs], ours.weights)
        np.testing.assert_allclose([part["cov"] for part in theirs], ours.covariances.reshape(-1, 4)[:, [0, 1, 3]])
        np.testing.assert_allclose(told["density"], np.exp(ours.log_prob(np.array(case["places"]))), atol=1e-12)
        [one] = told["one"]
        np.testing.assert_allclose(one["mean"], ours.mean)
        np.testing.assert_allclose(one["cov"], ours.covariance.ravel()[[0, 1, 3]])
        numbers.add(len(theirs))
    assert numbers == {2, 3, 4, 5, 6}


@needs_node
def test_script_says_which_credible_region_reaches_a_place():
    """Against a hundred thousand samples; its grid may be off by two hundredths."""
    cases = asked()[:8]
    for case, told in zip(cases, by_script(["rips.js", "mixture.js"], CALL, cases), strict=True):
        parts = told["mixture"]
        covariances = [np.array([[p["cov"][0], p["cov"][1]], [p["cov"][1], p["cov"][2]]]) for p in parts]
        ours = LoopMixture(*map(np.array, ([p["mean"] for p in parts], covariances, [p["weight"] for p in parts])))
        reached = ours.credibility(np.array(case["places"]), n=100_000, rng=0)
        np.testing.assert_allclose(told["reached"], reached, atol=0.02)
        assert np.ptp(reached) > 0.3


@needs_node
def test_script_finds_the_places_in_an_opening():
    """Of a square with a corner cut off, seven eighths."""
    cut = [[0, 0], [2, 0], [2, 1], [1, 2], [0, 2]]
    [found] = by_script(["mixture.js"], "(curve) => within(curve, 40)", [cut])
    x, y = np.array(found).T
    assert (x + y < 3).all()
    assert len(found) / 1600 == pytest.approx(7 / 8, abs=0.02)
