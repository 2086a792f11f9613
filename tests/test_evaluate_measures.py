"""Measures of forecasts, on loops of which everything is known; intervals, against formulas."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from scipy.stats import mannwhitneyu

from topokit import LoopMixture
from topokit.evaluate import Bootstrap, Condition, Estimate, EvaluationConfig
from topokit.evaluate._accuracy import COLUMNS, TrueCurves, measure_forecasts, opening_points
from topokit.evaluate._forecasters import steps_of
from topokit.evaluate._summary import Samples, mean_of, summarise
from topokit.models import Forecast, StateTensors

HORIZON, SLOTS = 4, 3
STEPS = (1, 2, 4)
PANE = 0.01 * np.array([[1, 0, 0], [-1, 0, 0], [0, 2, 0], [0, -2, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])


def circle(centre: tuple[float, float, float] = (0, 0, 0), radius: float = 0.1) -> np.ndarray:
    """(K, 40, 3) a flat loop that does not move."""
    angle = 2 * np.pi * np.arange(40) / 40
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    return np.repeat((np.array(centre) + radius * ring)[None], len(STEPS), axis=0)


def said(places: list[tuple[float, float, float]], lifetimes: list[float], there: list[bool] | None = None) -> StateTensors:
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
    assert tuple(found) == COLUMNS
    return {name: column[0] for name, column in found.items()}


def test_a_perfect_forecast_is_in_the_hull_and_one_beside_it_is_as_far_as_it_is():
    assert (score(said([(0, 0, 0)], [0.05]), circle())["outside"] < 1e-6).all()
    moved = score(said([(0, 0, 0.2)], [0.05]), circle())
    assert np.allclose(moved["outside"], 0.2, atol=1e-5)
    assert np.allclose(moved["distance"], 0.2, atol=1e-5)
    edge = score(said([(0.13, 0, 0)], [0.05]), circle())
    assert np.allclose(edge["outside"], 0.03, atol=1e-5)
    assert np.allclose(edge["distance"], 0.13, atol=1e-5)


def test_the_longest_lived_loop_counts_and_no_other():
    states = said([(0, 0, 0), (0, 0, 0.5)], [0.03, 0.05])
    assert np.allclose(score(states, circle())["outside"], 0.5, atol=1e-5)
    other = states.replace(death=states.death.flip(-1).roll(-1, dims=-1))  # now the first slot lives longer
    assert float(other.death[0, 0, 0]) > float(other.death[0, 0, 1])
    assert (score(other, circle())["outside"] < 1e-6).all()


def test_two_loops_ask_for_two_means_in_two_hulls():
    here, there = circle((-0.3, 0, 0)), circle((0.3, 0, 0))
    for places in ([(-0.3, 0, 0), (0.3, 0, 0)], [(0.3, 0, 0), (-0.3, 0, 0)]):  # the order is free
        assert (score(said(places, [0.05, 0.04]), here, there)["outside"] < 1e-6).all()
    twice = score(said([(-0.3, 0, 0), (-0.3, 0.01, 0)], [0.05, 0.04]), here, there)
    assert np.allclose(twice["outside"], 0.5, atol=1e-4)  # from one hull to the border of the other
    assert np.isinf(score(said([(-0.3, 0, 0)], [0.05]), here, there)["outside"]).all()


def test_of_three_loops_any_two_do():
    curves = [circle((x, 0, 0)) for x in (-0.5, 0.0, 0.5)]
    assert (score(said([(0.5, 0, 0), (-0.5, 0, 0)], [0.05, 0.04]), *curves)["outside"] < 1e-6).all()


def test_the_edge_that_ends_a_loop_widens_its_hull():
    """A tie before a skirt: its curve was marked straight across the skirt, and it is narrowest below."""
    curve, below = circle(), (0.0, 0.0, -0.1)
    edge = np.repeat(np.array([[[-0.05, 0, -0.1], [0.05, 0, -0.1]]]), len(STEPS), axis=0)
    states, rng = said([below], [0.05]), np.random.default_rng(0)
    for closing, expected in (((edge,), 0.0), ((), 0.1)):
        found = measure_forecasts(states, states, states[:, :1], [TrueCurves((curve,), closing)], STEPS, (), rng)
        assert np.allclose(found["outside"], expected, atol=1e-5)
        assert np.allclose(found["outside_marked"], 0.1, atol=1e-5)


def test_a_true_loop_that_is_not_there_is_not_asked_for():
    here, there = circle((-0.3, 0, 0)), circle((0.3, 0, 0))
    present = (np.array([True, True, False]), np.array([True, False, False]))
    states, rng = said([(-0.3, 0, 0)], [0.05]), np.random.default_rng(0)
    found = measure_forecasts(
        states, states, states[:, :1], [TrueCurves((here, there), (), present)], STEPS, (1, 4), rng
    )
    assert np.isinf(found["outside"][0, 0])  # two are there, one is forecast
    assert found["outside"][0, 1] < 1e-6  # one is there
    assert np.isnan(found["outside"][0, 2])  # none: nothing is asked
    assert np.isnan(found["nll"][0, 2])
    assert np.isinf(found["outside_marked"]).all()


def test_what_is_said_to_be_absent_does_not_count():
    silent = score(said([(0, 0, 0)], [0.05], [False]), circle())
    assert np.isinf(silent["outside"]).all()
    assert (silent["outside_anyway"] < 1e-6).all()
    assert np.isnan(silent["distance"]).all()
    assert np.isnan(silent["nll"]).all()
    assert (silent["in_plane"] == 0).all()


def test_in_the_plane():
    assert (
        score(said([(0.05, 0, 0.02)], [0.05]), circle())["in_plane"] == 1
    ).all()  # beside it by a fifth of the radius
    assert (score(said([(0.05, 0, 0.03)], [0.05]), circle())["in_plane"] == 0).all()
    assert (score(said([(0.11, 0, 0.0)], [0.05]), circle())["in_plane"] == 0).all()


def test_in_the_opening():
    assert (score(said([(0, 0, 0.09)], [0.05]), circle())["in_opening"] == 1).all()
    assert (score(said([(0, 0, 0.11)], [0.05]), circle())["in_opening"] == 0).all()


def test_likelihood_is_that_of_the_mixture():
    states, curve = said([(0.02, 0, 0.01)], [0.05]), circle()
    found = score(states, curve)
    mixture = Forecast.from_states(states).plan(0)[0][0].mixture()
    assert isinstance(mixture, LoopMixture)
    expected = -mixture.log_prob(opening_points(curve[0], 16, np.random.default_rng(0))).mean()
    assert found["nll"][0] == pytest.approx(expected, rel=1e-4)
    assert np.isnan(found["nll"][1])  # step 2 is none of the fine ones


def test_coverage_of_a_boaster_and_of_a_timid_one():
    tiny, wide = circle(radius=0.002), circle(radius=0.5)
    assert (
        score(said([(0, 0, 0)], [0.05]), tiny)["cover50"][0] == 1
    )  # the opening is a dot in the middle of the mixture
    assert score(said([(0, 0, 0)], [0.05]), wide)["cover90"][0] < 0.2  # the opening is far wider than the mixture


def test_points_of_an_opening_are_uniform():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    points = opening_points(square, 20_000, np.random.default_rng(0))
    assert np.allclose(points.mean(axis=0), [0.5, 0.5, 0], atol=0.01)
    assert np.allclose(np.cov(points[:, :2].T), np.eye(2) / 12, atol=0.005)


def test_centres_are_by_length_not_by_vertices():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    crowded = np.concatenate([np.column_stack([np.linspace(0, 1, 50), np.zeros(50), np.zeros(50)]), square[2:]])
    curves = TrueCurves((np.repeat(crowded[None], len(STEPS), axis=0),))
    assert np.allclose(curves.extents[0], [0.5, 0.5, 0])


def test_identity_is_kept_by_the_same_slot():
    here, there = circle((-0.3, 0, 0)), circle((0.3, 0, 0))
    states = said([(-0.3, 0, 0), (0.3, 0, 0)], [0.05, 0.04])
    assert score(states, here, there)["kept"].tolist() == [1, 1, 1]
    corners = states.corners.clone()
    corners[:, 2:, [0, 1]] = corners[:, 2:, [1, 0]]  # from step 3 on the slots change places
    assert score(states.replace(corners=corners), here, there)["kept"].tolist() == [1, 1, 0]
    gone = states.presence.clone()
    gone[:, 1:, 1] = -6.0  # one is lost at step 2
    assert score(states.replace(presence=gone), here, there)["kept"].tolist() == [1, 0.5, 0.5]


def test_presence_counts_slots():
    target = said([(0, 0, 0), (0.5, 0, 0)], [0.05, 0.04])
    fades = target.presence.clone()
    fades[:, 2:, 1] = -20.0  # the second loop closes at step 3
    target = target.replace(presence=fades)
    held = said([(0, 0, 0), (0.5, 0, 0)], [0.05, 0.04])  # as at the start, for good
    found = score(held, circle(), target=target)
    assert found["there"].tolist() == [2, 2, 1]
    assert found["there_right"].tolist() == [2, 2, 1]
    assert found["absent_right"].tolist() == [1, 1, 1]
    assert found["closes"].tolist() == [0, 0, 1]
    assert found["closes_said"].tolist() == found["closes_right"].tolist() == [0, 0, 0]  # who holds forecasts no event
    assert found["opens"].tolist() == found["opens_said"].tolist() == [0, 0, 0]
    swapped = held[:, :, [2, 1, 0]]
    assert score(swapped, circle(), target=target)["there_right"].tolist() == [2, 2, 1]  # slots have no order


def test_events_are_counted_whichever_slots_they_are_in():
    before = said([(0, 0, 0)], [0.05])
    target = said([(0, 0, 0), (0.5, 0, 0)], [0.05, 0.04])
    appears = target.presence.clone()
    appears[:, 0, 1] = -20.0  # the second loop opens at step 2
    target = target.replace(presence=appears)
    kept = score(before, circle(), target=target)
    assert kept["opens"].tolist() == [0, 1, 1]
    assert kept["opens_said"].tolist() == kept["opens_right"].tolist() == [0, 0, 0]
    told = score(target[:, :, [2, 1, 0]], circle(), target=target)
    assert told["opens_said"].tolist() == told["opens_right"].tolist() == [0, 1, 1]
    many = score(said([(0, 0, 0)] * 3, [0.05] * 3), circle(), target=target)  # two too many, then one
    assert many["opens_said"].tolist() == [2, 2, 2]
    assert many["opens_right"].tolist() == [0, 1, 1]
    none = score(said([], []), circle(), target=target)
    assert none["closes_said"].tolist() == [1, 1, 1]
    assert none["closes"].tolist() == none["closes_right"].tolist() == [0, 0, 0]


def test_brier_asks_how_sure_a_forecast_is():
    target = said([(0, 0, 0)], [0.05])
    coin = said([(0, 0, 0)], [0.05])
    coin = coin.replace(presence=0 * coin.presence)
    assert score(coin, circle(), target=target)["brier"] == pytest.approx(0.25)
    assert score(target, circle(), target=target)["brier"].max() < 1e-4
    wrong = target.replace(presence=-target.presence)
    assert score(wrong, circle(), target=target)["brier"] == pytest.approx(1 / 3, abs=0.01)  # two are there; one suits


# -- intervals --------------------------------------------------------------------------------------------------------------


def ratio(bootstrap: Bootstrap, values: np.ndarray) -> Estimate:
    return bootstrap.ratio(values, np.ones_like(values))


def test_interval_of_independent_samples_is_the_binomial_one():
    hits = (np.arange(1000) % 10 < 3).astype(float)[None]
    one = ratio(Bootstrap(np.arange(1000), draws=4000), hits)
    low, high = one.interval()
    half = 1.96 * np.sqrt(0.3 * 0.7 / 1000)
    assert one.value == pytest.approx(0.3)
    assert (high - low) / 2 == pytest.approx(half, rel=0.08)
    assert low < one.value < high


def test_windows_of_an_episode_are_no_independent_samples():
    hits = np.repeat(np.arange(20) % 2, 50).astype(float)[None]  # 20 episodes, each all right or all wrong
    careless = ratio(Bootstrap(np.arange(1000)), hits).interval()
    honest = ratio(Bootstrap(np.repeat(np.arange(20), 50)), hits).interval()
    assert np.ptp(honest) > 5 * np.ptp(careless)
    assert np.ptp(honest) == pytest.approx(2 * 1.96 * np.sqrt(0.25 / 20), rel=0.15)


def test_the_mixture_of_garments_is_not_drawn():
    bunch = np.repeat(np.arange(20), 5)
    easy = (bunch < 10).astype(float)[None]  # ten episodes of a garment that all pass, ten of one that none does
    assert np.ptp(ratio(Bootstrap(bunch), easy).interval()) > 0.3
    assert np.ptp(ratio(Bootstrap(bunch, strata=bunch < 10), easy).interval()) == 0


def test_seeds_widen_an_interval():
    rng = np.random.default_rng(0)
    hits = (rng.random((3, 400)) < np.array([[0.3], [0.5], [0.7]])).astype(float)
    alone = ratio(Bootstrap(np.arange(400)), hits.mean(axis=0, keepdims=True))
    all_three = ratio(Bootstrap(np.arange(400)), hits)
    assert all_three.value == pytest.approx(alone.value)
    assert np.ptp(all_three.interval()) > 2 * np.ptp(alone.interval())
    assert all_three.n == 400


def test_a_difference_is_on_the_same_episodes():
    rng = np.random.default_rng(0)
    bunch = np.repeat(np.arange(15), 10)
    hard = np.repeat(rng.random(15), 10)  # episodes differ far more than models do
    one, other = (hard[None] < 0.5).astype(float), (hard[None] < 0.55).astype(float)
    bootstrap = Bootstrap(bunch)
    gain = ratio(bootstrap, other) - ratio(bootstrap, one)
    assert np.ptp(gain.interval()) < np.ptp(ratio(bootstrap, one).interval())
    same = ratio(bootstrap, one) - ratio(bootstrap, one)
    assert same.interval() == (0.0, 0.0)


def test_doubt_tells_who_is_lost_as_often_as_the_rank_test_says():
    rng = np.random.default_rng(0)
    n, steps = 120, steps_of(60)
    columns = {name: rng.random((2, n, len(steps))) for name in COLUMNS}
    columns["outside"] = rng.choice([0.0, 0.1], (2, n, len(steps)))  # metres
    columns["doubt"] = 0.1 + columns["outside"] / 4 + rng.normal(0, 0.02, columns["outside"].shape)
    columns["doubt"][:, :10] = np.nan  # nothing is forecast there
    alike = columns | {"doubt": np.full_like(columns["doubt"], 0.1)}
    garment = np.repeat(["apron", "tote"], n // 2)
    samples = Samples(
        {"ours": columns, "carry": alike}, np.arange(n) // 4, garment, target := np.tile(["hook", "hanger"], n // 2)
    )
    config = EvaluationConfig(dataset="", models={}, conditions=[Condition(name="all")], samples=200)
    lost = summarise(samples, config, thorough=False)["lost"]
    doubt, far = columns["doubt"][:, 10:, -1].ravel(), columns["outside"][:, 10:, -1].ravel() > 0
    expected = mannwhitneyu(doubt[far], doubt[~far]).statistic / (far.sum() * (~far).sum())
    cell = lost["ours"]["60"]
    assert cell["mean"] == pytest.approx(expected, abs=1e-4)
    assert 0.65 < cell["low"] < cell["mean"] < cell["high"] < 0.95
    assert cell["n"] == n - 10
    assert lost["carry"]["60"]["mean"] == lost["carry"]["60"]["low"] == 0.5
    whole = summarise(samples, config, thorough=False)
    assert set(whole["by_target"]) == {"hook", "hanger"}
    alone = summarise(samples.of(target == "hook"), config, thorough=False)
    assert whole["by_target"]["hook"]["hull_accuracy"] == alone["hull_accuracy"] != whole["hull_accuracy"]
    assert "by_target" not in alone
    nobody = {"ours": columns | {"outside": np.zeros_like(columns["outside"])}}
    assert (
        summarise(Samples(nobody, np.arange(n), garment, target), config, thorough=False)["lost"]["ours"]["60"]["mean"]
        is None
    )


@pytest.mark.filterwarnings("error")
def test_where_no_loop_is_there_nothing_is_said():
    """Of the windows on hooks nothing is asked; a file of results has no NaN."""
    rng = np.random.default_rng(0)
    columns = {name: rng.random((2, 8, len(steps_of(60)))) for name in COLUMNS}
    target = np.repeat(["hook", "hanger"], 4)
    for name in ("outside", "outside_any", "outside_marked", "outside_anyway", "in_plane", "in_opening", "distance"):
        columns[name][:, :4] = np.nan
    samples = Samples({"ours": columns}, np.arange(8), np.repeat("apron", 8), target)
    config = EvaluationConfig(dataset="", models={}, conditions=[Condition(name="all")], samples=20)
    whole = summarise(samples, config, thorough=False)
    assert whole["by_target"]["hook"]["hull_accuracy"]["ours"]["60"]["mean"] is None
    json.dumps(whole, allow_nan=False)
    alone = summarise(samples.of(target == "hook"), config, thorough=False)
    assert alone["by_seed"]["ours"]["60"] == [None, None]
    assert alone["outcomes"]["ours"]["60"] == dict.fromkeys(("hit", "near", "far", "silent"))
    json.dumps(alone, allow_nan=False)


def test_median_and_what_is_missing():
    values = np.array([[1.0, 2.0, 100.0, np.nan, 3.0]])
    bootstrap = Bootstrap(np.arange(5))
    median = bootstrap.median(values)
    assert median.value == 2.5
    assert median.n == 4
    low, high = median.interval()
    assert 1 <= low <= 2.5 <= high <= 100
    nothing = bootstrap.median(np.full((1, 5), np.nan)).as_dict()
    assert nothing == {"mean": None, "low": None, "high": None, "n": 0}
    assert bootstrap.ratio(np.zeros((1, 5)), np.zeros((1, 5))).as_dict()["mean"] is None


def test_mean_over_horizons_is_taken_draw_by_draw():
    bootstrap = Bootstrap(np.arange(50))
    up = np.linspace(0, 1, 50)[None]
    whole = mean_of([ratio(bootstrap, up), ratio(bootstrap, 1 - up)])
    assert whole.value == pytest.approx(0.5)
    assert np.ptp(whole.interval()) == pytest.approx(0, abs=1e-9)  # what the one gains the other loses
