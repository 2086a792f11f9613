"""Rips persistence: known shapes, scales of coordinates, ties, parts of the engine, bounds of memory, Ctrl-C, threads.

`test_rips_properties` holds the same functions to GUDHI and to the textbook on random clouds.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from topokit import rips_persistence, rips_persistence_many
from topokit.rips import _cloud

from clouds import FAMILIES, compiled, config, fewer, gudhi_pairs, random_cloud, same, sorted_pairs
from conftest import polygon

if config is not None:
    from numba import njit

    from topokit.rips.engine import edges, lunes, tree

SQUARE = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])


def distances(cloud: np.ndarray) -> np.ndarray:
    """Summed axis by axis, as the engine does."""
    return np.sqrt(sum((cloud[:, None, k] - cloud[None, :, k]) ** 2 for k in range(cloud.shape[1])))


def torus(n: int) -> np.ndarray:
    a, b = 2 * np.pi * np.random.default_rng(0).random((2, n))
    return np.column_stack([(1 + 0.35 * np.cos(b)) * np.cos(a), (1 + 0.35 * np.cos(b)) * np.sin(a), 0.35 * np.sin(b)])


# Known shapes


def test_square_by_hand():
    diagram = rips_persistence(SQUARE)
    assert diagram.birth.tolist() == [1.0]
    assert diagram.death[0] == pytest.approx(np.sqrt(2))
    assert diagram.birth_edge.tolist() == [[2, 3]]  # the last side in the order (length, index, index)
    assert diagram.killer_edge.tolist() == [[0, 2]]  # the first diagonal
    assert sorted(map(sorted, diagram.killer_triangles[0].tolist())) == [[0, 1, 2], [0, 2, 3]]
    # The second diagonal is as long as the first, so its two triangles are in the complex at death.
    assert {tuple(sorted(t)) for t in diagram.neighbours(0).tolist()} == {(0, 1, 3), (1, 2, 3)}
    assert len(diagram.neighbours(0)) == 4


@pytest.mark.parametrize("n", [5, 6, 7, 12, 24, 300])
def test_regular_polygon(n):
    """A regular n-gon dies with its first chord that spans at least a third of the circle."""
    diagram = rips_persistence(polygon(n))
    assert len(diagram) == 1
    assert diagram.birth[0] == pytest.approx(np.sin(np.pi / n))
    assert diagram.death[0] == pytest.approx(np.sin(np.pi * np.ceil(n / 3) / n))


@pytest.mark.parametrize(
    "points",
    [np.empty((0, 3)), [[0.0, 0.0]], [[0, 0], [1, 0], [0, 1]], np.zeros((50, 3)), np.arange(9.0)[:, None]],
    ids=["no points", "one", "three", "all equal", "on a line"],
)
def test_no_loops_is_an_answer(points):
    diagram = rips_persistence(points)
    assert len(diagram) == 0
    assert diagram.killer_triangles.shape == (0, 2, 3)
    assert "0 loops" in repr(diagram)


@compiled
def test_ring_of_thousands_of_points():
    rng = np.random.default_rng(0)
    angle = 2 * np.pi * rng.random(5000)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(5000)]) * (1 + 0.05 * rng.random((5000, 1)))
    diagram = rips_persistence(ring)
    assert diagram.death[0] == pytest.approx(np.sqrt(3) / 2, rel=0.01)  # the inner rim has radius 1
    assert (diagram.lifetime[1:] < 0.05).all()


def test_clusters_far_apart_and_late_loops():
    """Loops born by edges far longer than all deaths before them: the stopping rule must not miss them."""
    far = np.vstack([polygon(6, 0.01) + 100 * corner for corner in polygon(5)])
    diagram = rips_persistence(far)
    assert diagram.death[0] == pytest.approx(100 * np.sin(2 * np.pi / 5), rel=1e-3)
    ours = sorted_pairs(np.column_stack([diagram.birth, diagram.death]))
    np.testing.assert_allclose(ours, gudhi_pairs(far), rtol=1e-9, atol=1e-9)


# Where the filtration is cut


def test_max_radius_leaves_loops_open_and_min_lifetime_leaves_them_out():
    circle = polygon(30)
    cut = rips_persistence(circle, max_radius=0.5)
    assert cut.death.tolist() == [np.inf]
    assert cut.killer_edge.tolist() == [[-1, -1]]
    assert cut.killer_triangles.tolist() == [[[-1] * 3] * 2]
    assert cut.neighbours(0).shape == (0, 3)
    assert len(rips_persistence(circle, max_radius=0.05)) == 0
    whole = rips_persistence(circle)
    assert len(rips_persistence(circle, min_lifetime=whole.lifetime[0])) == 1
    assert len(rips_persistence(circle, min_lifetime=np.nextafter(whole.lifetime[0], 9))) == 0


def test_ties_at_the_cut_are_inside():
    assert rips_persistence(SQUARE, max_radius=np.sqrt(2)).death[0] == np.sqrt(2)
    assert rips_persistence(SQUARE, max_radius=np.nextafter(np.sqrt(2), 0)).death[0] == np.inf
    assert len(rips_persistence(SQUARE, max_radius=1.0)) == 1
    assert len(rips_persistence(SQUARE, max_radius=np.nextafter(1.0, 0))) == 0
    assert rips_persistence(SQUARE, max_radius=1e200).death[0] == np.sqrt(2)  # its square overflows


# Scales


@pytest.mark.parametrize("metric", ["euclidean", "precomputed"])
@pytest.mark.parametrize("exponent", [-400, -50, 50, 400])
def test_a_cloud_at_any_scale_is_the_same_cloud(metric, exponent):
    data = np.random.default_rng(3).integers(0, 16, (24, 3)).astype(float)
    if metric == "precomputed":
        data = np.rint(4 * distances(data))
    one, other = rips_persistence(data, metric=metric), rips_persistence(np.ldexp(data, exponent), metric=metric)
    assert len(one) > 2
    for name in ("birth", "death"):
        np.testing.assert_array_equal(getattr(other, name), np.ldexp(getattr(one, name), exponent))
    same(one, other, ("birth_edge", "killer_edge", "killer_triangles"))
    for i in range(len(one)):
        assert other.neighbours(i).tolist() == one.neighbours(i).tolist()
        assert other.cycle(i).tolist() == one.cycle(i).tolist()
        assert other.tighten(other.cycle(i)).tolist() == one.tighten(one.cycle(i)).tolist()


@pytest.mark.parametrize("size", [1e-160, 1e160])
def test_a_unit_in_which_squares_are_no_numbers_is_refused(size):
    with pytest.raises(ValueError, match="another unit"):
        rips_persistence(SQUARE * size)


@pytest.mark.parametrize("metric", ["euclidean", "precomputed"])
def test_a_diagram_does_not_change_with_the_array_it_was_made_of(metric):
    cloud = np.random.default_rng(2).normal(size=(30, 3))
    buffer, walk = distances(cloud) if metric == "precomputed" else cloud, np.arange(30)
    kept = rips_persistence(buffer.copy(), metric=metric)
    diagram = rips_persistence(buffer, metric=metric)
    buffer[:] = 0
    for i in range(len(kept)):
        assert diagram.neighbours(i).tolist() == kept.neighbours(i).tolist()
        assert diagram.cycle(i).tolist() == kept.cycle(i).tolist()
    assert diagram.killers_of([walk]).tolist() == kept.killers_of([walk]).tolist()
    with pytest.raises(ValueError, match="read-only"):
        diagram.birth[0] = 0
    with pytest.raises(IndexError):
        diagram.neighbours(len(diagram))


# Parts of the engine


def called(function):
    """A function of the engine, most of which are compiled for each other alone, for calls from Python."""
    return njit(lambda *arguments: function(*arguments))


@compiled
def test_edges_of_one_length_are_sorted_in_less_than_quadratic_time():
    assert len(rips_persistence(1.0 - np.eye(1500), metric="precomputed")) == 0  # a million edges


@compiled
def test_lengths_are_the_same_in_numpy_and_compiled():
    points = np.random.default_rng(3).normal(size=(20, 3)) * np.logspace(-3, 3, 3)
    edge_length = called(edges.edge_length)
    for i in range(20):
        squares = _cloud.squares(points[i], points)
        assert squares.tolist() == [edge_length(points, i, j) for j in range(20)]
        assert squares.tolist() == [edge_length(points, j, i) for j in range(20)]


@compiled
@pytest.mark.parametrize("d", [2, 3])
def test_a_point_is_near_the_middle_only_if_it_is_near_all_of_the_lune(d):
    """Against points on the rim of the lune, where it is farthest from what is between its two balls."""
    rng, near = np.random.default_rng(d), 0
    edge_length, is_near_middle = called(edges.edge_length), called(lunes.is_near_middle)
    for _ in range(300):
        data = np.zeros((3, 3))
        data[:, :d] = rng.normal(size=(3, d))
        data[2] = data[:2].mean(axis=0)
        data[2, :d] += rng.normal(size=d) * 0.3
        length = edge_length(data, 0, 1)
        across = np.zeros((400, 3))
        across[:, :d] = rng.normal(size=(400, d))
        step = (data[1] - data[0]) / np.sqrt(length)
        across -= np.outer(across @ step, step)
        rim = data[:2].mean(axis=0) + np.sqrt(0.75 * length) * across / np.linalg.norm(across, axis=1, keepdims=True)
        farthest = max(((np.vstack([rim, data[:2]]) - data[2]) ** 2).sum(axis=1))
        is_near = is_near_middle(data, 0, 1, 2, length)
        assert is_near <= (farthest < length)
        near += is_near
    assert 20 < near < 200


@compiled
@pytest.mark.parametrize("shape", ["sheet", "torus"])
def test_places_decide_as_the_distances_do(shape):
    """Above 2,048 points cones are known from places; for a matrix of distances they cannot be."""
    cloud = torus(2300)
    if shape == "sheet":
        a, b = np.random.default_rng(11).random((2, 2300))
        cloud = np.column_stack([a, b, 0.05 * np.sin(5 * a)])[(a - 0.5) ** 2 + (b - 0.4) ** 2 > 0.04]
    same(rips_persistence(cloud), rips_persistence(distances(cloud), metric="precomputed"))


@compiled
def test_windows_of_edges_are_bounded_and_leave_none_out():
    cloud = _cloud.Cloud.of(np.random.default_rng(12).random((3100, 2)))
    built = called(tree.build_tree)(cloud.data)
    edges_between = called(edges.edges_between)
    window, shortest, count, before = called(edges.new_edges)(1 << 16), 0.0, 0, -1.0
    while shortest < 4:
        window, m, bound = edges_between(built.points, built, shortest, 5.0, window)
        lengths = window.lengths[:m]
        assert m <= len(window.found_keys) == edges.WINDOW
        assert before <= lengths[0]
        assert (np.diff(lengths) >= 0).all()
        assert shortest <= lengths[0] <= lengths[-1] < bound
        shortest, count, before = bound, count + m, lengths[-1]
    assert count == 3100 * 3099 // 2


# Memory, Ctrl-C


@compiled
def test_more_memory_than_is_allowed():
    with pytest.raises(MemoryError, match=r"200000 points take 5\.0 GB.*farthest_point_sample"):
        rips_persistence(np.random.default_rng(0).random((200_000, 3)))
    with pytest.raises(MemoryError, match="24000 points"):
        rips_persistence(np.zeros((24_000, 4)))


INTERRUPTED = """
import signal, sys, time
import numpy as np
from topokit import rips_persistence, rips_persistence_many

signal.signal(signal.SIGINT, signal.default_int_handler)
middle, large = map(np.load, sys.argv[2:])
diagram = rips_persistence(middle)  # the engine is loaded
while input() == "compute":
    try:
        print(flush=True)
        while True:
            exec(sys.argv[1])
    except KeyboardInterrupt:
        print(time.process_time(), flush=True)
raise KeyboardInterrupt
"""


@compiled
@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(
    "computation",
    [
        "rips_persistence(large)",
        "rips_persistence_many([large] * 2, 1)",
        "[diagram.cycle(i) for i in range(len(diagram))]",
    ],
)
def test_ctrl_c_ends_long_work(computation, tmp_path):
    """A fresh process goes on with KeyboardInterrupt within a second of the processor, and in the end does not crash."""
    clouds = [str(tmp_path / f"{n}.npy") for n in (3000, 12_000)]
    for path, n in zip(clouds, (3000, 12_000), strict=True):
        np.save(path, torus(n))
    command = [sys.executable, "-c", INTERRUPTED, computation, *clouds]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    for moment in np.random.default_rng().random(2):
        process.stdin.write("compute\n")
        process.stdin.flush()
        assert process.stdout.readline(), process.communicate()
        time.sleep(moment)
        process.send_signal(signal.SIGINT)
        times = psutil.Process(process.pid).cpu_times()
        heard = process.stdout.readline()
        assert heard, process.communicate()
        assert float(heard) - times.user - times.system < 1
    assert "KeyboardInterrupt" in process.communicate("end\n")[1]
    assert process.returncode == -signal.SIGINT


# Many clouds


def test_many_clouds_on_threads(capsys):
    rng = np.random.default_rng(0)
    clouds = [rng.random((int(n), 3)) for n in rng.integers(1, 120, size=40)]
    together = rips_persistence_many(clouds, n_jobs=4, progress=True)
    for one, other in zip(together, map(rips_persistence, clouds), strict=True):
        same(one, other)
    assert "40 of 40 clouds" in capsys.readouterr().err
    assert rips_persistence_many([]) == []


@pytest.mark.parametrize("family", FAMILIES)
def test_clouds_in_one_call_are_what_they_are_alone(family):
    """Bit for bit, with short loops, ties, repeated points, and clouds of all sizes."""
    rng = np.random.default_rng(FAMILIES.index(family))
    for radius in (np.inf, 0.5):
        clouds = [random_cloud(rng, family, max_points=60) for _ in range(fewer(40))]
        clouds = [cloud for cloud in clouds if cloud.shape[1] == clouds[0].shape[1]]
        together = rips_persistence_many(clouds, n_jobs=1, max_radius=radius, min_lifetime=0.01)
        for cloud, one in zip(clouds, together, strict=True):
            same(one, rips_persistence(cloud, max_radius=radius, min_lifetime=0.01))
            assert (one.n_points, one.max_radius) == (len(cloud), radius)
            if len(one):
                assert one.cycle(0).tolist() == rips_persistence(cloud, max_radius=radius).cycle(0).tolist()


# Bad input


@pytest.mark.parametrize(
    ("points", "error", "names"),
    [
        ([[0, 0], [1, np.nan], [1, 1], [0, 1]], ValueError, "row 1"),
        ([[0, 0], [np.inf, 1]], ValueError, "row 1"),
        ([1.0, 2.0, 3.0], ValueError, r"\(3,\)"),
        (np.zeros((3, 4, 2)), ValueError, "topokit.track"),
        ([["a", "b"]], TypeError, "points"),
        ([[1 + 1j, 0]], TypeError, "complex"),
        (np.empty((4, 0)), ValueError, "points"),
    ],
)
def test_bad_points(points, error, names):
    with pytest.raises(error, match=names):
        rips_persistence(points)


@pytest.mark.parametrize(
    ("matrix", "names"),
    [
        (np.zeros((3, 4)), r"\(3, 4\)"),
        ([[0, 1], [2, 0]], r"symmetric at \[0, 1\]"),
        ([[0, -1], [-1, 0]], r"\[0, 1\]"),
        ([[0, 1], [1, 3]], r"\[1, 1\]"),
    ],
)
def test_bad_distance_matrix(matrix, names):
    with pytest.raises(ValueError, match=names):
        rips_persistence(matrix, metric="precomputed")


@pytest.mark.parametrize(
    ("option", "error"),
    [
        ({"max_radius": -1}, ValueError),
        ({"min_lifetime": np.nan}, ValueError),
        ({"max_radius": "x"}, TypeError),
        ({"metric": "l1"}, ValueError),
    ],
)
def test_bad_options(option, error):
    with pytest.raises(error, match=next(iter(option))):
        rips_persistence(SQUARE, **option)


def test_many_names_the_cloud_that_is_bad():
    good = np.zeros((5, 2))
    with pytest.raises(ValueError, match=r"clouds\[1\]"):
        rips_persistence_many([good, np.where(np.eye(5, 2) > 0, [np.nan, 0], 0)])
    for n_jobs in (0, -1, 1.5, True, "2", float("nan"), float("inf")):
        with pytest.raises((TypeError, ValueError), match="n_jobs"):
            rips_persistence_many([good], n_jobs=n_jobs)
