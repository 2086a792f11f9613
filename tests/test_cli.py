"""The `topokit` command: what it answers and writes, its exit codes, and how a signal ends it."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from sensor_files import cloud_message, depth_image, ring, save_bag, save_pcd

from topokit import track
from topokit.cli import main
from topokit.io import load_episode, load_states

from conftest import DATA, hear_ctrl_c, polygon

COMMAND = [sys.executable, "-m", "topokit"]
COMMANDS = ("track", "simulate", "mesh", "hang", "generate", "label", "check", "train", "predict")


@pytest.fixture
def episode(tmp_path, episode_path) -> Path:
    return Path(shutil.copy(episode_path, tmp_path / "episode.npz"))


@pytest.fixture
def film(tmp_path) -> Path:
    """Five organised clouds with NaN rows and colours, in millimetres."""
    folder = tmp_path / "film"
    folder.mkdir()
    for t in range(5):
        points = 1000 * ring(t, 400)
        points[::10] = np.nan
        save_pcd(folder / f"{t}.pcd", points)
    return folder


def answer_of(capsys, *arguments: object) -> dict:
    """Return what a command that ends well answers as JSON."""
    assert main([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys, *arguments: object) -> str:
    """Return the one line that a refused command prints."""
    assert main([*map(str, arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"topokit {arguments[0]}: error: ")
    assert captured.err.count("\n") == 1
    return captured.err


# -- calls ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_help(command, capsys):
    assert main(["--help"]) == 0
    assert command in capsys.readouterr().out
    assert main([command, "--help"]) == 0
    assert "--json" in capsys.readouterr().out


def test_version_and_no_command(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("topokit 0.")
    assert main([]) == 2
    assert "track" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (["track", "a.npz", "--alhpa", "1"], "--alpha"),
        (["track", "a.npz", "--loops", "all"], "--loops"),
        (["track", "a.npz", "--memory", "1.5"], "--memory"),
        (["track", "a.npz", "b.npz"], "b.npz"),
        (["simulate"], "--out"),
        (["generate", "--out", "x", "--episodes", "many"], "--episodes"),
    ],
)
def test_wrong_calls_are_one_line(arguments, names, capsys):
    assert names in refused(capsys, *arguments)


def test_a_command_that_there_is_not_is_named(capsys):
    assert main(["trak"]) == 2
    assert "trak" in capsys.readouterr().err


def test_help_imports_nothing_heavy():
    heavy = ["numpy", "scipy", "numba", "torch", "pybullet", "matplotlib", "pydantic", "pandas", "trimesh", "dask"]
    code = f"import sys; from topokit.cli import main; main(['track', '--help']); assert not {set(heavy)} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


# -- track: episodes --------------------------------------------------------------------------------------------------------


def test_track_prints_a_table_and_writes_the_tracks_where_it_is_told_to(episode, tmp_path, capsys):
    beside = set(episode.parent.iterdir())
    assert main(["track", str(episode)]) == 0
    out = capsys.readouterr().out
    assert "lifetime" in out
    assert "true loop" in out
    assert set(episode.parent.iterdir()) == beside  # a data set is not changed by a look at it
    tracks = tmp_path / "tracks.npz"
    assert main(["track", str(episode), "--out", str(tracks)]) == 0
    assert f"tracks: {tracks}" in capsys.readouterr().out
    assert len(load_states(tracks)) == len(load_episode(episode))


def test_the_neck_loop_keeps_one_name(episode, capsys):
    """One id in at least 95 % of the frames, and inside the hull of the true loop in at least 90 % of those."""
    answer = answer_of(capsys, "track", episode)
    longest = answer["loops"][0]
    assert longest["frames"] >= 0.95 * answer["frames"]
    assert longest["in_hull"] >= 0.9
    assert 0 < longest["distance"] < 0.1


def test_tracks_as_lines_and_as_a_picture(episode, tmp_path):
    picture = tmp_path / "deep" / "tracks.png"
    assert main(["track", str(episode), "--out", str(tmp_path / "states.jsonl"), "--plot", str(picture)]) == 0
    lines = [json.loads(line) for line in (tmp_path / "states.jsonl").read_text().splitlines()]
    recorded = load_episode(episode)
    assert lines == [state.as_dict() for state in track(recorded.points, times=recorded.times)]
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        ([], "--live"),
        (["--live", "episode.npz"], "--live"),
        (["--live", "--out", "t.npz"], "--out"),
        (["--live", "--topic", "/points"], "--topic"),
        (["nowhere.npz"], "nowhere.npz"),
        (["empty.npz"], "empty.npz"),
        (["half.npz"], "half.npz"),
        (["table.npz"], "table.npz"),
        (["episode.npz", "--alpha", "-1"], "alpha"),
        (["episode.npz", "--alpha", "nan"], "alpha"),
        (["episode.npz", "--epsilon", "inf"], "epsilon"),
        (["episode.npz", "--memory", "-1"], "memory"),
        (["episode.npz", "--out", "episode.npz"], "episode.npz"),
        (["episode.npz", "--out", "tracks.csv"], ".jsonl"),
        (["episode.npz", "--plot", "a.txt"], ".png"),
        (["episode.npz", "--out", "folder.npz"], "folder"),
        (["episode.npz", "--plot", "folder.npz/deep.png", "--out", "cloud.txt/t.npz"], "cloud.txt"),
        (["episode.npz", "--unit", "mm"], "--unit"),
        (["film"], "0.pcd"),
        (["film", "--unit", "mm", "--plot", "a.txt"], ".png"),
        (["film", "--unit", "mm", "--pipeline", "bad.json"], "voxels"),
        (["film", "--unit", "mm", "--columns", "a,b,c"], "no a"),
        (["cloud.txt"], ".txt"),
        (["depth.npy", "--intrinsics", "none.json"], "none.json"),
    ],
    ids=" ".join,
)
def test_bad_calls_of_track_write_nothing(arguments, names, episode, film, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("empty.npz").write_bytes(b"")
    Path("half.npz").write_bytes(episode.read_bytes()[:10_000])
    Path("table.npz").write_text("x,y,z\n")
    Path("bad.json").write_text('{"voxels": 1}')
    Path("cloud.txt").write_text("1 2 3")
    np.save("depth.npy", depth_image())
    Path("folder.npz").mkdir()
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert names in refused(capsys, "track", *arguments)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


# -- track: clouds in files -------------------------------------------------------------------------------------------------


def test_track_takes_a_film(film, tmp_path, capsys):
    (tmp_path / "how.json").write_text('{"points": 100, "voxel": 0.001}')
    arguments = ["track", film, "--unit", "mm", "--fps", "10", "--pipeline", tmp_path / "how.json"]
    answer = answer_of(capsys, *arguments, "--out", tmp_path / "film.npz")
    assert answer["removed"]["not finite"] == 5 * 40
    assert answer["removed"]["by farthest points"] == 5 * 260
    around = np.linalg.norm(np.diff(ring(4, 400), axis=0), axis=1).sum()
    assert answer["apart"] == pytest.approx(around / 100, rel=0.4)  # a ring of 100 points
    assert [loop["frames"] for loop in answer["loops"]] == [5]
    states = load_states(tmp_path / "film.npz")
    assert [state.time for state in states] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert [[loop.id for loop in state.loops] for state in states] == [[0]] * 5
    assert main([*map(str, arguments)]) == 0
    assert "nan" not in capsys.readouterr().out  # there is no true loop to compare with


def test_a_single_cloud_is_told_and_drawn(tmp_path, capsys):
    np.save(tmp_path / "ring.npy", ring())
    picture = tmp_path / "ring.svg"
    assert main(["track", str(tmp_path / "ring.npy"), "--plot", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "loop 0 is around (0.000, 0.000, 1.000) m, through 60 points" in out.replace("-0.000", "0.000")
    assert f"picture: {picture}" in out
    assert b"</svg>" in picture.read_bytes()


def test_track_takes_the_folder_that_it_runs_in(film, monkeypatch, capsys):
    monkeypatch.chdir(film)
    answer = answer_of(capsys, "track", ".", "--unit", "mm")
    assert answer["frames"] == 5
    assert answer["tracks"] is None


def test_tracks_of_one_file_do_not_spoil_its_folder(film, capsys):
    assert answer_of(capsys, "track", film / "3.pcd", "--unit", "mm")["frames"] == 1
    assert answer_of(capsys, "track", film, "--unit", "mm")["frames"] == 5


def test_track_takes_an_archive_that_topokit_did_not_write(tmp_path, capsys):
    np.savez(tmp_path / "film.npz", [ring(t) for t in range(3)])
    assert answer_of(capsys, "track", tmp_path / "film.npz")["frames"] == 3


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_names_that_the_terminal_cannot_show_are_escaped(episode, encoding):
    path = episode.rename(episode.with_name("Schürze 围裙.npz"))
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"}
    done = subprocess.run([*COMMAND, "track", str(path)], env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert rb"\u56f4\u88d9.npz" in done.stdout


def test_a_bag_is_tracked_into_lines(tmp_path):
    messages = [cloud_message(ring(t).reshape(6, 10, 3), 1 + t) for t in range(3)]
    bag = save_bag(tmp_path / "recording", {"/camera/points": messages, "/other": messages})
    out = tmp_path / "states.jsonl"
    assert main(["track", str(bag), "--topic", "/camera/points", "--out", str(out)]) == 0
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    assert [line["time"] for line in lines] == [1, 2, 3]
    assert [[loop["id"] for loop in line["loops"]] for line in lines] == [[0]] * 3


# -- track: a stream --------------------------------------------------------------------------------------------------------


def npy_of(*clouds: np.ndarray) -> bytes:
    stream = io.BytesIO()
    for cloud in clouds:
        np.save(stream, cloud)
    return stream.getvalue()


def live(data: bytes, *options: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*COMMAND, "track", "--live", *options], input=data, capture_output=True)


def test_live_reads_clouds_from_a_pipe():
    clouds = [np.column_stack([polygon(30), np.full(30, 0.01 * t)]) for t in range(3)]
    done = live(npy_of(*clouds), "--identity", "killer-triangles", "--memory", "2")
    assert done.returncode == 0, done.stderr
    states = [json.loads(line) for line in done.stdout.splitlines()]
    assert [state["frame"] for state in states] == [0, 1, 2]
    assert [[loop["id"] for loop in state["loops"]] for state in states] == [[0]] * 3
    assert states[2]["loops"][0]["centre"][2] == pytest.approx(0.02)


def test_live_names_the_frame_that_is_broken_and_keeps_those_before():
    whole = npy_of(polygon(30))
    done = live(whole + whole[:-8])
    assert done.returncode == 2
    assert len(done.stdout.splitlines()) == 1
    assert b"frame 1" in done.stderr


def test_live_leaves_out_what_is_not_finite_and_reports_it_once():
    frames = [ring(t) for t in range(3)]
    frames[1][7] = frames[2][3] = np.nan
    done = live(npy_of(*frames))
    assert done.returncode == 0, done.stderr
    assert [json.loads(line)["frame"] for line in done.stdout.splitlines()] == [0, 1, 2]
    (warning,) = done.stderr.splitlines()
    assert b"frame 1: 1 of 60 points" in warning


def test_live_takes_a_pipeline_and_asks_about_units_and_columns(tmp_path):
    frames = [np.column_stack([1000 * ring(t, 300), np.full((300, 3), 200)]) for t in range(2)]
    (tmp_path / "how.json").write_text('{"points": 50}')
    options = ["--unit", "mm", "--columns", "0,1,2", "--pipeline", str(tmp_path / "how.json")]
    done = live(npy_of(*frames), *options)
    assert done.returncode == 0, done.stderr
    assert [len(json.loads(line)["loops"]) for line in done.stdout.splitlines()] == [1, 1]
    for left, name in ((options[2:], b"--unit mm"), ([], b"--columns")):
        wrong = live(npy_of(*frames), *left)
        assert wrong.returncode == 2
        assert name in wrong.stderr


def test_a_live_track_that_is_stopped_reports_what_it_gave():
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([*COMMAND, "track", "--live"], **pipes, preexec_fn=hear_ctrl_c) as process:
        for _ in range(2):
            process.stdin.write(npy_of(polygon(30)))
            process.stdin.flush()
            assert json.loads(process.stdout.readline())["loops"]
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
        (line,) = process.stderr.read().splitlines()
        assert b"2 frames" in line


@pytest.mark.parametrize(
    ("line", "code", "names"),
    [
        ("topokit track --live < clouds.npy | head -1 > /dev/null; exit ${PIPESTATUS[0]}", 141, "reader has stopped"),
        ("topokit track --live < clouds.npy > /dev/full", 2, "standard output: No space left"),
        ("topokit track --live <&-", 2, "standard input is closed"),
        ("topokit track /dev/null", 2, "/dev/null"),
    ],
    ids=["a broken pipe", "a full disk", "no input", "a device"],
)
def test_the_ends_of_pipes(tmp_path, line, code, names):
    (tmp_path / "clouds.npy").write_bytes(npy_of(*[polygon(12)] * 400))
    words = line.replace("topokit", " ".join(COMMAND))
    done = subprocess.run(["bash", "-c", words], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert names in done.stderr
    assert "Traceback" not in done.stderr


# -- simulate, mesh ---------------------------------------------------------------------------------------------------------


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
    answer = answer_of(capsys, "simulate", "--mesh", bag / "bag.obj", "--out", out)
    assert (answer["garment"], answer["target"], answer["task"]) == ("bag", "hook", "bag-hook")
    assert answer["success"]
    assert list(load_episode(out).named_loops) == answer["loops"] == ["handle 1", "handle 2"]


def test_a_film_that_does_not_end_well_says_why_and_so_does_the_exit_code(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pybullet")
    film = load_episode(DATA / "apron_hook_1.npz")
    aside = dataclasses.replace(film, success=False, points=film.points + np.float32([0, -2, 0]))
    monkeypatch.setattr("topokit.sim.simulate", lambda *_, **__: aside)
    out = tmp_path / "e.npz"
    assert main(["simulate", "--out", str(out)]) == 1
    assert "it does not hang: the loop 'neck' never came around the hook" in capsys.readouterr().out
    assert main(["simulate", "--out", str(out), "--json"]) == 1
    assert "never came around" in json.loads(capsys.readouterr().out)["reason"]
    assert not load_episode(out).success


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (["--task", "apron-hook"], "neck"),
        (["--task", "moon"], "apron-hook"),
        (["--loops", "bag.obj"], "--loops bag.obj"),
        (["--loops", "number.json"], "--loops number.json"),
        (["--loops", "far.json"], "99999"),
        (["--unit", "m", "--size", "1"], "size"),
        (["--up", "up"], "--up"),
        (["--out", "episode.txt"], ".npz"),
    ],
    ids=" ".join,
)
def test_a_mesh_that_does_not_fit_is_refused(bag, options, names, capsys, monkeypatch):
    monkeypatch.chdir(bag)
    (bag / "number.json").write_text("3")
    (bag / "far.json").write_text('{"handle": [1, 2, 99999]}')
    out = [] if "--out" in options else ["--out", "episode.npz"]
    assert names in refused(capsys, "simulate", "--mesh", "bag.obj", *options, *out)
    assert not list(bag.glob("episode*"))


def test_mesh_reports_and_draws_what_is_understood(bag, capsys):
    picture = bag / "bag.png"
    command = ["mesh", str(bag / "bag.obj"), "--loops", str(bag / "loops.json"), "--unit", "cm", "--up", "z"]
    assert main([*command, "--plot", str(picture)]) == 0
    assert "handle 1" in capsys.readouterr().out
    assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    answer = answer_of(capsys, *command)
    assert list(answer["loops"]) == ["handle 1", "handle 2"]
    assert max(answer["metres"]) < 0.01
    assert ".svg" in refused(capsys, *command, "--plot", bag / "bag.txt")


# -- train ----------------------------------------------------------------------------------------------------------------


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
    ("error", "code"), [(MemoryError(), 2), (RuntimeError("it exploded"), 1), (KeyboardInterrupt(), 130)], ids=repr
)
def test_what_ends_a_command_is_one_line(error, code, episode, monkeypatch, capsys):
    def broken(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("topokit.seqph.track", broken)
    assert main(["track", str(episode)]) == code
    assert capsys.readouterr().err.startswith("topokit track: ")


def test_a_mistake_in_the_code_shows_where(episode, monkeypatch):
    def broken(*_: object, **__: object) -> None:
        raise TypeError("unsupported operand")

    monkeypatch.setattr("topokit.seqph.track", broken)
    with pytest.raises(TypeError, match="unsupported operand"):
        main(["track", str(episode)])


@pytest.mark.parametrize(
    ("package", "use"),
    [
        ("pydantic", "from topokit.sim import SimulationConfig"),
        ("gymnasium", "from topokit.sim import HangEnv"),
        ("torch", "from topokit.models import Predictor"),
        ("matplotlib", "from topokit.view import plot_cloth"),
        ("pydantic", "sys.argv[1:] = ['generate', '--out', 'x', '--episodes', '1']; run()"),
    ],
)
def test_what_is_missing_is_named_with_the_extra_that_brings_it(package, use, tmp_path):
    code = f"import sys; from topokit.__main__ import run\nsys.modules[{package!r}] = None\n{use}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    last = done.stderr.splitlines()[-1]
    assert "pip install 'topokit[" in last
    assert package in last


# -- signals ----------------------------------------------------------------------------------------------------------------

INTERRUPTED = """
import os, runpy, signal, sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[-1]:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupt())
runpy.run_module("topokit", run_name="__main__")
"""


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("module", ["topokit.cli", "cyclopts", "numpy", "numpy.linalg", "topokit.seqph"])
def test_ctrl_c_while_modules_are_imported_is_one_line_and_130(module, tmp_path):
    """The signal comes when that module is about to be imported: at the start, or when the command runs."""
    command = ["track", str(tmp_path / "none.npy"), "--topic", module]
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, *command], capture_output=True, text=True, preexec_fn=hear_ctrl_c
    )
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "topokit: stopped\n"


def test_importing_the_library_changes_no_signal():
    code = "import signal, topokit.cli, topokit.__main__; print(signal.getsignal(signal.SIGTERM) is signal.SIG_DFL)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"]


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_simulation_that_is_ended_leaves_no_temporary_file(tmp_path, number):
    pytest.importorskip("pybullet")
    room, out = tmp_path / "room", tmp_path / "out"
    room.mkdir()
    with subprocess.Popen(
        [*COMMAND, "simulate", "--out", str(out / "e.npz")],
        env={**os.environ, "TMPDIR": str(room)},
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hear_ctrl_c,
    ) as command:
        end = time.monotonic() + 60
        while not any(room.iterdir()):  # the folder of the process that simulates
            assert time.monotonic() < end
            time.sleep(0.01)
        command.send_signal(number)
        _, message = command.communicate(timeout=60)
    assert (command.returncode, message) == (128 + number, "topokit simulate: stopped; nothing is half written\n")
    assert not list(room.iterdir())
    assert not out.exists()


ENDED = """
import os, runpy, signal, sys

made = os.mkdir

def end_when_made(path, *arguments, **options):
    made(path, *arguments, **options)
    if "topokit-" in str(path):
        os.kill(os.getpid(), signal.SIGTERM)

os.mkdir = end_when_made
runpy.run_module("topokit", run_name="__main__")
"""


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_signal_leaves_no_folder_that_was_just_made(tmp_path):
    pytest.importorskip("pybullet")
    room, out = tmp_path / "room", tmp_path / "out"
    room.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", ENDED, "simulate", "--out", str(out / "e.npz")],
        env={**os.environ, "TMPDIR": str(room)},
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hear_ctrl_c,
    )
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert not list(room.iterdir())


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_a_half_written_file_is_taken_away(tmp_path):
    code = """
import os, signal, sys
from topokit import __main__, _archive, cli

def work():
    with _archive.atomic_file(sys.argv[1]) as handle:
        handle.write(bytes(1000))
        os.kill(os.getpid(), signal.SIGTERM)

cli.main = work
sys.exit(__main__.run())
"""
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.npz")], capture_output=True, text=True)
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert not list(tmp_path.iterdir())
