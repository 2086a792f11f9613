"""Measures of forecasts, on loops of which everything is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from accuracy import TrueCurves, measure_forecasts

from topokit.models import StateTensors

HORIZON = 4
SLOTS = 3
STEPS = (1, 2, 4)
PANE = 0.01 * np.array([[1, 0, 0], [-1, 0, 0], [0, 2, 0], [0, -2, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])


def circle(centre: tuple[float, float, float] = (0, 0, 0), radius: float = 0.1) -> np.ndarray:
    """(K, 40, 3) a flat loop that does not move."""
    angle = 2 * np.pi * np.arange(40) / 40
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    return np.repeat((np.array(centre) + radius * ring)[None], len(STEPS), axis=0)


def said(
    places: list[tuple[float, float, float]], lifetimes: list[float], there: list[bool] | None = None
) -> StateTensors:
    """A forecast of one window that says the same at every step; slots that are not named are absent, far off."""
    fill = SLOTS - len(places)
    middle = np.array([*places, *[(9.0, 9.0, 9.0)] * fill])
    life = torch.tensor([*lifetimes, *[0.0] * fill]).expand(1, HORIZON, SLOTS)
    seen = torch.tensor([*(there or [True] * len(places)), *[False] * fill]).expand(1, HORIZON, SLOTS)
    corners = torch.tensor(middle[:, None] + PANE, dtype=torch.float32).expand(1, HORIZON, SLOTS, 8, 3)
    small = torch.full((1, HORIZON, SLOTS), 0.02)
    return StateTensors(
        corners.clone(),
        small[..., None].expand(*small.shape, 4).clone(),
        small,
        small + life,
        0 * small,
        torch.where(seen, 6.0, -6.0),
        torch.full_like(small, 1e-4),
    )


def score(states: StateTensors, *curves: np.ndarray, target: StateTensors | None = None) -> dict[str, np.ndarray]:
    """All columns, (K,) of the one window."""
    target = states if target is None else target
    rng = np.random.default_rng(0)
    found = measure_forecasts(states, target, target[:, :1], [TrueCurves(curves)], STEPS, (1, 4), rng)
    return {name: column[0] for name, column in found.items()}


def test_a_perfect_forecast_is_in_the_hull_and_one_beside_it_is_as_far_as_it_is():
    assert (score(said([(0, 0, 0)], [0.05]), circle())["hull_distance"] < 1e-6).all()
    moved = score(said([(0, 0, 0.2)], [0.05]), circle())
    assert np.allclose(moved["hull_distance"], 0.2, atol=1e-5)
    assert np.allclose(moved["distance"], 0.2, atol=1e-5)
    edge = score(said([(0.13, 0, 0)], [0.05]), circle())
    assert np.allclose(edge["hull_distance"], 0.03, atol=1e-5)
    assert np.allclose(edge["distance"], 0.13, atol=1e-5)


def test_the_longest_lived_loop_counts_and_no_other():
    states = said([(0, 0, 0), (0, 0, 0.5)], [0.03, 0.05])
    assert np.allclose(score(states, circle())["hull_distance"], 0.5, atol=1e-5)
    other = states.replace(death=states.death.flip(-1).roll(-1, dims=-1))  # now the first slot lives longer
    assert float(other.death[0, 0, 0]) > float(other.death[0, 0, 1])
    assert (score(other, circle())["hull_distance"] < 1e-6).all()


def test_two_loops_ask_for_two_means_in_two_hulls():
    here = circle((-0.3, 0, 0))
    there = circle((0.3, 0, 0))
    for places in ([(-0.3, 0, 0), (0.3, 0, 0)], [(0.3, 0, 0), (-0.3, 0, 0)]):  # the order is free
        assert (score(said(places, [0.05, 0.04]), here, there)["hull_distance"] < 1e-6).all()
    twice = score(said([(-0.3, 0, 0), (-0.3, 0.01, 0)], [0.05, 0.04]), here, there)
    assert np.allclose(twice["hull_distance"], 0.5, atol=1e-4)  # from one hull to the border of the other
    assert np.isinf(score(said([(-0.3, 0, 0)], [0.05]), here, there)["hull_distance"]).all()


def test_the_edge_that_ends_a_loop_widens_its_hull():
    """A tie before a skirt: its curve was marked straight across the skirt, and it is narrowest below."""
    curve = circle()
    below = (0.0, 0.0, -0.1)
    edge = np.repeat(np.array([[[-0.05, 0, -0.1], [0.05, 0, -0.1]]]), len(STEPS), axis=0)
    states = said([below], [0.05])
    rng = np.random.default_rng(0)
    for closing, expected in (((edge,), 0.0), ((), 0.1)):
        found = measure_forecasts(states, states, states[:, :1], [TrueCurves((curve,), closing)], STEPS, (), rng)
        assert np.allclose(found["hull_distance"], expected, atol=1e-5)
        assert np.allclose(found["hull_distance_marked_curve"], 0.1, atol=1e-5)


def test_a_true_loop_that_is_not_there_is_not_asked_for():
    here = circle((-0.3, 0, 0))
    there = circle((0.3, 0, 0))
    present = (np.array([True, True, False]), np.array([True, False, False]))
    states = said([(-0.3, 0, 0)], [0.05])
    rng = np.random.default_rng(0)
    found = measure_forecasts(
        states, states, states[:, :1], [TrueCurves((here, there), (), present)], STEPS, (1, 4), rng
    )
    assert np.isinf(found["hull_distance"][0, 0])  # two are there, one is forecast
    assert found["hull_distance"][0, 1] < 1e-6  # one is there
    assert np.isnan(found["hull_distance"][0, 2])  # none: nothing is asked
    assert np.isnan(found["nll"][0, 2])
    assert np.isinf(found["hull_distance_marked_curve"]).all()


def test_what_is_said_to_be_absent_does_not_count():
    silent = score(said([(0, 0, 0)], [0.05], [False]), circle())
    assert np.isinf(silent["hull_distance"]).all()
    assert (silent["hull_distance_presence_ignored"] < 1e-6).all()
    assert np.isnan(silent["distance"]).all()
    assert np.isnan(silent["nll"]).all()
    assert (silent["in_plane"] == 0).all()


def test_in_the_plane():
    assert (
        score(said([(0.05, 0, 0.02)], [0.05]), circle())["in_plane"] == 1
    ).all()  # beside it by a fifth of the radius
    assert (score(said([(0.05, 0, 0.03)], [0.05]), circle())["in_plane"] == 0).all()
    assert (score(said([(0.11, 0, 0.0)], [0.05]), circle())["in_plane"] == 0).all()


def test_likelihood_is_that_of_the_mixture():
    """An opening that is a dot has one point; the points of a wide one are uniform, so many of them give the integral."""
    states = said([(0.02, 0, 0.01)], [0.05])
    mixture = states[0].loops(0)[0].mixture()
    dot = score(states, circle(radius=1e-6))
    assert dot["nll"][0] == pytest.approx(-mixture.log_prob(np.zeros(3)), rel=1e-3)
    assert np.isnan(dot["nll"][1])  # step 2 is none of the fine ones

    square = np.array([[0, 0, 0], [0.05, 0, 0], [0.05, 0.05, 0], [0, 0.05, 0]])
    curves = TrueCurves((np.repeat(square[None], len(STEPS), axis=0),))
    many = states[torch.zeros(150, dtype=torch.long)]
    rng = np.random.default_rng(0)
    found = measure_forecasts(many, many, many[:, :1], [curves] * 150, STEPS, (1,), rng)
    across = (np.arange(50) + 0.5) / 1000
    grid = np.column_stack([*(axis.ravel() for axis in np.meshgrid(across, across)), np.zeros(2500)])
    assert found["nll"][:, 0].mean() == pytest.approx(-mixture.log_prob(grid).mean(), abs=0.05)


def test_identity_is_kept_by_the_same_slot():
    here = circle((-0.3, 0, 0))
    there = circle((0.3, 0, 0))
    states = said([(-0.3, 0, 0), (0.3, 0, 0)], [0.05, 0.04])
    assert score(states, here, there)["same_slot"].tolist() == [1, 1, 1]
    corners = states.corners.clone()
    corners[:, 2:, [0, 1]] = corners[:, 2:, [1, 0]]  # from step 3 on the slots change places
    assert score(states.replace(corners=corners), here, there)["same_slot"].tolist() == [1, 1, 0]
    gone = states.presence.clone()
    gone[:, 1:, 1] = -6.0  # one is lost at step 2
    assert score(states.replace(presence=gone), here, there)["same_slot"].tolist() == [1, 0.5, 0.5]


def test_presence_counts_slots():
    target = said([(0, 0, 0), (0.5, 0, 0)], [0.05, 0.04])
    fades = target.presence.clone()
    fades[:, 2:, 1] = -20.0  # the second loop closes at step 3
    target = target.replace(presence=fades)
    held = said([(0, 0, 0), (0.5, 0, 0)], [0.05, 0.04])  # as at the start, for good
    found = score(held, circle(), target=target)
    assert found["present"].tolist() == [2, 2, 1]
    assert found["present_right"].tolist() == [2, 2, 1]
    assert found["absent_right"].tolist() == [1, 1, 1]
    assert found["closes"].tolist() == [0, 0, 1]
    assert (
        found["closes_forecast"].tolist() == found["closes_right"].tolist() == [0, 0, 0]
    )  # who holds forecasts no event
    assert found["opens"].tolist() == found["opens_forecast"].tolist() == [0, 0, 0]
    swapped = held[:, :, [2, 1, 0]]
    assert score(swapped, circle(), target=target)["present_right"].tolist() == [2, 2, 1]  # slots have no order
