"""The `topokit` command on a recorded episode and on files that are none."""

from __future__ import annotations

import io
import json
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from topokit.cli import main
from topokit.io import load_episode, load_states

from conftest import hear_ctrl_c, polygon


@pytest.fixture
def episode(tmp_path, episode_path):
    return shutil.copy(episode_path, tmp_path / "episode.npz")


def test_track_prints_a_table_and_writes_the_tracks(episode, capsys, tmp_path):
    assert main(["track", str(episode)]) == 0
    out = capsys.readouterr().out
    assert "lifetime" in out
    assert "true loop" in out
    states = load_states(tmp_path / "episode.tracks.npz")
    assert len(states) >= 76


def test_the_neck_loop_keeps_one_name(episode, capsys, tmp_path):
    """Under one id in at least 95 % of the frames, and in the hull of the true loop in at least 90 % of those."""
    assert main(["track", str(episode), "--json", "--out", str(tmp_path / "t.npz")]) == 0
    answer = json.loads(capsys.readouterr().out)
    longest = answer["loops"][0]
    assert longest["frames"] >= 0.95 * answer["frames"]
    assert longest["in_hull"] >= 0.9
    assert 0 < longest["distance"] < 0.1


def test_plot(episode, tmp_path):
    picture = tmp_path / "deep" / "tracks.png"
    assert main(["track", str(episode), "--plot", str(picture)]) == 0
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere.npz"], "nowhere.npz: there is no such file"),
        (["empty.npz"], "empty"),
        (["half.npz"], "truncated or damaged"),
        (["table.npz"], "not a topokit episode"),
        (["episode.npz", "--alpha", "-1"], "alpha must be zero or more"),
        (["episode.npz", "--out", "episode.npz"], "that is the episode itself"),
        (["episode.npz", "--out", "tracks.csv"], "ends in .npz"),
    ],
)
def test_bad_calls_say_what_is_wrong_and_write_nothing(arguments, says, episode, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    raw = (tmp_path / "episode.npz").read_bytes()
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "half.npz").write_bytes(raw[: len(raw) // 2])
    (tmp_path / "table.npz").write_text("x,y,z\n")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(["track", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("topokit track: error: ")
    assert says in captured.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_simulate_refuses_a_bad_name_before_it_works(capsys):
    assert main(["simulate", "--out", "episode.txt"]) == 2
    assert "ends in .npz" in capsys.readouterr().err


@pytest.fixture
def bag(tmp_path):
    """A mesh file of a coarse bag of two handles, and its loops."""
    pytest.importorskip("pybullet")
    from topokit.sim import Garment

    tote = Garment.tote(handles=2, spacing=0.045)
    rows = ["v {} {} {}".format(*place) for place in tote.vertices]
    rows += ["f {} {} {}".format(*corners) for corners in tote.faces + 1]
    (tmp_path / "bag.obj").write_text("\n".join(rows))
    loops = {name: loop.tolist() for name, loop in tote.named_loops.items()}
    (tmp_path / "loops.json").write_text(json.dumps(loops))
    return tmp_path


def test_simulate_takes_a_mesh(bag, capsys):
    out = bag / "episode.npz"
    assert main(["simulate", "--mesh", str(bag / "bag.obj"), "--json", "--out", str(out)]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["garment"], answer["target"], answer["task"]) == ("bag", "hook", "bag-hook")
    assert answer["loops"] == ["handle 1", "handle 2"]
    assert answer["success"]
    assert list(load_episode(out).named_loops) == answer["loops"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--task", "apron-hook"], "apron-hook asks for the loops neck; the bag has handle 1, handle 2"),
        (["--task", "moon"], "there is no such task; there are apron-hook, "),
        (["--loops", "bag.obj"], "--loops bag.obj: no JSON"),
        (["--loops", "number.json"], "it must hold lists of vertex ids"),
        (["--loops", "far.json"], "names vertex 99999"),
        (["--unit", "m", "--size", "1"], "give size or scale, not both"),
    ],
)
def test_a_mesh_that_does_not_fit_is_refused_before_anything_is_simulated(bag, options, says, capsys, monkeypatch):
    monkeypatch.chdir(bag)
    monkeypatch.setattr("topokit.sim._episode.record_afresh", None)
    (bag / "number.json").write_text("3")
    (bag / "far.json").write_text('{"handle": [1, 2, 99999]}')
    assert main(["simulate", "--mesh", "bag.obj", *options, "--out", "episode.npz"]) == 2
    assert says in capsys.readouterr().err
    assert not (bag / "episode.npz").exists()


def test_mesh_says_and_shows_what_is_understood(bag, capsys):
    picture = bag / "bag.png"
    command = ["mesh", str(bag / "bag.obj"), "--loops", str(bag / "loops.json"), "--unit", "cm"]
    assert main([*command, "--plot", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "0.01 m" in out
    assert "handle 1: " in out
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert main([*command, "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["loops"]) == ["handle 1", "handle 2"]
    assert main([*command, "--plot", str(bag / "bag.txt")]) == 2
    assert "ends in .png, .svg, .pdf" in capsys.readouterr().err


def test_help_and_version(capsys):
    for arguments in (["--help"], ["track", "--help"], ["simulate", "--help"], ["--version"]):
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert stop.value.code == 0
    assert "topokit 0" in capsys.readouterr().out


def test_recorded_episodes_follow_the_format(episode_path):
    from topokit.io import load_episode

    for path in sorted(episode_path.parent.glob("apron_hook_*.npz")):
        episode = load_episode(path)
        assert len(episode) >= 76
        assert episode.observed.shape[1:] == (500, 3)
        assert episode.success
        assert episode.held[0]
        assert not episode.held[-1]
        loop = episode.points[:, episode.loops[0]]
        assert np.linalg.norm(loop - np.roll(loop, 1, axis=1), axis=2).max() < 0.08  # a cycle of mesh edges, in metres


def live(data: bytes, *options: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "topokit", "track", "--live", *options], input=data, capture_output=True
    )


def test_live_reads_clouds_from_a_pipe():
    stream = io.BytesIO()
    for t in range(3):
        np.save(stream, np.column_stack([polygon(30), np.full(30, 0.01 * t)]))
    done = live(stream.getvalue(), "--identity", "killer-triangles", "--memory", "2")
    assert done.returncode == 0, done.stderr
    states = [json.loads(line) for line in done.stdout.splitlines()]
    assert [state["frame"] for state in states] == [0, 1, 2]
    assert [[loop["id"] for loop in state["loops"]] for state in states] == [[0]] * 3
    assert states[2]["loops"][0]["centre"][2] == pytest.approx(0.02)


def test_live_says_which_frame_is_broken_and_keeps_those_before():
    stream = io.BytesIO()
    np.save(stream, polygon(30))
    whole = stream.getvalue()
    done = live(whole + whole[:-8])
    assert done.returncode == 2
    assert len(done.stdout.splitlines()) == 1
    assert b"frame 1 on standard input is no whole .npy array" in done.stderr
    pickled = io.BytesIO()
    np.lib.format.write_array_header_1_0(pickled, {"descr": "|O", "fortran_order": False, "shape": (1,)})
    refused = live(pickled.getvalue())
    assert refused.returncode == 2
    assert b"frame 0" in refused.stderr


@pytest.mark.parametrize(
    "arguments", [["track"], ["track", "--live", "episode.npz"], ["track", "--live", "--out", "t.npz"]]
)
def test_track_needs_one_source(arguments, capsys):
    assert main(arguments) == 2
    assert "--live" in capsys.readouterr().err


def test_a_live_track_that_is_stopped_says_what_it_gave():
    command = [sys.executable, "-m", "topokit", "track", "--live"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, preexec_fn=hear_ctrl_c) as process:
        for _ in range(2):
            stream = io.BytesIO()
            np.save(stream, polygon(30))
            process.stdin.write(stream.getvalue())
            process.stdin.flush()
            assert json.loads(process.stdout.readline())["loops"]
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
        assert process.stderr.read().decode().strip() == "topokit track: stopped after 2 frames, which were printed"


def test_a_mistake_in_the_code_shows_where(episode, monkeypatch):
    def broken(*_: object, **__: object) -> None:
        raise TypeError("unsupported operand")

    monkeypatch.setattr("topokit.cli.track", broken)
    with pytest.raises(TypeError, match="unsupported operand"):
        main(["track", str(episode)])


def test_arrays_that_hold_no_numbers_are_bad_input():
    stream = io.BytesIO()
    np.save(stream, np.zeros((5, 3), dtype=complex))
    done = live(stream.getvalue())
    assert done.returncode == 2
    assert (
        done.stderr.decode().strip()
        == "topokit track: error: frame 0 on standard input: the array must hold real numbers, not complex128"
    )
