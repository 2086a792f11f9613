"""The `topokit` command: each of its commands is a function of this file, and returns an answer that `main` prints.

Idea: an option that is not given is not passed on, so a default has one place, the function that uses it. What a command needs
is imported when it runs. The exit code is 0 when all is well, 1 when the work failed, 2 when the input or the call is wrong, and
130 after Ctrl-C.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from argparse import SUPPRESS, ArgumentParser, ArgumentTypeError
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from . import __version__

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .io import Episode
    from .seqph import TopologicalState

# Values and tables, a table as a list of rows. An answer whose `success` is false ends in exit code 1.
Answer = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (those of the process when None), print its answer, and return the exit code."""
    command = "topokit"
    try:
        options = vars(_parser().parse_args(arguments))
        work = options.pop("work")
        command = f"topokit {work.__name__}"
        as_json = options.pop("json", False)
        answer = work(**options)
        print(json.dumps(answer, default=os.fspath) if as_json else _table(answer), flush=True)
    except (ValueError, ImportError, OSError, MemoryError) as error:
        print(f"{command}: error: {error}", file=sys.stderr)
        return 2
    except RuntimeError as error:  # the input was right, and the work failed, as a simulation that exploded
        print(f"{command}: failed: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{command}: stopped; nothing is half written", file=sys.stderr)
        return 130
    return int(not answer.get("success", True))


# -- parameters and answers -------------------------------------------------------------------------------------------------


class _Parser(ArgumentParser):
    """A parser whose errors are raised, so that `main` prints them in one line."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(f"{message} (see {self.prog} --help)")


def _parser() -> ArgumentParser:
    """Return the parser of all commands; its namespace holds the options that were given, and the function `work`."""
    about = "Find the loops of deformable objects in clouds of points, follow them, forecast them, and hang garments by them."
    parser = _Parser(prog="topokit", description=about, allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"topokit {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(work: Callable[..., Answer]) -> Callable[..., Any]:
        """Add a command, named and described by a function, and return the method that adds its parameters."""
        about = (work.__doc__ or "").strip()
        options: dict[str, Any] = {"argument_default": SUPPRESS, "allow_abbrev": False}
        added = commands.add_parser(work.__name__, help=about.splitlines()[0], description=about, **options)
        added.set_defaults(work=work)
        added.add_argument("--json", action="store_true", help="print the answer as JSON")
        return added.add_argument

    add = command(track)
    add("episode", type=Path, metavar="EPISODE", help="an episode (.npz), a file of clouds, or a folder of them")
    add("--out", type=_name(".npz", ".jsonl"), metavar="FILE", help="write the tracks (.jsonl: a line a frame)")
    add("--plot", type=_name(".png", ".svg", ".pdf"), metavar="FILE", help="draw the last frame and the lifetimes")
    add("--observed", action="store_true", help="track the observed sample of an episode instead of all its vertices")
    add("--alpha", type=float, metavar="M", help="sampling in metres (default: estimated)")
    add("--beta", type=float, metavar="M", help="jitter of killers in metres (default: estimated)")
    add("--epsilon", type=float, metavar="M", help="motion in a frame in metres (default: estimated)")
    add("--memory", type=int, metavar="N", help="number of frames for which a missed loop is remembered")
    add("--paper", action="store_true", help="use the tracker of the paper")

    add = command(simulate)
    add("--out", type=_name(".npz"), metavar="FILE", required=True, help="file of the episode (.npz)")
    add("--randomise", action="store_true", help="draw physics and size, not only the path")
    _add_scene(add, "apron-hook")

    add = command(hang)
    add("--out", type=_name(".npz"), metavar="FILE", help="write the run as an episode (.npz)")
    add("--film", type=_name(".html"), metavar="FILE", help="write a film of it (.html)")
    add("--model", help="plan by a forecast: carry, or the checkpoint of a motion model (default: a servo without one)")
    place = {"dest": "place", "action": "store_const", "const": "anywhere"}
    add("--anywhere", **place, help="put the target anywhere in the room, at any yaw")
    _add_scene(add, "tote-hook")

    add = command(generate)
    add("--out", type=Path, metavar="FOLDER", required=True, help="folder of the dataset, new or to go on with")
    add("--episodes", type=int, metavar="N", required=True, help="number of episodes; a larger one adds some")
    add("--seed", type=int, metavar="N", help="seed of the dataset (default: 0)")
    add("--config", type=Path, metavar="FILE", help="a DatasetConfig (.json); missing fields have their defaults")
    add("--workers", type=int, metavar="N", help="number of processes or threads (default: one for each core)")

    add = command(train)
    add("config", type=Path, metavar="CONFIG", help="configuration of model, training and dataset (.json)")
    add("--out", type=Path, metavar="FOLDER", required=True, help="folder of checkpoints and log, new or to go on with")
    add("--dataset", metavar="FOLDER", help="a dataset in place of the configuration's")
    add("--start", metavar="FILE", help="a checkpoint to start from, in place of the configuration's")
    add("--seed", type=int, metavar="N", help="a seed in place of the configuration's")

    add = command(predict)
    add("checkpoint", type=Path, metavar="CHECKPOINT", help="a trained predictor (.safetensors)")
    add("episode", type=Path, metavar="EPISODE", help="a recorded episode (.npz)")
    add("--frame", type=int, metavar="N", help="the last observed frame (default: 15)")
    return parser


def _name(*suffixes: str) -> Callable[[str], Path]:
    """Return the type of a parameter: the name of a file to write, which ends in one of the suffixes."""

    def as_path(text: str) -> Path:
        path = Path(text)
        if path.suffix not in suffixes:
            raise ArgumentTypeError(f"{text}: the name must end in {' or '.join(suffixes)}")
        return path

    return as_path


def _add_scene(add: Callable[..., Any], default: str) -> None:
    """Add the parameters that say which garment is hung on which target."""
    add("--task", metavar="TASK", help=f"garment and target (default: {default}; topokit.sim.TASKS has all)")
    add("--seed", type=int, metavar="N", help="seed of everything random (default: 0)")


def _table(answer: Answer) -> str:
    """Return an answer as text: its values, a line each, then its tables."""
    tables = {name: value for name, value in answer.items() if isinstance(value, list)}
    lines = [f"{name}: {_cell(value)}" for name, value in answer.items() if name not in tables and value is not None]
    for name, rows in tables.items():
        lines.append(f"{name}: {len(rows)}")
        if rows:
            cells = [list(rows[0]), *([_cell(value) for value in row.values()] for row in rows)]
            widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
            lines += ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


# -- the commands -----------------------------------------------------------------------------------------------------------


def track(
    episode: Path,
    out: Path | None = None,
    plot: Path | None = None,
    observed: bool = False,
    paper: bool = False,
    **tracker: Any,
) -> Answer:
    """Follow the loops of a recorded episode, or of clouds in files.

    The clouds are .npy, .npz, .ply, .csv or .xyz files, a file a frame. Of each at most 1,000 farthest points are tracked.
    """
    from ._archive import atomic_file
    from .evaluate import summarise_tracks
    from .io import save_states
    from .seqph import PAPER
    from .seqph import track as track_clouds

    if out is not None and out.resolve() == episode.resolve():
        raise ValueError(f"--out {out}: that is the episode itself")
    options = {**PAPER, **tracker} if paper else tracker
    recorded, clouds, times = _read(episode, observed)
    states = track_clouds(clouds, times=times, progress=sys.stderr.isatty(), **options)

    # Compare the tracks with the true loops, where these are known.
    names = ["id", "first", "last", "frames", "lifetime"]
    loops = () if recorded is None else recorded.loops
    if loops:
        names += ["true_loop", "distance", "in_hull"]
    tracks = summarise_tracks(states, clouds if recorded is None else recorded.points, loops)
    rows = [{name: getattr(row, name) for name in names} for row in tracks]

    if out is not None and out.suffix == ".npz":
        save_states(out, states)
    elif out is not None:
        with atomic_file(out) as file:
            file.writelines(f"{json.dumps(state.as_dict())}\n".encode() for state in states)
    if plot is not None:
        _plot(plot, recorded, clouds[-1], states)
    answer = {"episode": episode, "frames": len(states), "out": out, "plot": plot, "tracks": rows}
    n_empty = sum(len(cloud) == 0 for cloud in clouds)
    return answer | {"empty frames": n_empty} if n_empty else answer


def _read(path: Path, observed: bool) -> tuple[Episode | None, Any, Any]:
    """Return an episode with its clouds and their times, or None with the clouds of files, of which each is cleaned first."""
    from ._archive import is_archive
    from .io import load_episode

    if path.suffix == ".npz" and is_archive(path):
        episode = load_episode(path)
        clouds = episode.observed if observed else episode.points
        return episode, clouds, episode.times

    from .sensors import Cleaner, read_clouds

    clean = Cleaner()
    times, frames = zip(*((time, clean(cloud)) for time, cloud in read_clouds(path)), strict=True)
    return None, frames, times


def _plot(path: Path, episode: Episode | None, cloud: NDArray[Any], states: Sequence[TopologicalState]) -> None:
    """Draw the last frame with its loops, and the lifetimes over time."""
    from matplotlib.figure import Figure

    from ._archive import atomic_file
    from .view import plot_cloth, plot_tracks

    figure = Figure(figsize=(11, 5), dpi=120, layout="constrained")
    axes: Any = figure.add_subplot(1, 2, 1, projection="3d")
    if episode is None:
        plot_cloth(cloud, ax=axes, loops=states[-1].loops)
    else:
        line = episode.centre_line
        plot_cloth(episode.points[-1], episode.faces, ax=axes, loops=states[-1].loops, centre_line=line)
    plot_tracks(states, figure.add_subplot(1, 2, 2))
    with atomic_file(path) as picture:
        figure.savefig(picture, format=path.suffix[1:])


def simulate(out: Path, task: str = "apron-hook", randomise: bool = False, **options: Any) -> Answer:
    """Record an episode: a garment is carried to a target and let go there.

    The exit code is 1 when it does not hang.
    """
    from .io import save_episode
    from .sim import Randomisation
    from .sim import simulate as run_simulation

    randomisation = Randomisation() if randomise else None
    episode = run_simulation(task=task, randomisation=randomisation, **options)
    save_episode(out, episode)
    return {
        "out": out,
        "task": episode.task,
        "frames": len(episode),
        "vertices": episode.points.shape[1],
        "success": episode.success,
    }


def hang(task: str = "tote-hook", out: Path | None = None, film: Path | None = None, **options: Any) -> Answer:
    """Hang a garment by its observations, in a closed loop.

    The exit code is 1 when it does not hang.
    """
    from .control import hang as run_hanging
    from .io import save_episode
    from .seqph import track as track_clouds

    result = run_hanging(task, **options)
    if out is not None:
        save_episode(out, result.episode)
    if film is not None:
        from .view import player

        player(result.episode, track_clouds(result.episode.observed, times=result.episode.times)).save(film)
    return {
        "task": result.episode.task,
        "success": result.success,
        "reason": result.reason,
        "linked": ", ".join(result.linked),
        "frames": result.steps,
        "seconds_a_decision": result.seconds_a_decision,
        "out": out,
        "film": film,
    }


def generate(out: Path, episodes: int, seed: int = 0, config: Path | None = None, workers: int | None = None) -> Answer:
    """Make a dataset of many episodes, and label the loops of each. The same command goes on where it was stopped."""
    from ._config import load
    from .data import DatasetConfig, generate_dataset, label_dataset

    settings = DatasetConfig()
    if config is not None:
        settings = load(DatasetConfig, config)
        # Paths of meshes are relative to the configuration.
        meshes = {name: {**mesh, "file": str(config.parent / mesh["file"])} for name, mesh in settings.meshes.items()}
        settings = dataclasses.replace(settings, meshes=meshes)
    progress = sys.stderr.isatty()
    dataset = generate_dataset(settings, out, episodes, seed, n_workers=workers, progress=progress)
    label_dataset(out, n_workers=workers, progress=progress)
    return {"out": out, **dataset.counts, "checksum": dataset.checksum()}


def train(config: Path, out: Path, **changes: Any) -> Answer:
    """Train a predictor on a dataset.

    The same command goes on where it was stopped.
    """
    from .models import TrainConfig
    from .models import train as run_training

    settings = dataclasses.replace(TrainConfig.load(config), **changes)
    return run_training(settings, out, progress=sys.stderr.isatty())


def predict(checkpoint: Path, episode: Path, frame: int = 15) -> Answer:
    """Forecast the loops of a recorded episode, 1, 15, 30, 45 and 60 frames after one of its frames."""
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

    rows = []
    for step in (1, 15, 30, 45, 60):
        for slot, mixture in forecast.mixtures(step - 1).items():
            presence = float(forecast.presence[step - 1, slot].sigmoid())
            place = dict(zip("xyz", mixture.mean.tolist(), strict=True))
            rows.append({"frame": frame + step, "loop": slot, "presence": presence, **place})
    return {"episode": episode, "frame": frame, "model": predictor.description["model"], "loops": rows}
