"""Pictures: what they show, that identities keep their colour, and that the player holds the episode it was given."""

import base64
import json
import subprocess
import sys

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

import topokit as tk
from topokit import view
from topokit.io import Episode
from topokit.view import _player, _plots, _render
from topokit.view._plots import long_lived, tube

from pages import NETWORK, page_data

FRAMES, RING, ROWS = 6, 24, 3


@pytest.fixture(scope="module")
def episode():
    """A short tube of cloth that drifts towards a rod: one true loop, three rings of vertices."""
    angle = np.linspace(0, 2 * np.pi, RING, endpoint=False)
    ring = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle)], axis=1)
    rest = np.concatenate([np.column_stack([ring * (1 + 0.1 * row), np.full(RING, 0.02 * row)]) for row in range(ROWS)])
    rest += np.random.default_rng(0).normal(0, 1e-3, rest.shape)
    points = np.stack([rest + [0.01 * frame, 0, 0.005 * frame] for frame in range(FRAMES)]).astype(np.float32)
    faces = []
    for row in range(ROWS - 1):
        for i in range(RING):
            a, b = row * RING + i, row * RING + (i + 1) % RING
            faces += [(a, b, a + RING), (b, b + RING, a + RING)]
    grippers = np.stack([points[:, 0], points[:, RING // 2]], axis=1)
    return Episode(
        points=points,
        observed=points[:, ::2],
        actions=grippers,
        grippers=grippers,
        held=np.arange(FRAMES) < 4,
        faces=np.array(faces, dtype=np.int32),
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


@pytest.fixture
def payload(episode, states):
    return page_data(view.player(episode, states))


def unpack(packed):
    """The array that the player's script sees."""
    array = np.frombuffer(base64.b64decode(packed["values"]), dtype="<" + packed["type"]).reshape(packed["shape"])
    return array * packed["scale"] + packed["low"] if "scale" in packed else array


@pytest.fixture
def no_pyvista(monkeypatch):
    monkeypatch.setattr(_render, "pyvista_works", lambda: (False, "no OpenGL; apt-get install libegl1 libgl1-mesa-dri"))
    _render._tell.cache_clear()


# ---- colours and names


def test_colour_depends_on_the_identity_alone():
    assert view.loop_colour(3) == view.loop_colour(9)
    assert len({view.loop_colour(number) for number in range(6)}) == 6


def test_the_weighty_identity_is_named_and_a_faint_one_is_not(states):
    neck = states[0].loops[0].id
    assert long_lived(states)[0] == neck
    assert view.appearances(states)[neck].tolist() == list(range(FRAMES))
    assert long_lived([]) == ()
    assert _player.telling_frame([]) == 0
    assert _player.telling_frame([tk.TopologicalState(0, 0.0)]) == 0


# ---- Matplotlib


def test_diagram_of_a_state_has_a_dot_a_loop_in_its_colour(states):
    axes = view.plot_diagram(states[0])
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    assert len(dots) == len(states[0].loops) >= 1
    for dot, loop in zip(dots, states[0].loops, strict=True):
        assert dot.get_xydata().tolist() == [[loop.birth, loop.death]]
        assert dot.get_color() == view.loop_colour(loop.id)
    assert [text.get_text() for text in axes.texts] == [f"loop {states[0].loops[0].id}"]
    dashed = next(line for line in axes.lines if line.get_linestyle() == "--")
    assert np.diff(dashed.get_xydata()[0]) == pytest.approx(states[0].parameters["alpha"])
    plt.close(axes.figure)


def test_diagram_without_identities_and_with_an_undying_loop(episode):
    axes = Figure().add_subplot()
    diagram = tk.rips_persistence(episode.points[0], max_radius=0.04)
    assert np.isinf(diagram.death).sum() == 1
    assert view.plot_diagram(diagram, axes) is axes
    assert sum(line.get_marker() == "^" for line in axes.lines) == 1
    assert np.isfinite(axes.get_ylim()).all()


def test_diagram_without_loops_is_an_empty_diagram():
    axes = view.plot_diagram(tk.TopologicalState(0, 0.0), Figure().add_subplot())
    assert len(axes.lines) == 1


def test_tracks_break_where_a_loop_is_away(states):
    gap = [*states[:2], tk.TopologicalState(2, states[2].time), *states[3:]]
    axes = view.plot_tracks(gap, Figure().add_subplot())
    neck = states[0].loops[0].id
    line = next(line for line in axes.lines if line.get_label() == f"loop {neck}")
    expected = [np.nan if t == 2 else states[t][neck].lifetime for t in range(FRAMES)]
    np.testing.assert_array_equal(line.get_ydata(), expected)
    np.testing.assert_allclose(line.get_xdata(), [state.time for state in states])


def test_tracks_of_nothing_draw():
    assert not view.plot_tracks([], Figure().add_subplot()).lines


def test_cloth_holds_faces_rod_and_killers(episode, states):
    loop = states[0].loops[0]
    axes = Figure().add_subplot(projection="3d")
    view.plot_cloth(
        episode.points[0],
        episode.faces,
        loops=[loop],
        true_loops=episode.loops,
        centre_line=episode.centre_line,
        ax=axes,
    )
    _, cloth, killers, edge = axes.collections  # first the shadow on the floor
    assert len(cloth.get_facecolor()) > len(episode.faces)  # the rod is sorted together with the cloth
    assert len(killers._faces) == 2
    assert mpl.colors.to_hex(edge.get_color()[0]).upper() == view.loop_colour(loop.id)
    axes.figure.canvas.draw()


@pytest.mark.parametrize(
    ("points", "faces", "message"),
    [
        (np.zeros((4, 2)), [], r"points must be a \(K, 3\) array"),
        (np.zeros((4, 3)), [[0, 1, 4]], "faces names vertex 4"),
        (np.zeros((4, 3)), [[0, 1, -1]], "faces names vertex -1"),
        (np.zeros((4, 3)), [[0, 1]], "faces must be"),
        (np.full((4, 3), np.nan), [], "points has 4 of 4 points with a NaN"),
    ],
)
def test_cloth_says_what_is_wrong(points, faces, message):
    with pytest.raises(ValueError, match=message):
        view.plot_cloth(points, faces, ax=Figure().add_subplot(projection="3d"))


def test_cloth_asks_for_axes_in_space(episode):
    with pytest.raises(ValueError, match="3D"):
        view.plot_cloth(episode.points[0], ax=Figure().add_subplot())


def test_track_figure_saves_and_refuses_other_lengths(episode, states, tmp_path):
    figure = view.track_figure(episode, states)
    assert len(figure.axes) == 6
    figure.savefig(tmp_path / "tracks.png")
    assert (tmp_path / "tracks.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="states has 5 frames where episode has 6"):
        view.track_figure(episode, states[:-1])


def test_tube_stays_at_its_radius():
    line = np.column_stack([np.linspace(0, 1, 9), np.zeros(9), np.zeros(9)])
    walls = tube(line, 0.1)
    assert walls.shape == (128, 3, 3)
    np.testing.assert_allclose(np.linalg.norm(walls[..., 1:], axis=-1), 0.1)


# ---- PyVista


def test_render_falls_back_and_says_so_once(episode, states, no_pyvista, capsys):
    options = {"loops": states[0].loops, "centre_line": episode.centre_line, "size": (200, 150)}
    image = view.render_cloth(episode.points[0], episode.faces, **options)
    view.render_cloth(episode.points[0], episode.faces, **options)
    said = capsys.readouterr().err.splitlines()
    assert said == ["topokit.view: a plainer picture by Matplotlib. no OpenGL; apt-get install libegl1 libgl1-mesa-dri"]
    pixels = np.asarray(image)
    assert pixels.shape == (150, 200, 3)
    assert pixels.std() > 5


def test_plot_cloth_draws_nothing_from_uninitialised_memory(episode, states, monkeypatch):
    def whatever_is_in_memory(shape, dtype=float, **options):
        return np.full(shape, 1.7e308 if np.issubdtype(dtype, np.floating) else 0, dtype, **options)

    options = {"loops": states[0].loops, "centre_line": episode.centre_line}
    with monkeypatch.context() as patch:
        patch.setattr(np, "empty", whatever_is_in_memory)
        axes = view.plot_cloth(episode.points[0], episode.faces, **options)
        axes.figure.canvas.draw()
    plt.close(axes.figure)


def test_plot_cloth_without_faces_draws_the_points_alone(episode):
    axes = view.plot_cloth(episode.points[0])
    axes.figure.canvas.draw()
    drawn = [len(part.get_offsets()) for part in axes.collections if len(part.get_offsets()) > 1]
    assert drawn == [len(episode.points[0])]
    assert _plots._shaded(np.zeros((0, 3)), _plots.CLOTH, (-60, 15)).shape == (0, 3)
    plt.close(axes.figure)


def test_probe_survives_a_segfault(monkeypatch):
    monkeypatch.setattr(_render, "_PROBE", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    works, reason = _render.pyvista_works.__wrapped__()
    assert not works
    assert "apt-get install libegl1" in reason


def test_probe_does_not_run_what_lies_in_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "pyvista.py").write_text("open('executed', 'w').close(); raise SystemExit(1)")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(_render, "find_spec", lambda name: name)
    _render.pyvista_works.__wrapped__()
    assert not (tmp_path / "executed").exists()


def test_render_with_pyvista_shows_the_loop(episode, states):
    works, reason = view.pyvista_works()
    if not works:
        pytest.skip(reason)
    loop = states[0].loops[0]
    options = {"centre_line": episode.centre_line, "true_loops": episode.loops, "size": (200, 150), "view": (-60, 60)}
    plain = np.asarray(view.render_cloth(episode.points[0], episode.faces, **options)).astype(int)
    marked = np.asarray(view.render_cloth(episode.points[0], episode.faces, loops=[loop], **options)).astype(int)
    assert plain.shape == marked.shape == (150, 200, 3)
    assert (abs(plain - marked).sum(axis=-1) > 30).mean() > 0.01


# ---- the player


def test_player_holds_the_coordinates_to_within_the_packing(episode, payload):
    packed = payload["arrays"]["points"]
    points = unpack(packed)
    assert points.shape == episode.points.shape
    assert abs(points - episode.points).max() <= packed["scale"] / 2 + 1e-9
    assert packed["scale"] / 2 < 1e-5  # a hundredth of a millimetre for a scene of half a metre
    np.testing.assert_array_equal(unpack(payload["arrays"]["faces"]), episode.faces)
    np.testing.assert_array_equal(unpack(payload["arrays"]["held"]), episode.held)
    assert payload["truth"] == [episode.loops[0].tolist()]


def test_player_holds_the_loops_of_every_frame(states, payload):
    arrays = {name: unpack(packed) for name, packed in payload["arrays"].items()}
    for frame, state in enumerate(states):
        rows = slice(arrays["first"][frame], arrays["first"][frame + 1])
        assert arrays["id"][rows].tolist() == [loop.id for loop in state.loops]
        np.testing.assert_allclose(arrays["death"][rows], [loop.death for loop in state.loops], rtol=1e-6)
        for row, loop in zip(range(rows.start, rows.stop), state.loops, strict=True):
            np.testing.assert_allclose(arrays["killer"][row, :2], loop.killer_edge_points, atol=1e-5)
            np.testing.assert_allclose(arrays["killer"][row, 2:].reshape(2, 3, 3), loop.killer_triangles, atol=1e-5)


def test_player_asks_nothing_of_the_network(episode, states):
    page = view.player(episode, states).page
    assert not NETWORK.search(page)


def test_player_is_a_frame_that_text_cannot_break_out_of(episode, states):
    figure = view.player(episode, states, height=400)
    markup = figure._repr_html_()
    assert markup.startswith("<iframe srcdoc=")
    assert "height:400px" in markup
    assert markup.count(chr(34)) == 8  # srcdoc, title, loading, style: nothing inside is unescaped
    assert figure.page.count("</script>") == 2  # the garment's name holds a third


def test_player_saves_a_whole_page(episode, states, tmp_path):
    path = view.player(episode, states).save(tmp_path / "player.html")
    text = path.read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert "__DATA__" not in text
    assert "__SCRIPT__" not in text


def test_player_starts_where_it_is_told(episode, states, payload):
    neck = states[0].loops[0].id
    assert payload["start"] == int(np.argmax([state[neck].lifetime for state in states]))
    assert '"start":3,' in view.player(episode, states, start=3).page
    with pytest.raises(ValueError, match="start must be a frame from 0 to 5, not 6"):
        view.player(episode, states, start=6)
    with pytest.raises(ValueError, match="states has 5 frames where episode has 6"):
        view.player(episode, states[1:])


def test_player_without_loops_or_faces(episode):
    from dataclasses import replace

    bare = replace(episode, faces=np.zeros((0, 3), np.int32), loops=(), centre_line=np.zeros((0, 3), np.float32))
    page = view.player(bare, [tk.TopologicalState(t, 0.0) for t in range(FRAMES)]).page
    assert '"long":[]' in page


def test_player_stays_small(states):
    points = np.random.default_rng(0).uniform(size=(96, 600, 3))
    assert len(json.dumps(_player.pack_coordinates(points))) < 500_000


@pytest.mark.parametrize("value", [np.zeros((3, 3)), np.full((2, 3), 7.5), np.zeros((0, 3))])
def test_equal_or_no_coordinates_pack(value):
    np.testing.assert_allclose(unpack(_player.pack_coordinates(value)), value)


# ---- the rest


def test_data_flow_lights_its_stages():
    svg = view.data_flow("loops", "tracks").svg
    assert svg.count('font-weight="600"') == 2
    assert "http" not in svg
    with pytest.raises(ValueError, match="no stage 'hook'"):
        view.data_flow("hook")


def test_import_without_matplotlib_says_what_to_install():
    code = "import sys; sys.modules['matplotlib'] = None; import topokit.view"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode
    assert "ImportError: topokit.view needs matplotlib: pip install 'topokit[view]'" in done.stderr


def test_topokit_alone_imports_no_plotting():
    code = "import sys, topokit; assert not {'matplotlib', 'pyvista', 'vtk', 'topokit.view'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_animation_of_an_episode(episode, tmp_path, monkeypatch):
    from PIL import Image

    monkeypatch.setattr(_render, "pyvista_works", lambda: (False, "not here"))
    states = tk.track(episode.points)
    rods = [(episode.centre_line[0], episode.centre_line[1], 0.02)]
    path = view.save_animation(tmp_path / "film.gif", episode, states, rods=rods, every=2, size=(120, 150))
    with Image.open(path) as film:
        assert film.n_frames == 3
        assert film.size == (120, 150)
        assert film.info["duration"] == pytest.approx(1000 * 2 * episode.dt, abs=10)
    for name, options in (("film.mp4", {}), ("film.gif", {"every": 0}), ("film.gif", {"states": states[1:]})):
        with pytest.raises(ValueError, match=r"\.gif|every|states has 5 frames where episode has 6"):
            view.save_animation(tmp_path / name, episode, **options)


# ---- the wardrobe


@pytest.fixture(scope="module")
def garments():
    from topokit.sim import WARDROBE

    return {name: WARDROBE[name]() for name in ("mask", "shirt")}


def test_wardrobe_holds_every_mesh_and_its_true_loops(garments):
    data = page_data(view.wardrobe(garments, title="two"))
    assert data["title"] == "two"
    assert [mesh["name"] for mesh in data["garments"]] == ["mask", "shirt"]
    for mesh, garment in zip(data["garments"], garments.values(), strict=True):
        np.testing.assert_allclose(unpack(mesh["points"])[0], garment.vertices, atol=mesh["points"]["scale"])
        assert mesh["points"]["scale"] < 1e-4
        np.testing.assert_array_equal(unpack(mesh["faces"]), garment.faces)
        assert [list(loop) for loop in garment.loops] == mesh["truth"]
        reach = np.linalg.norm(garment.vertices - mesh["centre"], axis=1).max()
        assert 0 < reach <= mesh["radius"] * (1 + 1e-9)
        for mark in mesh["marks"]:  # shares of a face's corners
            ends = unpack(mark["ends"])
            np.testing.assert_allclose(ends.sum(axis=-1), 1, atol=1e-4)
            assert unpack(mark["face"]).max(initial=0) < len(garment.faces)


def test_wardrobe_is_whole_and_asks_nothing_of_the_network(garments):
    page = view.wardrobe({"a </script> mask": garments["mask"]})
    assert not NETWORK.search(page.page)
    assert page.page.count("</script>") == 2
    assert "__" not in page.page
    assert len(page.page) < 60_000
    assert page._repr_html_().count('"') == 8  # nothing inside breaks out
    assert "allowfullscreen" in page._repr_html_()


def test_wardrobe_must_hold_a_garment():
    with pytest.raises(ValueError, match="garments names no garment"):
        view.wardrobe({})
