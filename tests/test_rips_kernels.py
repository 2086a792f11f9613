"""The kernel and its parts: every scale of coordinates, ties, bounds of work and memory, threads, where a filtration is cut."""

from __future__ import annotations

import resource
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from topokit import rips_persistence, rips_persistence_many
from topokit.rips import Film, _cloud, _pairs, kernel, tighten

from clouds import FAMILIES, compiled, fewer, gudhi_pairs, random_cloud, sorted_pairs
from conftest import polygon


def same(one, other) -> None:
    for name in ("birth", "death", "birth_edge", "killer_edge", "killer_triangles"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def plain(function):
    """A compiled function as Python."""
    return getattr(function, "py_func", function)


class Counting(np.ndarray):
    """An array that counts what is written into it."""

    writes = 0

    def __setitem__(self, place, value):
        Counting.writes += np.size(value)
        super().__setitem__(place, value)


@pytest.mark.parametrize("spread", [0.0, 1e-14], ids=["equal", "nearly equal"])
def test_sorting_edges_of_nearly_equal_length_takes_few_moves(spread, monkeypatch):
    """All pairs of 32 points, of lengths around 1; the last labels come first."""
    n = 32
    x, y = np.triu_indices(n, 1)
    lengths = 1 + spread * np.linspace(1, -1, len(x))
    m, label = len(x), np.arange(n)[::-1].copy()
    buffer = plain(kernel.new_buffer)(m)._replace(keys=np.empty(m, np.int64).view(Counting))
    buffer.found_keys[:], buffer.found_lengths[:] = y << 21 | x, lengths
    monkeypatch.setattr(kernel, "_heap_sort", plain(kernel._heap_sort), raising=False)
    monkeypatch.setattr(Counting, "writes", 0)
    plain(kernel.sort_edges)(buffer, m, label)
    assert Counting.writes <= m * (4 + np.log2(m))
    ends = sorted((length, *sorted((label[i], label[j]))) for length, i, j in zip(lengths, x, y, strict=True))
    found = [(sorted((label[key & 31], label[key >> 21]))) for key in buffer.keys.tolist()]
    assert found == [[a, b] for _, a, b in ends]


@compiled  # NumPy would warn of the quotients that overflow on purpose
@pytest.mark.parametrize("size", [5e-324, 1e-310, 1.7e308])
def test_distances_at_the_ends_of_floating_point(size):
    equal = np.full((8, 8), size)
    np.fill_diagonal(equal, 0)
    assert len(rips_persistence(equal, metric="precomputed")) == 0
    square = np.array([[0, 1, 2, 1], [1, 0, 1, 2], [2, 1, 0, 1], [1, 2, 1, 0]]) * (size if size < 1 else size / 2)
    assert rips_persistence(square, metric="precomputed").killer_edge.tolist() == [[0, 2]]


@pytest.mark.parametrize("size", [1e-320, 1e-310, 1e308])
def test_coordinates_at_the_ends_of_floating_point(size):
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size
    assert rips_persistence(square).killer_edge.tolist() == [[0, 2]]
    assert rips_persistence(square - size).killer_edge.tolist() == [[0, 2]]


@pytest.mark.parametrize("metric", ["euclidean", "precomputed"])
@pytest.mark.parametrize("exponent", [-1070, -1022, -1000, -540, 510, 1000, 1019])
def test_a_cloud_at_any_scale_is_the_same_cloud(metric, exponent):
    """Also where births and deaths lose their digits, as tiny numbers do."""
    data = np.random.default_rng(3).integers(0, 16, (24, 3)).astype(float)
    if metric == "precomputed":
        data = np.rint(4 * np.sqrt(_cloud.squares(data[:, None], data[None]))) / (1 if exponent < 0 else 16)
    one, other = rips_persistence(data, metric=metric), rips_persistence(np.ldexp(data, exponent), metric=metric)
    assert len(one) > 2
    for name in ("birth", "death"):
        np.testing.assert_array_equal(getattr(other, name), np.ldexp(getattr(one, name), exponent))
    for name in ("birth_edge", "killer_edge", "killer_triangles"):
        np.testing.assert_array_equal(getattr(other, name), getattr(one, name))
    for i in range(len(one)):
        assert other.neighbours(i).tolist() == one.neighbours(i).tolist()
        assert other.cycle(i).tolist() == one.cycle(i).tolist()
        assert tighten(other, other.cycle(i)).tolist() == tighten(one, one.cycle(i)).tolist()


def test_half_a_length_that_is_a_number_is_an_answer():
    wide = rips_persistence([[-1e308, 0], [1e308, 0], [0, 1e308], [0, -1e308]])
    assert wide.death.tolist() == [1e308]
    assert wide.killer_edge.tolist() == [[0, 1]]
    assert len(wide.neighbours(0)) == 4
    with pytest.raises(ValueError, match=r"points reach 1\.7e\+308, and half their distances overflow"):
        rips_persistence([[-1.7e308] * 3, [1.7e308] * 3, [0] * 3, [1] * 3])


def test_what_differs_too_much_for_one_unit_is_refused():
    with pytest.raises(ValueError, match=r"points\[1\] and points\[3\] are nearer to each other"):
        rips_persistence([[0, 1], [1e-200, 0], [1, 1], [0, 0]])
    assert len(rips_persistence([[0, 1], [1, 1e-200], [1, 1], [0, 1e-170]])) == 1
    matrix = (1.0 - np.eye(5)) * 1e300
    matrix[1, 2] = matrix[2, 1] = 1e-100
    with pytest.raises(ValueError, match=r"holds 1e-100 and 1e\+300"):
        rips_persistence(matrix, metric="precomputed")


def test_max_radius_whose_square_overflows():
    assert rips_persistence([[0, 0], [2, 0], [2, 2], [0, 2]], max_radius=1e200).death[0] == np.sqrt(2)


@pytest.mark.parametrize("metric", ["euclidean", "precomputed"])
def test_a_diagram_does_not_change_with_the_array_it_was_made_of(metric):
    cloud = np.random.default_rng(2).normal(size=(30, 3))
    buffer = np.linalg.norm(cloud[:, None] - cloud[None], axis=2) if metric == "precomputed" else cloud
    kept, walk = rips_persistence(buffer.copy(), metric=metric), np.arange(30)
    diagram = rips_persistence(buffer, metric=metric)
    buffer[:] = 0
    for i in range(len(kept)):
        assert diagram.neighbours(i).tolist() == kept.neighbours(i).tolist()
        assert diagram.cycle(i).tolist() == kept.cycle(i).tolist()
    assert diagram.killers_of([walk]).tolist() == kept.killers_of([walk]).tolist()


@pytest.mark.parametrize("d", [1, 2, 3, 4, 7])
def test_lengths_are_the_same_in_numpy_and_compiled(d):
    points = np.random.default_rng(d).normal(size=(20, d)) * np.logspace(-3, 3, d)
    for i in range(20):
        keys = _cloud.squares(points[i], points)
        assert keys.tolist() == [kernel.edge_length(points, i, j, (0,) * d) for j in range(20)]
        assert keys.tolist() == [kernel.edge_length(points, j, i, (0,) * d) for j in range(20)]
    matrix = np.abs(points @ points.T)
    assert kernel.edge_length(matrix, 3, 5, ()) == matrix[3, 5]


@pytest.mark.parametrize("d", [2, 3])
def test_a_point_is_near_the_middle_only_if_it_is_near_all_of_the_lune(d):
    """Against points on the rim of the lune, where it is farthest from what is between its two balls."""
    rng, axes, near = np.random.default_rng(d), (0,) * d, 0
    for _ in range(300):
        data = rng.normal(size=(3, d))
        data[2] = data[:2].mean(axis=0) + rng.normal(size=d) * 0.3
        length = kernel.edge_length(data, 0, 1, axes)
        across = rng.normal(size=(400, d))
        step = (data[1] - data[0]) / np.sqrt(length)
        across -= np.outer(across @ step, step)
        rim = data[:2].mean(axis=0) + np.sqrt(0.75 * length) * across / np.linalg.norm(across, axis=1, keepdims=True)
        farthest = max(((np.vstack([rim, data[:2]]) - data[2]) ** 2).sum(axis=1))
        assert kernel.is_near_middle(data, axes, 0, 1, 2, length) <= (farthest < length)
        near += kernel.is_near_middle(data, axes, 0, 1, 2, length)
    assert 20 < near < 200


@compiled
@pytest.mark.parametrize("shape", ["sheet", "torus"])
def test_places_decide_as_the_distances_do(shape):
    """Above 2,048 points cones are known from places; for a matrix of distances they cannot be."""
    rng = np.random.default_rng(11)
    a, b = rng.random((2, 2300))
    cloud = np.column_stack([a, b, 0.05 * np.sin(5 * a)])[(a - 0.5) ** 2 + (b - 0.4) ** 2 > 0.04]
    if shape == "torus":
        a, b = 2 * np.pi * a, 2 * np.pi * b
        cloud = np.column_stack([(1 + 0.3 * np.cos(b)) * np.cos(a), (1 + 0.3 * np.cos(b)) * np.sin(a), 0.3 * np.sin(b)])
    matrix = np.sqrt(_cloud.squares(cloud[:, None], cloud[None]))
    assert len(cloud) > 64 * kernel.FEW_WORDS or shape == "sheet"
    same(rips_persistence(cloud), rips_persistence(matrix, metric="precomputed"))


@compiled
def test_windows_of_edges_are_bounded_and_leave_none_out():
    cloud = _cloud.Cloud.of(np.random.default_rng(12).random((3100, 2)))
    tree = kernel.build_tree(cloud.data, cloud.axes)
    buffer, shortest, count, before, halt = kernel.new_buffer(1 << 16), 0.0, 0, -1.0, np.zeros(1, np.int64)
    while shortest < 4:
        buffer, m, bound = kernel.edges_between(tree.points, cloud.axes, tree, shortest, 5.0, buffer, 1 << 40, halt)
        lengths = buffer.lengths[:m]
        assert m <= len(buffer.found_keys) == kernel.WINDOW
        assert before <= lengths[0]
        assert (np.diff(lengths) >= 0).all()
        assert shortest <= lengths[0] <= lengths[-1] < bound
        shortest, count, before = bound, count + m, lengths[-1]
    assert count == 3100 * 3099 // 2


@compiled
def test_more_points_than_memory_is_allowed_for():
    with pytest.raises(
        MemoryError,
        match=r"4\.3 GB for one cloud, and these 200000 points need 5\.5 GB.*farthest_point_sample",
    ):
        rips_persistence(np.random.default_rng(0).random((200_000, 3)))


@compiled
def test_more_edges_or_loops_than_memory_is_allowed_for(monkeypatch):
    all_alike = 1.0 - np.eye(2000)
    many_loops = np.random.default_rng(0).random((4500, 3))
    cases = (
        (all_alike, "precomputed", 1 << 26, "edges of the same length"),
        (many_loops, "euclidean", 2_000_000, "loops"),
    )
    for cloud, metric, spare, what in cases:
        monkeypatch.setattr(_cloud, "MEMORY", len(cloud) * ((len(cloud) + 63) // 64) * 8 + spare)
        with pytest.raises(MemoryError, match=f"these {len(cloud)} points need more.*{what}.*farthest_point_sample"):
            rips_persistence(cloud, metric=metric)


@compiled
def test_a_refusal_gives_memory_back(monkeypatch):
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("only Linux tells what a process holds")
    cloud, held = np.random.default_rng(0).random((8192, 3)), []
    monkeypatch.setattr(_cloud, "MEMORY", 8192 * 1024 + 2_000_000)
    for _ in range(12):
        with pytest.raises(MemoryError, match="loops"):
            rips_persistence(cloud)
        held.append(int(statm.read_text().split()[1]) * resource.getpagesize())
    assert held[-1] - held[2] < 4 * 8192 * 1024  # nine refusals


def torus(n: int) -> np.ndarray:
    a, b = 2 * np.pi * np.random.default_rng(0).random((2, n))
    return np.column_stack([(1 + 0.35 * np.cos(b)) * np.cos(a), (1 + 0.35 * np.cos(b)) * np.sin(a), 0.35 * np.sin(b)])


@compiled
@pytest.mark.parametrize(
    "call",
    [lambda cloud: rips_persistence(cloud), lambda cloud: rips_persistence_many([cloud] * 2, 1)],
    ids=["one", "many"],
)
@pytest.mark.usefixtures("ctrl_c")
def test_a_long_computation_hears_an_interrupt(call):
    cloud = torus(12_000)
    call(cloud[:2500])  # compiled by now, for clouds that are large too
    start, main = time.process_time(), threading.main_thread().ident
    threading.Timer(0.2, signal.pthread_kill, (main, signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        call(cloud)
    assert time.process_time() - start < 3  # of ten seconds of the processor, or twenty


@compiled
def test_a_camera_that_sends_zeros_for_what_it_did_not_see():
    """A point that is there 20,000 times: with all its copies' edges it would take 15 GB."""
    ring = polygon(40)
    cloud = np.insert(ring, 20, np.zeros((20_000, 2)), axis=0)
    once = rips_persistence(np.insert(ring, 20, 0.0, axis=0))
    ids = np.r_[:21, 20_020:20_040]
    found = rips_persistence(cloud)
    np.testing.assert_array_equal(found.death, once.death)
    np.testing.assert_array_equal(found.birth_edge, ids[once.birth_edge])
    np.testing.assert_array_equal(found.killer_triangles, ids[once.killer_triangles])


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
    np.testing.assert_allclose(
        sorted_pairs(np.column_stack([diagram.birth, diagram.death])), gudhi_pairs(far), rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("scale", [1e-200, 1e-30, 1e30, 1e150])
def test_units_do_not_matter(scale):
    cloud = np.random.default_rng(1).random((60, 3))
    one, other = rips_persistence(cloud), rips_persistence(cloud * scale)
    np.testing.assert_allclose(other.death, one.death * scale, rtol=1e-9)
    np.testing.assert_array_equal(other.killer_edge, one.killer_edge)


def test_a_cut_filtration_is_the_same_up_to_the_cut():
    cloud = np.random.default_rng(4).random((80, 2))
    whole = rips_persistence(cloud)
    for radius in (0.05, 0.1, whole.death[0], float(np.median(whole.death))):
        cut = rips_persistence(cloud, max_radius=radius)
        inside = whole.birth <= radius
        expected = np.where(whole.death <= radius, whole.death, np.inf)[inside]
        order = np.lexsort((cut.death, cut.birth))
        reference = np.lexsort((expected, whole.birth[inside]))
        np.testing.assert_array_equal(cut.birth[order], whole.birth[inside][reference])
        np.testing.assert_array_equal(cut.death[order], expected[reference])


def test_ties_at_the_cut_are_inside():
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2]])
    assert rips_persistence(square, max_radius=np.sqrt(2)).death[0] == np.sqrt(2)
    assert rips_persistence(square, max_radius=np.nextafter(np.sqrt(2), 0)).death[0] == np.inf
    assert len(rips_persistence(square, max_radius=1.0)) == 1
    assert len(rips_persistence(square, max_radius=np.nextafter(1.0, 0))) == 0


def test_many_clouds_on_threads():
    rng = np.random.default_rng(0)
    clouds = [rng.random((int(n), 3)) for n in rng.integers(1, 120, size=40)]
    for one, other in zip(rips_persistence_many(clouds, n_jobs=4), map(rips_persistence, clouds), strict=True):
        same(one, other)
    assert rips_persistence_many([]) == []


def a_film(rng, family: str, frames: int) -> list[np.ndarray]:
    """Frames of a cloud of a family that trembles, drifts, grows, jumps, is renumbered, and loses points."""
    first = rng.permutation(random_cloud(rng, family, max_points=60))
    clouds = []
    for _ in range(frames):
        frame = clouds[-1] if clouds else first
        kind = rng.choice(["still", "tremble", "tremble", "drift", "grow", "jump", "renumber", "fewer", "again"])
        if kind == "tremble":
            frame = frame + rng.choice([1e-6, 1e-3, 1e-1]) * rng.normal(size=frame.shape)
        elif kind in ("drift", "grow"):
            frame = frame + rng.normal(size=frame.shape[1]) if kind == "drift" else frame * rng.uniform(0.4, 2.5)
        elif kind == "jump":
            frame = np.where(rng.random((len(frame), 1)) < 0.1, rng.normal(size=frame.shape), frame)
        elif kind == "renumber":
            frame = rng.permutation(frame)
        elif kind in ("fewer", "again"):
            frame = first[: rng.integers(1, len(first) + 1)] if kind == "fewer" else first
        clouds.append(frame)
    return clouds


@pytest.mark.parametrize("family", FAMILIES)
def test_clouds_in_one_call_are_what_they_are_alone(family):
    """Bit for bit, with short loops, ties, repeated points, and films whose frames tell little about the next."""
    rng = np.random.default_rng(FAMILIES.index(family))
    for radius in (np.inf, np.inf, 0.5):
        clouds, film = a_film(rng, family, fewer(40)), Film()
        together = rips_persistence_many(clouds, n_jobs=1, max_radius=radius, min_lifetime=0.01)
        for cloud, one in zip(clouds, together, strict=True):
            alone, after = rips_persistence(cloud, max_radius=radius, min_lifetime=0.01), film.next_diagram(cloud)
            same(one, alone)
            same(after, rips_persistence(cloud))
            for mine, other in zip(one._simplices, alone._simplices, strict=True):
                np.testing.assert_array_equal(mine, other)
            assert (one.n_points, one.max_radius) == (len(cloud), radius)


@pytest.mark.parametrize("step", [1e-4, 0.02, 0.2])
def test_a_list_of_edges_is_complete_below_its_bound(step):
    """However the points move, no edge shorter than the bound is missing; and when they move little, it is a useful one."""
    rng, axes = np.random.default_rng(3), (0, 0, 0)
    before = rng.random((200, 3))
    after = before + step * np.sin(5 * before) + 0.1 * step * rng.normal(size=before.shape)
    tree, reach = kernel.build_tree(before, axes), 0.3**2
    moved, bound = kernel.move_tree(tree, after, reach)
    np.testing.assert_array_equal(moved.points, after[tree.label])
    was, now = (_cloud.squares(t.points[:, None], t.points[None]) for t in (tree, moved))
    assert not ((was >= reach) & (now < bound)).any()
    assert bound <= reach
    assert bound > 0.9 * reach or step > 1e-4


def test_a_film_is_read_from_the_list_of_an_earlier_frame():
    """Known of the frame before: the same list for frames that tremble, none when the cloud is another."""
    rng, film, known = np.random.default_rng(5), Film(), []
    cloud = rng.random((60, 3))
    for frame in [*(cloud + 1e-4 * rng.normal(size=cloud.shape) for _ in range(5)), rng.random((60, 3))]:
        same(film.next_diagram(frame), rips_persistence(frame))
        known.append(film._before.keys)
    keys = known
    assert [len(k) > 0 for k in keys] == [False, True, True, True, True, False]
    assert all(np.array_equal(k, keys[1]) for k in keys[2:5])


@compiled
def test_a_list_that_another_thread_made_may_be_too_long_for_this_one():
    film, answers = Film(), []
    frames = [polygon(600) + 1e-5 * np.random.default_rng(i).normal(size=(600, 2)) for i in range(3)]
    for frame in frames[:2]:
        film.next_diagram(frame)
    assert len(film._before.keys) > 1 << 16  # edges for which a thread has buffer at first
    thread = threading.Thread(target=lambda: answers.append(film.next_diagram(frames[2])))
    thread.start()
    thread.join()
    same(answers[0], rips_persistence(frames[2]))


def test_many_says_which_cloud_is_bad(capsys):
    good = np.zeros((5, 2))
    with pytest.raises(ValueError, match=r"clouds\[1\] has 1 of 5 points with a NaN"):
        rips_persistence_many([good, np.where(np.eye(5, 2) > 0, [np.nan, 0], 0)])
    for n_jobs in (0, -1, 1.5, True, "2", float("nan"), float("inf")):
        with pytest.raises((TypeError, ValueError), match="n_jobs must be"):
            rips_persistence_many([good], n_jobs=n_jobs)
    rips_persistence_many([good, good], progress=True)
    assert "2 of 2 clouds" in capsys.readouterr().err


@pytest.mark.parametrize(("seconds", "said"), [(0.3, "compiling the persistence kernel for matrices"), (0.0, "")])
def test_long_compilation_is_announced(monkeypatch, capsys, seconds, said):
    monkeypatch.setattr(_pairs, "_PATIENCE", 0.1)
    monkeypatch.setattr(_pairs, "_ready", set())
    monkeypatch.setattr(_pairs, "_run", lambda *_: time.sleep(seconds))
    _pairs._compile(points=False)
    time.sleep(0.2)
    message = capsys.readouterr().err
    assert said in message
    assert message.count("\n") == bool(said)
    monkeypatch.setattr(_pairs, "_run", None)
    _pairs._compile(points=False)  # once is enough
