"""The `topokit` command, and of its parts `track`. What they need is imported when they run.

Exit code 0 when all is well, 1 when the work failed, 2 when the input or the call is wrong or there is no room, 130 after
Ctrl-C, 141 when nobody reads the output any more.
"""

from __future__ import annotations

import argparse
import dataclasses
import errno
import json
import math
import os
import sys
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import __version__
from ._archive import FormatError, atomic_file
from .seqph import PAPER, SeqPH, track

__all__ = ["main"]
_PICTURES = (".png", ".svg", ".pdf")
_LARGEST_FRAME = 2**28  # bytes of a cloud: eleven million points in space
_OF_CLOUDS = ("pipeline", "unit", "columns", "intrinsics", "topic", "fps")
_TRACKER = ("alpha", "beta", "epsilon", "loops", "gates", "identity", "memory")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (those of the process when None) and return its exit code."""
    options = parser().parse_args(arguments)
    try:
        code = int(options.run(options))
        print(end="", flush=True)  # here, where it can still be told that the output was not taken
        return code
    except ModuleNotFoundError as error:  # of a part of ours that needs more than the core
        wanted = f"{error.name} is needed, and is not there: pip install 'topokit[all]'"
        print(f"topokit {options.command}: error: {wanted}", file=sys.stderr)
        return 2
    except (ValueError, OSError, ImportError, MemoryError) as error:  # any other is a mistake of ours, and shows where
        print(f"topokit {options.command}: error: {_words(error)}", file=sys.stderr)
        return 141 if isinstance(error, BrokenPipeError) else 2
    except RuntimeError as error:  # the input was right, the work failed: a simulation that exploded
        print(f"topokit {options.command}: failed: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stopped:
        print(f"topokit {options.command}: {str(stopped) or 'stopped; nothing was written'}", file=sys.stderr)
        return 130


def _words(error: BaseException) -> str:
    """What an error says, and what to do; where it is not told of a file, it is standard output that takes no more."""
    if not isinstance(error, OSError) or error.errno not in (errno.EPIPE, errno.ENOSPC):
        return str(error) or "not enough memory for so much at a time"
    if error.filename is None:  # what waits for it is dropped: Python would try again at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    stopped, full = "its reader has stopped, files are written", "make room, and repeat the command"
    remedy = stopped if error.errno == errno.EPIPE else full
    return f"{error.filename or 'standard output'}: {error.strerror}; {remedy}"


def parser() -> argparse.ArgumentParser:
    from . import _simulate
    from .data import _commands as data
    from .models import _commands as models

    whole = argparse.ArgumentParser(prog="topokit", description="Sequential topology for deformable objects.")
    whole.add_argument("--version", action="version", version=f"topokit {__version__}")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _simulate.add(commands)
    _add_track(commands)
    for part in (data, models):
        part.add(commands)
    for command in commands.choices.values():
        command.add_argument("--json", action="store_true", help="print the answer as JSON")
    return whole


def _add_track(commands: Any) -> None:
    tracker = commands.add_parser("track", help="follow the loops of a recorded episode")
    option = tracker.add_argument
    what = "a recorded episode (.npz), or clouds: .npy, .npz, .ply, .pcd, depth images (.png), a ROS 2 bag, a folder of files"
    option("episode", type=Path, nargs="?", metavar="PATH", help=what)
    option("--pipeline", type=Path, metavar="FILE", help="of clouds: what is left out of each (.json)")
    option("--unit", choices=("m", "cm", "mm"), help="of clouds (default: metres; millimetres for depth images)")
    option("--columns", metavar="X,Y,Z", help="which numbers, or names, of a point are its place")
    option("--intrinsics", type=Path, metavar="FILE", help="fx, fy, cx, cy of a depth camera (.json)")
    option("--topic", help="of a bag; with --live, of a node of ROS 2 that publishes the loops as TOPIC/loops")
    option("--fps", type=float, help="frames a second, of clouds without times")
    live = "instead of a file, read clouds from standard input, .npy arrays one after another, and print a line of JSON"
    option("--live", action="store_true", help=f"{live} for each as it comes")
    tracks = "tracks to write (default PATH.tracks.npz), or a line of JSON a frame (.jsonl)"
    option("--out", type=Path, metavar="TRACKS", help=tracks)
    option("--plot", type=Path, metavar="PICTURE", help="also draw the tracks (.png, .svg or .pdf)")
    option("--rerun", type=Path, metavar="FILE", help="also write a recording for Rerun's viewer (.rrd)")
    clouds = "all vertices (default) or the subsample an observer sees"
    option("--cloud", choices=("points", "observed"), default="points", help=clouds)
    for name, what in (("alpha", "sampling"), ("beta", "jitter of killers"), ("epsilon", "motion a frame")):
        option(f"--{name}", type=float, help=f"{what} in metres (default: estimated)")
    option("--paper", action="store_true", help="the paper's tracker; options beside it take the place of its own")
    option("--loops", choices=("evidence", "alpha"), help="which bars are loops (default: by evidence without --alpha)")
    option("--gates", choices=("near", "proved", "paper"), help="how far a loop may move (default near)")
    identity = "what a loop's place is (default killer-triangles; the paper's killer edge can jump)"
    option("--identity", choices=("killer-edge", "killer-triangles", "cycle"), help=identity)
    option("--memory", type=int, metavar="FRAMES", help="how long a missed loop is remembered (default 20)")
    tracker.set_defaults(run=_track)


def _track(options: argparse.Namespace) -> int:
    from .evaluate import summarise_tracks
    from .io import save_states

    how = dict(PAPER) if options.paper else {}
    how |= {name: value for name in _TRACKER if (value := getattr(options, name)) is not None}
    if options.live:
        return _track_live(options, how)
    out, film = _tracks_file(options), _is_film(options.episode)
    given = [f"--{name}" for name in (_OF_CLOUDS, ("plot",))[film] if getattr(options, name)]
    if given:
        kind = "episodes" if film else "clouds"
        raise ValueError(f"{given[0]} is for {kind}, and {options.episode} is not: leave it out")
    if options.rerun:
        if options.rerun.suffix != ".rrd":
            raise ValueError(f"--rerun {options.rerun}: the name of a recording ends in .rrd")
        from .view._rerun import rerun, sdk

        sdk()  # before the work, so that it is said at once when it is missing
    states, truth, answer, words, shown = (_track_film if film else _track_episode)(options, how)
    summaries = summarise_tracks(states, *truth)
    if out.suffix == ".jsonl":
        with atomic_file(out) as lines:
            lines.writelines(f"{json.dumps(state.as_dict())}\n".encode() for state in states)
    else:
        save_states(out, states)
    if options.rerun:
        rerun(shown, states, options.rerun)
    if options.json:
        rows = [dict(list(dataclasses.asdict(summary).items())[: 5 if film else None]) for summary in summaries]
        print(json.dumps({**answer, "frames": len(states), "tracks": str(out), "loops": rows}))
        return 0
    print(words)
    _print_table(summaries, 35 if film else None)
    print(f"tracks: {out}" + (f"\npicture: {options.plot}" if options.plot else ""))
    return 0


def _track_episode(options: argparse.Namespace, how: dict[str, Any]) -> tuple[Any, ...]:
    """States, what they can be compared with, and what is said of the episode, in names and in words."""
    from .io import load_episode

    if options.plot:
        if options.plot.suffix not in _PICTURES:
            raise ValueError(f"--plot {options.plot}: the name of a picture ends in {', '.join(_PICTURES)}")
        from .view import track_figure  # before the work, so that a missing matplotlib is said at once
    episode = load_episode(options.episode)
    loud = sys.stderr.isatty() and not options.json
    states = track(getattr(episode, options.cloud), times=episode.times, progress=loud, **how)
    if options.plot:
        with atomic_file(options.plot) as picture:
            track_figure(episode, states).savefig(picture, format=options.plot.suffix[1:])
    words = f"{options.episode}: {episode.garment} to {episode.target}, {len(states)} frames, {options.cloud}"
    return states, (episode.points, episode.loops), {"episode": str(options.episode)}, words, episode


def _track_film(options: argparse.Namespace, how: dict[str, Any]) -> tuple[Any, ...]:
    """As of an episode, but that there is nothing to compare with; clouds are kept where they are to be shown."""
    from .io import read_clouds

    asked = {name: getattr(options, name) for name in ("unit", "intrinsics", "topic", "fps")}
    tracker, clean, states, removed, shown = SeqPH(**how), _cleaner(options), [], Counter[str](), []
    for time, cloud in read_clouds(options.episode, columns=_columns(options), **asked):
        left = clean(cloud)
        states.append(tracker.update(left, time=time))
        shown += [left] if options.rerun else []
        removed.update(clean.removed)
    if not states:
        raise ValueError(f"{options.episode}: it holds no cloud")
    told = ", ".join(f"{n / len(states):.0f} {name}" for name, n in removed.items())
    words = f"{options.episode}: {len(states)} frames\nremoved a frame: {told}"
    return states, (np.empty((len(states), 0, 3)), ()), {"film": str(options.episode), "removed": removed}, words, shown


def _is_film(path: Path) -> bool:
    """Whether it holds clouds; an archive does when it is none of ours."""
    if path.suffix != ".npz" or not zipfile.is_zipfile(path):
        return path.suffix != ".npz"
    with zipfile.ZipFile(path) as archive:
        return "json.npy" not in archive.namelist()


def _cleaner(options: argparse.Namespace) -> Any:
    from ._config import load
    from .sensors import Cleaner, Pipeline

    return Cleaner(load(Pipeline, options.pipeline) if options.pipeline else None)


def _columns(options: argparse.Namespace) -> list[int | str] | None:
    words = options.columns.split(",") if options.columns else []
    return [int(word) if word.isdigit() else word for word in words] or None


def _tracks_file(options: argparse.Namespace) -> Path:
    if options.episode is None:
        raise ValueError("which episode or film? (or --live, to read clouds from standard input)")
    path = options.episode if options.episode.name.strip(".") else options.episode.resolve()
    out: Path = options.out or path.with_suffix(".tracks.npz")
    if set(out.name) & set("*?["):
        raise ValueError(f"--out: say where to write the tracks of {options.episode}")
    if out.resolve() == options.episode.resolve():
        raise ValueError(f"--out {out}: that is the episode itself")
    if out.suffix not in (".npz", ".jsonl"):
        raise ValueError(f"--out {out}: the name of tracks ends in .npz or .jsonl")
    return out


def _print_table(summaries: Sequence[Any], width: int | None) -> None:
    """The identities of an episode, a line each; of a film, as far as they are not compared with the truth."""
    heads = ("id", "first", "last", "frames", "lifetime", " true loop", "distance", "in hull")
    print("{:>4} {:>6} {:>5} {:>7} {:>9} {:>10} {:>9} {:>8}".format(*heads)[:width])
    for row in summaries:
        line = (
            f"{row.id:>4} {row.first:>6} {row.last:>5} {row.frames:>7} {100 * row.lifetime:>6.2f} cm  "
            f"{row.true_loop if row.true_loop >= 0 else '-':>9} {100 * row.distance:>6.2f} cm {100 * row.in_hull:>6.1f} %"
        )
        print(line[:width])
    if not summaries:
        print("   no loop in any frame")


def _track_live(options: argparse.Namespace, how: dict[str, Any]) -> int:
    """Track clouds as they come; what is kept does not grow."""
    wrong = ["episode", "out", "plot", "rerun", "fps", *(("unit", "columns", "intrinsics") if options.topic else ())]
    if given := [name for name in wrong if getattr(options, name)]:
        place = "a topic and publishes" if options.topic else "standard input and writes standard output"
        raise ValueError(f"--live reads {place}: leave out {', '.join(given)}")
    if options.topic:
        from .compat import LoopMessages, listen

        listen(options.topic, LoopMessages(_cleaner(options).pipeline, **how))
        return 0
    if sys.stdin is None:
        raise ValueError("standard input is closed; pipe the clouds in")
    frames = 0
    try:
        for state in SeqPH(**how).stream(_ready(_clouds(sys.stdin.buffer), options)):
            frames += 1
            print(json.dumps(state.as_dict()), flush=True)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped after {frames} frames, which were printed") from None
    return 0


def _ready(clouds: Iterator[NDArray[Any]], options: argparse.Namespace) -> Iterator[NDArray[Any]]:
    """Clouds in metres, through the pipeline; without one, what is not finite is left out, and that is said once."""
    from .sensors._files import Asked, as_cloud, has_unit

    clean, said = _cleaner(options) if options.pipeline else None, False
    unsure = clean is not None and options.unit != "m"  # a pipeline is in metres
    asked = Asked(options.unit, _columns(options), options.intrinsics)
    for number, cloud in enumerate(clouds):
        try:
            cloud = as_cloud(cloud, asked, Path())
            unsure = unsure and not has_unit(cloud, asked)
        except ValueError as error:
            raise FormatError(f"frame {number} on standard input: {error}") from error
        if clean:
            yield clean(cloud)
            continue
        finite = np.isfinite(cloud).all(axis=1)
        if not (said or finite.all()):
            said, lost = True, f"frame {number}: {(~finite).sum()} of {len(finite)} points are not finite and left out"
            print(f"topokit track: {lost}, here and in what follows", file=sys.stderr)
        yield cloud[finite]


def _clouds(stream: Any) -> Iterator[NDArray[np.float64]]:
    """The .npy arrays of a stream, until it ends."""
    for number in count():
        if not stream.peek(1):
            return
        try:
            yield _cloud(stream)
        except Exception as error:  # a header can be wrong in a dozen ways
            raise FormatError(f"frame {number} on standard input is no whole .npy array: {error}") from error


def _cloud(stream: Any) -> NDArray[Any]:
    """The next array of a stream; memory is taken when what its header declares is no more than a cloud."""
    head = np.lib.format
    read = head.read_array_header_1_0 if head.read_magic(stream) == (1, 0) else head.read_array_header_2_0
    shape, columns_first, kind = read(stream)
    size = math.prod(shape) * kind.itemsize
    if kind.hasobject or not 0 <= size <= _LARGEST_FRAME:
        raise ValueError(f"its header declares {size} bytes of {kind}; {_LARGEST_FRAME} of numbers at most")
    data = stream.read(size)
    if len(data) < size:
        raise ValueError(f"{len(data)} of {size} bytes")
    return np.ndarray(shape, kind, data, order="F" if columns_first else "C")
