"""The `topokit` command: what it answers and writes, and its exit codes."""

from __future__ import annotations

import dataclasses
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from topokit import track
from topokit.cli import main
from topokit.io import load_episode, load_states

from conftest import DATA, polygon

COMMANDS = ("track", "simulate", "hang", "generate", "train", "predict")


@pytest.fixture
def episode(tmp_path, episode_path) -> Path:
    return Path(shutil.copy(episode_path, tmp_path / "episode.npz"))


def answer_of(capsys, *arguments: object) -> dict:
    """Return what a command that ends well answers as JSON."""
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys, *arguments: object) -> str:
    """Return the one line that a refused command prints."""
    assert main([*map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


# -- calls ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("words", [["--help"], ["--version"], *([command, "--help"] for command in COMMANDS)], ids=str)
def test_help_imports_nothing_heavy(words):
    heavy = ["numpy", "scipy", "numba", "torch", "pybullet", "matplotlib", "pydantic", "pandas", "trimesh"]
    code = f"import atexit, sys; from topokit.cli import main\natexit.register(lambda: print({{*{heavy}}} & {{*sys.modules}}))\n"
    done = subprocess.run([sys.executable, "-c", f"{code}main({words})"], capture_output=True, text=True, check=True)
    *lines, imported = done.stdout.splitlines()
    assert imported == "set()"
    assert "topokit" in lines[0]


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        ([], "COMMAND"),
        (["trak"], "trak"),
        (["track", "a.npz", "--alhpa", "1"], "--alhpa"),
        (["track", "a.npz", "--memory", "1.5"], "--memory"),
        (["track", "a.npz", "b.npz"], "b.npz"),
        (["simulate"], "--out"),
        (["simulate", "--out", "a.npz", "--task", "moon"], "apron-hook"),
        (["generate", "--out", "x", "--episodes", "many"], "--episodes"),
        (["hang", "--film", "film.mp4"], ".html"),
    ],
    ids=str,
)
def test_wrong_calls_are_one_line(arguments, names, capsys):
    assert names in refused(capsys, *arguments)


# -- track ------------------------------------------------------------------------------------------------------------------


def test_the_neck_loop_keeps_one_name(episode, capsys):
    """One id in at least 95 % of the frames, and inside the hull of the true loop in at least 90 % of those."""
    answer = answer_of(capsys, "track", episode)
    longest = answer["tracks"][0]
    assert longest["frames"] >= 0.95 * answer["frames"]
    assert longest["in_hull"] >= 0.9
    assert 0 < longest["distance"] < 0.1


def test_tracks_as_an_archive_as_lines_and_as_a_picture(episode, tmp_path):
    recorded = load_episode(episode)
    expected = [state.as_dict() for state in track(recorded.points, times=recorded.times)]
    picture = tmp_path / "deep" / "tracks.png"
    assert main(["track", str(episode), "--out", str(tmp_path / "states.jsonl"), "--plot", str(picture)]) == 0
    assert [json.loads(line) for line in (tmp_path / "states.jsonl").read_text().splitlines()] == expected
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert main(["track", str(episode), "--out", str(tmp_path / "states.npz")]) == 0
    stored = [state.as_dict()["loops"] for state in load_states(tmp_path / "states.npz", recorded.points)]
    assert stored == [state["loops"] for state in expected]


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_track_takes_clouds(kind, tmp_path, capsys):
    ring = np.column_stack([polygon(60), np.zeros(60)])
    clouds = [
        ring,
        ring + [0, 0, 0.01],
        np.zeros((9, 3)),
        ring + [0, 0, 0.02],
    ]  # a camera that sees nothing writes zeros
    path = tmp_path / "film"
    if kind == "folder":
        path.mkdir()
        for number, cloud in enumerate(clouds):
            np.save(path / f"{number}.npy", cloud)
    else:
        path = path.with_suffix(".npy")
        np.save(path, ring)
    picture = tmp_path / "film.svg"
    answer = answer_of(capsys, "track", path, "--plot", picture)
    frames, empty = {"folder": (4, 1), "file": (1, 0)}[kind]
    assert (answer["frames"], answer.get("empty frames", 0), answer["plot"]) == (frames, empty, str(picture))
    assert [(row["id"], row["frames"]) for row in answer["tracks"]] == [(0, frames - empty)]
    assert b"</svg>" in picture.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (["nowhere.npz"], "nowhere.npz"),
        (["half.npz"], "half.npz"),
        (["episode.npz", "--alpha", "-1"], "alpha"),
        (["episode.npz", "--out", "episode.npz"], "episode.npz"),
        (["episode.npz", "--out", "tracks.csv"], ".jsonl"),
        (["episode.npz", "--plot", "a.txt"], ".png"),
    ],
    ids=str,
)
def test_bad_calls_of_track_write_nothing(arguments, names, episode, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("half.npz").write_bytes(episode.read_bytes()[:10_000])
    before = {path: path.read_bytes() for path in tmp_path.rglob("*")}
    assert names in refused(capsys, "track", *arguments)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*")} == before


# -- simulate, generate, train ----------------------------------------------------------------------------------------------


def test_a_film_that_does_not_end_well_has_another_exit_code(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pybullet")
    film = load_episode(DATA / "apron_hook_1.npz")
    monkeypatch.setattr("topokit.sim.simulate", lambda *_, **__: dataclasses.replace(film, success=False))
    out = tmp_path / "e.npz"
    assert main(["simulate", "--out", str(out), "--json"]) == 1
    assert not json.loads(capsys.readouterr().out)["success"]
    assert not load_episode(out).success


def test_train_takes_dataset_and_start_in_place_of_the_configuration_s(tmp_path, capsys):
    shares = {"train": 0.5, "validation": 0.5}
    entries = {"model": "motion", "dataset": "old", "start": "old.safetensors", "batch": 4, "split": {"shares": shares}}
    config = tmp_path / "train.json"
    config.write_text(json.dumps(entries))
    missing = refused(capsys, "train", config, "--dataset", tmp_path / "films", "--out", tmp_path / "out")
    assert f"{tmp_path / 'films'}: there is no dataset" in missing
    start = tmp_path / "mine.safetensors"
    arguments = ["--dataset", DATA / "motion", "--start", start, "--out", tmp_path / "out"]
    assert str(start) in refused(capsys, "train", config, *arguments)


# -- errors -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "code"),
    [(MemoryError("too large"), 2), (RuntimeError("it exploded"), 1), (KeyboardInterrupt(), 130)],
    ids=repr,
)
def test_what_ends_a_command_is_one_line(error, code, episode, monkeypatch, capsys):
    def broken(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("topokit.seqph.track", broken)
    assert main(["track", str(episode)]) == code
    message = capsys.readouterr().err
    assert message.startswith("topokit track: ")
    assert str(error) in message


@pytest.mark.parametrize(
    ("package", "use"),
    [
        ("pydantic", "from topokit.sim import SimulationConfig"),
        ("gymnasium", "from topokit.sim import HangEnv"),
        ("torch", "from topokit.models import Predictor"),
        ("matplotlib", "from topokit.view import plot_cloth"),
        ("torch", "main(['predict', 'a.safetensors', 'a.npz'])"),
    ],
)
def test_what_is_missing_is_named_with_the_extra_that_brings_it(package, use):
    code = f"import sys; from topokit.cli import main\nsys.modules[{package!r}] = None\n{use}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    last = done.stderr.splitlines()[-1]
    assert "pip install 'topokit[" in last
    assert package in last
