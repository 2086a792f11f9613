"""Test the cloth of the figure `hold`, run by node: rest, contact, links, and names as the library gives them."""

from __future__ import annotations

import functools

import numpy as np

from topokit import SeqPH, farthest_point_sample
from topokit.io import Episode, load_episode
from topokit.linking import close_far, linking_numbers
from topokit.sim import WARDROBE, Hook

from conftest import DATA
from pages import by_script, needs_node

pytestmark = needs_node
FILM = """({ rest, faces, rods, start, grips, goals, release }) => {
  const EVERY = 5;
  const body = clothBody({ rest, faces, rods });
  body.place(start);
  grips.forEach((v, h) => body.hold(h, v, goals[0][h]));
  return goals.map((now, t) => {
    if (t === release) [0, 1].forEach((h) => body.hold(h, -1, body.hands[h].at));
    body.frame(now);
    return [t % EVERY ? [] : [...body.points], body.energy(), body.speed(), body.deepest()];
  });
}"""


@functools.cache
def episode() -> Episode:
    return load_episode(DATA / "apron_hook_0.npz")


def filmed(goals: np.ndarray, release: int = -1) -> tuple[np.ndarray, ...]:
    """Return vertices (T / 5, n, 3) of each fifth frame, energies, greatest speeds and depths for goals (T, 2, 3)."""
    apron = WARDROBE["apron"]()
    given = {
        "rest": apron.vertices.ravel().tolist(),
        "faces": apron.faces.ravel().tolist(),
        "rods": [[start.tolist(), end.tolist(), radius] for start, end, radius in Hook().rods],
        "start": episode().points[0].ravel().tolist(),
        "grips": apron.grips.tolist(),
        "goals": goals.tolist(),
        "release": release,
    }
    [frames] = by_script(["cloth.js"], FILM, [given])
    points, *measured = zip(*frames, strict=True)
    return np.reshape(points[::5], (len(points[::5]), -1, 3)), *map(np.array, measured)


@functools.cache
def hanging() -> tuple[np.ndarray, ...]:
    """Return the film of the recorded grippers' moves, two frames for one of theirs, and of the rest that follows."""
    moves = np.repeat(episode().grippers, 2, axis=0).astype(float)
    rest = np.repeat(moves[-1:], 400, axis=0)
    return filmed(np.concatenate([moves, rest]), release=2 * int(np.argmin(episode().held)))


def depths(points: np.ndarray) -> np.ndarray:
    """Return how deep the deepest vertex of each frame is in the hook, negative outside."""
    gaps = []
    for start, end, radius in Hook().rods:
        axis = end - start
        share = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
        gaps.append(np.linalg.norm(points - start - share[..., None] * axis, axis=-1) - radius)
    return -np.min(gaps, axis=(0, 2))


def test_a_cloth_that_is_held_or_hangs_gains_no_energy_and_comes_to_rest():
    still = np.repeat(episode().grippers[:1].astype(float), 500, axis=0)
    for _, energy, speed, _ in (filmed(still), hanging()):
        assert energy[-100:].max() <= energy[-200:-100].max() + 1e-4  # joules, of about 2; it still sways a little
        assert speed[-1] < 0.03 < speed[:100].max()


def test_no_vertex_is_ever_in_the_hook_and_the_same_moves_give_the_same_film():
    """The hands jump to and fro beside, above and behind the hook, faster than they can follow."""
    rng = np.random.default_rng(0)
    places = rng.uniform([-0.2, -0.2, 0.9], [0.2, 0.6, 1.5], (50, 2, 3))
    goals = np.repeat(places, 20, axis=0)
    points, _, _, deepest = filmed(goals)
    assert np.isfinite(points).all()
    assert -0.3 * Hook().radius - 1e-9 <= deepest.max() <= 0  # it touched the hook, from outside
    np.testing.assert_allclose(depths(points), deepest[::5], atol=1e-12)
    np.testing.assert_array_equal(points[:40], filmed(goals[:200])[0])


def test_the_apron_hangs_and_its_links_are_the_librarys():
    points, *_ = hanging()
    necks = points[:, episode().loops[0]]
    hook = close_far(episode().centre_line)
    sums = by_script(["link.js"], "([a, b]) => linkingSum(a, b)", [[neck.tolist(), hook.tolist()] for neck in necks])
    numbers, _ = linking_numbers(necks, hook)
    np.testing.assert_allclose(sums, numbers, atol=1e-6)
    assert numbers[0] == 0 != numbers[-1]
    assert necks[-1, :, 2].mean() > 0.9


def test_the_live_tracker_gives_the_names_of_the_library():
    count = 200
    scripts = ["sampling.js", "rips.js", "assign.js", "seqph.js", "live.js"]
    call = """(film) => {
      const { follow } = liveCalls();
      const states = film.map(([cloud, count], t) => follow(Float64Array.from(cloud), count, t === 0));
      return states.map(({ loops }) => loops.map(({ id, cycle }) => [id, cycle]));
    }"""
    for film in (hanging()[0][:50], episode().points[::3].astype(float)):
        [answer] = by_script(scripts, call, [[[cloud.ravel().tolist(), count] for cloud in film]])
        tracker = SeqPH()
        for cloud, loops in zip(film, answer, strict=True):
            ids, _ = farthest_point_sample(cloud, count)
            state = tracker.update(cloud[ids])
            assert [id for id, _ in loops] == [loop.id for loop in state.loops]
            assert all(set(cycle) <= set(ids.tolist()) for _, cycle in loops)
