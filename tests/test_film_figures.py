"""Test that the scripts of the figures of films, run by node, compute what the library computes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from accuracy import TrueCurves
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from topokit import linking_number
from topokit.evaluate import Overlap, distance_to_hull, score
from topokit.linking import close_far

from conftest import polygon
from pages import by_script, needs_node

pytestmark = needs_node

# ---- names and scores: scores.js and repaint.js

MEASURES = ["matches", "switches", "misses", "false_positives", "mota", "idf1", "hota", "deta", "assa"]
SCORE = """(frames) => {
  const { matches, switches, misses, extra, mota, idf1, hota, deta, assa } = scoreOf(frames);
  return [matches, switches, misses, extra, mota, idf1, hota, deta, assa];
}"""
SCORES = ["assign.js", "scores.js"]


def overlap_of(frame: dict) -> Overlap:
    shape = (len(frame["objects"]), len(frame["ids"]))
    objects, ids = (np.array(frame[name], int) for name in ("objects", "ids"))
    return Overlap(objects, ids, np.array(frame["similarity"], float).reshape(shape))


def test_films_are_scored_as_by_topokit():
    """Films in which objects and names come and go, with random similarities."""
    rng = np.random.default_rng(0)
    films = []
    for _ in range(60):
        frames = []
        for _ in range(int(rng.integers(2, 14))):
            objects = rng.permutation(4)[: rng.integers(0, 5)]
            ids = rng.permutation(5)[: rng.integers(0, 5)]
            similarity = rng.uniform(0, 1, (len(objects), len(ids))).round(3)
            frames.append({"objects": objects.tolist(), "ids": ids.tolist(), "similarity": similarity.tolist()})
        if any(frame["objects"] for frame in frames):
            films.append(frames)
    answers = by_script(SCORES, SCORE, films)
    for answer, frames in zip(answers, films, strict=True):
        ours = score([overlap_of(frame) for frame in frames])
        np.testing.assert_allclose(answer, [getattr(ours, name) for name in MEASURES], atol=1e-12)
    assert sum(answer[1] for answer in answers) > 100  # switches


# ---- the hull measure: hulls.js

HULL = "({ point, points }) => hullDistance(point, points)"
JUDGED = """({ loop, points }) => points.map((point) => TREATMENTS.map((treatment) => {
  const { off, most } = judged(treatment, loop, point, 0.01);
  return [off === Infinity ? null : off, most];
}))"""


def test_distances_to_hulls_are_topokits():
    """Solid, flat, straight and repeated points, from inside and outside."""
    rng = np.random.default_rng(2)
    cases = []
    for k in range(160):
        points = rng.normal(size=(int(rng.integers(1, 40)), 3)) * [1, 1, (1, 0.01, 0)[k % 3]]
        if k % 8 == 0:
            points = np.outer(rng.normal(size=9), [1, 2, 3])
        if k % 5 == 0:
            points = np.vstack([points, points[:3]])
        cases.append((rng.normal(size=3) * (0.4, 2)[k % 2] + points.mean(axis=0), points))
    given = [{"point": point.tolist(), "points": points.tolist()} for point, points in cases]
    expected = [distance_to_hull(point, points) for point, points in cases]
    np.testing.assert_allclose(by_script(["hulls.js"], HULL, given), expected, atol=2e-7)
    assert sum(value < 1e-9 for value in expected) > 15


def test_treatments_judge_as_topokit_does():
    rng = np.random.default_rng(3)
    cases = []
    for _ in range(30):
        turn = Rotation.random(rng=rng).as_matrix()
        curve = np.insert(polygon(17, 0.2), 2, 0.0, axis=1) * [1, rng.uniform(0.3, 1), 1]
        curve = (curve + rng.normal(0, 0.01, curve.shape)) @ turn
        closing = rng.normal(0, 0.2, (2, 3))
        tight = curve[::2] + rng.normal(0, 0.02, (9, 3))
        points = rng.normal(0, 0.12, (8, 3)) * [1, 1, 0.3] @ turn
        cases.append((curve, closing, tight, points))
    given = [
        {"loop": {"curve": a.tolist(), "closing": b.tolist(), "tight": c.tolist()}, "points": p.tolist()}
        for a, b, c, p in cases
    ]
    inside = np.zeros(5, int)
    for (curve, closing, tight, points), answer in zip(cases, by_script(["hulls.js"], JUDGED, given), strict=True):
        truth = TrueCurves((curve[None],), closing=(closing[None],), tight=([tight],))
        centres, radii = truth.extents
        for point, rows in zip(points, answer, strict=True):
            marked, wide, either, plane, opening = (row[0] for row in rows)
            hulls = truth.hulls(0, 0)
            assert marked == pytest.approx(distance_to_hull(point, curve), abs=1e-7)
            assert wide == pytest.approx(distance_to_hull(point, hulls[0]), abs=1e-7)
            assert either == pytest.approx(min(distance_to_hull(point, hull) for hull in hulls), abs=1e-7)
            share = truth.beside(0, 0, point)
            assert (plane is not None and plane <= rows[3][1]) == (share <= 1)
            if share <= 1:
                assert plane / rows[3][1] == pytest.approx(share, abs=1e-6)
            assert opening == pytest.approx(np.linalg.norm(point - centres[0, 0]))
            assert rows[4][1] == pytest.approx(radii[0, 0])
            inside += [off is not None and off <= most for off, most in rows]
    assert (inside > 10).all()
    assert (inside < 200).all()
    assert len(set(inside)) > 3


# ---- paths over a guide: guide.js

CLOSED_RING = 0.12 * np.insert(polygon(12), 1, 0.0, axis=1)
LINE = np.array([[0, 0.5, 0], [0, 0.5, 1.2], [0, 0.3, 1.2], [0, 0.3, 1.26]])
FIELD = """({ ring, line, closed, places }) => {
  const field = fieldOf(ring, line, closed);
  return places.map(([y, z]) => [field.around(y, z), field.guide(y, z), field.gap(y, z)]);
}"""


def test_the_guide_of_a_place_is_the_chapters():
    rng = np.random.default_rng(4)
    places = rng.uniform([-0.3, 0.9], [0.6, 1.6], (300, 2))
    given = {"ring": CLOSED_RING, "line": LINE, "closed": close_far(LINE), "places": places}
    scene = {name: values.tolist() for name, values in given.items()}
    [answer] = by_script(["link.js", "guide.js"], FIELD, [scene])
    seat = (LINE[-3] + LINE[-2]) / 2
    over = LINE[-1] + [0, 0, 0.06]
    linked = 0
    for place, (around, guide, gap) in zip(places, answer, strict=True):
        rim = np.array([0, *place])
        ring = CLOSED_RING + rim - CLOSED_RING[CLOSED_RING[:, 2].argmax()]
        assert around == (linking_number(ring, close_far(LINE)) != 0)
        way = [rim, seat] if around else [rim, over, seat]
        assert guide == pytest.approx(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
        fine = np.concatenate([np.linspace(a, b, 2000) for a, b in pairwise(LINE)])
        assert gap == pytest.approx(cdist(ring, fine).min(), abs=1e-3)
        linked += around
    assert 20 < linked < 150


# ---- a forecaster that copies: copycat.js

COPIES = """({ features, futures, alive, film, frame, cut, asked }) => {
  const ranked = rankedOf(features, alive), windows = { film, frame, cut };
  return asked.map(([gap, byCut]) => scoreOfCopies(ranked, windows, futures, alive, gap, byCut));
}"""


def test_the_copycat_copies_the_nearest_window_that_it_may():
    rng = np.random.default_rng(7)
    film = np.repeat(np.arange(6), 10)
    frame = np.tile(np.arange(10), 6)
    cut = film % 3
    features = rng.normal(size=(6, 4))[film] + 0.1 * frame[:, None] + rng.normal(0, 0.02, (60, 4))
    futures = rng.normal(size=(60, 3))
    alive = rng.random(60) < 0.8
    asked = [(gap, by_cut) for gap in (1, 4, 10) for by_cut in (False, True)]
    window = {"film": film.tolist(), "frame": frame.tolist(), "cut": cut.tolist(), "alive": alive.astype(int).tolist()}
    given = window | {"features": features.tolist(), "futures": futures.tolist(), "asked": asked}
    [answer] = by_script(["copycat.js"], COPIES, [given])
    apart = cdist(features, features)
    same_film = film[:, None] == film
    for (gap, by_cut), got in zip(asked, answer, strict=True):
        barred = same_film & (abs(frame[:, None] - frame) < gap) | ~alive[None]
        if by_cut:
            barred = barred | (cut[:, None] == cut)
        nearest = np.where(barred | np.eye(60, dtype=bool), np.inf, apart).argmin(axis=1)
        off = np.linalg.norm(futures[nearest] - futures, axis=1)[alive]
        assert got["error"] == pytest.approx(off.mean())
        assert got["same"] == pytest.approx((film[nearest] == film)[alive].mean())
    assert answer[0]["same"] > 0.9
    assert answer[4]["same"] == 0
