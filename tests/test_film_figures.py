"""Test that the scripts of the figures of films, run by node, compute what the library computes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from test_figures import tube_film

from chapter_tools import figures
from topokit import linking_number
from topokit.evaluate import Overlap, TrueCurves, distance_to_hull, score, true_loops
from topokit.linking import close_far

from conftest import polygon
from pages import by_script, needs_node, page_data, unpack

pytestmark = needs_node

# ---- names and scores: scores.js and repaint.js

MEASURES = ["matches", "switches", "misses", "false_positives", "mota", "idf1", "hota", "deta", "assa"]
SCORE = """(frames) => {
  const { matches, switches, misses, extra, mota, idf1, hota, deta, assa } = scoreOf(frames);
  return [matches, switches, misses, extra, mota, idf1, hota, deta, assa];
}"""
PAINT = """({ rows, strokes, similarity }) => {
  const done = strokes.reduce((now, [row, t, name]) => painted(now, row, t, name), rows);
  return { rows: done, frames: framesOf(done, similarity) };
}"""
SCORES = ["assign.js", "scores.js"]


def overlap_of(frame: dict) -> Overlap:
    shape = (len(frame["objects"]), len(frame["ids"]))
    ids = np.array([ord(name) if isinstance(name, str) else name for name in frame["ids"]], int)
    return Overlap(np.array(frame["objects"], int), ids, np.array(frame["similarity"], float).reshape(shape))


def assert_scored_alike(answers: list, films: list) -> None:
    for answer, frames in zip(answers, films, strict=True):
        ours = score([overlap_of(frame) for frame in frames])
        expected = [getattr(ours, name) for name in MEASURES]
        np.testing.assert_allclose(answer, expected, atol=1e-12)


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
    assert_scored_alike(answers, films)
    assert sum(answer[1] for answer in answers) > 100  # switches


def test_a_painted_strip_is_scored_as_by_topokit():
    rng = np.random.default_rng(1)
    cases = []
    for _ in range(40):
        rows = [list("aaaaaaaaa"), list("bbbbbbbbb"), [""] * 9]
        strokes = [
            [int(rng.integers(3)), int(rng.integers(9)), str(rng.choice(["a", "b", "c", ""]))] for _ in range(12)
        ]
        cases.append({"rows": rows, "strokes": strokes, "similarity": float(rng.choice([0.4, 0.5, 0.75, 1.0]))})
    films = []
    for case, answer in zip(cases, by_script([*SCORES, "repaint.js"], PAINT, cases), strict=True):
        for (row, t, name), last in zip(case["strokes"], range(len(case["strokes"])), strict=True):
            if not any(stroke[1] == t for stroke in case["strokes"][last + 1 :]):  # no later stroke in that frame
                assert answer["rows"][row][t] == name
        for names in zip(*answer["rows"], strict=True):
            given = [name for name in names if name]
            assert len(given) == len(set(given))
        detections = [name for names in answer["rows"] for name in names if name]
        assert sum(len(frame["ids"]) for frame in answer["frames"]) == len(detections)
        films.append(answer["frames"])
    assert_scored_alike(by_script(SCORES, SCORE, films), films)


@pytest.mark.parametrize("rows", [["ab", "a"], [""], ["ag"], ["ab", "ac"], []])
def test_names_that_cannot_be_painted_are_refused(rows):
    with pytest.raises(ValueError, match="'a film'"):
        figures.repaint({"a film": rows})


def test_a_strip_has_the_names_that_were_given():
    assert page_data(figures.repaint({"two": ["aa-", "bbb"]}))["films"] == {"two": ["aa-", "bbb"]}


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


def test_a_garment_is_packed_with_its_true_loops():
    film, hole = tube_film()
    means = {"one": np.full((2, 1, 3), np.nan)}
    data = page_data(figures.treatments(film, {"hole": hole}, means, [5, 60]))
    [loop] = data["loops"]
    np.testing.assert_allclose(unpack(loop["curve"]), film[:, hole], atol=1e-6)
    assert loop["present"] == [true.present[0] for true in true_loops(film, [hole])]
    assert not unpack(data["seen"]).any()
    with pytest.raises(ValueError, match="2"):
        figures.treatments(film, {"hole": hole}, means, [5])


# ---- paths over a guide: guide.js

CLOSED_RING = 0.12 * np.insert(polygon(12), 1, 0.0, axis=1)
LINE = np.array([[0, 0.5, 0], [0, 0.5, 1.2], [0, 0.3, 1.2], [0, 0.3, 1.26]])
FIELD = """({ ring, line, closed, places }) => {
  const field = fieldOf(ring, line, closed);
  return places.map(([y, z]) => [field.around(y, z), field.guide(y, z), field.gap(y, z)]);
}"""
PATHS = "({ knots }) => [WEIGHTS, pathOf(knots, [0, 0])]"
RUN = """({ ring, line, closed, asked }) => {
  const { frames, done } = runOf([-0.25, 1], fieldOf(ring, line, closed), asked);
  const costs = (rounds) => rounds.map((round) => round.map(({ cost }) => cost));
  return { done, frames: frames.map(({ at, guide, rounds }) => ({ at, guide, rounds: costs(rounds) })) };
}"""
GUIDE = ["link.js", "guide.js"]


def scene(**more: object) -> dict:
    closed = close_far(LINE)
    return {"ring": CLOSED_RING.tolist(), "line": LINE.tolist(), "closed": closed.tolist(), **more}


def guide_of(ring: np.ndarray, *, linked: bool) -> float:
    """Return the guide of the chapter."""
    rim = ring[ring[:, 2].argmax()]
    seat = (LINE[-3] + LINE[-2]) / 2
    over = LINE[-1] + [0, 0, 0.06]
    return np.linalg.norm(rim - seat) if linked else np.linalg.norm(rim - over) + np.linalg.norm(over - seat)


def test_the_guide_of_a_place_is_the_chapters():
    rng = np.random.default_rng(4)
    places = rng.uniform([-0.3, 0.9], [0.6, 1.6], (300, 2))
    [answer] = by_script(GUIDE, FIELD, [scene(places=places.tolist())])
    linked = 0
    for place, (around, guide, gap) in zip(places, answer, strict=True):
        rim = CLOSED_RING[CLOSED_RING[:, 2].argmax()]
        ring = CLOSED_RING + [0, *(place - rim[1:])]
        assert around == (linking_number(ring, close_far(LINE)) != 0)
        assert guide == pytest.approx(guide_of(ring, linked=around))
        fine = np.concatenate([np.linspace(a, b, 2000) for a, b in pairwise(LINE)])
        assert gap == pytest.approx(cdist(ring, fine).min(), abs=1e-3)
        linked += around
    assert 20 < linked < 150


def test_paths_are_natural_splines_within_the_limits_of_speed():
    knots = np.random.default_rng(5).normal(0, 0.3, (5, 2))
    [(weights, path)] = by_script(GUIDE, PATHS, [{"knots": knots.tolist()}])
    times = [0, 8, 18, 30, 44, 60]
    spline = CubicSpline(times, np.vstack([[0, 0], knots]), bc_type="natural")
    np.testing.assert_allclose(np.array(weights) @ knots, spline(np.arange(1, 61)), atol=1e-12)
    steps = np.diff(np.vstack([[0, 0], path]), axis=0)
    changes = np.diff(np.vstack([[0, 0], steps]), axis=0)
    assert abs(steps).max() <= 0.026 + 1e-12
    assert abs(changes).max() <= 0.0026 + 1e-12


def test_more_paths_bring_the_ring_to_the_seat_and_rounds_never_make_the_best_worse():
    few, many = ({"plans": n, "rounds": 2, "guess": False} for n in (2, 40))
    asked = [few | {"seed": seed} for seed in range(3)] + [many | {"seed": seed} for seed in (0, 1, 2, 0)]
    runs = by_script(GUIDE, RUN, [scene(asked=one) for one in asked])
    assert [run["done"] for run in runs] == 3 * [False] + 4 * [True]
    assert runs[-1] == runs[3]  # the same seed
    assert runs[3] != runs[4]
    for run in runs[3:]:
        assert run["frames"][-1]["guide"] < 0.03
        for frame in run["frames"][:-1]:
            assert [len(costs) for costs in frame["rounds"]] == [40, 40]
            assert frame["rounds"][1][0] <= frame["rounds"][0][0]
            assert frame["rounds"][0] == sorted(frame["rounds"][0])


# ---- a scene that is turned: turns.js

TURN = "({ forecast, truth, degrees, centre }) => errorsOf(forecast, truth, degrees, centre)"


def test_errors_in_a_turned_scene():
    """A forecast that turns with the scene errs alike at each angle; the error of one that stays is the way of the scene."""
    rng = np.random.default_rng(6)
    truth = rng.normal(size=(7, 3))
    centre = rng.normal(size=2)
    about = np.append(centre, 0.0)
    shift = [0.0, 0.0, 0.3]
    cases = []
    for degrees in (0, 30, 90, 180):
        turn = Rotation.from_euler("z", degrees, degrees=True)
        scene = turn.apply(truth - about) + about
        cases += [(scene + shift, degrees, np.full(7, 0.3)), (truth, degrees, np.linalg.norm(scene - truth, axis=1))]
    given = [
        {"forecast": forecast.tolist(), "truth": truth.tolist(), "degrees": degrees, "centre": centre.tolist()}
        for forecast, degrees, _ in cases
    ]
    np.testing.assert_allclose(by_script(["turns.js"], TURN, given), [expected for *_, expected in cases], atol=1e-12)


def test_forecasts_of_other_numbers_of_angles_are_refused():
    forecasts = {"one": np.zeros((2, 3, 3))}
    assert page_data(figures.turning(forecasts, np.zeros((3, 3)), np.zeros((2, 3)), [0, 90], [1, 2, 3]))["names"] == [
        "one"
    ]
    with pytest.raises(ValueError, match="3"):
        figures.turning(forecasts, np.zeros((3, 3)), np.zeros((2, 3)), [0, 45, 90], [1, 2, 3])


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
