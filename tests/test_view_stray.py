"""The figure of the stray point in chapter 7: what its page holds, and that its script decides as topokit.SeqPH does."""

from __future__ import annotations

import numpy as np
import pytest

from topokit import SeqPH, rips_persistence, view
from topokit.sampling import as_tree
from topokit.seqph import Frame

from conftest import polygon
from pages import by_script, check_small_and_whole, needs_node, page_data

RING = polygon(20, 2.0)
SCRIPTS = ["rips.js", "places.js", "rules.js"]
CALL = """(points) => [byAlpha(points), byEvidence(points)].map(({ alpha, cloud, loops, kept }) => (
  { alpha, cloud, kept: kept.length, bars: loops.map((l) => [l.birth, l.death, l.strength, l.needed]) }))"""


def test_stray_holds_the_cloud_and_the_way_of_the_stray_point():
    data = page_data(view.stray(RING, [2.5, 0.0], [9.0, 1 / 3]))
    assert data["points"] == RING.tolist()
    assert (data["start"], data["end"]) == ([2.5, 0.0], [9.0, 1 / 3])


def test_stray_is_whole_small_and_asks_nothing_of_the_network():
    figure = view.stray(RING, [2.5, 0.0], [9.0, 0.0])
    check_small_and_whole(figure)
    assert repr(figure).startswith("Framed('20 points and a stray one'")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((60, 2)), [0, 0], [1, 1]), "points must be 1 to 59 points, not 60"),
        ((np.zeros((5, 3)), [0, 0], [1, 1]), "points must lie in the plane, not in 3 dimensions"),
        ((RING, [0, 0, 0], [1, 1]), "start must lie in the plane"),
        ((RING, [0, 0], [1, np.inf]), "end has 1 of 1 points with a NaN or infinite"),
    ],
)
def test_stray_refuses_what_it_cannot_show(arguments, message):
    with pytest.raises(ValueError, match=message):
        view.stray(*arguments)


# ---- its script, run by node


def spoilt_clouds() -> list[np.ndarray]:
    """Rings and sheets, with a stray point near and far, or with points repeated; and clouds of all densities."""
    rng = np.random.default_rng(0)
    clouds = []
    for n in (5, 12, 30, 50):
        clouds += [polygon(n, 2.0) + rng.normal(0, 0.05, (n, 2)), rng.uniform(-2, 2, (n, 2))]
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(7.0)), axis=-1).reshape(-1, 2)
    clouds.append(grid + rng.normal(0, 0.1, grid.shape))
    clouds.append(np.vstack([polygon(24, 2.0), polygon(24, 2.1) + [5.0, 0.0]]) + rng.normal(0, 0.05, (48, 2)))
    far_and_near = [rng.standard_t(2, (30, 2)) for _ in range(20)]
    places = [[0.0, 0.0], [2.3, 0.0], [4.0, 1.0], [7.0, -3.0], [40.0, 0.0]]
    spoilt = [np.vstack([cloud, [place]]) for cloud in clouds for place in places]
    return spoilt + far_and_near + [np.vstack([cloud, cloud[:5], [[9.0, 9.0], [9.0, 9.0]]]) for cloud in clouds]


@needs_node
def test_script_finds_the_loops_that_the_tracker_finds():
    clouds = spoilt_clouds()
    left_out, kept = 0, []
    for cloud, (paper, new) in zip(clouds, by_script(SCRIPTS, CALL, [c.tolist() for c in clouds]), strict=True):
        for theirs, tracker in ((paper, SeqPH.paper()), (new, SeqPH())):
            state = tracker.update(cloud)
            assert theirs["alpha"] == pytest.approx(state.parameters["alpha"])
            found = sorted((birth, death) for birth, death, *_ in theirs["bars"][: theirs["kept"]])
            assert found == sorted((loop.birth, loop.death) for loop in state.loops)
        left_out += len(new["cloud"]) < len(np.unique(cloud, axis=0))
        kept.append((paper["kept"], new["kept"]))
    assert left_out > 10
    assert {(0, 0), (0, 1), (1, 1), (0, 2), (2, 2)} <= set(kept)


@needs_node
def test_script_measures_significance_and_the_mark_that_a_bar_must_reach():
    clouds = spoilt_clouds()
    compared = 0
    for cloud, (paper, new) in zip(clouds, by_script(SCRIPTS, CALL, [c.tolist() for c in clouds]), strict=True):
        frame = Frame.without_outliers(as_tree(cloud))
        np.testing.assert_array_equal(np.unique(new["cloud"], axis=0), np.unique(cloud[frame.ids], axis=0))
        diagram = rips_persistence(frame.tree.data)
        expected = frame.significance(diagram.birth, diagram.death)
        bars = np.array(new["bars"]).reshape(-1, 4)
        np.testing.assert_allclose(np.sort(bars[:, 2]), np.sort(expected), rtol=1e-9)
        for birth, death, strength, needed in new["bars"]:
            assert (strength > 1) == (death > needed)
            assert birth < needed
        for birth, death, strength, needed in paper["bars"]:
            assert needed - birth == pytest.approx((death - birth) / strength)
        compared += len(bars)
    assert compared > 200


@needs_node
def test_a_point_that_goes_away_takes_the_papers_loop_and_not_the_other():
    away = [np.vstack([RING, [[2 + by, 0.1]]]).tolist() for by in (0.3, 2, 6, 60, 0.3)]
    kept = [[rule["kept"] for rule in rules] for rules in by_script(SCRIPTS, CALL, away)]
    assert kept == [[1, 1], [1, 1], [0, 1], [0, 1], [1, 1]]
