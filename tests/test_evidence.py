"""Which bars are loops, when alpha is not given: what stray points, repeated points, units and noise may not change."""

import numpy as np
import pytest

from topokit import SeqPH, rips_persistence, track
from topokit.sampling import farthest_point_sample

from conftest import polygon


def film(length: int = 6) -> list[np.ndarray]:
    """A belt of 300 points around the z axis, which is not quite still."""
    rng = np.random.default_rng(0)
    clouds = []
    for t in range(length):
        angle = rng.permutation(np.linspace(0, 2 * np.pi, 300, endpoint=False))
        around = np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(0, 0.4, 300)])
        clouds.append(around + [0.02 * t, 0, 0] + rng.normal(0, 0.005, (300, 3)))
    return clouds


def ids(clouds: list[np.ndarray]) -> list[list[int]]:
    return [[loop.id for loop in state.loops] for state in track(clouds)]


def significance(cloud: np.ndarray) -> np.ndarray:
    """Of all bars of a cloud, read off the probability of a loop that is new: its log-odds are 5 log(significance)."""
    tracker = SeqPH()
    tracker.update(cloud)
    diagram = rips_persistence(cloud)
    presence = tracker.presence(diagram.birth, diagram.death, np.inf)
    return np.exp(np.log(presence / (1 - presence)) / 5)


STRAYS = {
    "a stray point": lambda rng, cloud: np.vstack([[30.0, 2.0, 1.0], cloud]),
    "stray points": lambda rng, cloud: np.vstack([rng.uniform(-2, 2, (15, 3)), cloud]),
    "every point twice": lambda rng, cloud: np.vstack([cloud, cloud]),
    "pixels without depth": lambda rng, cloud: np.vstack([cloud, np.zeros((200, 3)) - [0, 0, 5]]),
    "millimetres": lambda rng, cloud: 1000 * cloud,
    "another order": lambda rng, cloud: rng.permutation(cloud),
}


@pytest.mark.parametrize("how", STRAYS)
def test_what_is_no_part_of_the_scene_changes_no_loop(how):
    rng = np.random.default_rng(1)
    clouds = [STRAYS[how](rng, cloud) for cloud in film()]
    states = track(clouds)
    assert ids(film()) == [[0]] * 6 == [[loop.id for loop in state.loops] for state in states]
    for cloud, state in zip(clouds, states, strict=True):
        loop = state.loops[0]  # its ids are those of the cloud given
        np.testing.assert_array_equal(cloud[loop.killer_edge], loop.killer_edge_points)
        np.testing.assert_array_equal(cloud[loop.killer_triangle_ids], loop.killer_triangles)
        np.testing.assert_array_equal(cloud[loop.cycle], loop.cycle_points)


def test_one_stray_point_spoils_the_rule_of_the_paper():
    stray = [np.vstack([cloud, [30.0, 0, 0]]) for cloud in film()]
    assert [len(state) for state in SeqPH.paper().stream(film())] == [1] * 6
    assert [len(state) for state in SeqPH.paper().stream(stray)] == [0] * 6


@pytest.mark.parametrize("n", [128, 1000])
def test_points_strewn_at_random_seldom_look_like_a_loop(n):
    rng = np.random.default_rng(2)
    sheets = [np.column_stack([rng.uniform(0, 1, (n, 2)), 0.01 * rng.normal(size=n)]) for _ in range(50)]
    assert np.mean([len(SeqPH().update(sheet)) for sheet in sheets]) <= 0.4  # each the first frame of a film
    assert sum(map(len, ids(sheets[:10]))) <= 2  # nor do they add up along a film


def test_a_loop_seen_well_is_kept_when_it_is_hardly_seen_and_a_chance_bar_is_not_taken_up():
    rng = np.random.default_rng(3)

    def belt(radius: float) -> np.ndarray:
        """A square sheet with a round hole."""
        points = rng.uniform(-1, 1, (900, 2))
        return points[np.linalg.norm(points, axis=1) > radius]

    weak = next(r for r in np.arange(0.3, 0.05, -0.01) if significance(belt(r)).max() < 1)
    assert ids([belt(weak)] * 4) == [[]] * 4
    assert ids([belt(0.5), belt(0.4), belt(0.3), *[belt(weak + 0.03)] * 2])[3:] == [[0], [0]]


def evenly(points: np.ndarray, n: int = 1000) -> np.ndarray:
    return points[farthest_point_sample(points, n)[0]]


def test_a_small_hole_is_a_loop_where_the_other_bars_are_short_and_adds_up_along_a_film():
    sheet = np.random.default_rng(4).uniform(-1, 1, (20_000, 2))
    clouds = [evenly(sheet[np.linalg.norm(sheet, axis=1) > radius]) for radius in np.arange(0.08, 0.104, 0.004)]
    small = next(cloud for cloud in clouds if 0.74 < significance(cloud).max() < 0.98)
    assert ids([small] * 4) == [[0]] * 4
    assert ids([evenly(sheet)] * 4) == [[]] * 4


@pytest.mark.parametrize(("squares", "n_loops"), [(5, 0), (8, 1)])
def test_things_far_apart_are_a_loop_when_there_are_many_around(squares, n_loops):
    """Squares of a grid in a ring: the bar is born at more than ten times the spacing, and dies 1.7 or 2.9 times later."""
    grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2) - 3.5
    cloud = np.vstack([grid + place for place in 50 * polygon(squares)])
    assert len(SeqPH().update(cloud)) == n_loops


def test_the_presence_of_a_loop_is_that_of_the_formulas():
    """Chapter 7: z = 1.1 LT / spacing * ln(death / birth)^0.3 * (1000 / n)^p; p and spacing depend on unevenness.

    The evidence is 5 ln z, from -3 to 2; a belief of 2 / (1 - 0.9) fades by a factor of 0.9 a frame.
    """
    rng = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    for cloud, power in ((grid, 0.75), (rng.uniform(0, 1, (1000, 2)), 0.3), (grid[:50], 0.75)):
        nearest = np.sort(np.linalg.norm(cloud[:, None] - cloud, axis=2), axis=1)[:, 1:6]
        first, fifth = np.median(nearest, axis=0)[[0, 4]]
        uneven = min(fifth / first, 1.4 * np.quantile(nearest[:, 0], 0.9) / first)
        spacing = fifth * max(uneven / 2, 1)
        birth = 0.3 * fifth
        death = birth + spacing * np.linspace(0.02, 1, 80)
        ratio = np.log(death / birth) ** 0.3 * (1000 / max(len(cloud), 128)) ** power
        evidence = np.clip(5 * np.log(1.1 * (death - birth) / spacing * ratio), -3, 2)
        assert ((evidence > -3) & (evidence < 2)).sum() > 3
        tracker = SeqPH()
        tracker.update(cloud)
        for ahead in (np.inf, 8.0, 20.0):
            odds = np.exp(evidence + 20 * 0.9**ahead)
            np.testing.assert_allclose(tracker.presence(birth, death, ahead), odds / (1 + odds))


def test_significance_has_no_unit_and_one_place_has_none():
    cloud = film()[0]
    assert (significance(cloud) > 1).sum() == 1
    np.testing.assert_allclose(significance(1e6 * cloud), significance(cloud), rtol=1e-6)
    tracker = SeqPH()
    with pytest.raises(LookupError, match="update"):
        tracker.presence(1.0, 2.0, 1)
    tracker.update(np.ones((9, 2)))
    assert tracker.presence(np.array([1.0]), np.array([2.0]), np.inf) == pytest.approx(1 / (1 + np.exp(3)))
