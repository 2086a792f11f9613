"""The cloud with a memory: what is hidden stays, what is contradicted goes."""

import numpy as np
import pytest

import topokit as tk
from topokit.sensors import CloudMemory

EYE = (0.0, -2.0, 1.5)


def band(turn: float = 0.0, middle: float = 0.0) -> np.ndarray:
    """A ring of cloth, seen from above its rim."""
    angle = turn + np.linspace(0, 2 * np.pi, 40, endpoint=False)
    return np.concatenate(
        [np.column_stack([middle + 0.3 * np.cos(angle), 0.3 * np.sin(angle), 0 * angle + z]) for z in (0.0, 0.04)]
    )


def sheet(depth: float, n: int = 15, size: float = 1.0) -> np.ndarray:
    """A square that the camera at the origin looks at."""
    x, y = np.meshgrid(np.linspace(-size, size, n), np.linspace(-size, size, n))
    return np.column_stack([x.ravel(), y.ravel(), np.full(n * n, depth)])


def screen(cloth: np.ndarray, to: float) -> np.ndarray:
    """Something half way to the eye, in front of what is beyond `to` along x."""
    return (cloth[cloth[:, 0] > to] + EYE) / 2


def test_a_turning_ring_that_is_half_hidden_keeps_its_loop_and_its_name() -> None:
    memory, alone, with_memory = CloudMemory(), [], []
    for frame in range(24):
        ring = band(0.02 * frame, 0.004 * frame)
        to = 0.004 * frame + (0.05 if 6 <= frame < 18 else 9)
        seen = ring[ring[:, 0] <= to]
        alone.append(seen)
        with_memory.append(memory(seen, eye=EYE, around=screen(ring, to)))
    names = [[loop.id for loop in state.loops] for state in tk.track(with_memory)]
    assert names == [[0]] * 24
    assert [len(state.loops) for state in tk.track(alone)[6:18]].count(1) == 0  # without memory it is lost


def test_what_is_hidden_stays_where_it_was() -> None:
    cloth, memory = sheet(2.0), CloudMemory(frames=3)
    left, right = cloth[cloth[:, 0] < 0.1], cloth[cloth[:, 0] > 0.1]
    memory(cloth)
    for _ in range(100):
        cloud = memory(left, around=right / 2)
    assert np.array_equal(np.unique(cloud, axis=0), np.unique(cloth, axis=0))
    assert len(memory(cloth)) == len(cloth)  # what is seen again is there once


def test_a_place_that_the_camera_looks_through_is_empty() -> None:
    back, flap, memory = sheet(2.0), sheet(1.5, 5, 0.2), CloudMemory()
    memory(np.vstack([back, flap]))
    assert len(memory(back)) == len(back)  # cloth is seen behind it
    left, right = back[back[:, 0] < 0.1], back[back[:, 0] > 0.1]
    assert len(memory(left, around=right / 2)) == len(back)
    assert len(memory(left)) == len(back)  # nothing is known of what is there
    assert memory(left, around=back * 1.5)[:, 0].max() < 0.2  # a wall is seen behind all of it but its edge


def test_what_is_beside_all_that_is_seen_stays() -> None:
    near = [sheet(1.5, 5, 0.2) + [x, 0, 0] for x in (-1.2, 1.2)]
    far = [sheet(2.5, 5, 0.2) + [0, y, 0] for y in (-1.6, 1.6)]
    flaps = np.concatenate([*near, *far])
    cloth, memory = sheet(2.0, 11, 0.5), CloudMemory(frames=2)
    memory(np.vstack([cloth, flaps]))
    assert [len(memory(cloth)) for _ in range(5)] == [len(cloth) + len(flaps)] * 5


def test_what_should_be_in_sight_is_forgotten_after_some_frames() -> None:
    cloth, memory = sheet(2.0), CloudMemory(frames=3)
    rows = np.round(cloth[:, 1] / (2 / 14) + 7) % 2 == 0
    sizes = [len(memory(points)) for points in [cloth] + [cloth[rows]] * 5]
    assert sizes == [225, 225, 225, 225, 120, 120]


def test_the_order_of_points_and_their_unit_are_nothing() -> None:
    rng = np.random.default_rng(0)
    plain, other, larger = CloudMemory(), CloudMemory(), CloudMemory()
    for frame in range(12):
        points = band(0.1 * frame, 0.01 * frame)[: 80 - 4 * frame]
        cloud = plain(points, eye=EYE)
        shuffled = rng.permutation(np.vstack([points, points[:9]]))  # repeated points count once
        assert np.array_equal(cloud, other(shuffled, eye=EYE))
        assert np.allclose(1000 * cloud, larger(1000 * points, eye=1000 * np.array(EYE)))
    assert len(cloud) > len(points)


def test_a_hole_is_open_once_the_camera_has_looked_through_it() -> None:
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.concatenate([np.column_stack([r * np.cos(angle), r * np.sin(angle), 0 * angle + 2]) for r in (0.3, 0.35)])
    hand, wall, cloth = sheet(1.0, 15, 0.2), sheet(3.0), np.vstack([ring, sheet(3.0, 21)])
    for around, seen, expected in ((None, ring, 1), (wall, ring, 1), (hand, ring, 0), (None, cloth, 0)):
        state = tk.SeqPH().update(seen)
        assert len(state) == 1
        memory = CloudMemory()
        assert len(memory.open_loops(state)) == 0  # nothing has been looked at
        memory(seen, around=around)
        assert len(memory.open_loops(state)) == expected
    tracker, memory = tk.SeqPH(), CloudMemory()
    states = [memory.open_loops(tracker.update(memory(ring, around=around))) for around in (hand, wall, hand)]
    assert [[loop.id for loop in state.loops] for state in states] == [[], [0], [0]]


@pytest.mark.parametrize(
    ("points", "options", "words"),
    [
        (np.zeros((9, 2)), {}, r"points must be in space, \(n, 3\), not of shape \(9, 2\)"),
        (np.full((9, 3), np.nan), {}, "points has 9 of 9 points with a NaN"),
        (np.ones((9, 3)), {}, "points has 1 places, too few"),
        (np.zeros((0, 3)), {}, "points has 0 places"),
        (sheet(0.0), {}, "a point is where the eye is"),
        (sheet(2.0), {"eye": (0, 0)}, "eye must be in space"),
        (sheet(2.0), {"around": [[0.0, 0.0]]}, "around must be in space"),
    ],
)
def test_a_frame_that_cannot_be_is_refused_and_changes_nothing(points: np.ndarray, options: dict, words: str) -> None:
    memory = CloudMemory()
    memory(sheet(2.0))
    with pytest.raises(ValueError, match=words):
        memory(points, **options)
    assert np.array_equal(memory(sheet(2.0)), np.unique(sheet(2.0), axis=0))


def test_memory_is_a_whole_number_of_frames() -> None:
    with pytest.raises(ValueError, match="frames must be"):
        CloudMemory(frames=-1)


def test_what_a_hand_hides_is_not_taken_for_motion():
    sheet = np.column_stack([np.random.default_rng(0).uniform(-0.3, 0.3, (600, 2)), np.full(600, 0.8)])
    memory = CloudMemory()
    for edge in np.linspace(-0.3, 0.25, 20):
        hidden = sheet[:, 0] < edge
        cloud = memory(sheet[~hidden], around=0.6 * sheet[hidden])
    assert len(cloud) <= len(sheet)
    assert np.abs(cloud[:, 0]).max() <= 0.31
