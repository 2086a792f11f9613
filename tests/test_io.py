"""Episodes and states on disk: what goes in comes out, and a file that is not one says why."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from topokit import track
from topokit._archive import _digest, load_archive, save_archive
from topokit.io import Episode, FormatError, load_episode, load_states, save_episode, save_states

from conftest import polygon


def small_episode(frames: int = 5) -> Episode:
    rng = np.random.default_rng(0)
    ring = np.column_stack([polygon(12, 0.2), np.zeros(12)])
    points = (ring + rng.normal(size=(frames, 1, 3))).astype(np.float32)
    return Episode(
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


def test_episode_round_trip(tmp_path):
    episode = small_episode()
    path = save_episode(tmp_path / "new folder" / "ring.npz", episode)
    again = load_episode(path)
    for name in ("points", "observed", "actions", "grippers", "centre_line"):
        one, other = getattr(episode, name), getattr(again, name)
        assert one.shape == other.shape
        assert other.dtype == np.float32
        assert np.abs(one - other).max() < 1e-4  # a tenth of a millimetre
    np.testing.assert_array_equal(again.held, episode.held)
    np.testing.assert_array_equal(again.faces, episode.faces)
    assert [loop.tolist() for loop in again.loops] == [loop.tolist() for loop in episode.loops]
    for field in ("garment", "target", "success", "seed", "dt", "physics", "provenance"):
        assert getattr(again, field) == getattr(episode, field)
    np.testing.assert_allclose(again.times, [0, 0.04, 0.08, 0.12, 0.16])


def test_coordinates_are_packed_to_the_nearest_step(tmp_path):
    episode = small_episode()
    path = save_episode(tmp_path / "ring.npz", episode)
    step = load_archive(path, "topokit-episode")[1]["points_scale"][0]
    error = load_episode(path).points.astype(np.float64) - episode.points
    assert np.abs(error).max() <= 0.5 * step + 1e-6  # float32 costs the rest
    assert abs(error.mean()) < 0.1 * step
    assert step < 1.6e-4  # 65,535 steps across less than ten metres


def test_episode_without_true_loops(tmp_path):
    path = save_episode(tmp_path / "ring.npz", dataclasses.replace(small_episode(), loops=()))
    assert load_episode(path).loops == ()


def test_same_episode_same_bytes(tmp_path):
    one, other = (save_episode(tmp_path / name, small_episode()).read_bytes() for name in ("a.npz", "b.npz"))
    assert one == other


def test_failed_write_leaves_the_old_file_and_no_rubbish(tmp_path, monkeypatch):
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
    ("damage", "says"),
    [
        (lambda raw: b"", "empty"),
        (lambda raw: raw[: len(raw) // 2], "truncated or damaged"),
        (lambda raw: b"a,b,c\n1,2,3\n", "not a topokit episode"),
    ],
    ids=["empty", "truncated", "csv"],
)
def test_damaged_files(tmp_path, damage, says):
    path = save_episode(tmp_path / "ring.npz", small_episode())
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(FormatError, match=says) as caught:
        load_episode(path)
    assert str(path) in str(caught.value)


def test_a_changed_byte_never_gives_other_numbers(tmp_path):
    episode = small_episode()
    path = save_episode(tmp_path / "ring.npz", episode)
    raw, whole = path.read_bytes(), load_episode(path)
    refused = 0
    for at in range(0, len(raw), 7):
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 0x55]) + raw[at + 1 :])
        try:
            again = load_episode(path)
        except FormatError:
            refused += 1
        else:  # the byte was one of the archive's own, such as a time stamp
            np.testing.assert_array_equal(again.points, whole.points)
            assert again.physics == whole.physics
    assert refused > len(raw) / 7 * 0.6


def test_other_archives(tmp_path):
    np.savez(tmp_path / "other.npz", points=np.zeros((3, 4, 3)))
    with pytest.raises(FormatError, match="topokit did not write"):
        load_episode(tmp_path / "other.npz")
    states = save_states(tmp_path / "states.npz", track([polygon(9)], alpha=0.1))
    with pytest.raises(FormatError, match="holds a topokit states, not a topokit episode"):
        load_episode(states)
    np.savez(tmp_path / "objects.npz", points=np.array([{}], dtype=object))
    with pytest.raises(FormatError, match="topokit did not write"):
        load_episode(tmp_path / "objects.npz")
    json = np.frombuffer(b'{"kind": "topokit-episode", "sha256": ""}', dtype=np.uint8)
    np.savez(tmp_path / "objects.npz", points=np.array([{}], dtype=object), json=json)
    with pytest.raises(FormatError, match="pickle"):
        load_episode(tmp_path / "objects.npz")
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_episode(tmp_path / "nowhere.npz")
    with pytest.raises(FileNotFoundError, match="a folder"):
        load_episode(tmp_path)


def test_newer_schema(tmp_path):
    path = save_episode(tmp_path / "ring.npz", dataclasses.replace(small_episode(), schema=99))
    with pytest.raises(FormatError, match="schema 99"):
        load_episode(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"points": np.full((5, 12, 3), np.nan)}, "points has a NaN or infinite coordinate in frame 0"),
        ({"observed": np.zeros((4, 6, 3))}, r"observed has shape \(4, 6, 3\)"),
        ({"actions": np.zeros((5, 3, 3))}, "actions has shape"),
        ({"held": np.zeros(4, bool)}, "held"),
        ({"dt": 0.0}, "dt"),
        ({"loops": (np.array([0, 1, 12]),)}, r"loops\[0\] names vertex 12"),
        ({"points": np.linspace(0, 1e3, 180).reshape(5, 12, 3)}, "more than 0.1 mm"),
        ({"points": np.zeros((0, 12, 3))}, "no frame"),
    ],
)
def test_bad_episodes_are_not_written(tmp_path, change, says):
    with pytest.raises(ValueError, match=says):
        save_episode(tmp_path / "ring.npz", dataclasses.replace(small_episode(), **change))
    assert not list(tmp_path.iterdir())


def test_states_round_trip(tmp_path):
    states = track([polygon(20), np.zeros((1, 2)), polygon(20), polygon(21) * 1.01], alpha=0.1)
    again = load_states(save_states(tmp_path / "states.npz", states))
    assert [(s.frame, s.time, s.parameters) for s in again] == [(s.frame, s.time, s.parameters) for s in states]
    for one, other in zip(states, again, strict=True):
        for loop, same in zip(one.loops, other.loops, strict=True):
            for name in [
                *(field.name for field in dataclasses.fields(loop) if field.name != "_curve"),
                "cycle",
                "cycle_points",
            ]:
                np.testing.assert_array_equal(getattr(loop, name), getattr(same, name))


def test_no_states_round_trip(tmp_path):
    assert load_states(save_states(tmp_path / "states.npz", [])) == []
    assert [len(s) for s in load_states(save_states(tmp_path / "states.npz", track([np.zeros((2, 2))])))] == [0]


# -- what the checksum covers ----------------------------------------------------------------------------------------------------


def edited(path: Path, **changes: Any) -> Path:
    """Change entries of an archive's JSON document, and nothing else; None takes one out."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    document = json.loads(arrays["json"].tobytes()) | changes
    document = {name: value for name, value in document.items() if value is not None}
    arrays["json"] = np.frombuffer(json.dumps(document, sort_keys=True).encode(), dtype=np.uint8)
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize("changes", [{"success": False}, {"dt": 0.05}, {"seed": 4}, {"archive": None}, {"extra": 1}])
def test_changed_words_are_noticed(tmp_path, changes):
    path = save_episode(tmp_path / "ring.npz", small_episode())
    assert load_episode(edited(path)).success  # the same words in another file are well
    with pytest.raises(FormatError, match="checksum does not match"):
        load_episode(edited(path, **changes))


def test_changed_words_of_states_are_noticed(tmp_path):
    path = save_states(tmp_path / "states.npz", track([polygon(20)], alpha=0.1))
    with pytest.raises(FormatError, match="checksum does not match"):
        load_states(edited(path, parameters=[{"alpha": 9.0}]))


def test_files_of_the_first_version_still_read(tmp_path):
    """Their checksum covered the arrays alone."""
    path = save_episode(tmp_path / "ring.npz", small_episode())
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "json"}
    old = edited(path, archive=None, sha256=_digest(arrays, None))
    assert load_episode(old).physics == {"mass": 0.3}


def test_states_of_the_first_schema_still_read_without_cycles():
    clips = sorted((Path(__file__).parent.parent / "book" / "results" / "clips").glob("*.tracks.npz"))
    loop = next(state.loops[0] for state in load_states(clips[0]) if state.loops)
    assert loop.lifetime > 0
    with pytest.raises(LookupError, match="track the cloud"):
        _ = loop.cycle


@pytest.mark.parametrize("name", ["birth", "neighbour_ids", "n_neighbours", "n_loops", "cycle", "frame"])
def test_states_with_a_part_missing_say_so(tmp_path, name):
    path = save_states(tmp_path / "states.npz", track([polygon(20), polygon(20)], alpha=0.1))
    text, arrays = load_archive(path, "topokit-states")
    arrays.pop(name)
    save_archive(path, "topokit-states", text, arrays)
    with pytest.raises(FormatError, match=f"a missing or an unknown part: '{name}'; track them again"):
        load_states(path)


def test_states_that_do_not_fit_each_other_say_so(tmp_path):
    path = save_states(tmp_path / "states.npz", track([polygon(20), polygon(20)], alpha=0.1))
    text, arrays = load_archive(path, "topokit-states")
    save_archive(path, "topokit-states", text | {"parameters": []}, arrays)
    with pytest.raises(FormatError, match="track them again"):
        load_states(path)
