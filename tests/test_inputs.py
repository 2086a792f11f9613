"""Public names keep nothing of a caller's buffer, and name the argument that is wrong in the mistakes that users make."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import topokit as tk
from topokit.evaluate import Overlap, distance_to_hull, score
from topokit.io import load_episode, load_states, save_episode, save_states
from topokit.lemmas import beta_all, beta_critical, verify_step

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


def test_a_score_counts_what_a_generator_yields():
    overlap = Overlap(np.array([0]), np.array([7]), np.array([[0.9]]))
    assert score(overlap for _ in range(3)).objects == 3


def test_a_controller_keeps_no_buffer_of_its_caller(episode_path):
    control = pytest.importorskip("topokit.control")
    film = load_episode(episode_path)
    fresh = control.Planner()
    reused = control.Planner()
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


# -- numbers of other kinds -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong", [np.timedelta64(5, "ns"), np.datetime64("2024-01-01"), True, np.bool_(True), "1", [1.0]]
)
@pytest.mark.parametrize(
    "call",
    [
        lambda number: tk.SeqPH(alpha=number),
        lambda number: tk.SeqPH(epsilon=number),
        lambda number: tk.SeqPH(memory=number),
        lambda number: tk.SeqPH().update(RING, time=number),
        lambda number: tk.SeqPH().update(None, time=number),
        lambda number: tk.track([RING] * 2, times=[0.0, number]),
        lambda number: tk.rips_persistence(RING, max_radius=number),
        lambda number: tk.rips_persistence(RING, min_lifetime=number),
        lambda number: tk.farthest_point_sample(RING, number),
        lambda number: tk.loop_mixture(tk.track([RING])[0].loops[0], noise=number),
        lambda number: beta_all(RING, number),
        lambda number: beta_critical(RING, 0.1, number),
    ],
)
def test_what_is_no_plain_number_is_none(call, wrong):
    with pytest.raises(TypeError):
        call(wrong)


def test_an_array_or_a_tensor_of_one_number_is_that_number():
    torch = pytest.importorskip("torch")
    for one in (np.array(1.0), np.float32(1), np.int64(1), torch.tensor(1.0)):
        assert tk.SeqPH(alpha=one).alpha == 1.0
        assert tk.SeqPH().update(RING, time=one).time == 1.0


def test_columns_of_pandas_that_may_be_missing_are_numbers():
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame(RING).convert_dtypes()
    np.testing.assert_array_equal(tk.rips_persistence(table.to_numpy(object)).death, tk.rips_persistence(RING).death)
    table.iloc[3, 1] = pandas.NA
    with pytest.raises(TypeError, match="object"):
        tk.rips_persistence(table.to_numpy(object))


@pytest.mark.parametrize("part", ["vertices", "points"])
def test_the_points_of_a_mesh_are_asked_for(part):
    mesh = type("Mesh", (), {part: RING})()
    with pytest.raises(TypeError, match=part):
        tk.rips_persistence(mesh)


@pytest.mark.parametrize("size", [1e200, 1e-200])
@pytest.mark.parametrize(
    "call",
    [
        tk.rips_persistence,
        tk.SeqPH().update,
        lambda cloud: verify_step(cloud, range(40), cloud, range(40)),
        lambda cloud: beta_all(cloud, 0.1),
    ],
)
def test_coordinates_whose_squares_are_no_numbers_are_refused(call, size):
    with pytest.raises(ValueError, match="unit"):
        call(size * RING)


def by_scalar_products(points):
    squares = (points**2).sum(axis=1)
    return np.sqrt(np.maximum(squares[:, None] + squares - 2 * points @ points.T, 0))


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("off", [0, 3])
def test_distances_that_are_symmetric_up_to_rounding_are_made_so(kind, off):
    points = (off + np.random.default_rng(0).normal(size=(80, 3))).astype(kind)
    matrix = by_scalar_products(points)
    matrix[3, 7] *= 1 + 4 * np.finfo(kind).eps  # whatever the products of this machine
    symmetric = (matrix.astype(float) + matrix.T) / 2
    np.fill_diagonal(symmetric, 0)
    expected = tk.rips_persistence(symmetric, metric="precomputed")
    found = tk.rips_persistence(matrix, metric="precomputed")
    np.testing.assert_allclose(np.sort(found.death)[-3:], np.sort(expected.death)[-3:], rtol=1e-6)


def test_correlations_are_distances_from_one():
    series = np.random.default_rng(0).normal(size=(40, 100))
    assert len(tk.rips_persistence(1 - np.corrcoef(np.vstack([series, series])), metric="precomputed"))


@pytest.mark.parametrize(
    ("i", "j", "value", "named"),
    [
        (0, 0, np.inf, r"\[0, 0\]: inf"),
        (0, 1, 2.0, "symmetric"),
        (2, 2, 0.1, "diagonal"),
        (1, 2, -0.1, "-0.1"),
        (0, 2, np.nan, "nan"),
    ],
)
def test_a_matrix_that_is_none_of_distances_is_refused_by_its_entry(i, j, value, named):
    matrix = np.ones((4, 4)) - np.eye(4)
    matrix[i, j] = value
    with pytest.raises(ValueError, match=named):
        tk.rips_persistence(matrix, metric="precomputed")


# -- frames in which nothing was seen, and gaps in time ----------------------------------------------------------------------


@pytest.mark.parametrize("nothing", [None, [], np.empty((0, 3)), np.empty((0, 2))])
def test_in_an_empty_frame_nothing_was_seen(nothing):
    film = [RING, nothing, RING]
    tracker = tk.SeqPH()
    one_by_one = [tracker.update(cloud) for cloud in film]
    tracker = tk.SeqPH()
    skipped = [tracker.update(RING), tracker.update(None), tracker.update(RING)]
    for states in (tk.track(film), one_by_one, list(tk.SeqPH().stream(film))):
        assert [[loop.id for loop in state] for state in states] == [[0], [], [0]]
        assert [state.time for state in states] == [state.time for state in skipped]


@pytest.mark.parametrize(
    ("gap", "memory", "kept"),
    [(1, 0, True), (2, 0, False), (2, 1, True), (498, 1, False), (40, 40, True), (498, 40, False)],
)
def test_a_gap_in_time_counts_as_the_frames_that_it_would_hold(gap, memory, kept):
    times = np.append(np.arange(5), 4 + gap) / 30
    states = tk.track([RING] * 6, times=times, memory=memory)
    assert [state.loops[0].id for state in states] == [0] * 5 + [0 if kept else 1]


@pytest.mark.parametrize("jitter", [0.0, 0.03])
def test_loops_are_found_however_many_there_are(jitter):
    """A scene that grows at equal density loses none of its loops; those between four rings are loops too."""
    rng = np.random.default_rng(0)
    ring = np.column_stack([np.cos(TURN), np.sin(TURN)])[:-1]
    for side in (1, 4, 8, 10, 14):
        corners = 3 * np.stack(np.meshgrid(range(side), range(side)), axis=-1).reshape(-1, 1, 2)
        cloud = (ring + corners).reshape(-1, 2)
        loops = tk.track([cloud + jitter * rng.normal(size=cloud.shape)])[0].loops
        centres = np.array([loop.centre for loop in loops])
        distances = np.linalg.norm(centres - corners, axis=-1).min(axis=1)
        assert (distances < 0.5).all(), side


# -- paths ------------------------------------------------------------------------------------------------------------------


def test_a_tilde_is_the_home_folder(tmp_path, monkeypatch, episode_path):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    states = tk.track([RING])
    save_states("~/a/tracks.npz", states)
    save_episode("~/b/film.npz", load_episode(episode_path))
    assert len(load_states("~/a/tracks.npz", [RING])) == 1
    assert len(load_episode("~/b/film.npz").points)
    assert not (tmp_path / "~").exists()


def test_a_garment_is_no_name():
    pytest.importorskip("gymnasium")
    from topokit import control, sim

    for call in (
        lambda: control.hang(garment="apron"),
        lambda: sim.simulate("apron"),
        lambda: sim.Task.of("apron", sim.Hook()),
    ):
        with pytest.raises((TypeError, ValueError), match="apron"):
            call()
    with pytest.raises(TypeError, match="hook"):
        sim.Task.of(sim.WARDROBE["apron"](), "hook")


# -- hulls, with any version of SciPy ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_the_distance_to_a_hull_against_its_facets(d, flat):
    """Inside is what all facets of Qhull have on their inner side; in the plane, the nearest side is as far."""
    rng = np.random.default_rng(d)
    for _ in range(250):
        points = rng.normal(size=(rng.integers(d + 1, 60), d))
        places = np.vstack([rng.dirichlet(np.full(len(points), 0.3)) @ points, 2 * rng.normal(size=d)])
        hull = ConvexHull(points)
        inside = (hull.equations[:, :-1] @ places.T + hull.equations[:, -1:] <= 0).all(axis=0)
        expected = [nearest_side(place, points[hull.simplices]) for place in places]
        if flat:  # in a plane of a space of one dimension more, turned and moved
            turn = np.linalg.qr(rng.normal(size=(d + 1, d + 1)))[0]
            points, places = (np.pad(rows, ((0, 0), (0, 1))) @ turn + 5 for rows in (points, places))
        found = np.array([distance_to_hull(place, points) for place in places])
        np.testing.assert_array_equal(found < 1e-9, inside)
        if d == 2:
            np.testing.assert_allclose(found, np.where(inside, 0, expected), atol=1e-9)


def nearest_side(place, sides):
    """Return how far a place is from the nearest of some segments (m, 2, d)."""
    along = sides[:, 1] - sides[:, 0]
    share = np.clip(((place - sides[:, 0]) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
    return np.linalg.norm(sides[:, 0] + share[:, None] * along - place, axis=1).min()
