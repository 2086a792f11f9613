"""seqPH: identities on moving shapes, the gates, and that a bad frame changes nothing."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

from topokit import SeqPH, TopologicalState, farthest_point_sample, hausdorff, rips_persistence, track
from topokit.sampling import hausdorff_table, spacing
from topokit.seqph import Candidates, as_table, assign, place
from topokit.seqph._matching import within_gates

from conftest import polygon


def two_circles(shift: float, growth: float = 1.0) -> np.ndarray:
    left = polygon(20, growth) + [shift, 0]
    right = polygon(16, 0.6) + [4 + shift, 0]
    return np.vstack([left, right])


@pytest.mark.parametrize("gates", ["paper", "proved"])
def test_two_loops_keep_their_names(gates):
    rng = np.random.default_rng(0)
    frames = [
        rng.permutation(two_circles(0.03 * t, 1 + 0.01 * t)) for t in range(12)
    ]  # identity is not the order of points
    states = track(frames, alpha=0.2, beta=1.8, epsilon=0.05, gates=gates)
    assert [len(state) for state in states] == [2] * 12
    assert {tuple(loop.id for loop in state.loops) for state in states} == {(0, 1)}
    assert [loop.lifetime for loop in states[3].loops] == sorted(
        (loop.lifetime for loop in states[3].loops), reverse=True
    )
    assert np.linalg.norm(states[5][1].centre - [4.15, 0]) < 0.35


def test_loop_holds_what_the_paper_asks_for():
    cloud = np.column_stack([two_circles(0.0), np.zeros(36)])
    first, second = track([cloud, cloud + [0, 0, 0.02]], alpha=0.2)
    loop = second[0]
    assert np.isnan(first[0].killer_shift)
    assert loop.killer_shift == pytest.approx(0.02)
    assert loop.killer_triangles.shape == (2, 3, 3)
    assert 1 <= len(loop.neighbours) <= 4
    np.testing.assert_array_equal(loop.killer_triangles, (cloud + [0, 0, 0.02])[loop.killer_triangle_ids])
    np.testing.assert_allclose(loop.killer_values, loop.death)
    assert (loop.neighbour_values <= loop.death).all()
    sides = np.linalg.norm(loop.neighbours[:, :, None] - loop.neighbours[:, None], axis=-1)
    np.testing.assert_allclose(loop.neighbour_values, sides.max(axis=(1, 2)) / 2)
    assert hausdorff(loop.killer_edge_points[:1], loop.killer_edge_points[1:]) / 2 == pytest.approx(loop.death)
    with pytest.raises(ValueError, match="read-only"):
        loop.killer_triangles[0, 0, 0] = 1.0
    with pytest.raises(KeyError, match="has no loop 9"):
        second[9]


def test_where_a_loop_is():
    cloud = two_circles(0.0)
    diagram = rips_persistence(cloud)
    np.testing.assert_array_equal(place(diagram, 0, cloud, "killer-edge"), cloud[diagram.killer_edge[0]])
    thick = cloud[diagram.killer_triangles[0, 0]].mean(axis=0)
    np.testing.assert_array_equal(place(diagram, 0, cloud, "killer-triangles"), thick[None])
    np.testing.assert_allclose(place(diagram, 0, cloud, "cycle"), [[0.0, 0.0]], atol=1e-12)


def test_distances_of_places_look_both_ways():
    pairs = np.random.default_rng(0).normal(size=(2, 5, 2, 3))
    table = hausdorff_table(*pairs)
    assert table == pytest.approx(np.array([[hausdorff(a, b) for b in pairs[1]] for a in pairs[0]]))


def test_an_identity_is_never_used_again():
    circle, other = polygon(20), polygon(20) + [50, 0]
    blob = np.random.default_rng(0).normal(size=(5, 2)) * 0.1
    states = track([circle, blob, circle, other], alpha=0.3, beta=1.8, epsilon=0.1, memory=0)
    assert [[loop.id for loop in state.loops] for state in states] == [[0], [], [1], [2]]


def test_gates_forbid_a_loop_that_changed_too_much():
    options = {"alpha": 0.1, "beta": 1.8, "epsilon": 0.05}
    small, large = polygon(20), polygon(20, 1.4)  # the death moves by 0.35, more than 2 alpha + epsilon
    for gates, beyond in (("paper", large), ("proved", large), ("near", polygon(20, 2.0))):
        assert [state.loops[0].id for state in track([small, beyond], gates=gates, **options)] == [0, 1]
    for gates, ids in (("paper", [0, 0]), ("proved", [0, 1]), ("near", [0, 0])):
        states = track([small, polygon(20, 1.2)], gates=gates, **options)
        assert [state.loops[0].id for state in states] == ids


def test_lifetimes_below_alpha_are_dropped():
    lifetime = track([polygon(20)], alpha=0.0)[0].loops[0].lifetime
    assert len(track([polygon(20)], alpha=lifetime)[0]) == 1
    assert len(track([polygon(20)], alpha=np.nextafter(lifetime, 9))[0]) == 0


def test_estimates_are_reported():
    states = track([polygon(20), polygon(20) + [0.07, 0]])
    assert states[0].parameters["alpha"] == pytest.approx(np.sin(np.pi / 20))  # half the distance to the nearest point
    assert states[0].parameters["epsilon"] == 0.0
    assert 0 < states[1].parameters["epsilon"] <= 0.07 + 1e-12  # the Hausdorff distance is at most the motion
    assert states[1].parameters["beta"] == pytest.approx(2 * states[1].loops[0].death)
    assert track([polygon(20)], alpha=0.01)[0].parameters["alpha"] == 0.01


def test_streaming_and_whole_sequence_agree():
    frames = [two_circles(0.05 * t) for t in range(6)]
    tracker = SeqPH()
    streamed = [tracker.update(frame) for frame in frames]
    whole = track(np.array(frames))
    for one, other in zip(streamed, whole, strict=True):
        assert [loop.id for loop in one.loops] == [loop.id for loop in other.loops]
        assert one.parameters == other.parameters
        assert one.time == other.time == one.frame


def test_a_bad_frame_leaves_the_tracker_as_it_was():
    frames = [two_circles(0.05 * t) for t in range(4)]
    tracker = SeqPH()
    tracker.update(frames[0])
    for bad, says in (
        (np.full((9, 2), np.nan), "frame 1 .* NaN"),
        (np.empty((0, 2)), "frame 1 has no points"),
        (np.zeros((9, 3)), "frame 1 has 3 dimensions"),
        (np.zeros(9), "frame 1 must be"),
    ):
        with pytest.raises(ValueError, match=says):
            tracker.update(bad)
    after = [tracker.update(frame) for frame in frames[1:]]
    assert [state.frame for state in after] == [1, 2, 3]
    assert [[loop.id for loop in state.loops] for state in after] == [[0, 1]] * 3


def test_bad_sequences_name_the_frame():
    good = two_circles(0)
    bad = good.copy()
    bad[4, 1] = np.inf
    with pytest.raises(ValueError, match=r"sequence\[2\].*row 4"):
        track([good, good, bad])
    with pytest.raises(ValueError, match=r"sequence\[1\] has 3 dimensions"):
        track([good, np.zeros((5, 3))])
    with pytest.raises(ValueError, match="shape"):
        track(good)
    with pytest.raises(ValueError, match="1 values for 2 frames"):
        track([good, good], times=[0.0])


def test_few_points_have_no_loops():
    states = track([np.zeros((1, 3)), np.zeros((3, 3)), np.ones((40, 3))])
    assert [len(state) for state in states] == [0, 0, 0]
    assert track([]) == []


@pytest.mark.parametrize(
    ("option", "error"),
    [
        ({"alpha": -1}, ValueError),
        ({"beta": "wide"}, TypeError),
        ({"alpha": "0.1"}, TypeError),
        ({"epsilon": True}, TypeError),
        ({"gates": "loose"}, ValueError),
        ({"identity": "soul"}, ValueError),
    ],
)
def test_bad_options(option, error):
    with pytest.raises(error, match=next(iter(option))):
        SeqPH(**option)


def test_assignment_never_takes_a_forbidden_pair():
    rng = np.random.default_rng(1)
    for _ in range(200):
        shape = rng.integers(1, 6, size=2)
        cost, allowed = rng.random(shape), rng.random(shape) < 0.4
        pairs = assign(cost, allowed)
        assert all(allowed[pair] for pair in pairs)
        assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
        size, total = best_matching(cost, allowed)
        assert len(pairs) == size
        assert sum(cost[pair] for pair in pairs) == pytest.approx(total)


def best_matching(
    cost: np.ndarray, allowed: np.ndarray, row: int = 0, used: frozenset = frozenset()
) -> tuple[int, float]:
    """Size and cost of the largest, then cheapest matching, by trying all."""
    if row == len(cost):
        return 0, 0.0
    best = best_matching(cost, allowed, row + 1, used)
    for column in range(cost.shape[1]):
        if allowed[row, column] and column not in used:
            size, total = best_matching(cost, allowed, row + 1, used | {column})
            best = max(best, (size + 1, total + cost[row, column]), key=lambda pair: (pair[0], -pair[1]))
    return best


def test_farthest_points_cover():
    cloud = np.random.default_rng(2).random((300, 3))
    idx, radius = farthest_point_sample(cloud, 40, start=7)
    assert idx[0] == 7
    assert len(set(idx.tolist())) == 40
    away = np.linalg.norm(cloud[:, None] - cloud[idx][None], axis=2).min(axis=1)
    assert radius == pytest.approx(away.max())
    for bad, says in (({"n": 0}, "n must be"), ({"n": 301}, "n must be"), ({"n": 3, "start": 300}, "start")):
        with pytest.raises(ValueError, match=says):
            farthest_point_sample(cloud, **bad)


def test_state_of_nothing():
    assert len(TopologicalState(frame=0, time=0.0)) == 0


@pytest.mark.parametrize("identity", ["killer-edge", "killer-triangles", "cycle"])
def test_every_identity_follows_a_loop_that_moves(identity):
    rng = np.random.default_rng(0)
    clouds = [polygon(40) + rng.normal(scale=0.005, size=(40, 2)) + [0.02 * t, 0] for t in range(12)]
    states = track(clouds, alpha=0.1, beta=1.8, epsilon=0.05, identity=identity)
    assert [[loop.id for loop in state.loops] for state in states] == [[0]] * 12


def test_a_round_loop_has_a_killer_edge_that_jumps_and_a_place_that_does_not():
    """A hexagon of alternating radii: a motion of 1e-9 moves its killer edge by the edge's whole length."""
    angle = np.pi / 3 * np.arange(6)
    hexagon = np.column_stack([np.cos(angle), np.sin(angle)]) * np.where(np.arange(6) % 2, 1, 0.95)[:, None]
    moved = hexagon + np.eye(6)[:, :1] * [0, 1e-9]
    options = {"alpha": 0.1, "beta": 0.5, "epsilon": 1e-8}
    edge = track([hexagon - np.eye(6)[:, :1] * [0, 1e-9], moved], identity="killer-edge", **options)
    assert [state.loops[0].id for state in edge] == [0, 1]
    for identity in ("killer-triangles", "cycle"):
        states = track([hexagon - np.eye(6)[:, :1] * [0, 1e-9], moved], identity=identity, **options)
        assert [state.loops[0].id for state in states] == [0, 0]
        assert states[1].loops[0].killer_shift > 1.6  # what moved is the killer edge


def test_memory_gives_a_loop_that_was_missed_its_identity_back():
    loop, gap = polygon(20), np.vstack([polygon(20)[:16], [[3.0, 0.0]]])  # an arc is no loop
    options = {"alpha": 0.3, "beta": 1.8, "epsilon": 0.1}
    frames = [loop, gap, gap, loop]
    assert [[one.id for one in state.loops] for state in track(frames, memory=0, **options)] == [[0], [], [], [1]]
    assert [one.id for one in track(frames, memory=1, **options)[3].loops] == [1]
    assert [one.id for one in track(frames, memory=2, **options)[3].loops] == [0]
    away = [loop, gap, gap, loop + [3.0, 0]]  # farther than beta and the motion of three steps allow
    assert [one.id for one in track(away, memory=2, **options)[3].loops] == [1]


@pytest.mark.parametrize(
    ("frame", "time", "says"),
    [
        (np.empty((0, 2)), 2.0, "frame 2 has no points"),
        (1000 * polygon(20), 2.0, "frame 2 is 2000 across.*units"),
        (np.vstack([polygon(19), [[np.nan, 0]]]), 2.0, "frame 2 has 1 of 20 points with a NaN"),
        (polygon(20), 1.0, r"frame 2 is repeated: its time 1.0 s"),
        (polygon(20), 0.5, r"frame 2 is out of order: its time 0.5 s is not later than 1.0 s"),
        (polygon(20), np.nan, "frame 2 has time nan"),
    ],
)
def test_a_frame_that_cannot_follow_is_refused_and_forgotten(frame, time, says):
    tracker, other = SeqPH(memory=3), SeqPH(memory=3)
    for one in (tracker, other):
        for t in range(2):
            one.update(polygon(20), time=float(t))
    with pytest.raises(ValueError, match=says):
        tracker.update(frame, time=time)
    a, b = (one.update(polygon(20) + 0.01, time=2.0) for one in (tracker, other))
    assert [vars(loop).keys() for loop in a.loops] == [vars(loop).keys() for loop in b.loops]
    assert (a.frame, a.time, [loop.id for loop in a.loops]) == (b.frame, b.time, [loop.id for loop in b.loops])
    whole = says.replace("frame 2 has 1", r"sequence\[2\] has 1")
    with pytest.raises(ValueError, match=whole):  # before anything is computed
        track([polygon(20), polygon(20), frame], times=[0.0, 1.0, time])


def test_part_of_a_scene_is_not_taken_for_other_units():
    tracker = SeqPH()
    tracker.update(polygon(200))
    tracker.update(polygon(200)[:2])
    tracker.update(polygon(200))


def test_streaming_is_updating():
    clouds = [polygon(20) + [0.05 * t, 0] for t in range(5)]
    streamed = list(SeqPH(alpha=0.1).stream(iter(clouds)))
    whole = track(clouds, alpha=0.1, n_jobs=2)
    for a, b in zip(streamed, whole, strict=True):
        assert (a.frame, a.time, a.parameters) == (b.frame, b.time, b.parameters)
        for one, two in zip(a.loops, b.loops, strict=True):
            for name in [*(name for name in vars(one) if not name.startswith("_")), "cycle", "cycle_points"]:
                np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize(("memory", "error"), [(-1, ValueError), (1.5, ValueError), ("all", TypeError)])
def test_memory_is_a_number_of_frames(memory, error):
    with pytest.raises(error, match="memory"):
        SeqPH(memory=memory)


def test_states_as_a_table():
    pandas = pytest.importorskip("pandas")
    states = track([two_circles(0.0), two_circles(0.1)])
    table = as_table(states)
    assert len(table) == sum(len(state) for state in states)
    assert table["lifetime"].tolist() == [loop.lifetime for state in states for loop in state.loops]
    assert table.groupby("id")["frame"].count().tolist() == [2, 2]
    pandas.testing.assert_index_equal(
        as_table([]).columns, pandas.Index([*table.columns[:7], "x", "y", "z", *table.columns[-2:]])
    )


# -- what a caller does with its arrays afterwards ----------------------------------------------------------------------------


def test_a_buffer_that_is_refilled_is_not_the_frame_before():
    tracker, buffer = SeqPH(), np.empty((20, 2))
    states = []
    for t in range(4):
        buffer[:] = polygon(20) + [0.07 * t, 0]
        states.append(tracker.update(buffer))
    fresh = track([polygon(20) + [0.07 * t, 0] for t in range(4)])
    assert [state.parameters for state in states] == [state.parameters for state in fresh]
    assert states[1].parameters["epsilon"] > 0
    assert [[loop.id for loop in state.loops] for state in states] == [[0]] * 4
    for state, other in zip(states, fresh, strict=True):  # found when asked for, long after the buffer was refilled
        np.testing.assert_array_equal(state.loops[0].cycle_points, other.loops[0].cycle_points)


def test_a_tracked_sequence_owns_its_clouds():
    frames = np.stack([polygon(20), polygon(20) + [0.05, 0]])
    states, copy = track(frames), frames.copy()
    frames[:] = np.nan
    np.testing.assert_array_equal(states[1].loops[0].cycle_points, copy[1][states[1].loops[0].cycle])


def test_a_loop_does_not_freeze_or_share_what_it_was_made_of():
    loop = track([polygon(20)])[0].loops[0]
    edge = loop.killer_edge.copy()
    made = replace(loop, killer_edge=edge)
    edge[0] += 1
    np.testing.assert_array_equal(made.killer_edge, loop.killer_edge)
    with pytest.raises(ValueError, match="read-only"):
        made.killer_edge[0] = 3


# -- repeated points -----------------------------------------------------------------------------------------------------------


def test_repeated_points_change_nothing():
    rng = np.random.default_rng(5)
    ring = polygon(60) + rng.normal(scale=0.01, size=(60, 2))
    one = track([ring])[0]
    for padded in (np.concatenate([ring, ring[:25]]), np.concatenate([ring, ring])):  # a camera's, and a doubled cloud
        other = track([padded])[0]
        assert one.parameters == other.parameters
        assert [loop.lifetime for loop in one.loops] == [loop.lifetime for loop in other.loops]
    assert spacing(np.array([[0.0], [-0.0], [0.0]])) == 0.0
    assert spacing(np.array([[0.0], [-0.0], [3.0]])) == 1.5


# -- a diagram that is handed in -----------------------------------------------------------------------------------------------


def test_a_known_diagram_is_taken_and_an_open_one_refused():
    tracker = SeqPH()
    with pytest.raises(ValueError, match=r"frame 0: 1 loops .* do not die below max_radius = 0.5"):
        tracker.update(polygon(20), diagram=rips_persistence(polygon(20), max_radius=0.5))
    with pytest.raises(ValueError, match="frame 0 has 20 points, its diagram is of 19"):
        tracker.update(polygon(20), diagram=rips_persistence(polygon(19)))
    state = tracker.update(polygon(20), diagram=rips_persistence(polygon(20)))
    np.testing.assert_array_equal(state.loops[0].centre, track([polygon(20)])[0].loops[0].centre)


# -- time ------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ([1.0, None, 0.5], "frame 1 has no time, the frame before it one"),
        ([None, 1.0], r"frame 1 has time 1.0 s, the frame before it none"),
    ],
)
def test_all_frames_have_a_time_or_none(times, says):
    tracker = SeqPH()
    tracker.update(polygon(20), time=times[0])
    with pytest.raises(ValueError, match=says):
        tracker.update(polygon(20), time=times[1])
    with pytest.raises(ValueError, match=says):
        track([polygon(20)] * len(times), times=times)


# -- gates -----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gates", "gate", "bound"),
    [("paper", 2 * 0.125 + 0.0625, 2 * 0.125 + 0.25 + 0.0625), ("proved", 0.125 + 0.0625, 2 * 0.25 + 0.0625)],
)
def test_gates_are_as_wide_as_they_are_said_to_be(gates, gate, bound):
    """Just inside is the same loop; on the bound and just outside is not: for births, deaths and places."""
    for size, change in ((gate, "birth"), (gate, "death"), (bound, "place")):
        for factor, wanted in ((0.999, [(0, 0)]), (1.0, []), (1.001, [])):
            moved = {"birth": 1.0, "death": 2.0, "place": 0.0} | {change: 3.0 + factor * size}
            base = {"birth": 1.0, "death": 2.0, "place": 0.0} | {change: 3.0}
            loops = Candidates(
                *(np.array([moved[name]]) for name in ("birth", "death")),
                np.array([[[moved["place"]]]]),
                *(np.array([base[name]]) for name in ("birth", "death")),
                np.array([[[base["place"]]]]),
                motion=np.array([0.0625]),
                alpha=0.125,
                beta=0.25,
            )
            assert within_gates(gates, loops) == wanted, (change, factor)


def test_a_remembered_loop_may_have_moved_in_every_frame_since():
    """Three steps of 0.1 are farther than one step's gates allow, and not farther than three's."""
    options = {"alpha": 0.3, "beta": 0.05, "epsilon": 0.1, "gates": "proved", "identity": "killer-triangles"}
    gap = np.vstack([polygon(20)[:16], [[3.0, 0.0]]])
    for gone, wanted in ((0, 1), (2, 0)):  # as far as three steps, at once or after two frames without the loop
        frames = [polygon(20), *[gap] * gone, polygon(20) + [0.35, 0]]
        assert [loop.id for loop in track(frames, memory=2, **options)[-1].loops] == [wanted]


def test_a_matching_of_ones_own():
    def first_come(loops: Candidates) -> list[tuple[int, int]]:
        return [(i, i) for i in range(min(len(loops.birth), len(loops.known_birth)))]

    far = [polygon(20), polygon(20) + [9.0, 0]]
    options = {"alpha": 0.1, "beta": 0.1, "epsilon": 0.1}
    assert [state.loops[0].id for state in track(far, **options)] == [0, 1]
    assert [state.loops[0].id for state in track(far, match=first_come, **options)] == [0, 0]


def test_a_loop_carries_its_curve():
    cloud = two_circles(0.0)
    diagram = rips_persistence(cloud)
    state = track([cloud])[0]
    assert len(state) == 2
    for i, loop in enumerate(state.loops):
        np.testing.assert_array_equal(loop.cycle, diagram.cycle(i))
        np.testing.assert_array_equal(loop.cycle_points, cloud[diagram.cycle(i)])
        assert loop.cycle is loop.cycle  # found once
    with pytest.raises(LookupError, match="loop 0 knows no cloud"):
        _ = replace(state.loops[0], _curve=None).cycle


def rings(which: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Rings that stand side by side and are drawn anew; the first is denser."""
    parts = []
    for k in which:
        angle = rng.uniform(0, 2 * np.pi, 300 if k == 0 else 150)
        parts.append(np.column_stack([0.1 * np.cos(angle) + 0.3 * k, 0.1 * np.sin(angle)]))
    return np.vstack(parts)


def test_loops_that_stand_still_keep_their_names_when_others_come_or_go():
    rng = np.random.default_rng(0)
    states = track([rings((0, 1, 2), rng)] * 4 + [rings((1, 2), rng)] * 4 + [rings((0, 1, 2), rng)] * 2)
    named = [{round(loop.centre[0] / 0.3): loop.id for loop in state.loops} for state in states]
    assert named[0].keys() == {0, 1, 2}
    assert all(each[k] == named[0][k] for each in named for k in (1, 2))


@pytest.mark.parametrize(
    ("pairs", "what"),
    [
        ([(0, 0), (1, 0)], "each once"),
        ([(5, 5)], "each once"),
        ([(-1, 0)], "each once"),
        (None, "each once"),
        ([0], "each"),
    ],
)
def test_a_matching_of_ones_own_gives_each_loop_once(pairs, what):
    tracker = SeqPH(match=lambda loops: pairs)
    tracker.update(two_circles(0.0), diagram=rips_persistence(two_circles(0.0)))
    with pytest.raises(ValueError, match=what):
        tracker.update(two_circles(0.1))
    with pytest.raises(TypeError, match="match must be a function"):
        SeqPH(match=3)


def test_states_can_be_sent_to_another_process():
    state = track([polygon(20)])[0]
    again = pickle.loads(pickle.dumps(state))
    np.testing.assert_array_equal(again.loops[0].cycle, state.loops[0].cycle)


@pytest.mark.parametrize("time", [np.timedelta64(1, "s"), np.complex128(1)])
def test_a_time_is_a_number_of_seconds(time):
    with pytest.raises(ValueError, match="seconds"):
        SeqPH().update(polygon(20), time=time)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        SeqPH(alpha=np.float32(0.01), epsilon=np.float16(0.5)).update(polygon(20), time=np.float32(1))
