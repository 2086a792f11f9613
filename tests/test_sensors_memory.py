"""The cloud with a memory: what is hidden stays, what is contradicted goes."""

import numpy as np
import pytest

import topokit as tk
from topokit.sensors import CloudMemory

EYE = (0.0, -2.0, 1.5)


def band(turn: float = 0.0, middle: float = 0.0) -> np.ndarray:
    """A ring of cloth, seen from above its rim."""
    angle = turn + np.linspace(0, 2 * np.pi, 40, endpoint=False)
    rims = [np.column_stack([middle + 0.3 * np.cos(angle), 0.3 * np.sin(angle), 0 * angle + z]) for z in (0.0, 0.04)]
    return np.concatenate(rims)


def sheet(depth: float, n: int = 15, size: float = 1.0) -> np.ndarray:
    """A square that the camera at the origin looks at."""
    x, y = np.meshgrid(np.linspace(-size, size, n), np.linspace(-size, size, n))
    return np.column_stack([x.ravel(), y.ravel(), np.full(n * n, depth)])


def screen(cloth: np.ndarray, to: float) -> np.ndarray:
    """Something half way to the eye, in front of what is beyond `to` along x."""
    return (cloth[cloth[:, 0] > to] + EYE) / 2


def test_a_turning_ring_that_is_half_hidden_keeps_its_loop_and_its_name():
    memory = CloudMemory()
    alone = []
    with_memory = []
    for frame in range(24):
        ring = band(0.02 * frame, 0.004 * frame)
        to = 0.004 * frame + (0.05 if 6 <= frame < 18 else 9)
        seen = ring[ring[:, 0] <= to]
        alone.append(seen)
        with_memory.append(memory(seen, eye=EYE, around=screen(ring, to)))
    assert [[loop.id for loop in state.loops] for state in tk.track(with_memory)] == [[0]] * 24
    assert 1 not in [len(state.loops) for state in tk.track(alone)[6:18]]  # without memory it is lost


def test_what_is_hidden_stays_where_it_was():
    cloth = sheet(2.0)
    memory = CloudMemory(frames=3)
    left = cloth[cloth[:, 0] < 0.1]
    right = cloth[cloth[:, 0] > 0.1]
    memory(cloth)
    for _ in range(100):
        cloud = memory(left, around=right / 2)
    assert np.array_equal(np.unique(cloud, axis=0), np.unique(cloth, axis=0))
    assert len(memory(cloth)) == len(cloth)  # what is seen again is there once


def test_a_place_that_the_camera_looks_through_is_empty():
    back = sheet(2.0)
    memory = CloudMemory()
    memory(np.vstack([back, sheet(1.5, 5, 0.2)]))
    assert len(memory(back)) == len(back)  # cloth is seen behind it
    left = back[back[:, 0] < 0.1]
    right = back[back[:, 0] > 0.1]
    assert len(memory(left, around=right / 2)) == len(back)
    assert len(memory(left)) == len(back)  # nothing is known of what is there
    assert memory(left, around=back * 1.5)[:, 0].max() < 0.2  # a wall is seen behind all of it but its edge


def test_what_is_beside_all_that_is_seen_stays():
    near = [sheet(1.5, 5, 0.2) + [x, 0, 0] for x in (-1.2, 1.2)]
    far = [sheet(2.5, 5, 0.2) + [0, y, 0] for y in (-1.6, 1.6)]
    flaps = np.concatenate([*near, *far])
    cloth = sheet(2.0, 11, 0.5)
    memory = CloudMemory(frames=2)
    memory(np.vstack([cloth, flaps]))
    assert [len(memory(cloth)) for _ in range(5)] == [len(cloth) + len(flaps)] * 5


def test_what_should_be_in_sight_is_forgotten_after_some_frames():
    cloth = sheet(2.0)
    memory = CloudMemory(frames=3)
    rows = np.round(cloth[:, 1] / (2 / 14) + 7) % 2 == 0
    assert [len(memory(points)) for points in [cloth] + [cloth[rows]] * 5] == [225, 225, 225, 225, 120, 120]


def test_the_order_of_points_and_their_unit_change_nothing():
    rng = np.random.default_rng(0)
    plain, shuffled, larger = CloudMemory(), CloudMemory(), CloudMemory()
    for frame in range(12):
        points = band(0.1 * frame, 0.01 * frame)[: 80 - 4 * frame]
        cloud = plain(points, eye=EYE)
        repeated = rng.permutation(np.vstack([points, points[:9]]))  # repeated points count once
        assert np.array_equal(cloud, shuffled(repeated, eye=EYE))
        assert np.allclose(1000 * cloud, larger(1000 * points, eye=1000 * np.array(EYE)))
    assert len(cloud) > len(points)


def test_a_hole_is_open_once_the_camera_has_looked_through_it():
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.concatenate([np.column_stack([r * np.cos(angle), r * np.sin(angle), 0 * angle + 2]) for r in (0.3, 0.35)])
    hand, wall = sheet(1.0, 15, 0.2), sheet(3.0)
    for around, seen, expected in (
        (None, ring, 1),
        (wall, ring, 1),
        (hand, ring, 0),
        (None, np.vstack([ring, sheet(3.0, 21)]), 0),
    ):
        state = tk.SeqPH().update(seen)
        assert len(state) == 1
        memory = CloudMemory()
        assert len(memory.open_loops(state)) == 0  # nothing has been looked at
        memory(seen, around=around)
        assert len(memory.open_loops(state)) == expected
    tracker, memory = tk.SeqPH(), CloudMemory()
    states = [memory.open_loops(tracker.update(memory(ring, around=around))) for around in (hand, wall, hand)]
    assert [[loop.id for loop in state.loops] for state in states] == [[], [0], [0]]


def test_what_a_hand_hides_is_not_taken_for_motion():
    cloth = np.column_stack([np.random.default_rng(0).uniform(-0.3, 0.3, (600, 2)), np.full(600, 0.8)])
    memory = CloudMemory()
    for edge in np.linspace(-0.3, 0.25, 20):
        hidden = cloth[:, 0] < edge
        cloud = memory(cloth[~hidden], around=0.6 * cloth[hidden])
    assert len(cloud) <= len(cloth)
    assert np.abs(cloud[:, 0]).max() <= 0.31


@pytest.mark.parametrize(
    ("points", "options", "names"),
    [
        (np.zeros((9, 2)), {}, r"points .*\(9, 2\)"),
        (np.full((9, 3), np.nan), {}, "points"),
        (np.ones((9, 3)), {}, "1 places"),
        (np.zeros((0, 3)), {}, "0 places"),
        (sheet(0.0), {}, "eye"),
        (sheet(2.0), {"eye": (0, 0)}, "eye"),
        (sheet(2.0), {"around": [[0.0, 0.0]]}, "around"),
    ],
)
def test_a_frame_that_cannot_be_is_refused_and_changes_nothing(points, options, names):
    memory = CloudMemory()
    memory(sheet(2.0))
    with pytest.raises(ValueError, match=names):
        memory(points, **options)
    assert np.array_equal(memory(sheet(2.0)), np.unique(sheet(2.0), axis=0))
    with pytest.raises(ValueError, match="frames"):
        CloudMemory(frames=-1)
