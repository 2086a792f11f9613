"""The `topokit` command: each command is a function of this file, and its options are the function's own parameters.

Exit code 0 when all is well, 1 when the work failed, 2 when the input or the call is wrong or there is no room, 141 when nobody
reads the output any more, 128 and the number of the signal that stopped it, 130 for Ctrl-C. What a command needs is imported
when it runs.
"""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter, Token

from . import __version__
from ._strangers import printable

if TYPE_CHECKING:
    from .io import Episode
    from .sensors import Cleaner
    from .seqph import TopologicalState
    from .sim import Garment, Task

app = App(
    name="topokit",
    help="Find the loops of deformable objects in clouds of points, follow them, forecast them, and hang garments by them.",
    version=f"topokit {__version__}",
    default_parameter=Parameter(negative=(), show_default=False),
    help_format="plaintext",
    result_action="return_value",
    suppress_keyboard_interrupt=False,
    exit_on_error=False,
    print_error=False,
)

PICTURES = (".png", ".svg", ".pdf")
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (those of the process when None) and return its exit code."""
    if arguments is None:
        arguments = sys.argv[1:]
    command = "topokit"
    if arguments and arguments[0] in list(app):
        command = f"topokit {arguments[0]}"
    try:
        code = app(list(arguments))
        print(end="", flush=True)  # here, where an error of the output can still be reported
        if not arguments:
            return 2  # no command was given, so the help was printed
        return code or 0
    except CycloptsError as error:
        return _report(command, f"error: {_one_line(error)} (see {command} --help)", 2)
    except ModuleNotFoundError as error:
        return _report(command, f"error: {error.name} is not installed: pip install 'topokit[all]'", 2)
    except BrokenPipeError as error:
        return _report(command, f"error: {_of_output(error, 'its reader has stopped, files are written')}", 141)
    except MemoryError as error:
        return _report(command, f"error: {str(error) or 'not enough memory for so much at a time'}", 2)
    except OSError as error:
        message = str(error)
        if error.errno == errno.ENOSPC:
            message = _of_output(error, "make room, and repeat the command")
        return _report(command, f"error: {message}", 2)
    except (ValueError, ImportError) as error:  # any other error is a mistake of ours and shows its traceback
        return _report(command, f"error: {error}", 2)
    except RuntimeError as error:  # the input was right, and the work failed, as a simulation that exploded
        return _report(command, f"failed: {error}", 1)
    except KeyboardInterrupt as error:
        return _report(command, str(error) or "stopped; nothing is half written", 130)


def _report(command: str, message: str, code: int) -> int:
    print(f"{command}: {printable(message)}", file=sys.stderr)
    return code


def _print(line: str) -> None:
    """Print a line that may hold names of strangers: of files, garments, loops."""
    print(printable(line))


def _one_line(error: CycloptsError) -> str:
    return " ".join(str(error).split()).removesuffix(".")


def _of_output(error: OSError, advice: str) -> str:
    """Return the message of a file, or of standard output, that takes no more."""
    if error.filename is None:
        # What waits for standard output is dropped, because Python would try to write it again at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return f"{error.filename or 'standard output'}: {error.strerror}; {advice}"


# -- parameters that several commands share ---------------------------------------------------------------------------------


def _whole(kind: type, tokens: Sequence[Token]) -> int:
    """Convert a word to a whole number; cyclopts itself would round 1.5."""
    return int(tokens[0].value)


Whole = Annotated[int, Parameter(converter=_whole)]
Json = Annotated[bool, Parameter(name="--json", help="Print the answer as JSON.")]
Quiet = Annotated[bool, Parameter(help="Show no progress.")]


@Parameter(name="*", group="Mesh")
@dataclass(frozen=True)
class MeshOptions:
    """Options for reading the mesh of a garment.

    Attributes
    ----------
    loops
        Loops of the mesh: auto (default), borders, or a file of vertex ids: {NAME: [ID, ...], ...} or [[ID, ...], ...] (.json).
    unit
        Unit of the mesh (default: the unit that makes it as large as a garment).
    size
        Largest extent of the mesh in metres, instead of a unit.
    up
        The axis of the mesh that points up (default: found).
    max_vertices
        Most vertices; a finer mesh is simplified (default: 3000).
    """

    loops: str | None = None
    unit: Literal["m", "cm", "mm", "in"] | None = None
    size: float | None = None
    up: Annotated[Literal["x", "y", "z", "-x", "-y", "-z"] | None, Parameter(allow_leading_hyphen=True)] = None
    max_vertices: Whole | None = None


@Parameter(name="*", group="Clouds")
@dataclass(frozen=True)
class CloudOptions:
    """Options for reading clouds that topokit did not record.

    Attributes
    ----------
    pipeline
        Steps that clean each cloud (.json).
    unit
        Unit of the clouds (default: metres; millimetres for depth images).
    columns
        Indices or names of the numbers of a point that are its place, as 0,1,2.
    intrinsics
        Intrinsics fx, fy, cx and cy of a depth camera (.json).
    topic
        Topic of a bag.
    fps
        Frames a second, of clouds without times.
    """

    pipeline: Path | None = None
    unit: Literal["m", "cm", "mm"] | None = None
    columns: str | None = None
    intrinsics: Path | None = None
    topic: str | None = None
    fps: float | None = None

    def given(self) -> list[str]:
        """Return the names of the options that were given."""
        return [name for name, value in vars(self).items() if value is not None]

    def chosen_columns(self) -> list[int | str] | None:
        if self.columns is None:
            return None
        return [int(word) if word.isdigit() else word for word in self.columns.split(",")]

    def cleaner(self) -> Cleaner:
        from .sensors import Cleaner, Pipeline

        if self.pipeline is None:
            return Cleaner()

        from ._config import load  # needs pydantic

        return Cleaner(load(Pipeline, self.pipeline))


@Parameter(name="*", group="Tracker")
@dataclass(frozen=True)
class TrackerOptions:
    """Options of the tracker, `topokit.SeqPH`.

    Attributes
    ----------
    alpha
        Sampling in metres (default: estimated).
    beta
        Jitter of killers in metres (default: estimated).
    epsilon
        Motion of a frame in metres (default: estimated).
    paper
        Use the tracker of the paper; other options replace its own.
    loops
        Rule by which bars are loops (default: evidence, without --alpha).
    gates
        Limits on the motion of a loop (default: near).
    identity
        Place of a loop (default: killer-triangles; the paper's killer edge can jump).
    memory
        Number of frames for which a missed loop is remembered (default: 40).
    """

    alpha: float | None = None
    beta: float | None = None
    epsilon: float | None = None
    paper: bool = False
    loops: Literal["evidence", "alpha"] | None = None
    gates: Literal["near", "proved", "paper"] | None = None
    identity: Literal["killer-edge", "killer-triangles", "cycle"] | None = None
    memory: Whole | None = None

    def chosen(self) -> dict[str, Any]:
        """Return the given options, by the names of the parameters of `SeqPH`."""
        from .seqph import PAPER

        options = {name: value for name, value in vars(self).items() if name != "paper" and value is not None}
        if self.paper:
            return {**PAPER, **options}
        return options


@Parameter(name="*", group="Processes")
@dataclass(frozen=True)
class ClusterOptions:
    """Options for the work on many episodes.

    Attributes
    ----------
    workers
        Processes on this machine (default: one a core).
    scheduler
        Address of a Dask scheduler whose workers have access to the same folder.
    """

    workers: Whole | None = None
    scheduler: str | None = None


def _check_output(option: str, path: Path | None, suffixes: Sequence[str]) -> None:
    """Raise ValueError, before any work, when a path is given that is no place for a file with one of the suffixes."""
    if path is None:
        return
    if path.suffix not in suffixes:
        raise ValueError(f"{option} {path}: the name must end in {', '.join(suffixes)}")
    if path.is_dir():
        raise ValueError(f"{option} {path}: that is a folder; name a file")
    # Folders that are missing will be made.
    folder = next(parent for parent in path.absolute().parents if os.path.lexists(parent))
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise ValueError(f"{option} {path}: nothing can be written in {folder}")


# -- track ------------------------------------------------------------------------------------------------------------------


@app.command
def track(
    episode: Path | None = None,
    /,
    *,
    live: bool = False,
    out: Path | None = None,
    plot: Path | None = None,
    cloud: Literal["points", "observed"] = "points",
    clouds: CloudOptions = CloudOptions(),
    tracker: TrackerOptions = TrackerOptions(),
    as_json: Json = False,
) -> int:
    """Follow the loops of a recorded episode, of clouds in files, or of clouds as they come.

    Parameters
    ----------
    episode
        A recorded episode (.npz), or clouds: .npy, .npz, .ply, .pcd, depth images (.png), a bag of ROS 1 or 2, a folder of files.
    live
        Read clouds from standard input, .npy arrays one after another, and print a line of JSON for each as it comes.
    out
        File to write the tracks to (.npz), or a line of JSON for each frame (.jsonl).
    plot
        Also draw the tracks of an episode, or the last of the clouds with its loops, with z up and as a camera sees it (.png,
        .svg or .pdf).
    cloud
        Episodes: all vertices (default), or their observed sample.
    """
    # A stream has no file: options of files are refused.
    if live:
        files = {"an episode": episode, "--out": out, "--plot": plot, "--topic": clouds.topic, "--fps": clouds.fps}
        if given := [name for name, value in files.items() if value is not None]:
            raise ValueError(f"--live reads standard input and writes standard output: leave out {', '.join(given)}")
        return _track_live(clouds, tracker)
    if episode is None:
        raise ValueError("name an episode or clouds, or give --live to read clouds from standard input")
    _check_tracks_file(episode, out)
    _check_output("--plot", plot, PICTURES)

    # Options that do not apply to this kind of input are refused.
    if _is_archive_of_ours(episode):
        if given := clouds.given():
            raise ValueError(f"--{given[0]} is for clouds, and {episode} is an episode: leave it out")
        return _track_episode(episode, out, plot, cloud, tracker, as_json)
    return _track_clouds(episode, out, plot, clouds, tracker, as_json)


def _is_archive_of_ours(path: Path) -> bool:
    """Return whether a file is an archive that topokit wrote; one that is damaged counts as one."""
    from ._archive import is_archive

    if path.suffix != ".npz":
        return False
    return is_archive(path)


def _check_tracks_file(episode: Path, out: Path | None) -> None:
    """Raise ValueError when the tracks cannot be written there."""
    if out is not None and out.resolve() == episode.resolve():
        raise ValueError(f"--out {out}: that is the episode itself")
    _check_output("--out", out, (".npz", ".jsonl"))


def _track_episode(
    path: Path, out: Path | None, plot: Path | None, cloud: str, tracker: TrackerOptions, as_json: bool
) -> int:
    """Track an episode, and compare the tracks with its true loops."""
    from ._archive import atomic_file
    from .evaluate import summarise_tracks
    from .io import load_episode
    from .seqph import track as track_sequence

    if plot is not None:
        from .view import track_figure  # before the work, so that a missing matplotlib is reported at once
    episode = load_episode(path)

    # Follow the loops, compare them with the true ones, and write.
    options = tracker.chosen()
    progress = sys.stderr.isatty() and not as_json
    states = track_sequence(getattr(episode, cloud), times=episode.times, progress=progress, **options)
    rows = [dataclasses.asdict(row) for row in summarise_tracks(states, episode.points, episode.loops)]
    if plot is not None:
        with atomic_file(plot) as picture:
            track_figure(episode, states).savefig(picture, format=plot.suffix[1:])
    _write_states(out, states)

    if as_json:
        print(json.dumps({"episode": str(path), "frames": len(states), "tracks": _name_of(out), "loops": rows}))
        return 0
    _print(f"{path}: {episode.garment} to {episode.target}, {len(states)} frames, {cloud}")
    print("  id  first  last  frames  lifetime  true loop  distance  in hull")
    for row in rows:
        true_loop = row["true_loop"] if row["true_loop"] >= 0 else "-"
        compared = f"{true_loop:>9} {100 * row['distance']:>6.2f} cm {100 * row['in_hull']:>6.1f} %"
        print(f"{_row_of_track(row)}  {compared}")
    _print_where(rows, out, plot)
    return 0


def _track_clouds(
    path: Path, out: Path | None, plot: Path | None, clouds: CloudOptions, tracker: TrackerOptions, as_json: bool
) -> int:
    """Track clouds that topokit did not record, each of them cleaned first."""
    from collections import Counter

    import numpy as np
    from scipy.spatial import cKDTree

    from ._archive import FormatError
    from .evaluate import summarise_tracks
    from .sensors import read_clouds
    from .seqph import SeqPH

    if plot is not None:
        from . import view  # noqa: F401 - before the work, so that a missing matplotlib is reported at once
    follower = SeqPH(**tracker.chosen())
    clean = clouds.cleaner()
    last: Any = None  # the last cloud that has points, and its state
    film = read_clouds(
        path,
        unit=clouds.unit,
        columns=clouds.chosen_columns(),
        intrinsics=clouds.intrinsics,
        topic=clouds.topic,
        fps=clouds.fps,
    )
    states: list[TopologicalState] = []
    removed = Counter[str]()
    blind = 0
    try:
        for time, cloud in film:
            left = clean(cloud)
            removed.update(clean.removed)
            if len(left):
                states.append(follower.update(left, time=time))
                last = (left, states[-1])
            else:
                states.append(follower.skip(time=time))
                blind += 1
    except FormatError:  # it names the file
        raise
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if blind == len(states):
        raise ValueError(f"{path}: {_nothing_left(blind, removed)}")
    if plot is not None:
        _plot_cloud(plot, *last)
    _write_states(out, states)

    # How far the points of the last cloud are apart, in the median.
    left, _ = last
    apart = float(np.median(cKDTree(left).query(left, k=2)[0][:, 1])) if len(left) > 1 else None

    # There is no true loop to compare with.
    names = ("id", "first", "last", "frames", "lifetime")
    summaries = summarise_tracks(states, np.empty((len(states), 0, 3)), ())
    rows = [{name: getattr(summary, name) for name in names} for summary in summaries]
    if as_json:
        answer = {"film": str(path), "removed": removed, "apart": apart, "frames": len(states), "blind": blind}
        answer["tracks"] = _name_of(out)
        print(json.dumps({**answer, "loops": rows}))
        return 0
    unseen = f", {blind} of them without a point" if blind else ""
    _print(f"{path}: {len(states)} {'frame' if len(states) == 1 else 'frames'}{unseen}")
    print(
        "points removed per frame: " + ", ".join(f"{count / len(states):.0f} {step}" for step, count in removed.items())
    )
    if apart is not None and removed["by farthest points"]:
        print(
            f"{len(left)} points are left, {100 * apart:.2g} cm apart: holes below about {300 * apart:.2g} cm are too small "
            "to see (crop the clouds, or keep more points, in --pipeline)"
        )
    print("  id  first  last  frames  lifetime")
    for row in rows:
        print(_row_of_track(row))
    if len(states) == 1:
        for loop in states[0].loops:
            x, y, z = loop.cycle_points.mean(axis=0)
            print(f"   loop {loop.id} is around ({x:.3f}, {y:.3f}, {z:.3f}) m, through {len(loop.cycle)} points")
    _print_where(rows, out, plot)
    return 0


def _plot_cloud(path: Path, points: Any, state: TopologicalState) -> None:
    """Draw a cloud, and around each of its loops the cycle and the killer triangles.

    A file does not say whether z is up or leads away from a camera, so both views are drawn.
    """
    from matplotlib.figure import Figure

    from ._archive import atomic_file
    from .view import plot_cloth

    figure = Figure(figsize=(12, 6), dpi=120)
    views = {"z up": (-60, 12), "as a camera sees it: x right, y down": (-90, -90)}
    for column, (title, view) in enumerate(views.items(), 1):
        axes: Any = figure.add_subplot(1, 2, column, projection="3d", title=title)
        plot_cloth(points, ax=axes, loops=state.loops, true_loops=[loop.cycle for loop in state.loops], view=view)
        for loop in state.loops:
            axes.text(*loop.cycle_points.mean(axis=0), f"{loop.id}", ha="center", zorder=6)
    with atomic_file(path) as picture:
        figure.savefig(picture, format=path.suffix[1:])


def _nothing_left(frames: int, removed: dict[str, int]) -> str:
    """Return why a film gives no state."""
    if not frames:
        return "it holds no cloud"
    counts = ", ".join(f"{count} {name}" for name, count in removed.items())
    return f"nothing is left of {frames} frames: removed were {counts}; check box and units"


def _write_states(path: Path | None, states: Sequence[TopologicalState]) -> None:
    if path is None:
        return
    from ._archive import atomic_file
    from .io import save_states

    if path.suffix == ".npz":
        save_states(path, states)
        return
    with atomic_file(path) as lines:
        for state in states:
            lines.write(f"{json.dumps(state.as_dict())}\n".encode())


def _row_of_track(row: dict[str, Any]) -> str:
    return f"{row['id']:>4} {row['first']:>6} {row['last']:>5} {row['frames']:>7} {100 * row['lifetime']:>6.2f} cm"


def _print_where(rows: Sequence[Any], out: Path | None, plot: Path | None) -> None:
    """Print what was written, and that there is no loop where there is none."""
    if not rows:
        print("   no loop in any frame")
    _print_files(tracks=out, picture=plot)


def _print_files(**files: Path | None) -> None:
    """Print which files were written."""
    for what, path in files.items():
        if path is not None:
            _print(f"{what}: {path}")


def _name_of(path: Path | None) -> str | None:
    """Return a path for JSON."""
    return None if path is None else str(path)


def _track_live(clouds: CloudOptions, tracker: TrackerOptions) -> int:
    """Track clouds as they come; the memory does not grow."""
    from .sensors import read_stream
    from .seqph import SeqPH

    follower = SeqPH(**tracker.chosen())
    if sys.stdin is None:
        raise ValueError("standard input is closed; pipe the clouds in")
    stream = read_stream(
        sys.stdin.buffer,
        unit=clouds.unit,
        columns=clouds.chosen_columns(),
        intrinsics=clouds.intrinsics,
        check_unit=clouds.pipeline is not None,  # lengths in a pipeline are metres
    )
    prepared = _finite(stream) if clouds.pipeline is None else map(clouds.cleaner(), stream)
    frames = 0
    blind = 0
    try:
        for cloud in prepared:
            state = follower.update(cloud) if len(cloud) else follower.skip()
            frames += 1
            blind += not len(cloud)
            print(json.dumps(state.as_dict()), flush=True)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped after {frames} frames, which were printed") from None
    if blind:
        print(f"topokit track: {blind} of {frames} frames had no point, and are frames without loops", file=sys.stderr)
    return 0


def _finite(clouds: Iterator[Any]) -> Iterator[Any]:
    """Yield clouds without the points that are not finite, which is reported once."""
    import numpy as np

    reported = False
    for number, cloud in enumerate(clouds):
        finite = np.isfinite(cloud).all(axis=1)
        if not reported and not finite.all():
            lost = f"frame {number}: {(~finite).sum()} of {len(finite)} points are not finite and left out"
            print(f"topokit track: {lost}, here and in what follows", file=sys.stderr)
            reported = True
        yield cloud[finite]


# -- simulate, mesh, hang ---------------------------------------------------------------------------------------------------


@app.command
def simulate(
    *,
    out: Path,
    task: str | None = None,
    seed: Whole = 0,
    randomise: bool = False,
    cameras: Whole = 0,
    noise: bool = False,
    observed: Whole | None = None,
    time_limit: float = 60.0,
    mesh: Path | None = None,
    mesh_options: MeshOptions = MeshOptions(),
    as_json: Json = False,
) -> int:
    """Record an episode: a garment carried to a target and let go there; the exit code is 1 when it does not hang.

    A task is a garment and a target, such as tote-hook. There are
      -hook, -hanger: apron apron2 tote tote2 backpack mask sheet sheet2
                      scarf belt net trousers
      -mannequin: apron apron2 backpack shirt vest
    With --mesh, hook, hanger and mannequin alone are tasks too.

    Parameters
    ----------
    out
        File for the episode (.npz).
    task
        Garment and target (default: apron-hook; hook with --mesh).
    seed
        Seed of everything random (default: 0).
    randomise
        Draw physics, size and cameras, not only the path.
    cameras
        Number of depth cameras around the target that observe the garment.
    noise
        Give the cameras the noise of a depth sensor.
    observed
        Number of points of an observation (default: 500, or all vertices if fewer).
    time_limit
        Seconds without progress after which a simulation is stopped (default: 60).
    mesh
        A garment of one's own (.obj, .ply, .stl).
    """
    from .io import save_episode
    from .sim import Camera, DepthNoise, Randomisation, explain
    from .sim import simulate as run_simulation

    _check_output("--out", out, (".npz",))
    if cameras < 0 or (noise and not cameras):
        raise ValueError(f"--cameras {cameras}: a number of cameras, one at least with --noise")
    garment, chosen = _garment_and_task(mesh, mesh_options, task, "apron-hook")
    depth_noise = DepthNoise() if noise else None
    around: Sequence[Camera] = ()
    if cameras:
        around = Camera.around(chosen.target.seat, cameras, distance=2.2, noise=depth_noise)
    episode = run_simulation(
        garment,
        task=chosen,
        seed=seed,
        randomisation=Randomisation() if randomise else None,
        cameras=around,
        n_observed=observed,
        time_limit=time_limit,
        progress=True,
    )
    save_episode(out, episode)
    reason = explain(episode, chosen)

    answer = {
        "episode": str(out),
        "task": episode.task,
        "seed": episode.seed,
        "garment": episode.garment,
        "target": episode.target,
        "loops": list(episode.named_loops),
        "frames": len(episode),
        "vertices": episode.points.shape[1],
        "observed": episode.observed.shape[1],
        "success": episode.success,
        "reason": reason or "it hangs",
    }
    if as_json:
        print(json.dumps(answer))
        return int(not episode.success)
    size = f"{answer['frames']} frames, {answer['vertices']} vertices"
    outcome = f"it does not hang: {reason}" if reason else "it hangs"
    _print(f"{out}: {episode.garment} to {episode.target}, {size}; {outcome}")
    return int(not episode.success)


def _garment_and_task(path: Path | None, options: MeshOptions, task: str | None, default: str) -> tuple[Any, Task]:
    """Return the garment of a mesh, None when none is given, and the chosen task."""
    from .sim import TASKS, Hanger, Hook, Mannequin, task_for

    # A garment of one's own has no task of its own name; its targets are enough.
    targets: dict[str, Any] = {}
    if path is not None:
        targets = {target.name: target for target in (Hook, Hanger, Mannequin)}
        default = "hook"
    name = task or default
    if name not in TASKS and name not in targets:
        raise ValueError(f"--task {name}: there is no such task; there are {', '.join([*TASKS, *targets])}")
    # Without a mesh, options of meshes are refused.
    if path is None:
        given = [option for option, value in vars(options).items() if value is not None]
        if given:
            raise ValueError(f"--{given[0]} is an option of meshes: give --mesh FILE, or leave it out")
        return None, TASKS[name]
    garment = _garment(path, options).evened()
    if name in targets:
        own = task_for(garment, targets[name]().raised_for(garment))
        if not own.loops:
            raise ValueError(
                f"{path}: its loops are {', '.join(garment.loop_names)}, and a garment is not hung by these"
            )
        return garment, own
    return garment, TASKS[name]


def _garment(path: Path, options: MeshOptions) -> Garment:
    """Return the garment of a mesh that has a loop to hang it by."""
    from ._archive import FormatError, existing, read_json
    from .sim import Garment

    loops: Any = options.loops or "auto"
    if loops not in ("auto", "borders"):
        try:
            loops = read_json(existing(loops).read_bytes())
        except ValueError as error:
            raise FormatError(f"--loops {options.loops}: no JSON: {error}") from error
        if not isinstance(loops, dict | list):
            raise FormatError(f"--loops {options.loops}: it must hold lists of vertex ids, by name or in a list")
    scale = METRES[options.unit] if options.unit else None
    bound = {} if options.max_vertices is None else {"max_vertices": options.max_vertices}
    garment = Garment.from_mesh(path, loops=loops, scale=scale, size=options.size, up=options.up, **bound)
    if not garment.loops:
        whys = ("open front", "too small for a rod", "no rod can go through it")
        reasons = [repair for repair in garment.repairs if any(why in repair for why in whys)]
        reasons.append("its border is its edge")
        raise ValueError(f"{path}: it has no loop to hang it by; {reasons[0]}")
    return garment


@app.command
def mesh(
    mesh: Path, /, *, plot: Path | None = None, mesh_options: MeshOptions = MeshOptions(), as_json: Json = False
) -> int:
    """Print, and draw, the size, the loops and the grips of a mesh.

    Parameters
    ----------
    mesh
        A garment of one's own (.obj, .ply, .stl).
    plot
        Also draw it (.png, .svg or .pdf).
    """
    _check_output("--plot", plot, PICTURES)
    garment = _garment(mesh, mesh_options)
    sizes = garment.vertices.max(axis=0) - garment.vertices.min(axis=0)
    loops = {name: len(loop) for name, loop in garment.named_loops.items()}
    if plot is not None:
        _plot_garment(plot, garment)
    if as_json:
        answer = {
            "mesh": str(mesh),
            "vertices": len(garment.vertices),
            "faces": len(garment.faces),
            "metres": sizes.tolist(),
            "loops": loops,
            "grips": garment.vertices[garment.grips].tolist(),
            "repairs": garment.repairs,
        }
        print(json.dumps(answer))
        return 0
    x, y, z = sizes
    counts = f"{len(garment.vertices)} vertices, {len(garment.faces)} faces"
    _print(f"{mesh}: {counts}; {x:.2f} by {y:.2f} by {z:.2f} m")
    for name, count in loops.items():
        _print(f"  {name}: {count} vertices")
    return 0


def _plot_garment(path: Path, garment: Garment) -> None:
    """Draw the garment from the front and from the side, its loops with their names, and its grips."""
    from matplotlib.figure import Figure

    from ._archive import atomic_file
    from .view import plot_cloth

    figure = Figure(figsize=(10, 6), dpi=120)
    # The front view is on the left, the side view on the right.
    for column, view in enumerate(((-70, 12), (-20, 12)), 1):
        axes: Any = figure.add_subplot(1, 2, column, projection="3d")
        plot_cloth(garment.vertices, garment.faces, ax=axes, true_loops=garment.loops, view=view)
        axes.scatter(*garment.vertices[garment.grips].T, color="black", zorder=5)
        for name, loop in garment.named_loops.items():
            axes.text(*garment.vertices[loop].mean(axis=0), printable(name), ha="center", zorder=6, parse_math=False)
    with atomic_file(path) as picture:
        figure.savefig(picture, format=path.suffix[1:])


@app.command
def hang(
    *,
    task: Annotated[str | None, Parameter(name=["--task", "--target"])] = None,
    seed: Whole = 0,
    model: str | None = None,
    anywhere: bool = False,
    fence: float = 0.0,
    out: Path | None = None,
    film: Path | None = None,
    mesh: Path | None = None,
    mesh_options: MeshOptions = MeshOptions(),
    as_json: Json = False,
) -> int:
    """Hang a garment by its observations, in a closed loop; the exit code is 1 when it does not hang.

    The tasks are those of topokit simulate.

    Parameters
    ----------
    task
        Garment and target (default: tote-hook; hook with --mesh).
    seed
        Seed of the start (default: 0).
    model
        Plan by a forecast: carry, or a checkpoint of a motion model (default: a servo, which needs none).
    anywhere
        Draw target and start anywhere in the room, at any yaw, by the seed.
    fence
        Distance in metres before the arm at which the hands stop; the garment is then thrown.
    out
        Also write the run as an episode (.npz).
    film
        Also write a film of it (.gif, .html).
    mesh
        A garment of one's own (.obj, .ply, .stl).
    """
    from .control import hang as run_hanging
    from .io import save_episode

    _check_output("--out", out, (".npz",))
    _check_output("--film", film, (".gif", ".html"))
    if film is not None:
        from . import view  # noqa: F401 - before the work, so that a missing matplotlib is reported at once
    garment, chosen = _garment_and_task(mesh, mesh_options, task, "tote-hook")

    # Options that were not given are left to `hang` itself.
    scene: dict[str, Any] = {}
    if anywhere:
        scene.update(place="anywhere", start="anywhere")
    if fence:
        scene.update(fence=fence)
    result = run_hanging(chosen, seed=seed, garment=garment, model=model, progress=True, **scene)
    if out is not None:
        save_episode(out, result.episode)
    if film is not None:
        _save_film(film, result.episode)

    if as_json:
        answer = {
            "task": result.episode.task,
            "seed": seed,
            "success": result.success,
            "linked": result.linked,
            "reason": result.reason,
            "steps": result.steps,
            "seconds_a_decision": result.seconds_a_decision,
        }
        print(json.dumps(answer))
    else:
        decision = 1000 * result.seconds_a_decision
        _print(f"{result.episode.task}: {result.reason}; {result.steps} frames, {decision:.0f} ms a decision")
        _print_files(episode=out, film=film)
    return int(not result.success)


def _save_film(path: Path, episode: Episode) -> None:
    from .seqph import track as track_sequence
    from .view import player, save_animation

    if path.suffix == ".gif":
        save_animation(path, episode)
    else:
        player(episode, track_sequence(episode.observed, times=episode.times)).save(path)


# -- generate, label, check -------------------------------------------------------------------------------------------------


@app.command
def generate(
    *,
    out: Path,
    episodes: Whole,
    seed: Whole = 0,
    config: Path | None = None,
    time_limit: float = 600.0,
    retry_failed: bool = False,
    cluster: ClusterOptions = ClusterOptions(),
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Make a dataset of many episodes; the same command goes on where it was stopped.

    Parameters
    ----------
    out
        Folder of the dataset, new or to go on with.
    episodes
        Number of episodes; a larger number than last time adds episodes.
    seed
        Seed of the dataset (default: 0).
    config
        A DatasetConfig (.json); missing fields have their defaults.
    time_limit
        Seconds after which the simulation of an episode is stopped and tried again (default: 600).
    retry_failed
        Try failed episodes again.
    """
    from ._config import load
    from .data import DatasetConfig, generate_dataset

    settings = DatasetConfig()
    if config is not None:
        settings = load(DatasetConfig, config)
        # Paths of meshes are relative to the configuration.
        meshes = {
            name: dataclasses.replace(mesh, file=str(config.parent / mesh.file))
            for name, mesh in settings.meshes.items()
        }
        settings = dataclasses.replace(settings, meshes=meshes)
    return _make(
        lambda: generate_dataset(
            settings,
            out,
            episodes,
            seed,
            time_limit=time_limit,
            retry_failed=retry_failed,
            n_workers=cluster.workers,
            scheduler=cluster.scheduler,
            progress=not quiet,
        ),
        as_json,
    )


@app.command
def label(
    dataset: Path,
    /,
    *,
    observation: Literal["full", "observed", "camera"] = "full",
    points: Whole | None = None,
    name: str | None = None,
    cluster: ClusterOptions = ClusterOptions(),
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Track the loops of every episode of a dataset; the same command goes on where it was stopped.

    Parameters
    ----------
    dataset
        The folder of the dataset.
    observation
        Input of the tracker: all vertices (default), the recorded observation, or the points of the cameras.
    points
        With observed: number of points of a farthest-point sample.
    name
        Name of the labels (default: the name of the observation).
    """
    from .data import label_dataset

    return _make(
        lambda: label_dataset(
            dataset,
            observation,
            name=name,
            n_points=points,
            n_workers=cluster.workers,
            scheduler=cluster.scheduler,
            progress=not quiet,
        ),
        as_json,
    )


def _make(work: Callable[[], Any], as_json: bool) -> int:
    """Do work that goes on where it was stopped, and print the result so far."""
    made = work()
    counts = made.counts
    checksum = made.checksum()
    if as_json:
        print(json.dumps({"out": str(made.folder), "episodes": sum(counts.values()), **counts, "checksum": checksum}))
        return 0
    _print(f"{made.folder}: " + ", ".join(f"{count} {status}" for status, count in sorted(counts.items())))
    print(f"checksum: {checksum}")
    return 0


@app.command
def check(dataset: str, /, *, quiet: Quiet = False, as_json: Json = False) -> int:
    """Verify a dataset: its files, shapes, draws and identities; the exit code is 1 when there is a problem.

    Parameters
    ----------
    dataset
        The folder of the dataset.
    """
    from .data import check_dataset

    problems = check_dataset(dataset, progress=sys.stderr.isatty() and not quiet)
    if as_json:
        print(json.dumps({"dataset": dataset, "problems": [dataclasses.asdict(problem) for problem in problems]}))
    else:
        for problem in problems:
            _print(str(problem))
        summary = f"{len(problems)} problem{'s' * (len(problems) > 1)}" if problems else "all is well"
        _print(f"{dataset}: {summary}")
    return int(bool(problems))


# -- train, predict ---------------------------------------------------------------------------------------------------------


@app.command
def train(
    config: Path,
    /,
    *,
    out: Path,
    dataset: Path | None = None,
    start: Path | None = None,
    seed: Whole | None = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Train a predictor on a dataset; the same command goes on where it was stopped.

    Parameters
    ----------
    config
        Configuration of the model, the training and the dataset (.json).
    out
        Folder for the checkpoints and the log, new or to go on with.
    dataset
        A dataset in place of the configuration's.
    start
        A checkpoint to start from, in place of the configuration's.
    seed
        A seed in place of the configuration's.
    """
    from .models import TrainConfig
    from .models import train as run_training

    settings = TrainConfig.load(config)
    given: dict[str, Any] = {"dataset": dataset and str(dataset), "start": start and str(start), "seed": seed}
    settings = dataclasses.replace(settings, **{name: value for name, value in given.items() if value is not None})
    progress = sys.stderr.isatty() and not as_json and not quiet
    try:
        answer = run_training(settings, out, progress=progress)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; the same command goes on from {out / 'last.safetensors'}") from None
    if as_json:
        print(json.dumps(answer))
        return 0
    model = f"{answer['checkpoint']}: {answer['model']}, {answer['parameters']:,} parameters"
    loss = f"{answer['validation_loss']:.4f} in epoch {answer['best_epoch'] + 1} of {answer['epochs']}"
    line = f"{model}, validation loss {loss}"
    if answer["windows_per_second"]:
        line += f", {answer['windows_per_second']:.0f} windows/s"
    _print(line)
    return 0


@app.command
def predict(checkpoint: Path, episode: Path, /, *, frame: Whole = 15, as_json: Json = False) -> int:
    """Forecast the loops of a recorded episode from one of its frames on.

    Parameters
    ----------
    checkpoint
        A trained predictor (.safetensors).
    episode
        A recorded episode (.npz).
    frame
        The last observed frame (default: 15).
    """
    import numpy as np

    from .io import load_episode
    from .models import Predictor

    predictor = Predictor.load(checkpoint)
    film = load_episode(episode)
    last = len(film) - 1
    if not 0 <= frame < last:
        raise ValueError(f"--frame {frame}: the episode has frames 0 to {last}, and one must be left to forecast")

    # The predictor gets the frames of its history, and then the plan; past its end the last action goes on.
    shape = predictor.model.shape
    for seen in range(max(0, frame - shape.history + 1), frame + 1):
        held = bool(film.held[seen])
        predictor.observe(film.observed[seen], film.grippers[seen], held, target=film.centre_line)
    ahead = np.minimum(np.arange(frame + 1, frame + 1 + shape.horizon), last)
    forecast = predictor.predict(film.actions[ahead], film.held[ahead])

    if as_json:
        about = {name: predictor.description.get(name) for name in ("model", "dataset", "topokit")}
        steps = [[loop.as_dict() for loop in forecast[step]] for step in range(len(forecast))]
        print(json.dumps({"episode": str(episode), "frame": frame, **about, "steps": steps}))
        return 0
    _print(f"{predictor.description.get('model')} at frame {frame} of {episode}: loops that are forecast")
    print(f"{'frame':>6} {'slot':>5} {'present':>8} {'lifetime':>9}   mean of the mixture (m)")
    for step in sorted({0, *range(14, shape.horizon, 15), shape.horizon - 1}):
        for loop in forecast[step]:
            x, y, z = loop.mixture().mean
            start = f"{frame + 1 + step:>6} {loop.slot:>5} {loop.presence:>8.2f} {100 * loop.lifetime:6.2f} cm"
            print(f"{start}   {x:7.3f} {y:7.3f} {z:7.3f}")
    return 0
