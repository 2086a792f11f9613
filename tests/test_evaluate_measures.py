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


def measured(states: StateTensors, truth: TrueCurves, target: StateTensors | None = None) -> dict[str, np.ndarray]:
    """All columns, (K,) of the one window."""
    target = states if target is None else target
    found = measure_forecasts(states, target, target[:, :1], [truth], STEPS, (1, 4), np.random.default_rng(0))
    return {name: column[0] for name, column in found.items()}


def score(states: StateTensors, *curves: np.ndarray, target: StateTensors | None = None) -> dict[str, np.ndarray]:
    return measured(states, TrueCurves(curves), target)


HERE = circle((-0.3, 0, 0))
THERE = circle((0.3, 0, 0))
LEFT = (-0.3, 0.0, 0.0)
RIGHT = (0.3, 0.0, 0.0)
MIDDLE = (0.0, 0.0, 0.0)
ABSENT = {
    "hull_distance": np.inf,
    "hull_distance_presence_ignored": 0,
    "distance": np.nan,
    "nll": np.nan,
    "in_plane": 0,
}


@pytest.mark.parametrize(
    ("forecast", "curves", "expected"),
    [
        (said([MIDDLE], [0.05]), [circle()], {"hull_distance": 0}),
        (said([(0, 0, 0.2)], [0.05]), [circle()], {"hull_distance": 0.2, "distance": 0.2}),
        (said([(0.13, 0, 0)], [0.05]), [circle()], {"hull_distance": 0.03, "distance": 0.13}),
        # The longest-lived loop counts and no other.
        (said([MIDDLE, (0, 0, 0.5)], [0.03, 0.05]), [circle()], {"hull_distance": 0.5}),
        (said([MIDDLE, (0, 0, 0.5)], [0.05, 0.03]), [circle()], {"hull_distance": 0}),
        # Two loops ask for two means in two hulls, in any order; twice in one hull is as far as the border of the other.
        (said([LEFT, RIGHT], [0.05, 0.04]), [HERE, THERE], {"hull_distance": 0}),
        (said([RIGHT, LEFT], [0.05, 0.04]), [HERE, THERE], {"hull_distance": 0}),
        (said([LEFT, (-0.3, 0.01, 0)], [0.05, 0.04]), [HERE, THERE], {"hull_distance": 0.5}),
        (said([LEFT], [0.05]), [HERE, THERE], {"hull_distance": np.inf}),
        (said([MIDDLE], [0.05], [False]), [circle()], ABSENT),
        # In the plane: inside, and at most a fifth of the radius aside.
        (said([(0.05, 0, 0.02)], [0.05]), [circle()], {"in_plane": 1}),
        (said([(0.05, 0, 0.03)], [0.05]), [circle()], {"in_plane": 0}),
        (said([(0.11, 0, 0.0)], [0.05]), [circle()], {"in_plane": 0}),
    ],
)
def test_forecasts_of_which_everything_is_known(forecast, curves, expected):
    found = score(forecast, *curves)
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, atol=1e-4, err_msg=name)


def test_the_edge_that_ends_a_loop_widens_its_hull():
    """A tie before a skirt: its curve was marked straight across the skirt, and it is narrowest below."""
    edge = np.repeat(np.array([[[-0.05, 0, -0.1], [0.05, 0, -0.1]]]), len(STEPS), axis=0)
    states = said([(0, 0, -0.1)], [0.05])
    for closing, expected in (((edge,), 0.0), ((), 0.1)):
        found = measured(states, TrueCurves((circle(),), closing))
        np.testing.assert_allclose(found["hull_distance"], expected, atol=1e-5)
        np.testing.assert_allclose(found["hull_distance_marked_curve"], 0.1, atol=1e-5)
        np.testing.assert_allclose(found["opening_distance"], 0.1, atol=1e-5)
    # By the paper's words the vertices down to that edge are marked. By the other measure the mean has to be near the edge.
    found = measured(states, TrueCurves((circle(),), (edge,), marked=(np.concatenate([circle(), edge], axis=1),)))
    np.testing.assert_allclose(found["opening_distance"], 0, atol=1e-5)
    for place, expected in (((0, 0, -0.1), 0), ((0, 0.04, -0.1), 0.8), ((0, 0, -0.02), 1.6)):
        found = measured(said([place], [0.05]), TrueCurves((circle(),), (edge,)))
        np.testing.assert_allclose(found["killer_distance"], expected, atol=1e-4)


def test_a_true_loop_that_is_not_there_is_not_asked_for():
    """Two loops are there and one is forecast; one is there; none is, and nothing is asked."""
    present = (np.array([True, True, False]), np.array([True, False, False]))
    found = measured(said([LEFT], [0.05]), TrueCurves((HERE, THERE), (), present))
    np.testing.assert_allclose(found["hull_distance"], [np.inf, 0, np.nan], atol=1e-6)
    assert np.isnan(found["nll"][2])
    assert np.isinf(found["hull_distance_marked_curve"]).all()


def test_likelihood_is_that_of_the_mixture():
    """An opening that is a dot has one point; the points of a wide one are uniform, so many of them give the integral."""
    states = said([(0.02, 0, 0.01)], [0.05])
    mixture = states[0].mixtures(0)[0]
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
    states = said([LEFT, RIGHT], [0.05, 0.04])
    assert score(states, HERE, THERE)["same_slot"].tolist() == [1, 1, 1]
    corners = states.corners.clone()
    corners[:, 2:, [0, 1]] = corners[:, 2:, [1, 0]]  # from step 3 on the slots change places
    assert score(states.replace(corners=corners), HERE, THERE)["same_slot"].tolist() == [1, 1, 0]
    gone = states.presence.clone()
    gone[:, 1:, 1] = -6.0  # one is lost at step 2
    assert score(states.replace(presence=gone), HERE, THERE)["same_slot"].tolist() == [1, 0.5, 0.5]


def test_presence_counts_slots():
    target = said([(0, 0, 0), (0.5, 0, 0)], [0.05, 0.04])
    fades = target.presence.clone()
    fades[:, 2:, 1] = -20.0  # the second loop closes at step 3
    target = target.replace(presence=fades)
    held = said([(0, 0, 0), (0.5, 0, 0)], [0.05, 0.04])  # as at the start, for good: it forecasts no event
    found = score(held, circle(), target=target)
    expected = {"present": [2, 2, 1], "present_right": [2, 2, 1], "absent_right": [1, 1, 1], "closes": [0, 0, 1]}
    expected |= {key: [0, 0, 0] for key in ("closes_forecast", "closes_right", "opens", "opens_forecast")}
    assert {name: found[name].tolist() for name in expected} == expected
    swapped = held[:, :, [2, 1, 0]]
    assert score(swapped, circle(), target=target)["present_right"].tolist() == [2, 2, 1]  # slots have no order
