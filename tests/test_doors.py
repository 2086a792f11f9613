"""What a stranger may hand in, and what it gets, through every door at once; `book/doors.md` says what is promised."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_io import small_episode

import topokit as tk
from topokit import lemmas
from topokit._archive import FormatError, load_archive, save_archive
from topokit._config import load
from topokit.io import load_episode, load_states, save_episode, save_states
from topokit.linking import close_far, linking_numbers
from topokit.mixture import InverseWishart
from topokit.sampling import spacing
from topokit.sim import Garment, HangEnv, SimulationConfig
from topokit.sim._read import read_mesh
from topokit.view import plot_cloth

from conftest import memory, polygon

ROOT = Path(__file__).parent.parent
RING = np.column_stack([polygon(12), np.zeros(12)])
FAR = RING + [9.0, 0, 0]
LOOP = tk.SeqPH(alpha=0.1).update(RING).loops[0]
MIXTURE = tk.loop_mixture(LOOP)


# -- clouds, matrices and masks --------------------------------------------------------------------------------------------

TAKES_CLOUD = {
    "rips_persistence": tk.rips_persistence,
    "rips_persistence_many": lambda cloud: tk.rips_persistence_many([cloud], n_jobs=1),
    "rips_persistence_many of an array": lambda cloud: tk.rips_persistence_many(np.ma.stack([cloud, cloud]), n_jobs=1),
    "track": lambda cloud: tk.track([cloud, cloud], n_jobs=1),
    "SeqPH.update": lambda cloud: tk.SeqPH().update(cloud),
    "follow": lambda cloud: tk.follow([LOOP], cloud),
    "farthest_point_sample": lambda cloud: tk.farthest_point_sample(cloud, 3),
    "covering_radius": lambda cloud: tk.covering_radius(RING, cloud),
    "hausdorff": lambda cloud: tk.hausdorff(cloud, RING),
    "spacing": spacing,
    "linking_number": lambda cloud: tk.linking_number(cloud, FAR),
    "linking_numbers": lambda cloud: linking_numbers(np.ma.stack([cloud, cloud]), FAR),
    "linking_numbers of a list": lambda cloud: linking_numbers([FAR], [cloud]),
    "close_far": close_far,
    "close_far(start=)": lambda cloud: close_far(RING, start=cloud[0]),
    "LoopMixture.log_prob": MIXTURE.log_prob,
    "loop_mixture": lambda cloud: tk.loop_mixture(loop_like(killer_triangles=cloud[:6].reshape(2, 3, 3))),
    "feature_separation": lemmas.feature_separation,
    "max_displacement": lambda cloud: lemmas.max_displacement(RING, cloud),
    "distortion": lambda cloud: lemmas.distortion(cloud, RING),
    "vertex_ids": lambda cloud: lemmas.vertex_ids(RING, cloud),
    "plot_cloth": lambda cloud: plot_cloth(cloud),
}
RECORDED = small_episode()


def loop_like(**changes: Any) -> SimpleNamespace:
    names = ("killer_triangles", "neighbours", "killer_values", "neighbour_values")
    return SimpleNamespace(**{**{name: getattr(LOOP, name) for name in names}, **changes})


@pytest.mark.parametrize("door", TAKES_CLOUD)
def test_masked_entries_are_refused_and_nothing_under_a_mask_is_read(door):
    with pytest.raises(ValueError, match=r"masked entries"):
        TAKES_CLOUD[door](np.ma.masked_greater(RING, 0.9))
    TAKES_CLOUD[door](np.ma.masked_greater(RING, 9.0))  # none is masked


def test_masks_of_matrices_ids_times_and_rows_are_refused():
    matrix = np.linalg.norm(RING[:, None] - RING, axis=2)
    with pytest.raises(ValueError, match="masked entries"):
        tk.rips_persistence(np.ma.masked_less(matrix, 0.6), metric="precomputed")
    with pytest.raises(ValueError, match="masked entries"):
        tk.rips_persistence([np.ma.masked_less([0.0, 1.0], 0.5), [1, 2], [3, 4]])
    with pytest.raises(ValueError, match="masked entries"):
        lemmas.vertex_ids(RING, np.ma.masked_less(np.arange(12), 3))
    with pytest.raises(ValueError, match="frame 1 has time"):
        tk.track([RING, RING], times=np.ma.masked_greater([0.0, 1.0], 0.5))
    with pytest.raises(ValueError, match="points has 17 masked entries"):
        save_episode("never.npz", dataclasses.replace(RECORDED, points=np.ma.masked_greater(RECORDED.points, 1)))


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_few_rows_of_many_columns_are_asked_about(rows):
    cloud = np.random.default_rng(0).random((rows, 500))
    for call in (tk.rips_persistence, lambda c: tk.track([c]), lambda c: tk.SeqPH().update(c)):
        with pytest.raises(ValueError, match=rf"{rows} rows and 500 columns: are they 500 points in {rows} dimensions"):
            call(cloud)
    assert tk.hausdorff(cloud, cloud) == 0  # two edges in a space of many dimensions are two edges
    repeated = np.concatenate([cloud, np.repeat(cloud[:1], 3, axis=0)])
    assert len(tk.rips_persistence(repeated)) == 0  # the answer to the question
    assert len(tk.rips_persistence(np.zeros((rows, 32)))) == 0


BAD_CLOUDS = {
    "nothing": (None, "must hold real numbers"),
    "a word": ("abc", "must hold real numbers"),
    "whole numbers beyond floating point": ([[10**400, 0]], "must hold real numbers"),
    "longer floating point": (np.full((4, 2), np.longdouble("1e4000")), "NaN or infinite"),
    "rows of different length": ([[1, 2], [3]], "rows differ in length"),
    "nested too deep": (json.loads("[" * 80 + "]" * 80), "rows differ in length"),
    "dates": (np.zeros((4, 2), "M8[s]"), "must hold real numbers"),
    "named columns": (np.zeros(4, [("x", "f8"), ("y", "f8")]), "must hold real numbers"),
    "complex numbers": (np.zeros((4, 2), complex), "must hold real numbers"),
    "a NaN": (np.full((4, 2), np.nan), "NaN or infinite coordinate, the first at row 0"),
    "one axis": (np.zeros(4), r"not of shape \(4,\)"),
}


@pytest.mark.parametrize("what", BAD_CLOUDS)
def test_what_is_no_cloud(what):
    cloud, says = BAD_CLOUDS[what]
    for call in (tk.rips_persistence, spacing, lambda c: tk.track([c]), lambda c: tk.linking_number(c, RING)):
        with pytest.raises(ValueError, match=says):
            call(cloud)


BAD_CALLS = {
    "SeqPH(alpha) beyond floating point": (lambda: tk.SeqPH(alpha=10**400), "alpha must be"),
    "SeqPH(memory) infinite": (lambda: tk.SeqPH(memory=float("inf")), "memory must be 0 or more, a whole number"),
    "SeqPH(memory) true": (lambda: tk.SeqPH(memory=True), "memory must be a whole number"),
    "track(times=words)": (lambda: tk.track([RING], times=["now"]), "frame 0 has time now"),
    "track(times=rows)": (lambda: tk.track([RING], times=np.zeros((1, 2))), "frame 0 has time"),
    "update(time=huge)": (lambda: tk.SeqPH().update(RING, time=10**400), "frame 0 has time"),
    "farthest_point_sample(n=2.5)": (lambda: tk.farthest_point_sample(RING, 2.5), "n must be 1 to 12, a whole number"),
    "farthest_point_sample(n='3')": (lambda: tk.farthest_point_sample(RING, "3"), "n must be a whole number"),
    "farthest_point_sample(start=1.5)": (lambda: tk.farthest_point_sample(RING, 3, 1.5), "start must be"),
    "sample(nan)": (lambda: MIXTURE.sample(float("nan")), "n must be"),
    "sample('3')": (lambda: MIXTURE.sample("3"), "n must be"),
    "density(0)": (lambda: MIXTURE.density(0), "n must be 1 or more"),
    "density(extent=nan)": (lambda: MIXTURE.density(4, extent=float("nan")), "extent must be"),
    "credibility(n=0)": (lambda: MIXTURE.credibility(RING, n=0), "n must be 1 or more"),
    "log_prob('abc')": (lambda: MIXTURE.log_prob("abc"), "x must hold real numbers"),
    "log_prob(ragged)": (lambda: MIXTURE.log_prob([[1, 2, 3], [1]]), "x must be an array of numbers"),
    "InverseWishart(dof=inf)": (lambda: tk.loop_mixture(LOOP, prior=InverseWishart(1.0, float("inf"))), "dof must be"),
    "InverseWishart(scale=inf)": (
        lambda: tk.loop_mixture(LOOP, prior=InverseWishart(np.inf)),
        "scale must be positive",
    ),
    "InverseWishart(scale='a')": (
        lambda: tk.loop_mixture(LOOP, prior=InverseWishart("a")),
        "scale must hold real numbers",
    ),
    "close_far(1e308)": (lambda: close_far(RING * 1e308), "reaches beyond 1e150"),
    "close_far(start=word)": (lambda: close_far(RING, start="up"), "start must hold real numbers"),
    "linking_numbers(words)": (lambda: linking_numbers(["a"], ["b"]), "curves_a must hold real numbers"),
}


@pytest.mark.parametrize("call", BAD_CALLS)
def test_a_bad_argument_is_named(call):
    with pytest.raises(ValueError, match=BAD_CALLS[call][1]):
        BAD_CALLS[call][0]()


# -- files --------------------------------------------------------------------------------------------------------------------

BAD_EPISODES = {
    "points": ([[0, 0, 0]], "points must be an array, not list"),
    "observed": (None, "observed must hold real numbers"),
    "held": ("a", "held must hold real numbers"),
    "faces": (np.zeros((2, 2), int), r"faces has shape \(2, 2\)"),
    "loops": ((np.zeros((2, 2), int),), "a loop is a list of vertex ids"),
    "centre_line": (np.full((3, 3), np.nan), "centre_line has a NaN or infinite coordinate in row 0"),
    "garment": (5, "garment must be a str, not 5"),
    "dt": (float("inf"), "dt must be the seconds"),
}


@pytest.mark.parametrize("part", BAD_EPISODES)
def test_an_episode_of_wrong_parts_is_not_written(part, tmp_path):
    value, says = BAD_EPISODES[part]
    with pytest.raises(ValueError, match=says):
        save_episode(tmp_path / "e.npz", dataclasses.replace(RECORDED, **{part: value}))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("part", "value", "says"),
    [
        ("loop_lengths", np.array(["a"]), "loop_lengths"),
        ("points_scale", np.ones(5), "points_scale"),
        ("points", np.zeros((5, 12, 1), "u2"), "points"),
        ("points", np.zeros((5, 12, 3), complex), "points"),
        ("extra", np.zeros(3), "extra"),
        ("n_loops", np.array([3, -1]), "id has 2 rows, and they are counted otherwise"),
        ("killer_edge_points", np.zeros((2, 2, 7)), "killer_triangles"),
        ("neighbour_ids", np.zeros((1, 3), int), "neighbours"),
        ("n_cycle", np.array([1.5, 2.5]), "n_cycle"),
        ("frame", np.zeros(5, int), "frame|time|n_loops"),
        ("parameters", "ab", "parameters"),
        ("parameters", None, "a missing or an unknown part"),
        ("parameters", [{}, {}, {}], "a missing or an unknown part"),
    ],
)
def test_sealed_episodes_and_states_of_wrong_parts_say_which(part, value, says, tmp_path):
    write, load = (lambda path: save_states(path, tk.track([RING, RING], alpha=0.1))), load_states
    if part in ("loop_lengths", "points_scale", "points", "extra"):
        write, load = (lambda path: save_episode(path, RECORDED)), load_episode
    path, kind = write(tmp_path / "a.npz"), f"topokit-{'states' if load is load_states else 'episode'}"
    text, arrays = load_archive(path, kind)
    changed = (text, arrays | {part: value}) if part != "parameters" else (text | {part: value}, arrays)
    save_archive(path, kind, *changed)
    with pytest.raises(FormatError, match=rf"a.npz: .*({says})"):
        load(path)


PLY = "ply\nformat ascii 1.0\n{}element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
PLY += "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 0 1\n3 0 1 2\n"


@pytest.mark.parametrize(
    ("extra", "old", "new", "says"),
    [
        (
            "element evil 2000000000\nproperty char x\n",
            "",
            "",
            "2000000000 rows of its element 'evil': the file has 27 bytes",
        ),
        ("element evil -1\nproperty char x\n", "", "", "-1 rows of its element 'evil'"),
        ("", "vertex 3", "vertex 9" + "9" * 30, "rows of its element 'vertex': the file has 27 bytes"),
        ("", "3 0 1 2", "inf 0 1 2", "its element 'face': cannot convert float infinity"),
        ("", "3 0 1 2", "3 0 nan 2", "its element 'face': cannot convert float NaN"),
        ("", "3 0 1 2", "900000000 0 1 2", "its element 'face': the file ends there"),
        ("", "property float x", "property list uchar float x", "among the 3 rows of its element 'vertex'"),
        ("", "property list uchar int", "property list", "not understood: 'property list vertex_indices'"),
        ("property float w\n", "", "", "line of the PLY header is not understood: 'property float w'"),
        ("element\n", "", "", "not understood: 'element'"),
        ("", "1 0 0", "1e200 0 0", "needs a place"),
    ],
)
def test_a_ply_file_declares_no_more_than_it_holds(tmp_path, extra, old, new, says):
    path = tmp_path / "cloth.ply"
    path.write_text(PLY.format(extra).replace(old, new) if old else PLY.format(extra))
    with pytest.raises(ValueError, match=f"cloth.ply: .*{says}"):
        Garment.from_mesh(path)


def test_elements_without_properties_hold_nothing(tmp_path):
    (tmp_path / "cloth.ply").write_text(PLY.format("element evil 2000000000\n"))
    assert len(Garment.from_mesh(tmp_path / "cloth.ply").vertices) == 3


def test_work_for_a_mesh_is_bounded(tmp_path):
    """Cutting faces into triangles takes the square of their corners: thirty seconds here."""
    around = "".join(f"v {x} 0 {z}\n" for x, z in polygon(1000))
    (tmp_path / "round.obj").write_text(around + ("f " + " ".join(map(str, range(1, 1001))) + "\n") * 31)
    with pytest.raises(ValueError, match=r"round.obj: 31 faces are more than can be cut"):
        Garment.from_mesh(tmp_path / "round.obj")


@pytest.mark.parametrize("name", ["cloth.ply", "cloth.obj", "cloth.stl"])
def test_a_mesh_takes_a_hundred_times_its_file_at_most(tmp_path, name):
    """The densest files: a byte or two for each number."""
    n = 20_000
    bytes_of = {
        "cloth.ply": PLY.replace("ascii", "binary_little_endian")
        .replace("float", "char")
        .replace("uchar int", "uchar uchar"),
        "cloth.obj": "v 0 0 0\n" * n + "f 1 2 3\n" * n,
        "cloth.stl": "solid\n" + "facet normal vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n" * n + "endsolid",
    }
    data = bytes_of[name].encode()
    if name == "cloth.ply":
        head = (
            bytes_of[name]
            .format("")
            .replace("vertex 3", f"vertex {n}")
            .replace("face 1", f"face {n}")
            .split("0 0 0")[0]
        )
        data = head.encode() + b"\0\1\2" * n + b"\3\0\1\2" * n
    (tmp_path / name).write_bytes(data)
    with memory() as peak:
        read_mesh(tmp_path / name)
        assert peak() < 100 * len(data)


def test_deep_json_of_a_configuration_names_the_file(tmp_path):
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match=r"deep.json: not JSON"):
        load(SimulationConfig, tmp_path / "deep.json")


def test_a_device_is_no_file():
    for reader in (load_episode, load_states, Garment.from_mesh):
        with pytest.raises(FileNotFoundError, match="/dev/null: a device or a pipe, not a file"):
            reader("/dev/null")


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: .*s.npz"):
        save_states(tmp_path / "s.npz", [])
    assert not list(tmp_path.iterdir())


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200), st.sampled_from([".ply", ".obj", ".stl"]), st.integers(0, 200))
def test_any_mesh_file_is_read_or_refused(tmp_path_factory, noise, suffix, at):
    """A slice of `tests/fuzz_readers.py`, without coverage to guide it."""
    whole = PLY.format("").encode() if suffix == ".ply" else b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"
    path = tmp_path_factory.getbasetemp() / f"fuzz{suffix}"
    path.write_bytes(whole[:at] + noise + whole[at + len(noise) // 2 :])
    with contextlib.suppress(ValueError):
        Garment.from_mesh(path)


# -- the environment ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [{"n_points": 2.5}, {"n_points": "a"}, {"n_points": True}, {"max_steps": 0.5}, {"max_steps": float("inf")}],
)
def test_numbers_of_the_environment_are_whole(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        HangEnv(**options)


@pytest.mark.parametrize(
    "action",
    [
        None,
        "abc",
        [0] * 6,
        [np.inf] * 7,
        [[1], 2, 3, 4, 5, 6, 7],
        [10**400] * 7,
        np.zeros(7, complex),
        np.ma.masked_all(7),
    ],
    ids=str,
)
def test_an_action_that_is_none_moves_nothing(action, monkeypatch):
    env = HangEnv(n_points=50)
    monkeypatch.setattr(env, "_running", lambda: None)
    with pytest.raises(ValueError, match="action"):
        env.step(action)
