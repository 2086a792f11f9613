"""The commands `topokit simulate`, `hang` and `mesh`. What they need is imported when they run."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from ._archive import FormatError, atomic_file, existing, read_json

_TASKS = """tasks, a garment and a target:
  {apron,apron2,tote,tote2,backpack,mask,sheet,sheet2,scarf,belt,net,trousers}-hook
  {apron,apron2,tote,tote2,backpack,mask,sheet,sheet2,scarf,belt,net,trousers}-hanger
  {apron,apron2,backpack,shirt,vest}-mannequin
with --mesh also hook, hanger and mannequin: as the names of its loops allow"""
_AXES = ("x", "y", "z", "-x", "-y", "-z")
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}


def add(commands: Any) -> None:
    form: Any = {"formatter_class": argparse.RawDescriptionHelpFormatter, "epilog": _TASKS}
    words = "record an episode: a garment carried to a target and let go there"
    simulate = commands.add_parser("simulate", help=words, **form)
    option = simulate.add_argument
    option("--task", help="what goes where (default apron-hook; hook with --mesh), see below")
    option("--seed", type=int, default=0, help="of everything random (default 0)")
    option("--out", type=Path, required=True, metavar="EPISODE", help="where to write it (.npz)")
    option("--randomise", action="store_true", help="draw physics, size and cameras, not only the path")
    option("--cameras", type=int, default=0, metavar="K", help="observe with K depth cameras around the target")
    option("--noise", action="store_true", help="cameras with the noise of a depth sensor")
    option("--observed", type=int, metavar="N", help="points of an observation (default 500, or all vertices if fewer)")
    patience = "stop a simulation that shows no sign of life for so many seconds (default 60)"
    option("--time-limit", type=float, default=60.0, metavar="S", help=patience)
    option("--mesh", type=Path, metavar="FILE", help="a garment of one's own (.obj, .ply, .stl)")
    _add_of_mesh(simulate)
    simulate.set_defaults(run=_simulate)

    words = "hang a garment by what is seen of it, in a closed loop; exit code 1 when it does not hang"
    hang = commands.add_parser("hang", help=words, **form)
    option = hang.add_argument
    option("--task", "--target", help="what goes where (default tote-hook; hook with --mesh), see below")
    option("--seed", type=int, default=0, help="of where it starts (default 0)")
    option("--model", help="plan by a forecast: carry, or a checkpoint of a motion model (default: a servo, without)")
    option("--anywhere", action="store_true", help="target and start anywhere in the room, at any yaw, by the seed")
    option("--fence", type=float, default=0.0, metavar="METRES", help="so far before the arm hands stop: it is thrown")
    option("--out", type=Path, metavar="EPISODE", help="also write what happened, as an episode (.npz)")
    option("--film", type=Path, metavar="FILM", help="also write a film of it (.gif, .html)")
    option("--mesh", type=Path, metavar="FILE", help="a garment of one's own (.obj, .ply, .stl)")
    _add_of_mesh(hang)
    hang.set_defaults(run=_hang)

    mesh = commands.add_parser("mesh", help="say, and show, what is understood of a mesh: borders, loops and grips")
    mesh.add_argument("mesh", type=Path, metavar="FILE", help="a garment of one's own (.obj, .ply, .stl)")
    _add_of_mesh(mesh)
    mesh.add_argument("--plot", type=Path, metavar="PICTURE", help="also draw it (.png, .svg or .pdf)")
    mesh.set_defaults(run=_mesh)


def _add_of_mesh(command: Any) -> None:
    ids = "auto (default), borders, or a file of vertex ids: {NAME: [ID, ...], ...} or [[ID, ...], ...] (.json)"
    command.add_argument("--loops", metavar="LOOPS", help=f"of the mesh: {ids}")
    command.add_argument("--unit", choices=_UNITS, help="of the mesh (default: the one that makes it a garment's size)")
    command.add_argument("--size", type=float, metavar="METRES", help="its largest extent, instead of a unit")
    command.add_argument("--up", choices=_AXES, help="the axis of the mesh that points up (default: found)")


def _simulate(options: argparse.Namespace) -> int:
    from .io import save_episode

    if options.out.suffix != ".npz":
        raise ValueError(f"--out {options.out}: the name of an episode ends in .npz")
    episode = _simulated(options)
    path = save_episode(options.out, episode)
    answer: dict[str, Any] = {"episode": str(path)}
    answer |= {name: getattr(episode, name) for name in ("task", "seed", "garment", "target")}
    answer |= {"loops": list(episode.named_loops)}
    answer |= {"frames": len(episode), "vertices": episode.points.shape[1], "observed": episode.observed.shape[1]}
    answer |= {"success": episode.success}
    outcome = "it hangs" if episode.success else "it does not hang"
    words = "{episode}: {garment} to {target}, {frames} frames, {vertices} vertices".format(**answer)
    print(json.dumps(answer) if options.json else f"{words}; {outcome}")
    return 0


def _simulated(options: argparse.Namespace) -> Any:
    """The episode that was asked for."""
    from .sim import Camera, DepthNoise, Randomisation, simulate

    if options.cameras < 0 or (options.noise and not options.cameras):
        raise ValueError(f"--cameras {options.cameras}: a number of cameras, one at least with --noise")
    garment, task = _garment_and_task(options, "apron-hook")
    noise = DepthNoise() if options.noise else None
    return simulate(
        garment,
        task=task,
        seed=options.seed,
        randomisation=Randomisation() if options.randomise else None,
        cameras=Camera.around(task.target.seat, options.cameras, distance=2.2, noise=noise) if options.cameras else (),
        n_observed=options.observed,
        time_limit=options.time_limit,
        progress=sys.stderr.isatty() and not options.json,
    )


def _hang(options: argparse.Namespace) -> int:
    from .control import hang
    from .io import save_episode
    from .seqph import track

    for name, known in (("out", (".npz",)), ("film", (".gif", ".html"))):
        path = getattr(options, name)
        if path and path.suffix not in known:
            raise ValueError(f"--{name} {path}: the name ends in {' or '.join(known)}")
    if options.film:
        from .view import player, save_animation  # before the work, so that a missing matplotlib is said at once
    garment, task = _garment_and_task(options, "tote-hook")
    where: dict[str, Any] = {"place": "anywhere", "start": "anywhere"} if options.anywhere else {}
    where |= {"fence": options.fence} if options.fence else {}
    loud = sys.stderr.isatty() and not options.json
    result = hang(task, seed=options.seed, garment=garment, model=options.model, progress=loud, **where)
    if options.out:
        save_episode(options.out, result.episode)
    if options.film and options.film.suffix == ".gif":
        save_animation(options.film, result.episode)
    elif options.film:
        player(result.episode, track(result.episode.observed, times=result.episode.times)).save(options.film)
    answer = {"task": result.episode.task, "seed": options.seed}
    answer |= {name: getattr(result, name) for name in ("success", "linked", "reason", "steps", "seconds_a_decision")}
    words = "{task}: {reason}; {steps} frames, {0:.0f} ms a decision".format(1000 * result.seconds_a_decision, **answer)
    print(json.dumps(answer) if options.json else words)
    return 0 if result.success else 1


def _garment_and_task(options: argparse.Namespace, default: str) -> tuple[Any, Any]:
    """The garment of a mesh, None when none is given, and the task that was asked for."""
    from .sim import TASKS, Hanger, Hook, Mannequin, task_for

    targets = {kind.name: kind for kind in (Hook, Hanger, Mannequin)} if options.mesh else {}
    name = options.task or ("hook" if options.mesh else default)
    if name not in {**TASKS, **targets}:
        raise ValueError(f"--task {name}: there is no such task; there are {', '.join([*TASKS, *targets])}")
    garment = _garment(options)
    if garment and name in targets:
        return garment, task_for(garment, targets[name]().raised_for(garment))
    return garment, TASKS[name]


def _garment(options: argparse.Namespace) -> Any:
    """The garment of a mesh; None when none is given."""
    from .sim import Garment

    loops = options.loops or "auto"
    if not options.mesh:
        given = [name for name in ("loops", "unit", "size", "up") if getattr(options, name)]
        if given:
            raise ValueError(f"--{given[0]} is of a mesh: give --mesh FILE, or leave it out")
        return None
    if loops not in ("auto", "borders"):
        try:
            loops = read_json(existing(loops).read_bytes())
        except ValueError as error:
            raise FormatError(f"--loops {options.loops}: no JSON: {error}") from error
        if not isinstance(loops, dict | list):
            raise FormatError(f"--loops {options.loops}: it must hold lists of vertex ids, by name or in a list")
    asked = {"loops": loops, "scale": _UNITS.get(options.unit), "size": options.size, "up": options.up}
    garment = Garment.from_mesh(options.mesh, **asked)
    if not garment.loops:
        why = next((said for said in garment.repairs if "open front" in said), "its border is its edge")
        raise ValueError(f"{options.mesh}: it has no loop to hang it by; {why}")
    return garment


def _mesh(options: argparse.Namespace) -> int:
    garment = _garment(options)
    sizes = garment.vertices.max(axis=0) - garment.vertices.min(axis=0)
    loops = {name: len(loop) for name, loop in garment.named_loops.items()}
    answer = {"mesh": str(options.mesh), "vertices": len(garment.vertices), "faces": len(garment.faces)}
    answer |= {"metres": sizes.tolist(), "loops": loops, "grips": garment.vertices[garment.grips].tolist()}
    if options.plot:
        _plot(options.plot, garment)
    if options.json:
        print(json.dumps({**answer, "repairs": garment.repairs}))
        return 0
    print("{mesh}: {vertices} vertices, {faces} faces; {0:.2f} by {1:.2f} by {2:.2f} m".format(*sizes, **answer))
    for name, count in loops.items():
        print(f"  {name}: {count} vertices")
    return 0


def _plot(path: Path, garment: Any) -> None:
    """The garment from before and from the side, its loops with their names, its grips."""
    from matplotlib.figure import Figure

    from .view import plot_cloth

    figure = Figure(figsize=(10, 6), dpi=120)
    for column, view in enumerate(((-70, 12), (-20, 12)), 1):
        axes: Any = figure.add_subplot(1, 2, column, projection="3d")
        plot_cloth(garment.vertices, garment.faces, ax=axes, true_loops=garment.loops, view=view)
        axes.scatter(*garment.vertices[garment.grips].T, color="black", zorder=5)
        for name, loop in garment.named_loops.items():
            axes.text(*garment.vertices[loop].mean(axis=0), name, ha="center", zorder=6)
    if path.suffix not in (".png", ".svg", ".pdf"):
        raise ValueError(f"--plot {path}: the name of a picture ends in .png, .svg, .pdf")
    with atomic_file(path) as picture:
        figure.savefig(picture, format=path.suffix[1:])
