"""Episodes and states on disk: what goes in comes out, and a file that is not one is refused before it takes memory."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from topokit import track
from topokit._archive import FormatError, load_archive, save_archive
from topokit.io import Episode, load_episode, load_states, save_episode, save_states

from conftest import memory, polygon

EPISODE = "topokit-episode"
STATES = "topokit-states"


def small_episode(frames: int = 5, **changes: object) -> Episode:
    rng = np.random.default_rng(0)
    ring = np.column_stack([polygon(12, 0.2), np.zeros(12)])
    points = (ring + rng.normal(size=(frames, 1, 3))).astype(np.float32)
    episode = Episode(
        points=points,
        observed=points[:, ::2],
        actions=points[:, :2],
        grippers=points[:, 1:3],
        held=np.arange(frames) < 3,
        faces=np.array([[0, 1, 2], [2, 3, 4]], dtype=np.int32),
        loops=(np.arange(12, dtype=np.int32), np.array([3, 5, 7], dtype=np.int32)),
        centre_line=np.array([[0, 0, 0], [0, 0.3, 0]], dtype=np.float32),
        garment="ring",
        target="hook",
        success=True,
        seed=3,
        dt=0.04,
        physics={"mass": 0.3},
        provenance={"command": "a test"},
    )
    return dataclasses.replace(episode, **changes)


def some_states():
    return track([polygon(20), polygon(20)], alpha=0.1)


def ticks(positions):
    return np.rint(np.asarray(positions, dtype=np.float64) * 10_000)


# -- round trips ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"loops": ()},
        {"observed": np.random.default_rng(1).normal(size=(5, 7, 3)).astype(np.float32)},  # by a camera
        {"points": (40 * small_episode().points).astype(np.float32)},  # does not fit 16 bits
        {"points": np.array([-3.2767, 3.2767] * 90, dtype=np.float32).reshape(5, 12, 3)},  # differences wrap around
    ],
    ids=["as it is", "no loops", "camera", "far", "wraps"],
)
def test_an_episode_comes_back_in_ticks(tmp_path, changes):
    episode = small_episode(**changes)
    again = load_episode(save_episode(tmp_path / "new folder" / "ring.npz", episode))
    for name in ("points", "observed", "actions", "grippers", "centre_line"):
        assert getattr(again, name).dtype == np.float32
        np.testing.assert_array_equal(ticks(getattr(again, name)), ticks(getattr(episode, name)))
    np.testing.assert_array_equal(again.held, episode.held)
    np.testing.assert_array_equal(again.faces, episode.faces)
    assert [loop.tolist() for loop in again.loops] == [loop.tolist() for loop in episode.loops]
    for name in ("garment", "target", "success", "seed", "dt", "physics", "provenance", "schema"):
        assert getattr(again, name) == getattr(episode, name)
    np.testing.assert_allclose(again.times, [0, 0.04, 0.08, 0.12, 0.16])
    assert (tmp_path / "new folder" / "ring.npz").read_bytes() == save_episode(tmp_path / "b.npz", again).read_bytes()


def test_anybody_can_read_the_file(tmp_path):
    """By NumPy alone, as the page on formats says."""
    episode = small_episode()
    with np.load(save_episode(tmp_path / "ring.npz", episode)) as archive:
        points = np.cumsum(archive["points"], axis=0, dtype=archive["points"].dtype) / 10_000
        header = json.loads(archive["header.json"])
    np.testing.assert_allclose(points, episode.points, atol=0.51e-4)
    assert (header["kind"], header["garment"], header["frames"]) == (EPISODE, "ring", 5)


def test_a_failed_write_leaves_the_old_file_and_no_rubbish(tmp_path, monkeypatch):
    path = save_episode(tmp_path / "ring.npz", small_episode())
    before = path.read_bytes()

    def no_room(*_: object, **__: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", no_room)
    with pytest.raises(OSError, match="no space left"):
        save_episode(path, small_episode(7))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["ring.npz"]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"points": np.full((5, 12, 3), np.nan)}, "points .* row 0"),
        ({"observed": np.zeros((4, 6, 3))}, r"observed .*\(4, 6, 3\)"),
        ({"actions": np.zeros((5, 3, 3))}, "actions"),
        ({"held": np.zeros(4, bool)}, "held"),
        ({"dt": 0.0}, "dt"),
        ({"loops": (np.array([0, 1, 12]),)}, r"loops\[0\] .* 12"),
        ({"points": np.linspace(0, 1e6, 180).reshape(5, 12, 3)}, "points"),
        ({"points": np.zeros((0, 12, 3))}, "no frame"),
    ],
)
def test_bad_episodes_are_not_written(tmp_path, changes, says):
    with pytest.raises(ValueError, match=says):
        save_episode(tmp_path / "ring.npz", small_episode(**changes))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "clouds",
    [[], [np.zeros((2, 2))], [polygon(20), np.zeros((1, 2)), polygon(20), polygon(21) * 1.01]],
    ids=["no frame", "no loop", "loops"],
)
def test_states_come_back_to_the_last_bit(tmp_path, clouds):
    states = track(clouds, alpha=0.1) if clouds else []
    again = load_states(save_states(tmp_path / "states.npz", states), clouds)
    assert [(s.frame, s.time) for s in again] == [(s.frame, s.time) for s in states]
    for one, other in zip(states, again, strict=True):
        assert {**one.parameters, "dropped": 0} == other.parameters
        for loop, same in zip(one.loops, other.loops, strict=True):
            names = [field.name for field in dataclasses.fields(loop) if field.name != "_curve"]
            for name in [*names, "cycle", "cycle_points"]:
                np.testing.assert_array_equal(getattr(loop, name), getattr(same, name))


def test_states_of_other_clouds_are_refused(tmp_path):
    path = save_states(tmp_path / "states.npz", some_states())
    for clouds in ([polygon(20)], [polygon(20), polygon(9)]):
        with pytest.raises(FormatError, match=r"states\.npz: .*clouds?"):
            load_states(path, clouds)


# -- files that are damaged, or something else --------------------------------------------------------------------------------


def saved(path: Path) -> Path:
    """Write states or an episode, as the name of the file says."""
    return save_states(path, some_states()) if path.name == "states.npz" else save_episode(path, small_episode())


def content(path: Path) -> object:
    if path.name == "states.npz":
        return [state.as_dict() for state in load_states(path, [polygon(20)] * 2)]
    parts = vars(load_episode(path))
    return {name: np.asarray(value).tolist() if name != "loops" else str(value) for name, value in parts.items()}


@pytest.mark.parametrize("name", ["ring.npz", "states.npz"])
def test_a_flipped_bit_is_refused_or_harmless(tmp_path, name):
    """The CRC-32 of every entry covers the content; what is left are the archive's own notes, such as time stamps."""
    path = saved(tmp_path / name)
    raw, whole = path.read_bytes(), content(path)
    rng = np.random.default_rng(0)
    places = rng.choice(len(raw), 600, replace=False).tolist()
    refused = 0
    for at in places:
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 1 << rng.integers(8)]) + raw[at + 1 :])
        try:
            assert content(path) == whole
        except FormatError:
            refused += 1
    assert refused > 0.5 * len(places)


def rewritten(path: Path, **changes: bytes) -> Path:
    """Replace entries of an archive, CRC-32 and all; `header` is the JSON header."""
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    for name, data in changes.items():
        entries["header.json" if name == "header" else f"{name}.npy"] = data
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return path


def npy(array: np.ndarray, tmp_path: Path) -> bytes:
    np.save(tmp_path / "a.npy", array)
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").unlink()
    return data


def test_what_is_declared_is_compared_before_memory_is_taken(tmp_path):
    path = save_episode(tmp_path / "ring.npz", small_episode())
    whole = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        points = archive.read("points.npy")
    for shape in (b"(5000000000, 12, 3)", b"(5, 12, 4)"):
        lying = points.replace(b"(5, 12, 3), }" + b" " * (len(shape) - 10), shape + b", }")
        assert len(lying) == len(points)
        with memory() as peak:
            with pytest.raises(FormatError, match="points"):
                load_episode(rewritten(path, points=lying))
            assert peak() < 2_000_000
        path.write_bytes(whole)


def test_pickles_and_other_headers_are_refused(tmp_path):
    path = save_episode(tmp_path / "ring.npz", small_episode())
    whole = path.read_bytes()
    with pytest.raises(FormatError, match="pickle"):
        load_episode(rewritten(path, held=npy(np.array([{}], dtype=object), tmp_path)))
    for header in (b"[]", b"{", b"\xff"):
        path.write_bytes(whole)
        with pytest.raises(FormatError, match=r"ring\.npz"):
            load_episode(rewritten(path, header=header))


# -- whole archives whose parts do not fit ------------------------------------------------------------------------------------


FAULTS_OF_EPISODES = [
    ("points", np.zeros((5, 12, 3)), "points .* float64"),
    ("faces", np.zeros(6, np.int32), r"faces .* \(6,\)"),
    ("observed_ids", np.full((5, 6), 12, np.uint16), "observed_ids .* 12"),
    ("observed_ids", np.zeros((4, 6), np.uint16), "observed|shape"),
    ("loops", [[0, 1.5]], "loop"),
    ("loops", [[0, 12]], r"loops\[0\] .* 12"),
    ("frames", 6, "frames"),
    ("dt", "0.04", "dt must be"),
    ("extra", 1, "extra"),
]
FAULTS_OF_STATES = [
    ("id", np.zeros((2, 1)), "id is of type float64"),
    ("values", np.zeros((2, 1, 6)), "values"),
    ("simplices", np.zeros((3, 1, 22), np.uint16), "simplices"),
    ("simplices", np.full((2, 1, 22), 65535, np.uint16), "65535"),
    ("values", None, "'values'"),
]


@pytest.mark.parametrize(
    ("file", "name", "value", "says"),
    [*(("ring.npz", *fault) for fault in FAULTS_OF_EPISODES), *(("states.npz", *fault) for fault in FAULTS_OF_STATES)],
)
def test_parts_that_do_not_fit_are_named(tmp_path, file, name, value, says):
    path = saved(tmp_path / file)
    kind = STATES if file == "states.npz" else EPISODE
    header, arrays = load_archive(path, kind)
    if name in arrays or isinstance(value, np.ndarray):
        arrays[name] = value
    else:
        header[name] = value
    save_archive(path, kind, header, {name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(FormatError, match=says):
        content(path)
