"""Test pictures: they draw the loops, cloths and targets they are given, and the player's page holds the episode."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import topokit as tk
from chapter_tools import figures
from topokit import view
from topokit.io import Episode, load_episode
from topokit.linking import close_far, linking_number

from conftest import DATA, polygon
from pages import by_script, needs_node, page_data, unpack

FRAMES, RING, ROWS = 6, 24, 3


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def episode():
    """Return a short tube of cloth that drifts towards a rod: one true loop, three rings of vertices."""
    ring = polygon(RING, 0.1)
    rest = np.concatenate([np.column_stack([ring * (1 + 0.1 * row), np.full(RING, 0.02 * row)]) for row in range(ROWS)])
    rest += np.random.default_rng(0).normal(0, 1e-3, rest.shape)
    points = np.stack([rest + [0.01 * frame, 0, 0.005 * frame] for frame in range(FRAMES)]).astype(np.float32)
    a = np.arange((ROWS - 1) * RING)
    b = a - a % RING + (a + 1) % RING
    faces = np.concatenate([np.column_stack([a, b, a + RING]), np.column_stack([b, b + RING, a + RING])])
    grippers = np.stack([points[:, 0], points[:, RING // 2]], axis=1)
    return Episode(
        points=points,
        observed=points[:, ::2],
        actions=grippers,
        grippers=grippers,
        held=np.arange(FRAMES) < 4,
        faces=faces.astype(np.int32),
        loops=(np.arange(RING, dtype=np.int32),),
        centre_line=np.array([[0.0, 0, -0.1], [0, 0, 0.1], [0, 0.05, 0.12]], dtype=np.float32),
        garment="tube</script>",
        target="rod",
        success=True,
        seed=0,
        dt=0.04,
    )


@pytest.fixture(scope="module")
def states(episode):
    return tk.track(episode.points, times=episode.times)


def test_a_diagram_has_a_dot_for_each_loop_in_its_colour(states):
    axes = view.plot_diagram(states[0])
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    assert len(dots) == len(states[0].loops) >= 1
    for dot, loop in zip(dots, states[0].loops, strict=True):
        assert dot.get_xydata().tolist() == [[loop.birth, loop.death]]
        assert dot.get_color() == view.loop_colour(loop.id)
    dashed = next(line for line in axes.lines if line.get_linestyle() == "--")
    assert np.diff(dashed.get_xydata()[0]) == pytest.approx(states[0].parameters["alpha"])


def test_tracks_break_where_a_loop_is_missing(states):
    gap = [*states[:2], tk.TopologicalState(2, states[2].time), *states[3:]]
    axes = view.plot_tracks(gap)
    neck = states[0].loops[0].id
    line = next(line for line in axes.lines if line.get_label() == f"loop {neck}")
    expected = [np.nan if t == 2 else states[t][neck].lifetime for t in range(FRAMES)]
    np.testing.assert_array_equal(line.get_ydata(), expected)
    np.testing.assert_allclose(line.get_xdata(), [state.time for state in states])
    assert not view.plot_tracks([]).lines


def test_the_player_holds_the_episode_and_the_loops_of_each_frame(episode, states):
    data = page_data(view.player(episode, states))
    arrays = {name: unpack(packed) for name, packed in data["arrays"].items()}
    assert abs(arrays["points"] - episode.points).max() <= data["arrays"]["points"]["scale"] / 2 + 1e-9 < 1e-5
    np.testing.assert_array_equal(arrays["faces"], episode.faces)
    np.testing.assert_array_equal(arrays["held"], episode.held)
    assert data["truth"] == [episode.loops[0].tolist()]
    for frame, state in enumerate(states):
        rows = slice(arrays["first"][frame], arrays["first"][frame + 1])
        assert arrays["id"][rows].tolist() == [loop.id for loop in state.loops]
        np.testing.assert_allclose(arrays["death"][rows], [loop.death for loop in state.loops], rtol=1e-6)
        for corners, loop in zip(arrays["killer"][rows], state.loops, strict=True):
            np.testing.assert_allclose(corners[:2], loop.killer_edge_points, atol=1e-5)
            np.testing.assert_allclose(corners[2:].reshape(2, 3, 3), loop.killer_triangles, atol=1e-5)


def test_the_player_starts_at_the_longest_life_or_at_a_given_frame(episode, states):
    """An episode without loops or faces starts at its first frame."""
    neck = states[0].loops[0].id
    longest = int(np.argmax([state[neck].lifetime for state in states]))
    assert [page_data(view.player(episode, states, start=t))["start"] for t in (None, 3)] == [longest, 3]
    with pytest.raises(ValueError, match=r"5 frames .* 6"):
        view.player(episode, states[:-1])
    bare = replace(episode, faces=np.zeros((0, 3), np.int32), loops=(), centre_line=np.zeros((0, 3), np.float32))
    data = page_data(view.player(bare, [tk.TopologicalState(t, 0.0) for t in range(FRAMES)]))
    assert (data["long"], data["marks"], data["start"]) == ([], [], 0)


AHEAD = (1, 3, 6, 10)
PLANS = (3, 5)
NOW = 80  # the apron hangs by then


@pytest.fixture(scope="module")
def film():
    return load_episode(DATA / "apron_hook_0.npz")


@pytest.fixture(scope="module")
def forecasts(film):
    """Return plans that end up to a metre apart, and a cloth that follows them, stretched."""
    rise, aside = (np.linspace(-0.5, 0.5, n) for n in PLANS)
    ends = np.stack(np.broadcast_arrays(aside[None], 0 * aside[None], rise[:, None]), axis=-1)  # (R, C, 3)
    share = np.arange(1, AHEAD[-1] + 1)[:, None] / AHEAD[-1]
    shift = ends[:, :, None] * share + np.array([0, 0.2, 0]) * share**2
    actions = film.grippers[NOW].astype(float) + shift[:, :, :, None]
    follows = np.linspace(0.7, 1.1, film.points.shape[1])[:, None]
    clouds = film.points[NOW].astype(float) + shift[:, :, np.array(AHEAD) - 1, None] * follows
    return actions, clouds


@needs_node
def test_the_script_of_plans_shows_the_forecasts_and_links_as_topokit_does(film, forecasts):
    """No vertex and no gripper is off by more than 5 mm, at the knots and between them."""
    actions, clouds = forecasts
    page = page_data(figures.plans(film, NOW, actions, clouds, AHEAD, film.loops[0]))
    arrays = {name: unpack(page["arrays"][name]).ravel().tolist() for name in ("shares", "modes")}
    asked = [[plan, t] for plan in range(PLANS[0] * PLANS[1]) for t in (0, 1, 2, 5, 9, 10)]
    call = """({ arrays, plans, asked }) => {
      globalThis.clamp = (v, low, high) => Math.max(low, Math.min(high, v));
      const bent = bending(arrays, plans);
      return asked.map(([p, t]) => [[...bent.coordinates(p, t)], bent.number(p, t)]);
    }"""
    given = [{"arrays": arrays, "plans": page["plans"], "asked": asked}]
    [answers] = by_script(["link.js", "planar.js", "plans.js"], call, given)
    first = np.concatenate([film.points[NOW], film.grippers[NOW]]).astype(float)
    numbers = set()
    for (plan, t), (flat, number) in zip(asked, answers, strict=True):
        row, column = divmod(plan, PLANS[1])
        later = np.concatenate([clouds[row, column], actions[row, column][np.array(AHEAD) - 1]], axis=1)
        knots = np.concatenate([first[None], later]).reshape(len(AHEAD) + 1, -1)
        forecast = [np.interp(t, [0, *AHEAD], coordinate) for coordinate in knots.T]
        shown = np.reshape(flat, (-1, 3))
        assert np.linalg.norm(shown - np.reshape(forecast, (-1, 3)), axis=1).max() < 0.00501
        assert number == linking_number(shown[film.loops[0]], close_far(film.centre_line))
        numbers.add(abs(number))
    assert numbers == {0, 1}
