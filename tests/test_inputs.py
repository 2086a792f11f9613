"""Public names refuse input that they cannot use, keep nothing of a caller's buffer, and are as good after an error as before."""

from __future__ import annotations

import io

import numpy as np
import pytest

import topokit as tk
from topokit.evaluate import Overlap, distance_to_hull, score
from topokit.io import load_episode
from topokit.sampling import hausdorff, spoil
from topokit.seqph import assign

TURN = np.linspace(0, 2 * np.pi, 40, endpoint=False)
RING = np.column_stack([0.2 * np.cos(TURN), 0.2 * np.sin(TURN), np.ones(40)])
RNG = np.random.default_rng(0)


def test_followed_loops_do_not_change_with_the_buffer_of_the_cloud():
    buffer = RING.copy()
    (loop,) = tk.follow(tk.track([RING])[0].loops, buffer)
    buffer[:] = 7
    assert np.array_equal(loop.cycle_points, RING[loop.cycle])


def test_a_state_is_iterated_loop_by_loop():
    (state,) = tk.track([RING])
    assert list(state) == list(state.loops)
    assert [loop.id for loop in tk.follow(state, RING)] == [0]


def test_points_far_away_are_unlikely_and_no_point_is_refused():
    mixture = tk.loop_mixture(tk.track([RING])[0].loops[0])
    assert mixture.credibility([[1e200, 0, 0]]) == 1
    assert mixture.log_prob([1e200, 0, 0]) == -np.inf
    with pytest.raises(ValueError, match="row 1"):
        mixture.credibility([[0, 0, 1], [np.nan, 0, 0]])


@pytest.mark.parametrize(
    ("means", "covariances", "weights"),
    [
        ([0.0, 0.0], [np.eye(2)], [1.0]),
        ([[0.0, 0.0]], [np.eye(3)], [1.0]),
        ([[0.0, 0.0]], [np.eye(2)], [0.4]),
        ([[0.0, 0.0]], [np.eye(2)], [0.5, 0.5]),
    ],
)
def test_a_mixture_has_shapes_that_fit_and_weights_that_sum_to_one(means, covariances, weights):
    with pytest.raises(ValueError, match="mixture"):
        tk.LoopMixture(means, covariances, weights)


def test_a_mixture_of_lists_is_one_of_arrays():
    mixture = tk.LoopMixture([[1, 2]], [[[1, 0], [0, 1]]], [1])
    assert mixture.mean.tolist() == [1, 2]
    assert "LoopMixture" in repr(mixture)


@pytest.mark.parametrize(
    ("point", "points"),
    [([0, 0, 0], np.zeros((0, 3))), (2 * RING, RING), (0, RING), ([0, 0], RING), ([np.nan, 0, 0], RING)],
)
def test_a_distance_to_a_hull_is_of_one_point_to_some(point, points):
    with pytest.raises(ValueError, match="point"):
        distance_to_hull(point, points)


def test_a_score_counts_what_a_generator_yields():
    overlap = Overlap(np.array([0]), np.array([7]), np.array([[0.9]]))
    assert score(overlap for _ in range(3)).objects == 3
    with pytest.raises(ValueError, match="threshold"):
        score([overlap], 2)


@pytest.mark.parametrize("options", [{"keep": 2}, {"keep": np.nan}, {"outliers": -1}, {"noise": -1}, {"noise": np.nan}])
def test_shares_and_noise_of_spoilt_clouds_are_possible(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        spoil(RING, RNG, **options)


def test_a_seed_is_enough_to_spoil_a_cloud():
    assert np.array_equal(spoil(RING, 3, noise=0.01), spoil(RING, np.random.default_rng(3), noise=0.01))
    with pytest.raises(ValueError, match="clouds"):
        spoil(np.full((4, 3), np.nan), RNG)


def test_a_matrix_of_distances_that_is_read_as_points_is_suspected():
    distances = np.linalg.norm(RING[:, None] - RING, axis=-1)
    with pytest.warns(UserWarning, match="precomputed"):
        tk.rips_persistence(distances)


def test_messages_name_the_arguments():
    with pytest.raises(ValueError, match="a has 3 dimensions, b 2"):
        hausdorff(RING, RING[:, :2])
    diagram = tk.rips_persistence(RING)
    with pytest.raises(TypeError, match=r"walks\[0\]"):
        diagram.killers_of([0, 1, 2, 3])
    with pytest.raises(ValueError, match=r"walks\[1\] is empty"):
        diagram.killers_of([[0, 1, 2], []])
    with pytest.raises(ValueError, match="points is empty"):
        tk.farthest_point_sample(np.zeros((0, 3)), 1)
    (state,) = tk.track([RING])
    with pytest.raises(ValueError, match="cloud"):
        tk.follow(state.loops, RING[:, :2])


def test_costs_may_be_lists():
    assert assign([[1, 2], [3, 3]]) == [(0, 0), (1, 1)]


# -- clouds from files -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("columns", [(0, 0, 0), (0,)])
def test_places_have_different_numbers(tmp_path, columns):
    sensors = pytest.importorskip("topokit.sensors")
    np.save(tmp_path / "ring.npy", RING)
    with pytest.raises(ValueError, match="three different numbers"):
        list(sensors.read_clouds(tmp_path / "ring.npy", columns=columns))


def test_intrinsics_of_the_wrong_kind_are_blamed(tmp_path):
    sensors = pytest.importorskip("topokit.sensors")
    np.save(tmp_path / "depth.npy", np.ones((480, 640), np.float32))
    with pytest.raises(TypeError, match="intrinsics"):
        list(sensors.read_clouds(tmp_path / "depth.npy", intrinsics=np.eye(3)))


def test_a_film_in_a_stream_is_as_many_clouds_as_in_a_file(tmp_path):
    sensors = pytest.importorskip("topokit.sensors")
    film = RING + RNG.normal(0, 0.01, (4, 40, 3))
    np.save(tmp_path / "film.npy", film)
    stream = io.BufferedReader(io.BytesIO((tmp_path / "film.npy").read_bytes()))  # type: ignore[arg-type]
    from_stream = list(sensors.read_stream(stream))
    from_file = [cloud for _, cloud in sensors.read_clouds(tmp_path / "film.npy")]
    assert np.array_equal(from_stream, from_file)


def test_an_empty_frame_is_counted_in_every_step():
    sensors = pytest.importorskip("topokit.sensors")
    clean = sensors.Cleaner()
    clean(np.zeros((4, 3)))
    assert clean.removed["by farthest points"] == 0
    with pytest.raises(TypeError, match="Pipeline"):
        sensors.Cleaner({"points": 5})


def test_configurations_take_numbers_of_numpy_and_lists():
    sensors = pytest.importorskip("topokit.sensors")
    sim = pytest.importorskip("topokit.sim")
    assert sensors.Pipeline(points=np.int64(5), thickness=np.float32(0.5)).points == 5
    assert sim.Randomisation(mass=[0.1, 0.2]).mass == (0.1, 0.2)
    with pytest.raises(ValueError, match="'a'"):
        sim.Camera(eye=[0, 0, "a"])
    with pytest.raises(ValueError, match="distance"):
        sim.Camera.around(distance=-1)


# -- forecasts and controllers -----------------------------------------------------------------------------------------------

ACTIONS = np.tile([[-0.1, 0.0, 1.2], [0.1, 0.0, 1.2]], (60, 1, 1))


def test_a_cloud_in_other_units_is_refused_when_it_is_observed():
    models = pytest.importorskip("topokit.models")
    predictor = models.MotionPredictor(models.build("motion"))
    predictor.observe(RING, ACTIONS[0])
    before = predictor.predict(ACTIONS)
    with pytest.raises(ValueError, match="units"):
        predictor.observe(1000 * RING[::-1], ACTIONS[0])
    after = predictor.predict(ACTIONS)
    assert np.array_equal(before.death, after.death)


def test_a_forecast_of_many_plans_is_no_sequence():
    models = pytest.importorskip("topokit.models")
    predictor = models.Predictor(models.build("carry"))
    predictor.observe(RING, ACTIONS[0])
    forecast = predictor.predict(np.stack([ACTIONS, ACTIONS]))
    with pytest.raises(TypeError, match="plan"):
        list(forecast)
    with pytest.raises(TypeError, match="slice"):
        forecast.plan(0)[0:2]
    with pytest.raises(TypeError, match="MotionPredictor"):
        models.Predictor(models.build("motion"))


def test_units_of_layers_are_a_sequence():
    models = pytest.importorskip("topokit.models")
    with pytest.raises(ValueError, match="hidden"):
        models.build("mlp", options={"hidden": 64})


def test_a_controller_that_was_not_reset_says_so():
    control = pytest.importorskip("topokit.control")
    for servo in (control.Servo(), control.StrapController(), control.PullOverController()):
        with pytest.raises(RuntimeError, match="reset"):
            servo.act({})
    with pytest.raises(RuntimeError, match="reset"):
        _ = control.Servo().goals
    with pytest.raises(RuntimeError, match="observe"):
        control.Carried().move(ACTIONS[None], None, RING)


@pytest.mark.parametrize("name", ["points", "grippers", "target", "rods"])
def test_a_controller_names_the_entry_of_an_observation_that_is_wrong(name):
    control = pytest.importorskip("topokit.control")
    line = [[0, 0, 0], [0, 0, 1.4], [0, 0, 1.6]]  # no arm, so that the rods are read
    observation = {"points": RING, "grippers": ACTIONS[0], "target": line, "held": True, "rods": np.ones((3, 7))}
    for servo in (control.Servo(), control.StrapController()):
        servo.reset(observation)
        for wrong in (np.full((2, 3), np.nan), np.zeros((2, 2)), None):
            spoilt = {key: value for key, value in observation.items() if key != name}
            if wrong is not None:
                spoilt[name] = wrong
            with pytest.raises(ValueError, match=name):
                servo.act(spoilt)


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
