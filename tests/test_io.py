"""Episodes and states on disk: what goes in comes out, and a file that is not one says why."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from topokit import _archive, track
from topokit._archive import _digest, load_archive, save_archive
from topokit.io import Episode, FormatError, load_episode, load_states, save_episode, save_states

from conftest import memory, polygon


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
    with np.load(states) as archive:
        np.savez(tmp_path / "objects.npz", json=archive["json"], birth=np.array([{}], dtype=object))
    with pytest.raises(FormatError, match="pickle"):
        load_states(tmp_path / "objects.npz")
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


# -- archives that claim more than they are --------------------------------------------------------------------------------------


def claim(path: Path, name: str, size: int) -> None:
    """Let the directory of an archive say another size of an entry."""
    raw, entry = path.read_bytes(), f"{name}.npy".encode()
    at = raw.rindex(entry) - 46  # in the directory, which comes last; 46 bytes before a name begins its record
    path.write_bytes(raw[: at + 24] + size.to_bytes(4, "little") + raw[at + 28 :])


def peak_while_refused(path: Path, says: str) -> int:
    with memory() as peak:
        with pytest.raises(FormatError, match=says) as caught:
            load_episode(path)
        assert str(path) in str(caught.value)
        return peak()


def test_the_kind_is_looked_at_before_an_array_is_unpacked(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", points=np.zeros(20_000_000, np.uint8))
    assert peak_while_refused(tmp_path / "bomb.npz", "topokit did not write") < 1_000_000
    words = np.frombuffer(json.dumps({"kind": "topokit-states", "sha256": ""}).encode(), np.uint8)
    np.savez_compressed(tmp_path / "bomb.npz", json=words, points=np.zeros(20_000_000, np.uint8))
    assert peak_while_refused(tmp_path / "bomb.npz", "holds a topokit states") < 1_000_000


def test_an_archive_that_would_unpack_to_far_more_than_it_is_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(_archive, "FREE", 2**20)
    words = np.frombuffer(json.dumps({"kind": "topokit-episode", "sha256": ""}).encode(), np.uint8)
    np.savez_compressed(tmp_path / "bomb.npz", json=words, points=np.zeros(80_000_000, np.uint8))
    assert peak_while_refused(tmp_path / "bomb.npz", r"bytes claim to hold 8\d{7}") < 1_000_000


@pytest.mark.parametrize("name", ["points", "json"])
def test_an_entry_that_claims_another_size_is_refused(tmp_path, name):
    path = save_episode(tmp_path / "ring.npz", small_episode())
    for size, says in ((0xFFFFFFF0, "claim to hold"), (40, "truncated or damaged|did not write")):
        claim(path, name, size)
        assert peak_while_refused(path, says) < 2_000_000


def test_an_array_that_claims_another_shape_is_refused(tmp_path):
    path = save_episode(tmp_path / "ring.npz", small_episode())
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    entries["points.npy"] = entries["points.npy"].replace(b"(5, 12, 3), }         ", b"(5000000000, 12, 3), }")
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    with pytest.raises(FormatError, match="truncated or damaged"):
        load_episode(path)


def test_packings_that_unpack_without_bound_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("json.npy", bytes(1000))
    with pytest.raises(FormatError, match=r"json\.npy is packed by another method than deflate"):
        load_episode(tmp_path / "bomb.npz")


def test_words_too_deep_to_read_are_refused(tmp_path):
    np.savez(tmp_path / "deep.npz", json=np.frombuffer(b"[" * 100_000, np.uint8))
    with pytest.raises(FormatError, match="topokit did not write"):
        load_episode(tmp_path / "deep.npz")


def test_what_is_so_dense_that_it_looks_like_a_bomb_is_read_again(tmp_path, monkeypatch):
    monkeypatch.setattr(_archive, "FREE", 10_000)
    still = np.zeros((500, 100, 3), np.float32)
    flat = dataclasses.replace(
        small_episode(500), points=still, observed=still, actions=still[:, :2], grippers=still[:, :2], loops=()
    )
    path = save_episode(tmp_path / "still.npz", flat)
    assert not load_episode(path).points.any()
    assert path.stat().st_size > 600_000  # it is not packed


# -- archives whose checksum is right and whose parts are not --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("points", np.zeros((5, 12, 3)), "points is of type float64"),
        ("points", np.zeros((10**9, 0, 3), np.uint16), r"points is empty and claims the shape \(1000000000, 0, 3\)"),
        ("points_scale", np.zeros((10**9, 0)), "points_scale is empty and claims"),
        ("points_scale", np.full(4, 1e308), "points cannot be unpacked"),
        ("points_scale", np.array([0.0, 0, 0, 0]), "points cannot be unpacked"),
        ("held", np.ones(5), "held is of type float64"),
        ("faces", np.zeros(6, np.int32), r"faces is of type int32 and shape \(6,\)"),
        ("centre_line", np.zeros((2, 2), np.uint16), "centre_line is of type uint16"),
        ("loop_lengths", np.array([12, 4], np.int32), "loop_vertices has 15 rows, and they are counted otherwise"),
        ("loop_lengths", np.array([18, -3], np.int32), "loop_vertices has 15 rows, and they are counted otherwise"),
        ("success", "yes", "success must be a bool, not 'yes'"),
        ("seed", True, "seed must be a int, not True"),
        ("garment", ["apron"], "garment must be a str"),
        ("dt", "0.04", "dt must be"),
        ("physics", [], "physics must be a dict"),
    ],
)
def test_parts_of_an_episode_that_do_not_fit_are_named(tmp_path, name, value, says):
    text, arrays = load_archive(save_episode(tmp_path / "ring.npz", small_episode()), "topokit-episode")
    changed = [text | {name: value}, arrays] if name in text else [text, arrays | {name: value}]
    save_archive(tmp_path / "ring.npz", "topokit-episode", *changed)
    with pytest.raises(FormatError, match=says):
        load_episode(tmp_path / "ring.npz")


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("id", np.zeros((10**9, 0)), "id is empty and claims"),
        ("id", np.zeros(2), "id is of type float64"),
        ("birth", np.array(["0.1", "0.1"]), "birth is of type <U3"),
        ("killer_triangles", np.zeros((2, 2, 3, 3)), "killer_triangles is of type float64"),
        ("killer_edge", np.zeros((3, 2), int), r"killer_edge is of type int64 and shape \(3, 2\)"),
        ("n_cycle", np.array([2, -1]), "cycle has 40 rows, and they are counted otherwise"),
        ("n_loops", np.array([2, 1]), "id has 2 rows, and they are counted otherwise"),
        ("parameters", [1, 2], "parameters that have no names"),
    ],
)
def test_parts_of_states_that_do_not_fit_are_named(tmp_path, name, value, says):
    path = save_states(tmp_path / "states.npz", track([polygon(20), polygon(20)], alpha=0.1))
    text, arrays = load_archive(path, "topokit-states")
    changed = [text | {name: value}, arrays] if name in text else [text, arrays | {name: value}]
    save_archive(path, "topokit-states", *changed)
    with pytest.raises(FormatError, match=says):
        load_states(path)


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


def test_a_changed_byte_never_gives_other_states(tmp_path):
    path = save_states(tmp_path / "states.npz", track([polygon(20), polygon(20)], alpha=0.1))
    raw, whole = path.read_bytes(), [state.as_dict() for state in load_states(path)]
    rng = np.random.default_rng(0)
    refused, places = 0, rng.choice(len(raw), 400, replace=False).tolist()
    for at in places:
        path.write_bytes(raw[:at] + bytes([raw[at] ^ 1 << rng.integers(8)]) + raw[at + 1 :])
        try:
            again = load_states(path)
        except FormatError:
            refused += 1
        else:
            assert [state.as_dict() for state in again] == whole
    assert refused > 0.5 * len(places)


def test_files_of_the_first_version_still_read(tmp_path):
    """Their checksum covered the arrays alone."""
    path = save_episode(tmp_path / "ring.npz", small_episode())
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "json"}
    old = edited(path, archive=None, sha256=_digest(arrays, None))
    assert load_episode(old).physics == {"mass": 0.3}


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
