"""The command `topokit hang`. What it needs is imported when it runs."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from topokit._simulate import TASKS_HELP, add_of_mesh, garment_and_task

_FILMS = (".gif", ".html")


def add(commands: Any) -> None:
    """Add the sub-parser."""
    words = "hang a garment by what is seen of it, in a closed loop; exit code 1 when it does not hang"
    form = argparse.RawDescriptionHelpFormatter
    hang = commands.add_parser("hang", help=words, formatter_class=form, epilog=TASKS_HELP)
    option = hang.add_argument
    option("--task", "--target", help="what goes where (default tote-hook; hook with --mesh), see below")
    option("--seed", type=int, default=0, help="of where it starts (default 0)")
    option("--max-steps", type=int, default=300, metavar="N", help="frames after which it is over (default 300)")
    option("--out", type=Path, metavar="EPISODE", help="also write what happened, as an episode (.npz)")
    option("--film", type=Path, metavar="FILM", help="also write a film of it (.gif, .html)")
    option("--mesh", type=Path, metavar="FILE", help="a garment of one's own (.obj, .ply, .stl)")
    add_of_mesh(hang)
    hang.set_defaults(run=_hang)


def _hang(options: argparse.Namespace) -> int:
    from topokit.io import save_episode

    from . import hang

    if options.out and options.out.suffix != ".npz":
        raise ValueError(f"--out {options.out}: the name of an episode ends in .npz")
    if options.film:
        if options.film.suffix not in _FILMS:
            raise ValueError(f"--film {options.film}: the name of a film ends in {' or '.join(_FILMS)}")
        import topokit.view  # noqa: F401  # before the work, so that a missing matplotlib is said at once
    garment, task = garment_and_task(options, "tote-hook")
    loud = sys.stderr.isatty() and not options.json
    result = hang(task, seed=options.seed, garment=garment, max_steps=options.max_steps, progress=loud)
    if options.out:
        save_episode(options.out, result.episode)
    if options.film:
        _film(options.film, result.episode)
    answer = {"task": result.episode.task, "seed": options.seed}
    answer |= {name: getattr(result, name) for name in ("success", "linked", "reason", "steps", "seconds_a_decision")}
    answer |= {name: str(path) for name in ("out", "film") if (path := getattr(options, name))}
    words = "{task}: {reason}; {steps} frames, {0:.0f} ms a decision".format(1000 * result.seconds_a_decision, **answer)
    print(json.dumps(answer) if options.json else words)
    return 0 if result.success else 1


def _film(path: Path, episode: Any) -> None:
    from topokit.view import player, save_animation

    if path.suffix == ".gif":
        save_animation(path, episode)
        return
    from topokit import track

    player(episode, track(episode.observed, times=episode.times)).save(path)
