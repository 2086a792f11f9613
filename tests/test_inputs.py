"""Public names keep nothing of a caller's buffer, and name the argument that is wrong in the mistakes that users make."""

from __future__ import annotations

import numpy as np
import pytest

import topokit as tk
from topokit.evaluate import Overlap, score
from topokit.io import load_episode

TURN = np.linspace(0, 2 * np.pi, 40, endpoint=False)
RING = np.column_stack([0.2 * np.cos(TURN), 0.2 * np.sin(TURN), np.ones(40)])


@pytest.mark.parametrize(
    "call",
    [
        tk.rips_persistence,
        tk.SeqPH().update,
        lambda cloud: tk.track([cloud]),
        lambda cloud: tk.farthest_point_sample(cloud, 5),
        lambda cloud: tk.covering_radius(RING, cloud),
        lambda cloud: tk.hausdorff(cloud, RING),
        lambda cloud: tk.linking_number(cloud, RING + 9),
        lambda cloud: tk.follow(tk.track([RING])[0], cloud),
    ],
)
def test_a_missing_coordinate_is_named_by_its_row(call):
    cloud = RING.copy()
    cloud[3, 1] = np.nan
    with pytest.raises(ValueError, match="the first at row 3"):
        call(cloud)


@pytest.mark.parametrize("call", [tk.rips_persistence, lambda cloud: tk.track([cloud])])
def test_a_number_under_a_mask_is_not_used(call):
    with pytest.raises(ValueError, match="masked"):
        call(np.ma.masked_greater(RING, 0.19))


@pytest.mark.parametrize("call", [tk.rips_persistence, lambda cloud: tk.track([cloud])])
def test_a_transposed_cloud_is_recognised(call):
    with pytest.raises(ValueError, match=r"\.T"):
        call(RING.T)


@pytest.mark.parametrize("call", [tk.rips_persistence, tk.SeqPH().update, lambda cloud: tk.hausdorff(cloud, RING)])
@pytest.mark.parametrize("cloud", [RING[0], RING[None], np.zeros((5, 0))])
def test_the_shape_of_a_cloud_is_named(call, cloud):
    with pytest.raises(ValueError, match=r"\(n, d\).*shape"):
        call(cloud)


def test_clouds_are_numbers_of_one_length():
    with pytest.raises(TypeError, match="real numbers"):
        tk.rips_persistence([["a", "b"]])
    with pytest.raises(ValueError, match="inhomogeneous"):
        tk.rips_persistence([[0.0, 1.0], [2.0]])
    with pytest.raises(ValueError, match=r"sequence\[1\] has 2 dimensions"):
        tk.track([RING, RING[:, :2]])


def test_a_matrix_of_distances_that_is_read_as_points_is_suspected():
    distances = np.linalg.norm(RING[:, None] - RING, axis=-1)
    with pytest.warns(UserWarning, match="precomputed"):
        tk.rips_persistence(distances)


def test_walks_are_a_list_of_lists():
    diagram = tk.rips_persistence(RING)
    with pytest.raises(TypeError, match=r"walks\[0\]"):
        diagram.killers_of([0, 1, 2, 3])


def test_a_score_counts_what_a_generator_yields():
    overlap = Overlap(np.array([0]), np.array([7]), np.array([[0.9]]))
    assert score(overlap for _ in range(3)).objects == 3


def test_a_controller_keeps_no_buffer_of_its_caller(episode_path):
    control = pytest.importorskip("topokit.control")
    film = load_episode(episode_path)
    fresh = control.Planner(control.Carried())
    reused = control.Planner(control.Carried())
    buffers = {name: np.zeros(getattr(film, name)[0].shape) for name in ("points", "grippers")}
    for t in range(0, 60, 4):
        new = {name: getattr(film, name)[t].astype(np.float64) for name in buffers}
        for name, values in new.items():
            buffers[name][:] = values
        rest = {"target": film.centre_line, "held": True}
        if t == 0:
            fresh.reset(new | rest)
            reused.reset(buffers | rest)
        assert np.array_equal(fresh.act(new | rest), reused.act(buffers | rest))
