"""The `topokit` command. Exit code 0 when all is well, 1 when the work failed, 2 when the input or the call is wrong."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from . import __version__
from .seqph import SeqPH, track

__all__ = ["main"]

_TASKS = """tasks, a garment and a target:
  {apron,apron2,tote,tote2,backpack,mask,sheet,sheet2}-hook
  {apron,apron2,tote,tote2,backpack,mask,sheet,sheet2}-hanger
  {apron,apron2,backpack,shirt,vest}-mannequin"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (those of the process when None) and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options)
        return code
    except (ValueError, OSError, ImportError) as error:  # any other is a mistake of ours, and shows where
        print(f"topokit {options.command}: error: {error}", file=sys.stderr)
        return 2
    except RuntimeError as error:  # the input was right, the work failed: a simulation that exploded
        print(f"topokit {options.command}: failed: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"topokit {options.command}: stopped; nothing was written", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="topokit", description="Sequential topology for deformable objects.")
    parser.add_argument("--version", action="version", version=f"topokit {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    simulate = commands.add_parser(
        "simulate",
        help="record an episode: a garment carried to a target and let go there",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=_TASKS,
    )
    simulate.add_argument("--task", default="apron-hook", help="what goes where (default apron-hook), see below")
    simulate.add_argument("--seed", type=int, default=0, help="of everything random (default 0)")
    simulate.add_argument("--out", type=Path, required=True, metavar="EPISODE", help="where to write it (.npz)")
    simulate.add_argument("--randomise", action="store_true", help="draw physics, size and cameras, not only the path")
    simulate.add_argument(
        "--cameras", type=int, default=0, metavar="K", help="observe with K depth cameras around the target"
    )
    simulate.add_argument("--noise", action="store_true", help="cameras with the noise of a depth sensor")
    simulate.add_argument(
        "--observed", type=int, metavar="N", help="points of an observation (default 500, or all vertices if fewer)"
    )
    simulate.add_argument(
        "--time-limit",
        type=float,
        default=60.0,
        metavar="S",
        help="stop a simulation that shows no sign of life for so many seconds (default 60)",
    )
    simulate.add_argument("--json", action="store_true", help="print the answer as JSON")
    simulate.set_defaults(run=_simulate)

    tracker = commands.add_parser("track", help="follow the loops of a recorded episode")
    tracker.add_argument("episode", type=Path, nargs="?", metavar="EPISODE", help="a recorded episode (.npz)")
    tracker.add_argument(
        "--live",
        action="store_true",
        help="instead of an episode, read clouds from standard input, .npy arrays one after another, and print a line of JSON "
        "for each as it comes",
    )
    tracker.add_argument("--out", type=Path, metavar="TRACKS", help="tracks to write (default EPISODE.tracks.npz)")
    tracker.add_argument("--plot", type=Path, metavar="PICTURE", help="also draw the tracks (.png, .svg or .pdf)")
    tracker.add_argument(
        "--cloud",
        choices=("points", "observed"),
        default="points",
        help="all vertices (default) or the subsample an observer sees",
    )
    for name, what in (("alpha", "sampling"), ("beta", "jitter of killers"), ("epsilon", "motion a frame")):
        tracker.add_argument(f"--{name}", type=float, help=f"{what} in metres (default: estimated)")
    tracker.add_argument("--gates", choices=("paper", "proved"), default="paper", help="how far a loop may move")
    tracker.add_argument(
        "--identity",
        choices=("killer-edge", "killer-triangles", "cycle"),
        default="killer-edge",
        help="what a loop's place is (default: the paper's killer edge, which can jump)",
    )
    tracker.add_argument(
        "--memory", type=int, default=0, metavar="FRAMES", help="how long a missed loop is remembered (default 0)"
    )
    tracker.add_argument("--tolerance", type=float, default=0.0, help="metres beside the hull that count as in it")
    tracker.add_argument("--json", action="store_true", help="print the answer as JSON")
    tracker.set_defaults(run=_track)

    from .data.commands import add as add_data_commands
    from .evaluate._commands import add as add_evaluate_commands
    from .models.commands import add as add_model_commands

    add_data_commands(commands)
    add_model_commands(commands)
    add_evaluate_commands(commands)
    return parser


def _simulate(options: argparse.Namespace) -> int:
    from .io import save_episode
    from .sim import TASKS, DepthNoise, Randomisation, cameras_around, simulate

    if options.out.suffix != ".npz":
        raise ValueError(f"--out {options.out}: the name of an episode ends in .npz")
    if options.task not in TASKS:
        raise ValueError(f"--task {options.task}: there is no such task; there are {', '.join(TASKS)}")
    if options.cameras < 0 or (options.noise and not options.cameras):
        raise ValueError(f"--cameras {options.cameras}: a number of cameras, one at least with --noise")
    noise = DepthNoise() if options.noise else None
    seat = TASKS[options.task].target.seat
    episode = simulate(
        task=options.task,
        seed=options.seed,
        randomisation=Randomisation() if options.randomise else None,
        cameras=cameras_around(seat, options.cameras, distance=2.2, noise=noise) if options.cameras else (),
        n_observed=options.observed,
        time_limit=options.time_limit,
        progress=sys.stderr.isatty() and not options.json,
    )
    path = save_episode(options.out, episode)
    answer = {
        "episode": str(path),
        "task": episode.task,
        "seed": episode.seed,
        "garment": episode.garment,
        "target": episode.target,
        "frames": len(episode),
        "vertices": episode.points.shape[1],
        "observed": episode.observed.shape[1],
        "success": episode.success,
    }
    if options.json:
        print(json.dumps(answer))
    else:
        outcome = "it hangs" if episode.success else "it does not hang"
        print(
            f"{path}: {episode.garment} to {episode.target}, {len(episode)} frames, {answer['vertices']} vertices; {outcome}"
        )
    return 0


def _track(options: argparse.Namespace) -> int:
    from .evaluate import summarise_tracks
    from .io import load_episode, save_states

    how = {name: getattr(options, name) for name in ("alpha", "beta", "epsilon", "gates", "identity", "memory")}
    if options.live:
        return _track_live(options, how)
    if options.episode is None:
        raise ValueError("which EPISODE? (or --live, to read clouds from standard input)")
    out = options.out or options.episode.with_suffix(".tracks.npz")
    if out.resolve() == options.episode.resolve():
        raise ValueError(f"--out {out}: that is the episode itself")
    if out.suffix != ".npz":
        raise ValueError(f"--out {out}: the name of tracks ends in .npz")
    if options.plot:
        from .view import track_figure  # before the work, so that a missing matplotlib is said at once
    episode = load_episode(options.episode)
    states = track(
        getattr(episode, options.cloud),
        times=episode.times,
        progress=sys.stderr.isatty() and not options.json,
        **how,
    )
    summaries = summarise_tracks(states, episode.points, episode.loops, tolerance=options.tolerance)
    save_states(out, states)
    if options.plot:
        options.plot.parent.mkdir(parents=True, exist_ok=True)
        track_figure(episode, states).savefig(options.plot)
    if options.json:
        rows = [dataclasses.asdict(summary) for summary in summaries]
        print(json.dumps({"episode": str(options.episode), "frames": len(states), "tracks": str(out), "loops": rows}))
        return 0
    print(f"{options.episode}: {episode.garment} to {episode.target}, {len(states)} frames, {options.cloud}")
    print(
        f"{'id':>4} {'first':>6} {'last':>5} {'frames':>7} {'lifetime':>9}  {'true loop':>9} {'distance':>9} {'in hull':>8}"
    )
    for row in summaries:
        where = "-" if row.true_loop < 0 else str(row.true_loop)
        print(
            f"{row.id:>4} {row.first:>6} {row.last:>5} {row.frames:>7} {100 * row.lifetime:>6.2f} cm  {where:>9} "
            f"{100 * row.distance:>6.2f} cm {100 * row.in_hull:>6.1f} %"
        )
    if not summaries:
        print("   no loop of a lifetime above alpha in any frame")
    print(f"tracks: {out}" + (f"\npicture: {options.plot}" if options.plot else ""))
    return 0


def _track_live(options: argparse.Namespace, how: dict[str, Any]) -> int:
    """Track clouds as they come; what is kept does not grow."""
    if options.episode or options.out or options.plot:
        raise ValueError("--live reads standard input and writes standard output: leave out EPISODE, --out and --plot")
    frames = 0
    try:
        for state in SeqPH(**how).stream(_clouds(sys.stdin.buffer)):
            print(json.dumps(state.as_dict()), flush=True)
            frames += 1
    except KeyboardInterrupt:
        print(f"topokit track: stopped after {frames} frames, which were printed", file=sys.stderr)
        return 130
    return 0


class _Pipe:
    """What can be read and nothing else: NumPy asks real files for their position, and a pipe has none."""

    def __init__(self, stream: BinaryIO) -> None:
        self.read = stream.read


def _clouds(stream: Any) -> Iterator[NDArray[np.float64]]:
    """The .npy arrays of a stream, until it ends."""
    number = 0
    while stream.peek(1):
        try:
            yield np.lib.format.read_array(_Pipe(stream), allow_pickle=False)
        except ValueError as error:
            raise ValueError(f"frame {number} on standard input is no whole .npy array: {error}") from error
        number += 1


if __name__ == "__main__":
    sys.exit(main())
