"""Which bars are loops, when alpha is not given: what stray points, repeated points, units and noise may not change."""

import numpy as np
import pytest

from topokit import SeqPH, rips_persistence, track
from topokit.sampling import as_tree, farthest_point_sample
from topokit.seqph import Frame, belief_after

from conftest import polygon


def ring(rng: np.random.Generator, shift: float = 0.0) -> np.ndarray:
    """A belt of 300 points around the z axis, not quite still."""
    angle = rng.permutation(np.linspace(0, 2 * np.pi, 300, endpoint=False))
    around = np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(0, 0.4, 300)])
    return around + [shift, 0, 0] + rng.normal(0, 0.005, (300, 3))


def film(length: int = 6) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [ring(rng, 0.02 * t) for t in range(length)]


def ids(clouds: list[np.ndarray], **options) -> list[list[int]]:
    return [[loop.id for loop in state.loops] for state in track(clouds, **options)]


SPOIL = {
    "a stray point": lambda rng, cloud: np.vstack([[30.0, 2.0, 1.0], cloud]),
    "stray points": lambda rng, cloud: np.vstack([rng.uniform(-2, 2, (15, 3)), cloud]),
    "every point twice": lambda rng, cloud: np.vstack([cloud, cloud]),
    "pixels without depth": lambda rng, cloud: np.vstack([cloud, np.zeros((200, 3)) - [0, 0, 5]]),
    "millimetres": lambda rng, cloud: 1000 * cloud,
    "another order": lambda rng, cloud: rng.permutation(cloud),
}


@pytest.mark.parametrize("how", SPOIL)
def test_what_is_no_part_of_the_scene_changes_no_loop(how):
    rng = np.random.default_rng(1)
    clouds = [SPOIL[how](rng, cloud) for cloud in film()]
    assert ids(clouds) == [[0]] * 6 == ids(film())
    for cloud, state in zip(clouds, track(clouds), strict=True):
        loop = state.loops[0]  # its ids are those of the cloud given
        np.testing.assert_array_equal(cloud[loop.killer_edge], loop.killer_edge_points)
        np.testing.assert_array_equal(cloud[loop.killer_triangle_ids], loop.killer_triangles)
        np.testing.assert_array_equal(cloud[loop.cycle], loop.cycle_points)


def test_one_stray_point_spoils_the_rule_of_the_paper():
    stray = [np.vstack([cloud, [30.0, 0, 0]]) for cloud in film()]
    assert [len(state) for state in SeqPH.paper().stream(film())] == [1] * 6
    assert [len(state) for state in SeqPH.paper().stream(stray)] == [0] * 6


@pytest.mark.parametrize("n", [128, 250, 500, 1000])
def test_points_strewn_at_random_seldom_look_like_a_loop(n):
    rng = np.random.default_rng(2)
    sheets = [np.column_stack([rng.uniform(0, 1, (n, 2)), 0.01 * rng.normal(size=n)]) for _ in range(50)]
    loops = [len(SeqPH().update(sheet)) for sheet in sheets]  # each the first frame of a film of its own
    assert np.mean(loops) <= 0.4
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
    rng = np.random.default_rng(4)
    sheet = rng.uniform(-1, 1, (20_000, 2))
    clouds = [evenly(sheet[np.linalg.norm(sheet, axis=1) > radius]) for radius in np.arange(0.08, 0.104, 0.004)]
    small = next(cloud for cloud in clouds if 0.74 < significance(cloud).max() < 0.98)
    assert np.sort(significance(small))[-2] < 0.29
    assert ids([small] * 4) == [[0]] * 4
    assert ids([evenly(sheet)] * 4) == [[]] * 4


@pytest.mark.parametrize(("squares", "found"), [(5, 0), (8, 1)])
def test_things_far_apart_are_a_loop_when_there_are_many_around(squares, found):
    """Squares of a grid in a ring: the bar is born at more than ten times the spacing, and dies 1.7 or 2.9 times later."""
    grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2) - 3.5
    places = 50 * polygon(squares)
    cloud = np.vstack([grid + place for place in places])
    assert len(SeqPH().update(cloud)) == found


def significance(cloud: np.ndarray) -> np.ndarray:
    frame = Frame.without_outliers(as_tree(cloud))
    diagram = rips_persistence(cloud)
    return frame.significance(diagram.birth, diagram.death)


def test_significance_is_that_of_the_formula():
    """Chapter 7: z = 1.1 LT / spacing * ln(death / birth)^0.3 * (1000 / n)^p; p and spacing depend on unevenness."""
    rng = np.random.default_rng(5)
    birth, death = np.array([0.01, 0.02]), np.array([0.1, 0.03])
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    for cloud, power in ((grid, 0.75), (rng.uniform(0, 1, (1000, 2)), 0.3), (grid[:50], 0.75)):
        nearest = np.sort(np.linalg.norm(cloud[:, None] - cloud, axis=2), axis=1)[:, 1:6]
        first, fifth = np.median(nearest, axis=0)[[0, 4]]
        uneven = min(fifth / first, 1.4 * np.quantile(nearest[:, 0], 0.9) / first)
        spacing = fifth * max(uneven / 2, 1)
        ratio = np.log(death / birth) ** 0.3 * (1000 / max(len(cloud), 128)) ** power
        frame = Frame.without_outliers(as_tree(cloud))
        np.testing.assert_allclose(frame.significance(birth, death), 1.1 * (death - birth) / spacing * ratio)


def test_evidence_is_bounded_and_has_no_unit():
    cloud = film()[0]
    assert (significance(cloud) > 1).sum() == 1
    np.testing.assert_allclose(significance(1e6 * cloud), significance(cloud), rtol=1e-6)
    diagram = rips_persistence(cloud)
    evidence = Frame.without_outliers(as_tree(cloud)).loop_evidence(diagram.birth, diagram.death)
    inner = (evidence > -3) & (evidence < 2)
    np.testing.assert_allclose(evidence[inner], 5 * np.log(significance(cloud)[inner]))
    assert (evidence.min(), evidence.max()) == (-3, 2)
    alone = Frame.without_outliers(as_tree(np.ones((9, 2))))
    assert alone.significance(np.array([1.0]), np.array([2.0])).tolist() == [0]


def test_belief_fades():
    beliefs = [2.0]
    for _ in range(400):
        beliefs.append(0.9 * beliefs[-1] + 2.0)  # a loop seen well for long
    np.testing.assert_allclose(belief_after(np.array([0.0, 1.0, 3.0])), beliefs[-1] * np.array([1, 0.9, 0.9**3]))
