"""The figure of bent plans: that its page and its script give back the forecasts, and link what topokit links."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_view import unpack

from topokit import view
from topokit.io import load_episode
from topokit.linking import close_far, linking_number
from topokit.view._player import sums

from pages import NETWORK, by_script, needs_node, page_data

ROOT = Path(__file__).parents[1]
AHEAD = (1, 3, 6, 10)
ROWS, COLUMNS, FRAME = 3, 5, 80  # the apron hangs by then


@pytest.fixture(scope="module")
def film():
    return load_episode(ROOT / "data_small" / "apron_hook_0.npz")


@pytest.fixture(scope="module")
def bent(film):
    """Plans that end up to a metre apart, and a cloth that follows them, stretched: under some it stays on the hook."""
    rise, aside = (np.linspace(-0.5, 0.5, n) for n in (ROWS, COLUMNS))
    ends = np.stack(np.broadcast_arrays(aside[None], 0 * aside[None], rise[:, None]), axis=-1)  # (R, C, 3)
    share = np.arange(1, AHEAD[-1] + 1)[:, None] / AHEAD[-1]
    shift = ends[:, :, None] * share + np.array([0, 0.2, 0]) * share**2
    actions = film.grippers[FRAME].astype(float) + shift[:, :, :, None]
    follows = np.linspace(0.7, 1.1, film.points.shape[1])[:, None]
    clouds = film.points[FRAME].astype(float) + shift[:, :, np.array(AHEAD) - 1, None] * follows
    return actions, clouds


@pytest.fixture(scope="module")
def page(film, bent):
    return page_data(view.plans(film, FRAME, *bent, AHEAD, film.loops[0]))


def test_page_says_what_the_plans_are(film, page):
    told = page["plans"]
    assert (told["rows"], told["columns"], told["knots"]) == (ROWS, COLUMNS, [0, *AHEAD])
    assert told["vertices"] == film.points.shape[1]
    assert told["cycle"] == film.loops[0].tolist()
    np.testing.assert_array_equal(told["target"], close_far(film.centre_line))
    assert page["frames"] == AHEAD[-1] + 1


def test_page_asks_nothing_of_the_network_and_is_small(film, bent):
    figure = view.plans(film, FRAME, *bent, AHEAD, film.loops[0])
    assert not NETWORK.search(figure.page)
    assert len(figure.page) < 150_000
    assert "15 plans" in figure.title


def test_forecasts_of_another_shape_are_refused(film, bent):
    actions, clouds = bent
    for wrong in ((actions[:, :, 1:], clouds), (actions, clouds[:2]), (actions, clouds[..., 1:, :])):
        with pytest.raises(ValueError, match="actions and clouds must be"):
            view.plans(film, FRAME, *wrong, AHEAD, film.loops[0])


def test_sums_are_as_near_as_they_say_and_as_few_as_can_be():
    rng = np.random.default_rng(0)
    clouds = np.einsum("mq,qnd->mnd", rng.normal(size=(40, 7)), rng.normal(size=(7, 30, 3)))
    shares, modes = sums(clouds, 1e-9)
    assert len(modes) == 7
    assert shares.shape == (40, 9)
    assert not shares[:, 7:].any()
    np.testing.assert_allclose(np.tensordot(shares[:, :7], modes, 1), clouds, atol=1e-9)
    shares, modes = sums(clouds, 5.0)
    off = np.linalg.norm(np.tensordot(shares[:, : len(modes)], modes, 1) - clouds, axis=-1).max()
    assert 0 < len(modes) < 7
    assert off <= 5.0


@needs_node
def test_script_shows_the_forecasts_and_links_what_topokit_links(film, bent, page):
    """No vertex and no gripper is off by more than 5 mm and the rounding of 16 bits, at the knots and between them."""
    actions, clouds = bent
    arrays = {name: unpack(page["arrays"][name]).ravel().tolist() for name in ("shares", "modes")}
    asked = [[p, t] for p in range(ROWS * COLUMNS) for t in (0, 1, 2, 5, 9, 10)]
    call = """({ arrays, plans, asked }) => {
      globalThis.clamp = (v, low, high) => Math.max(low, Math.min(high, v));
      const bent = bending(arrays, plans);
      return asked.map(([p, t]) => [[...bent.coordinates(p, t)], bent.number(p, t)]);
    }"""
    given = [{"arrays": arrays, "plans": page["plans"], "asked": asked}]
    [told] = by_script(["link.js", "planar.js", "plans.js"], call, given)
    knots, now, seen = (0, *AHEAD), np.concatenate([film.points[FRAME], film.grippers[FRAME]]).astype(float), set()
    for (p, t), (flat, number) in zip(asked, told, strict=True):
        plan = p // COLUMNS, p % COLUMNS
        later = np.concatenate([clouds[plan], actions[plan][np.array(AHEAD) - 1]], axis=1)
        k = max(1, np.searchsorted(knots, t))
        before = now if k == 1 else later[k - 2]
        share = (t - knots[k - 1]) / (knots[k] - knots[k - 1])
        forecast = (1 - share) * before + share * later[k - 1]
        shown = np.reshape(flat, (-1, 3))
        assert np.linalg.norm(shown - forecast, axis=1).max() < 0.0055
        assert number == linking_number(shown[film.loops[0]], close_far(film.centre_line))
        seen.add(abs(number))
    assert seen == {0, 1}


def test_an_episode_that_ends_before_the_plans_is_refused(film, bent):
    with pytest.raises(ValueError, match=r"actions and clouds must be .* of 10 frames after 90 of 96"):
        view.plans(film, 90, *bent, AHEAD, film.loops[0])
