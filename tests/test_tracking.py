"""Scores of trackers: by hand, as TrackEval has them; the truth about loops; baselines; a stream without end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from chapter_tools.trackers import by_diagram, by_killer, by_midpoint, track_vines
from topokit import SeqPH, track
from topokit.evaluate import Overlap, compare, events, score, summarise_tracks, true_loops
from topokit.io import load_episode

from conftest import polygon

MEASURES = ("mota", "idf1", "hota", "deta", "assa", "switches", "fragments", "misses", "false_positives")

# What TrackEval 1.3.0 (HOTA, CLEAR and Identity at threshold 0.5) says about `film(seed)`.
TRACKEVAL = {
    0: (0.118811881188, 0.331658291457, 0.301461761122, 0.480323994755, 0.19027894281, 28, 29, 32, 29),
    1: (0.184466019417, 0.289855072464, 0.240048889774, 0.468909419713, 0.125188166654, 25, 23, 29, 30),
    2: (0.059405940594, 0.4, 0.338481960071, 0.467901018475, 0.248373300807, 31, 27, 33, 31),
    3: (-0.096774193548, 0.313131313131, 0.260292905243, 0.442793737001, 0.157120469817, 28, 26, 31, 43),
    4: (0.283018867925, 0.48275862069, 0.365684431195, 0.46841061729, 0.286824100733, 19, 27, 33, 24),
    5: (0.201923076923, 0.339622641509, 0.323211680741, 0.503894911167, 0.208878929204, 27, 25, 26, 30),
}


def film(seed: int) -> list[Overlap]:
    """Thirty frames of four objects, some unseen, and of a tracker that loses, confuses and invents."""
    rng = np.random.default_rng(seed)
    free = rng.permutation(60).tolist()
    own = [free.pop() for _ in range(4)]
    frames = []
    for _ in range(30):
        for k in range(4):
            if rng.random() < 0.06:
                own[k] = free.pop()
            if rng.random() < 0.05:
                other = int(rng.integers(4))
                own[k], own[other] = own[other], own[k]
        objects = np.flatnonzero(rng.random(4) < 0.85)
        shown = np.flatnonzero(rng.random(4) < 0.85)
        right, wrong = rng.uniform(0.3, 1, (2, len(objects), len(shown))) * [[[1.0]], [[0.6]]]
        table = np.where(objects[:, None] == shown[None], right, wrong)
        frames.append(Overlap(objects, np.array([own[k] for k in shown], dtype=np.int64), table))
    return frames


def one(objects: list[int], ids: list[int], *pairs: tuple[int, int]) -> Overlap:
    """A frame in which the named pairs fit perfectly and nothing else at all."""
    table = np.array([float((a, b) in pairs) for a in objects for b in ids]).reshape(len(objects), len(ids))
    return Overlap(np.array(objects, np.int64), np.array(ids, np.int64), table)


def test_a_film_scored_by_hand():
    """Object 7 is seen as 1, 1, not at all, as 2; object 8 as 3 throughout; in the last frame there is also a ghost."""
    frames = [one([7, 8], [1, 3], (7, 1), (8, 3))] * 2
    frames += [one([7, 8], [3], (8, 3)), one([7, 8], [2, 3, 9], (7, 2), (8, 3))]
    result = score(frames)
    assert (result.objects, result.detections, result.matches, result.id_matches) == (8, 8, 7, 6)
    assa = (2 * 2 / 4 + 1 * 1 / 4 + 4 * 4 / 4) / 7
    expected = [1 - 3 / 8, 2 * 6 / 16, np.sqrt(7 / 9 * assa), 7 / 9, assa, 1, 1, 1, 1]
    np.testing.assert_allclose([getattr(result, name) for name in MEASURES], expected)
    told = [(event.frame, event.kind, event.loop, event.id) for event in events(frames) if event.kind != "match"]
    assert told == [(2, "miss", 7, -1), (3, "switch", 7, 2), (3, "fragment", 7, 2), (3, "false positive", -1, 9)]


@pytest.mark.parametrize("seed", TRACKEVAL)
def test_scores_are_those_of_trackeval(seed):
    result = score(film(seed))
    np.testing.assert_allclose([getattr(result, name) for name in MEASURES], TRACKEVAL[seed], rtol=0, atol=1e-9)


def test_scores_add_up():
    """Two films in one, the names of the second moved out of the way, are the sum of both."""
    first = film(1)
    second = film(2)
    moved = [Overlap(o.objects + 10, o.ids + 100, o.similarity) for o in second]
    together = vars(score([*first, *moved]))
    for name, value in vars(score(first) + score(second)).items():
        np.testing.assert_allclose(together[name], value)


def test_a_perfect_film_and_an_empty_one():
    perfect = score([one([0, 1], [4, 5], (0, 4), (1, 5))] * 5)
    assert [getattr(perfect, name) for name in MEASURES] == [1, 1, 1, 1, 1, 0, 0, 0, 0]
    blind = score([one([0, 1], [])] * 3)
    assert (blind.mota, blind.idf1, blind.hota, blind.misses) == (0, 0, 0, 6)
    nothing = score([one([], [])])
    assert np.isnan([nothing.mota, nothing.idf1]).all()


def test_a_match_is_kept_while_it_holds():
    """A better partner that comes along does not take the object away; HOTA, which looks at all frames, agrees."""
    before = Overlap(np.array([0]), np.array([1]), np.array([[0.6]]))
    after = Overlap(np.array([0]), np.array([1, 2]), np.array([[0.6, 0.9]]))
    assert score([before, after, after]).switches == 0


def ring(n: int, radius: float, centre: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    return np.column_stack([polygon(n, radius), np.zeros(n)]) + centre


def test_truth_of_a_tube_is_one_loop_not_two():
    """Both rims go around the tube: the class has one bar, and the first rim has its name."""
    heights = 0.2 * np.arange(6)
    tube = np.vstack([ring(30, 1.0, (0, 0, z)) for z in heights])
    rims = [np.arange(30), 150 + np.arange(30)]
    (truth,) = true_loops(tube[None], rims)
    assert truth.present.tolist() == [True, False]
    np.testing.assert_allclose(truth.centres, [[0, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(truth.radii, 1)
    (state,) = track([tube])
    assert by_killer(truth, state)[0].tolist() == [1.0]


def test_a_detection_of_what_is_not_there_is_set_aside():
    points = np.vstack([ring(30, 1.0), ring(30, 1.0, (9, 0, 0))])
    (truth,) = true_loops(points[None], [np.arange(30), 30 + np.arange(30)])
    half = replace(truth, present=np.array([True, False]))
    states = track([points])
    assert score(compare(states, [truth])).matches == 2
    result = score(compare(states, [half]))
    assert (result.objects, result.detections, result.matches) == (1, 1, 1)
    with pytest.raises(ValueError, match="zip"):
        compare(states, [truth, truth])


def test_a_detection_that_fits_a_present_loop_best_is_not_set_aside():
    """As TrackEval removes distractors: it matches for the greatest similarity, not for the largest number of pairs."""
    points = np.vstack([ring(30, 1.0, (9.0 * k, 0, 0)) for k in range(3)])
    (truth,) = true_loops(points[None], np.arange(90).reshape(3, 30))
    two = replace(truth, present=np.array([True, True, False]))
    table = np.array([[0.9, 0.5, 0], [0, 0.9, 0.5], [0.5, 0, 0]])
    (overlap,) = compare(track([points]), [two], lambda *_: table)
    assert overlap.similarity.tolist() == table[:2].tolist()


def test_places_are_compared_by_the_size_of_the_true_loop():
    (truth,) = true_loops(ring(30, 2.0)[None], [np.arange(30)])
    (state,) = track([ring(30, 2.0) + [1.0, 0, 0]], alpha=0.1)
    away = np.linalg.norm(state.loops[0].centre)
    assert compare([state], [truth])[0].similarity[0, 0] == pytest.approx(1 - away / 4)
    (far,) = track([ring(30, 2.0) + [9.0, 0, 0]], alpha=0.1)
    assert compare([far], [truth])[0].similarity[0, 0] == 0
    (nothing,) = track([ring(3, 2.0)], alpha=0.1)
    for options in ({}, {"similarity": by_killer}):
        assert compare([nothing], [truth], **options)[0].similarity.shape == (1, 0)


def test_an_apron_is_tracked_without_a_fault(episode_path):
    """Place and killer, an estimate and an exact answer, agree in every frame."""
    episode = load_episode(episode_path)
    points = episode.points[::8]
    truth = true_loops(points, episode.loops)
    assert all(frame.present.all() for frame in truth)
    states = track(points)
    for options in ({}, {"similarity": by_killer}):
        result = score(compare(states, truth, **options))
        assert (result.mota, result.idf1, result.misses, result.switches) == (1, 1, 0, 0)
    assert score(compare(states, truth, by_killer)).hota == pytest.approx(1)
    (summary,) = summarise_tracks(states, points, episode.loops)
    (bare,) = summarise_tracks(states, points, ())
    centres = np.array([state.loops[0].centre for state in states])
    away = np.linalg.norm(centres - points[:, episode.loops[0]].mean(axis=1), axis=1)
    assert (summary.frames, summary.true_loop, summary.in_hull) == (len(points), 0, 1)
    assert summary.distance == pytest.approx(away.mean())
    assert (bare.true_loop, bare.lifetime) == (-1, summary.lifetime)


def test_baselines_on_what_they_cannot_see():
    """Two rings trade sizes where they stand, then one grows at once."""
    sizes = np.linspace(1, 0.6, 9)
    frames = [np.vstack([ring(24, s), ring(24, 1.6 - s, (6, 0, 0))]) for s in sizes]
    where = {}
    for match in (None, by_diagram, by_midpoint):
        states = list(SeqPH(match=match).stream(frames))
        where[match] = [next(loop.id for loop in state.loops if loop.centre[0] < 3) for state in states]
    assert len(set(where[None])) == len(set(where[by_midpoint])) == 1
    assert len(set(where[by_diagram])) == 2  # it follows the size, not the ring
    for match, ids in ((by_midpoint, [0, 0]), (None, [0, 1])):
        tracker = SeqPH(epsilon=0.1, loops="alpha", match=match)
        assert [tracker.update(ring(24, size)).loops[0].id for size in (0.5, 1.5)] == ids


def test_vines_follow_a_motion_that_a_matching_loses():
    small = ring(24, 0.2)
    large = ring(24, 1.5)
    assert [state.loops[0].id for state in map(SeqPH(match=by_diagram).update, [small, large])] == [0, 1]
    states = track_vines([small, large], steps=12)
    assert [(state.frame, state.loops[0].id) for state in states] == [(0, 0), (1, 0)]
    assert states[1].loops[0].death == track([large])[0].loops[0].death
    with pytest.raises(ValueError, match="same vertices"):
        track_vines([small, large[:9]])
