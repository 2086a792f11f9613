"""Which bars are loops, when alpha is not given: what a stray point, repeated points, units and noise may not change."""

import numpy as np
import pytest

from topokit import SeqPH, rips_persistence, track
from topokit.sampling import inliers
from topokit.seqph._evidence import Gaps, evidence, significance


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


def spoilt(rng: np.random.Generator, cloud: np.ndarray) -> dict[str, np.ndarray]:
    """The same belt, as it may come."""
    return {
        "a stray point": np.vstack([[30.0, 2.0, 1.0], cloud]),
        "stray points": np.vstack([rng.uniform(-2, 2, (15, 3)), cloud]),
        "every point twice": np.vstack([cloud, cloud]),
        "pixels without depth": np.vstack([cloud, np.zeros((200, 3)) - [0, 0, 5]]),
        "millimetres": 1000 * cloud,
        "another order": rng.permutation(cloud),
    }


@pytest.mark.parametrize("how", spoilt(np.random.default_rng(0), np.zeros((4, 3))))
def test_what_is_no_part_of_the_scene_changes_no_loop(how):
    rng = np.random.default_rng(1)
    clouds = [spoilt(rng, cloud)[how] for cloud in film()]
    assert ids(clouds) == [[0]] * 6 == ids(film())
    for cloud, state in zip(clouds, track(clouds), strict=True):
        loop = state.loops[0]
        np.testing.assert_array_equal(
            cloud[loop.killer_edge], loop.killer_edge_points
        )  # ids are those of the cloud given
        np.testing.assert_array_equal(cloud[loop.killer_triangle_ids], loop.killer_triangles)
        np.testing.assert_array_equal(cloud[loop.cycle], loop.cycle_points)


def test_the_papers_rule_is_spoilt_by_one_stray_point():
    clouds = film()
    stray = [np.vstack([cloud, [30.0, 0, 0]]) for cloud in clouds]
    paper = SeqPH.paper()
    assert [[loop.id for loop in state.loops] for state in map(paper.update, clouds)] == [[0]] * 6
    assert not any(len(state) for state in map(SeqPH.paper().update, stray))


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

    weak = next(r for r in np.arange(0.3, 0.05, -0.01) if _most(belt(r)) < 1)
    assert ids([belt(weak)] * 4) == [[]] * 4
    assert ids([belt(0.5), belt(0.4), belt(0.3), *[belt(weak + 0.03)] * 2])[3:] == [[0], [0]]


def _most(cloud: np.ndarray) -> float:
    diagram = rips_persistence(cloud)
    return float(significance(diagram.birth, diagram.death, _gaps(cloud), len(cloud)).max())


def _gaps(cloud: np.ndarray) -> Gaps:
    return Gaps.of(np.sort(np.linalg.norm(cloud[:, None] - cloud, axis=2), axis=1)[:, 1:6])


def test_evidence_is_of_no_unit_and_bounded():
    cloud = film()[0]
    diagram, large = rips_persistence(cloud), rips_persistence(1e6 * cloud)
    said = evidence(diagram.birth, diagram.death, _gaps(cloud), len(cloud))
    np.testing.assert_allclose(said, evidence(large.birth, large.death, _gaps(1e6 * cloud), len(cloud)), atol=1e-6)
    assert said.max() == 2
    assert said.min() == -3
    assert (significance(diagram.birth, diagram.death, _gaps(cloud), len(cloud)) > 1).sum() == 1


def test_unevenness_tells_random_points_from_grids_and_curves():
    rng = np.random.default_rng(5)
    angle = np.linspace(0, 6, 100)
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2)
    assert _gaps(np.column_stack([np.cos(angle), np.sin(angle)])).unevenness < 2
    assert _gaps(grid).unevenness < 2
    assert _gaps(rng.uniform(0, 1, (1000, 2))).unevenness > 2.4
    assert _gaps(np.repeat(grid, 2, axis=0)[:, [0, 0]]).unevenness < 2


def test_inliers_are_those_with_neighbours():
    cloud = film()[0]
    far = np.array([[5.0, 0, 0], [5, 0.1, 0], [-9, 0, 0]])  # a pair is no scene
    np.testing.assert_array_equal(inliers(np.vstack([far, cloud])), np.arange(3, 303))
    np.testing.assert_array_equal(inliers(np.vstack([far, cloud, far])), np.arange(3, 303))
    np.testing.assert_array_equal(inliers(np.repeat(cloud, 2, axis=0)), np.arange(600))
    assert len(inliers(np.zeros((3, 2)))) == 3
    with pytest.raises(ValueError, match="factor"):
        inliers(cloud, factor=0)
    with pytest.raises(ValueError, match="neighbours"):
        inliers(cloud, neighbours=0)
