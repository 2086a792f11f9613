"""The tracker: identities on moving shapes, the gates, what it refuses, and that a bad frame changes nothing."""

from __future__ import annotations

import gc
import pickle
import weakref
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from topokit import SeqPH, TopologicalState, follow, hausdorff, rips_persistence, track
from topokit.seqph import assign
from topokit.seqph._matching import Candidates

from conftest import polygon

NO_LOOP = np.vstack([polygon(20)[:16], [[3.0, 0.0]]])


def two_circles(shift: float, growth: float = 1.0) -> np.ndarray:
    left = polygon(20, growth) + [shift, 0]
    right = polygon(16, 0.6) + [4 + shift, 0]
    return np.vstack([left, right])


LOOPS = track([two_circles(0.0)])[0].loops


def ids(states) -> list[list[int]]:
    return [[loop.id for loop in state.loops] for state in states]


def assert_same(one: TopologicalState, other: TopologicalState) -> None:
    assert (one.frame, one.time, one.parameters) == (other.frame, other.time, other.parameters)
    for a, b in zip(one.loops, other.loops, strict=True):
        names = [name for name in vars(a) if not name.startswith("_")]
        for name in (*names, "cycle", "cycle_points"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_loop_holds_what_the_paper_asks_for():
    cloud = np.column_stack([two_circles(0.0), np.zeros(36)])
    moved = cloud + [0, 0, 0.02]
    first, second = track([cloud, moved], alpha=0.2)
    diagram = rips_persistence(moved)
    assert len(second) == 2
    for i, loop in enumerate(second):
        assert (loop.birth, loop.death, loop.lifetime) == (diagram.birth[i], diagram.death[i], diagram.lifetime[i])
        np.testing.assert_allclose([first[loop.id].killer_shift, loop.killer_shift], [np.nan, 0.02])
        assert loop.killer_triangles.shape == (2, 3, 3)
        assert 1 <= len(loop.neighbours) <= 4
        np.testing.assert_array_equal(loop.killer_triangles, moved[loop.killer_triangle_ids])
        np.testing.assert_allclose(loop.killer_values, loop.death)
        sides = np.linalg.norm(loop.neighbours[:, :, None] - loop.neighbours[:, None], axis=-1)
        np.testing.assert_allclose(loop.neighbour_values, sides.max(axis=(1, 2)) / 2)
        assert hausdorff(loop.killer_edge_points[:1], loop.killer_edge_points[1:]) / 2 == pytest.approx(loop.death)
        np.testing.assert_array_equal(loop.cycle_points, moved[diagram.cycle(i)])
    row = second.as_dict()
    assert (row["frame"], row["loops"][0]["id"], row["parameters"]) == (1, 0, second.parameters)
    assert_same(pickle.loads(pickle.dumps(second)), second)
    with pytest.raises(KeyError, match="9"):
        second[9]
    with pytest.raises(LookupError):
        _ = replace(loop, _curve=None).cycle


@pytest.mark.parametrize("gates", ["paper", "proved", "near"])
def test_two_loops_keep_their_identities(gates):
    rng = np.random.default_rng(0)
    frames = [rng.permutation(two_circles(0.03 * t, 1 + 0.01 * t)) for t in range(12)]
    states = track(frames, alpha=0.2, beta=1.8, epsilon=0.05, gates=gates)
    assert ids(states) == [[0, 1]] * 12
    assert all(state.loops[0].lifetime > state.loops[1].lifetime for state in states)
    assert np.linalg.norm(states[5][1].centre - [4.15, 0]) < 0.35


def test_a_round_loop_has_a_killer_edge_that_jumps_and_a_place_that_does_not():
    """A hexagon of alternating radii: a motion of 1e-9 moves its killer edge by the edge's whole length."""
    hexagon = polygon(6) * np.where(np.arange(6) % 2, 1, 0.95)[:, None]
    nudge = np.eye(6)[:, :1] * [0, 1e-9]
    for identity, expected in (("killer-edge", [[0], [1]]), ("killer-triangles", [[0], [0]]), ("cycle", [[0], [0]])):
        states = track([hexagon - nudge, hexagon + nudge], alpha=0.1, beta=0.5, epsilon=1e-8, identity=identity)
        assert ids(states) == expected
    assert states[1].loops[0].killer_shift > 1.6


def test_loops_that_stand_still_keep_their_identities_when_others_come_or_go():
    """Rings side by side, drawn anew in each frame; the first is denser, so that the middle of the scene moves."""
    rng = np.random.default_rng(0)

    def rings(*which: int) -> np.ndarray:
        parts = []
        for k in which:
            angle = rng.uniform(0, 2 * np.pi, 300 if k == 0 else 150)
            parts.append(np.column_stack([0.1 * np.cos(angle) + 0.3 * k, 0.1 * np.sin(angle)]))
        return np.vstack(parts)

    states = track([rings(0, 1, 2)] * 4 + [rings(1, 2)] * 4 + [rings(0, 1, 2)] * 2)
    at = [{round(loop.centre[0] / 0.3): loop.id for loop in state.loops} for state in states]
    assert at[0].keys() == {0, 1, 2}
    assert all(each[k] == at[0][k] for each in at for k in (1, 2))


@pytest.mark.parametrize("gates", ["paper", "proved", "near"])
@pytest.mark.parametrize("change", ["birth", "death", "place"])
def test_gates_are_as_wide_as_documented(gates, change):
    """Just inside the gates is the same loop, just outside is not."""
    ring = polygon(12)
    after = {"birth": ring[2:], "death": 1.5 * ring, "place": ring + [0.7, 0]}[change]
    loop, moved = (track([cloud], alpha=0.05)[0].loops[0] for cloud in (ring, after))
    alpha = 0.05
    for share, new_id in ((0.999, 1), (1.001, 0)):
        if change == "place":
            bound = 0.7 * share
            epsilon = 0.1
            beta = {"paper": bound - 0.2, "proved": (bound - 0.1) / 2, "near": bound - 0.1}[gates]
        else:
            gate = share * abs(getattr(moved, change) - getattr(loop, change))
            beta = 100.0
            quarter = max(loop.death, moved.death) / 4
            epsilon = gate - {"paper": 2 * alpha, "proved": alpha, "near": alpha + quarter}[gates]
        states = track([ring, after], alpha=alpha, beta=beta, epsilon=epsilon, gates=gates)
        assert ids(states) == [[0], [new_id]]


def best_matching(cost: np.ndarray, allowed: np.ndarray) -> tuple[int, float]:
    """Return the size and the cost of the largest, then cheapest matching, by trying all."""
    if cost.shape[0] > cost.shape[1]:
        return best_matching(cost.T, allowed.T)
    found = []
    for columns in permutations(range(cost.shape[1]), len(cost)):
        pairs = [pair for pair in enumerate(columns) if allowed[pair]]
        found.append((len(pairs), sum(cost[pair] for pair in pairs)))
    return min(found, key=lambda matching: (-matching[0], matching[1]))


def test_assignments_are_the_cheapest_of_the_largest_and_take_no_forbidden_pair():
    rng = np.random.default_rng(1)
    for _ in range(100):
        cost = rng.random(rng.integers(1, 6, size=2))
        for allowed in (rng.random(cost.shape) < 0.4, np.ones(cost.shape, dtype=bool)):
            pairs = assign(cost, allowed)
            assert all(allowed[pair] for pair in pairs)
            assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
            assert (len(pairs), pytest.approx(sum(cost[pair] for pair in pairs))) == best_matching(cost, allowed)
        assert assign(cost) == pairs


def test_a_match_rule_of_ones_own():
    def first_come(loops: Candidates) -> list[tuple[int, int]]:
        return [(i, i) for i in range(min(len(loops.birth), len(loops.known_birth)))]

    far = [polygon(20), polygon(20) + [9.0, 0]]
    options = {"alpha": 0.1, "beta": 0.1, "epsilon": 0.1}
    assert ids(track(far, **options)) == [[0], [1]]
    assert ids(track(far, match=first_come, **options)) == [[0], [0]]


def test_a_match_rule_gives_each_loop_once_or_changes_nothing():
    answers = [[(0, 0), (1, 0)], []]
    tracker = SeqPH(match=lambda loops: answers.pop(0))
    tracker.update(two_circles(0.0))
    with pytest.raises(ValueError, match="match"):
        tracker.update(two_circles(0.1))
    assert tracker.update(two_circles(0.1)).frame == 1


def test_memory_gives_a_loop_that_was_missed_its_identity_back():
    options = {"alpha": 0.3, "beta": 1.8, "epsilon": 0.1}
    frames = [polygon(20), NO_LOOP, NO_LOOP, polygon(20)]
    for memory, last in ((0, 1), (1, 1), (2, 0)):
        assert ids(track(frames, memory=memory, **options)) == [[0], [], [], [last]]
        assert ids(track([frames[0], None, None, frames[3]], memory=memory, **options)) == [[0], [], [], [last]]
    too_far = [*frames[:3], polygon(20) + [3.0, 0]]
    assert ids(track(too_far, memory=2, **options)) == [[0], [], [], [1]]


def test_a_loop_whose_place_leaps_keeps_its_identity():
    """Beta is the length of the killer edge, 1.7. The first ring leaps, and the second one stands still."""
    second = polygon(100) + [10.0, 0]
    frames = [np.vstack([polygon(100) + [x, 0], second]) for x in (0.0, 0.0, 2.5, -1.5)]
    assert [set(frame) for frame in ids(track(frames, epsilon=0.1))] == [{0, 1}, {0, 1}, {0, 1}, {1, 2}]
    assert [set(frame) for frame in ids(track(frames[:3], epsilon=0.1, loops="alpha"))][-1] == {1, 2}


def test_a_remembered_loop_may_have_moved_in_every_frame_since():
    """Three steps of 0.1 are farther than the gates of one step allow, and not farther than those of three."""
    options = {"alpha": 0.3, "beta": 0.05, "epsilon": 0.1, "gates": "proved", "memory": 2}
    for n_missed, last in ((0, 1), (2, 0)):
        frames = [polygon(20), *[NO_LOOP] * n_missed, polygon(20) + [0.35, 0]]
        assert ids(track(frames, **options))[-1] == [last]


@pytest.mark.parametrize("identity", ["killer-edge", "cycle"])
def test_an_endless_stream_keeps_nothing(identity):
    """Every cloud but the last is released, and so is every loop that is forgotten."""
    clouds: list[weakref.ref] = []
    loops: list[weakref.ref] = []

    def frames(n: int):
        for t in range(n):
            cloud = np.vstack([polygon(24), polygon(24, 0.8) + [9 + 40 * (t % 2), 0]])  # the second comes and goes
            clouds.append(weakref.ref(cloud))
            yield cloud

    for state in SeqPH(identity=identity, memory=3).stream(frames(60)):
        loops.extend(weakref.ref(loop) for loop in state.loops)
    del state
    gc.collect()
    assert sum(cloud() is not None for cloud in clouds) <= 1
    assert sum(loop() is not None for loop in loops) <= 2 + 2 * 3  # those of the last frame and those remembered


def test_estimates_are_reported():
    clouds = [polygon(20), polygon(20) + [0.07, 0]]
    first, second = track(clouds)
    assert first.parameters["alpha"] == pytest.approx(np.sin(np.pi / 20))  # half the distance to the nearest point
    assert first.parameters["epsilon"] == 0.0
    assert 0 < second.parameters["epsilon"] <= 0.07 + 1e-12  # the Hausdorff distance is at most the motion
    assert second.parameters["beta"] == pytest.approx(2 * second.loops[0].death)
    assert track(clouds, alpha=0.01, loops="evidence")[0].parameters["alpha"] == 0.01
    paper = list(SeqPH.paper().stream(clouds))[1]
    assert paper.parameters["epsilon"] == pytest.approx(hausdorff(*clouds))
    assert paper.parameters["beta"] == pytest.approx(2 * paper.loops[0].death)
    assert SeqPH.paper(memory=3).memory == 3


def test_few_points_have_no_loops():
    assert ids(track([np.zeros((1, 3)), np.zeros((3, 3)), np.ones((40, 3))])) == [[], [], []]
    assert track([]) == []


@pytest.mark.parametrize("options", [{}, {"alpha": 0.1}, {"loops": "alpha"}])
def test_streaming_and_whole_sequence_agree(options):
    clouds = [two_circles(0.05 * t) for t in range(6)]
    streamed = SeqPH(**options).stream(iter(clouds))
    for one, other in zip(streamed, track(np.array(clouds), n_jobs=2, **options), strict=True):
        assert_same(one, other)
        assert one.time == one.frame


def test_buffers_may_be_refilled():
    clouds = np.stack([polygon(20) + [0.07 * t, 0] for t in range(4)])
    expected = track(clouds.copy())
    whole = track(clouds)
    tracker = SeqPH()
    buffer = np.empty((20, 2))
    updated = []
    for cloud in clouds.copy():
        buffer[:] = cloud
        updated.append(tracker.update(buffer))
    buffer[:] = clouds[:] = np.nan
    for states in (whole, updated):  # their cycles are found only now
        for one, other in zip(states, expected, strict=True):
            assert_same(one, other)


def test_a_diagram_that_is_given_is_used():
    ring = polygon(20)
    larger = rips_persistence(2 * ring)
    assert_same(SeqPH().update(ring, diagram=rips_persistence(ring)), track([ring])[0])
    assert SeqPH().update(ring, diagram=larger).loops[0].death == larger.death[0]


@pytest.mark.parametrize(
    ("call", "error", "names"),
    [
        (lambda: SeqPH(alpha=-1), ValueError, "alpha"),
        (lambda: SeqPH(gates="loose"), ValueError, "gates"),
        (lambda: track(polygon(20)), ValueError, "shape"),
        (lambda: track([polygon(20)] * 2, times=[0.0]), ValueError, "1 values for 2 frames"),
        (lambda: SeqPH().update(polygon(9), diagram=rips_persistence(polygon(8))), ValueError, "9 points"),
        (
            lambda: SeqPH().update(polygon(9), diagram=rips_persistence(polygon(9), max_radius=0.5)),
            ValueError,
            "9 points",
        ),
        (lambda: follow(LOOPS, two_circles(0.0)[:30]), ValueError, "30"),
        (lambda: follow(LOOPS, np.zeros((36, 3))), ValueError, "3 dimensions"),
    ],
)
def test_what_cannot_be_is_named(call, error, names):
    with pytest.raises(error, match=names):
        call()


@pytest.mark.parametrize(
    ("frame", "time"),
    [
        (np.zeros((9, 3)), 2.0),
        (np.zeros(9), 2.0),
        (np.vstack([polygon(19), [[np.nan, 0]]]), 2.0),
        (polygon(20), 1.0),
        (polygon(20), np.nan),
    ],
)
def test_a_frame_that_cannot_follow_is_refused_and_forgotten(frame, time):
    tracker = SeqPH(memory=3)
    for t in range(2):
        tracker.update(polygon(20), time=float(t))
    with pytest.raises(ValueError, match="frame 2"):
        tracker.update(frame, time=time)
    expected = track([polygon(20), polygon(20), polygon(20) + 0.01], times=[0.0, 1.0, 2.0], memory=3)[2]
    assert_same(tracker.update(polygon(20) + 0.01, time=2.0), expected)
    with pytest.raises(ValueError, match=r"frame 2|sequence\[2\]"):  # before anything is computed
        track([polygon(20), polygon(20), frame], times=[0.0, 1.0, time])


def test_followed_loops_are_those_of_the_moved_cloud():
    """Points that keep their order: what `follow` finds has the killers of a fresh diagram, and the old birth."""
    cloud = two_circles(0.0)
    moved = cloud * [1, 0.9] + [0.3, 0.1]
    fresh = rips_persistence(moved)
    buffer = moved.copy()
    followed = follow(LOOPS, buffer)
    buffer[:] = 7
    for i, (loop, before) in enumerate(zip(followed, LOOPS, strict=True)):
        assert (loop.id, loop.birth, loop.death) == (before.id, before.birth, fresh.death[i])
        np.testing.assert_array_equal(loop.killer_edge, fresh.killer_edge[i])
        np.testing.assert_array_equal(loop.cycle_points, moved[loop.cycle])
    assert follow(LOOPS, cloud * [1, 1e-3]) == []  # squashed


def test_a_loop_is_born_where_a_moved_cloud_has_evidence_for_it():
    opened = two_circles(0.0)
    (left,) = (loop for loop in LOOPS if loop.centre[0] < 2)
    for tracker in (SeqPH(), SeqPH(alpha=0.2)):
        tracker.update(opened)
        followed = follow([left], opened, tracker)
        assert [(loop.id, round(loop.centre[0])) for loop in followed] == [(left.id, 0), (left.id + 1, 4)]
    assert [loop.id for loop in follow([left], opened)] == [left.id]
