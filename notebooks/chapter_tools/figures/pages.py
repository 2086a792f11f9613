"""Interactive figures of the chapters: the reader moves points, and scripts compute the loops anew in the browser.

Idea: `topokit.view.HtmlFigure` joins the data with the scripts of this folder. `rips.js` computes loops by the same lunes as
`topokit.rips`, `complex.js` hands them to the figures, `seqph.js` decides which bars are loops, `match.js`, `lens.js` and
`corollary.js` match diagrams and find critical edges as `topokit.lemmas` does, `follow.js` and `evidence.js` track with the
reader's numbers, `link.js` links curves, and `files.js` reads the reader's files. Tests compare the answers of the scripts with
topokit's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import pdist

from topokit import farthest_point_sample, lemmas, linking_number, rips_persistence, rips_persistence_many
from topokit.linking import close_far
from topokit.view import HtmlFigure, loop_colour

from ..records import model_label

HERE = Path(__file__).parent
MOST_POINTS = 60  # the scripts compute the loops of so many while a point is dragged
MOST_THINNED = 600  # the script computes the loops of so many while a slider moves
MOST_NUDGED = 24  # the script computes 121 clouds at every change
MOST_REDUCED = 12  # their triangles are columns that can still be told apart
MOST_FRAMES = 16
MOST_IN_SPACE = 160  # edges and triangles are drawn one by one
MOST_DOTS = 120  # points of a film that are drawn
LEAST_LIFETIME = 0.005  # metres; shorter bars of a film are not stored
VERSIONS = ("paper", "corrected", "intrinsic")  # of a statement
OF_MOTION = ("temporal persistence", "regularity of killers")  # statements that depend on epsilon more than on alpha
MOST_TESTED = 160  # of their edges those of one length are tested at every change
LOOPS = ("sampling.js", "rips.js", "complex.js")  # scripts that compute loops
NO_SHARE = 65535  # stands for a share that the results lack

# ---- the data-flow picture -----------------------------------------------------------------------------------------

STAGES = ("cloth", "cloud", "loops", "tracks", "mixture", "model", "plan")


@dataclass(frozen=True)
class DataFlow:
    """The data-flow picture; a notebook shows it in the colours of the page around it."""

    svg: str = field(repr=False)  #: the picture as SVG

    def _repr_html_(self) -> str:
        return f'<div class="topokit-flow">{self.svg}</div>'


def data_flow(*lit: str) -> DataFlow:
    """Return the picture of the stages from cloth to plan, with the stages named in `lit` filled.

    Raises
    ------
    ValueError
        When a name is no stage.
    """
    unknown = set(lit) - set(STAGES)
    if unknown:
        raise ValueError(f"no stage {unknown.pop()!r}; there are {', '.join(STAGES)}")
    looks = {"lit": ", ".join(lit) or "none of them"}
    for stage in STAGES:
        if stage in lit:
            looks[f"{stage}_box"] = f'fill="{loop_colour(1)}" stroke="{loop_colour(1)}"'
            looks[f"{stage}_ink"] = 'fill="#ffffff" font-weight="600"'
        else:
            looks[f"{stage}_box"] = 'fill="none" stroke="currentColor" opacity="0.55"'
            looks[f"{stage}_ink"] = 'opacity="0.75"'
    template = Template((HERE / "data_flow.html").read_text(encoding="utf-8"))
    return DataFlow(template.substitute(looks))


# ---- the complex, its loops and its matrix -------------------------------------------------------------------------


def growth(
    points: ArrayLike,
    *,
    height: int = 500,
    start: float | None = None,
    max_radius: float | None = None,
    title: str = "drag a point",
) -> HtmlFigure:
    """Return an interactive figure of the Rips complex of a cloud as the radius grows, and of its loops.

    The diagram and the bars are beside the complex. In the diagram a loop is a circle while it lives and a dot afterwards.
    The tightest cycle of a living loop, its killer edge and its killer triangles have one colour. The reader can drag points
    of the plane. A film in space can be turned, and a second slider runs through its frames.

    Parameters
    ----------
    points : (n, 2) or (T, n, 3) array_like
        At most 60 points of the plane, or a film in space of at most 16 frames of 160 points, shown in single precision.
        Radii, births and deaths are in their unit, and half the length of an edge.
    height : int
        Height of the frame in CSS pixels.
    start : float, optional
        The radius shown first; in the middle of the longest life by default.
    max_radius : float, optional
        The end of the slider; a little after the last death by default.
    title : str
        The caption in the corner of the figure.
    """
    data: dict[str, Any] = {"start": start, "end": max_radius}
    scripts = [*LOOPS, "planar.js"]
    if np.ndim(points) == 3:
        data |= pack_film(points, max_radius)
        scripts = ["orbit.js", *scripts]
    else:
        data["points"] = planar(points).tolist()
    name = f"Rips complex of {np.shape(points)[-2]} points"
    return _figure("growth", data, scripts, height, title, name)


def pack_film(film: ArrayLike, max_radius: float | None = None) -> dict[str, Any]:
    """Return the data of a film (T, n, 3) in space; its longest lifetime decides which loops are drawn strong."""
    clouds = np.asarray(film, dtype=np.float32)
    frames, n_points, dimensions = clouds.shape
    if not (1 <= frames <= MOST_FRAMES and 1 <= n_points <= MOST_IN_SPACE and dimensions == 3):
        raise ValueError(f"a film has at most {MOST_FRAMES} frames of {MOST_IN_SPACE} points, not {clouds.shape}")
    diagrams = [rips_persistence(cloud) for cloud in clouds.astype(np.float64)]
    longest = max(float(diagram.lifetime.max(initial=0.0)) for diagram in diagrams)
    last_death = max(float(diagram.death.max(initial=0.0)) for diagram in diagrams)
    return {
        "film": clouds,
        "view": [-60, 15],
        "frame": frames // 2,
        "longest": longest,
        "end": max_radius or 1.15 * last_death or 1.0,
    }


def chains(points: ArrayLike, *, start: float, max_radius: float, chain: Sequence[tuple[int, int]] = ()) -> HtmlFigure:
    """Return an interactive figure in which the reader makes a chain of edges and asks whether it bounds.

    The boundary of the chain is marked. The answer is a set of triangles that fill a cycle, or the loops around which it goes,
    with the triangles between the cycle and theirs. A click on a triangle adds its boundary to the chain.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 12 points.
    start, max_radius : float
        The radius shown first, and the end of the slider.
    chain : sequence of (2,) tuple of int
        The edges of the chain at first, each with the smaller vertex first.
    """
    cloud = planar(points, most=MOST_REDUCED)
    edges = [list(edge) for edge in chain]
    data = {"points": cloud.tolist(), "start": float(start), "end": float(max_radius), "chain": edges}
    scripts = [*LOOPS, "planar.js", "places.js", "columns.js"]
    return _figure("chains", data, scripts, 460, "click edges to make a chain", f"Chains of {len(cloud)} points")


def elimination(points: ArrayLike, max_radius: float) -> HtmlFigure:
    """Return an interactive figure of the reduction of a planar cloud's boundary matrix, one sum of columns at a time.

    The matrix has a row for each edge and a column for each triangle up to `max_radius`, in the order of
    `topokit.rips.reduction`. The triangles and edges of the current column are highlighted in the cloud, and pairs enter a
    diagram. The reader can drag points.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 12 points. Radii, births and deaths are in their unit, and half the length of an edge.
    max_radius : float
        The radius of the last simplex.
    """
    cloud = planar(points, most=MOST_REDUCED)
    data = {"points": cloud.tolist(), "radius": float(max_radius)}
    scripts = [*LOOPS, "planar.js", "places.js", "columns.js"]
    title = f"The boundary matrix of {len(cloud)} points, reduced"
    return _figure("elimination", data, scripts, 500, "drag a point", title)


def lunes(points: ArrayLike | Mapping[str, ArrayLike]) -> HtmlFigure:
    """Return an interactive figure of the lune of one edge after another, in the order in which the edges arrive.

    The lune has a colour for each component. The figure states whether the edge joins two components, creates a loop, kills one,
    or does neither. Beside the cloud the lune is drawn alone, with its points and the two ends of the edge.

    Parameters
    ----------
    points : (n, 2) array_like, or mapping of str to (n, 2) array_like
        2 to 60 points, or several such clouds by name, of which the reader chooses one.
    """
    clouds, count = _named_clouds(points, MOST_POINTS)
    scripts = [*LOOPS, "planar.js", "places.js"]
    return _figure(
        "lunes", {"shapes": clouds}, scripts, 500, "drag a point, or click two", f"The lunes of {count} points"
    )


# ---- clouds that are observed, moved or spoilt ---------------------------------------------------------------------


def coverage(
    points: ArrayLike,
    observed: Sequence[int],
    *,
    hand: tuple[float, float, float] | None = None,
    title: str = "click a point to hide or show it",
) -> HtmlFigure:
    """Return an interactive figure of a planar scene of which some points are observed.

    Balls of the covering radius alpha lie around the observed points. In the diagram each loop of the scene that lives longer
    than alpha has a square of side alpha, in which it must be observed. The third part shows alpha against the number of
    points for farthest-point samples. The reader hides points, draws other samples, and drags points.

    Parameters
    ----------
    points : (n, 2) array_like
        The scene S, at most 60 points. Radii, births and deaths are in their unit.
    observed : (m,) sequence of int
        The points O that are observed at first.
    hand : (3,) float, optional
        Place and radius of a disc that the reader drags; it hides the points below it. The figure then also shows an estimate
        of alpha from the observed points alone, `topokit.sampling.spacing`.
    title : str
        The caption in the corner of the figure.
    """
    cloud = planar(points)
    ids = _ids(observed)
    data: dict[str, Any] = {"points": cloud.tolist(), "observed": ids}
    if hand is not None:
        data["hand"] = [float(value) for value in hand]
    scripts = [*LOOPS, "assign.js", "match.js", "planar.js"]
    return _figure("coverage", data, scripts, 500, title, f"{len(ids)} of {len(cloud)} points observed")


def thinned(
    points: ArrayLike, *, start: int = 200, least: int = 50, view: tuple[float, float] = (-60.0, 15.0)
) -> HtmlFigure:
    """Return an interactive figure of a cloud in space, thinned to fewer points, and of a threshold alpha on its loops.

    Sliders set the number of points of a farthest-point sample and alpha, which at first is the sample's covering radius. The
    picture shows the killer edges and the killer triangles of the loops that live alpha or longer; the diagram has their line.

    Parameters
    ----------
    points : (n, 3) array_like
        At most 600 points, metres, shown in single precision.
    start, least : int
        The number of points at first, and the smallest one.
    view : (2,) tuple of float
        Azimuth and elevation of the eye, degrees.

    Raises
    ------
    ValueError
        When there are too many points, or `least`, `start` and n do not ascend.
    """
    cloud = np.asarray(points, dtype=np.float32)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or not 1 <= least <= start <= len(cloud) <= MOST_THINNED:
        raise ValueError(
            f"the figure thins at most {MOST_THINNED} points in space to {start} and to {least}, not an array of shape "
            f"{cloud.shape}"
        )
    low = cloud.min(axis=0)
    high = cloud.max(axis=0)
    data = {
        "points": cloud,
        "start": int(start),
        "least": int(least),
        "middle": ((low + high) / 2).tolist(),
        "spread": float((high - low).max()) or 1.0,
        "view": list(view),
    }
    scripts = ["sampling.js", "rips.js", "orbit.js", "planar.js"]
    return _figure("thinned", data, scripts, 480, "drag to turn", f"A cloud of {len(cloud)} points, thinned")


def motion(points: ArrayLike, epsilon: float, observed: Sequence[int] | None = None) -> HtmlFigure:
    """Return an interactive figure of a planar cloud whose points can be dragged, each within `epsilon` of its first place.

    Dragging beside all points moves them together. The diagram shows each loop before the motion, with the square of side
    2 epsilon around it, and after. The dashed lines are lifetimes of epsilon and of 2 epsilon. The play button starts an
    adversary that pushes on the birth edge and the killer edge; the bars show the lifetime that no motion can remove.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 60 points, before the motion.
    epsilon : float
        Radius of the discs at first; the reader can double it.
    observed : (m,) sequence of int, optional
        The points observed before the motion, if not all are; the observed loop then has a bar of its own, with the paper's
        filter on it.
    """
    cloud = planar(points)
    ids = None if observed is None else _ids(observed)
    data = {"points": cloud.tolist(), "observed": ids, "epsilon": float(epsilon)}
    scripts = [*LOOPS, "assign.js", "match.js", "planar.js", "places.js", "adversary.js"]
    title = f"{len(cloud)} points, each within {epsilon:g} of its place"
    return _figure("motion", data, scripts, 440, "drag the points within their discs", title)


def nudge(points: ArrayLike | Mapping[str, ArrayLike]) -> HtmlFigure:
    """Return an interactive figure of how far three places of the longest-lived loop move when one point moves.

    The places are the killer edge (compared by Hausdorff distance), the barycentre of the thick killer triangle, and the
    centroid of the representative cycle, by length. A slider moves the point by at most a twentieth to a billionth of a unit.
    Charts show the moves, and birth and death, over the slider's whole range. The reader can choose and drag any point.

    Parameters
    ----------
    points : (n, 2) array_like, or mapping of str to (n, 2) array_like
        At most 24 points, about a unit in size, or several such clouds by name, of which the reader chooses one.
    """
    clouds, count = _named_clouds(points, MOST_NUDGED)
    data = {"shapes": clouds, "reaches": [0.05, 1e-3, 1e-6, 1e-9]}
    scripts = [*LOOPS, "planar.js", "places.js"]
    return _figure("nudge", data, scripts, 480, "nudge a point, or drag one", f"Loop of {count} points, nudged")


def critical(points: ArrayLike, alpha: float, epsilon: float = 0.0) -> HtmlFigure:
    """Return an interactive figure of one edge of a planar cloud: whether it is critical, and the path that decides it.

    The reader drags the ends of the edge from point to point, and sets alpha and epsilon. The dashed lens contains the points
    that need a path; the shaded lens contains the points that a path may use. The hardest pair is marked, with its best path;
    a chart compares each step of this path with its limit. Another chart shows all edges of about the killer's length, as
    `topokit.lemmas.beta_critical` tests them.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 160 points with at least one loop. Radii, births and deaths are in their unit.
    alpha, epsilon : float
        The first values of the sliders, in the unit of the points.

    Raises
    ------
    ValueError
        When the points have no loop.
    """
    cloud = planar(points, most=MOST_TESTED)
    if not len(rips_persistence(cloud)):
        raise ValueError(f"the {len(cloud)} points have no loop, so there is no killer edge to start from")
    data = {"points": cloud.tolist(), "alpha": float(alpha), "epsilon": float(epsilon)}
    scripts = [*LOOPS, "planar.js", "places.js", "lens.js"]
    title = f"A critical edge of {len(cloud)} points?"
    return _figure("critical", data, scripts, 520, "drag an end of the edge", title)


def hiding(points: ArrayLike, hidden: Sequence[int] = ()) -> HtmlFigure:
    """Return an interactive figure of two observers of a planar cloud, and of the killer edge that each of them sees.

    The reader hides points from one observer. A chart compares its killer with that of every observer who misses one point or
    none, and with two bounds of `topokit.lemmas.corollary`: the paper's, and the corrected one. A strip shows the components of
    the lunes of the edges that the first observer sees. The reader can drag points.

    Parameters
    ----------
    points : (n, 2) array_like
        4 to 24 points with at least one loop.
    hidden : sequence of int
        The points that are hidden at first.

    Raises
    ------
    ValueError
        When there are too few points, or they have no loop.
    """
    cloud = planar(points, most=MOST_NUDGED)
    if not len(rips_persistence(cloud)):
        raise ValueError(f"the {len(cloud)} points have no loop, so there is no killer edge to observe")
    data = {"points": cloud.tolist(), "hidden": _ids(hidden)}
    scripts = [*LOOPS, "assign.js", "match.js", "planar.js", "places.js", "lens.js", "corollary.js"]
    title = f"The killer edges that observers of {len(cloud)} points see"
    return _figure("hiding", data, scripts, 480, "click a point to hide it", title)


def stray(points: ArrayLike, start: Sequence[float], end: Sequence[float]) -> HtmlFigure:
    """Return an interactive figure of two rules that decide which bars are loops, and of a stray point that spoils one rule.

    The bars are beside the cloud, each with the mark that the bar of a loop must reach. The first rule is that of
    ``SeqPH.paper()``, with a guessed alpha, on all points. The second is the evidence of `topokit.SeqPH` in one frame, on the
    points that have neighbours. The reader can drag any point.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 59 points. Radii, births and deaths are in their unit.
    start, end : (2,) sequence of float
        The first place of the stray point, and the place to which the slider and the play button take it.
    """
    cloud = planar(points, most=MOST_POINTS - 1)
    ends = planar([start, end]).tolist()
    data = {"points": cloud.tolist(), "start": ends[0], "end": ends[1]}
    scripts = [*LOOPS, "assign.js", "seqph.js", "planar.js", "places.js", "rules.js"]
    return _figure("stray", data, scripts, 480, "drag the stray point away", f"{len(cloud)} points and a stray one")


def gates(
    film: ArrayLike,
    *,
    alpha: float,
    beta: float,
    epsilon: float,
    rule: str = "paper",
    view: tuple[float, float] = (-75.0, 12.0),
) -> HtmlFigure:
    """Return an interactive figure of a film, the table of costs of each step with its assignment, and the names of the loops.

    Sliders set alpha, beta and epsilon, a menu chooses the gates. The names are those of `topokit.SeqPH` with these options,
    ``loops="alpha"``, ``identity="killer-edge"`` and no memory. A cell of the table shows the cost of a pair, or the gate that
    closes the pair. A chart shows the names along the film.

    Parameters
    ----------
    film : (T, n, 3) array_like
        Clouds, metres. Their bars of 5 mm and more are stored, and 120 of their points.
    alpha, beta, epsilon : float
        The first values of the sliders, metres.
    rule : {"paper", "proved", "near"}
        The gates at first, as in `topokit.SeqPH`.
    view : (2,) tuple of float
        Azimuth and elevation of the eye, degrees.
    """
    clouds = np.asarray(film, dtype=np.float64)
    diagrams = rips_persistence_many(list(clouds), min_lifetime=LEAST_LIFETIME)
    rows = []
    for diagram, points in zip(diagrams, clouds, strict=True):
        ends = points[diagram.killer_edge].reshape(-1, 6)
        rows.append(np.column_stack([diagram.birth, diagram.death, ends]))
    bars = np.concatenate(rows)

    # The picture needs few points, to the millimetre.
    shown, _ = farthest_point_sample(clouds[0], min(MOST_DOTS, clouds.shape[1]))
    dots = clouds[:, shown]
    low = dots.min(axis=(0, 1))
    high = dots.max(axis=(0, 1))
    data = {
        "frames": len(clouds),
        "counts": [len(diagram) for diagram in diagrams],
        "bars": bars,
        "cloud": np.rint((dots - low) * 1000).astype(np.int64),
        "scale": 1e-3,
        "low": low.tolist(),
        "middle": ((low + high) / 2).tolist(),
        "spread": float((high - low).max()),
        "view": list(view),
        "least": LEAST_LIFETIME,
        "most": float(1.1 * max(diagram.lifetime.max(initial=LEAST_LIFETIME) for diagram in diagrams)),
        "options": {"alpha": float(alpha), "beta": float(beta), "epsilon": float(epsilon), "gates": rule},
    }
    scripts = ["orbit.js", "planar.js", "assign.js", "follow.js"]
    return _figure("gates", data, scripts, 560, "drag to turn", f"The loops of {len(clouds)} frames, matched by gates")


def belief(films: Mapping[str, ArrayLike]) -> HtmlFigure:
    """Return an interactive figure of the significance of a loop's bar along a film, and of the belief that adds up.

    Sliders set the threshold of significance, the share of the belief that is kept, and the belief above which the loop is
    reported; their first values are those of `topokit.SeqPH`. The reader can drag the significance of each frame. A strip
    shows the frames in which the loop is reported, by each frame alone and by belief.

    Parameters
    ----------
    films : mapping of str to (T,) array_like
        Significances of the loop's bar by frame, for each film; the reader chooses one.
    """
    strengths = {name: np.asarray(film, dtype=np.float64).tolist() for name, film in films.items()}
    scripts = ["planar.js", "places.js", "evidence.js"]
    title = f"Belief along {' or '.join(strengths)}"
    return _figure("belief", {"shapes": strengths}, scripts, 500, "drag a dot up or down", title)


def verdicts(
    before: ArrayLike, after: ArrayLike, *, levels: tuple[int, int] = (8, 6), view: tuple[float, float] = (-75.0, 12.0)
) -> HtmlFigure:
    """Return an interactive figure of one frame of cloth, with sliders for alpha and epsilon and a verdict on every statement.

    The alpha slider hides points: the observed ones are farthest-point samples. The epsilon slider makes a part of the motion
    from `before` to `after`. For each step of both, `topokit.lemmas.verify_step` has checked all statements in the paper's
    version, the corrected one, and the intrinsic one. A chart shows what is measured, and the bounds, for one statement.

    Parameters
    ----------
    before, after : (n, 3) array_like
        The same points in two frames, metres. A step with 130 points takes a fifth of a second.
    levels : (2,) tuple of int
        The numbers of steps of the two sliders, alpha and epsilon, each at least 2.
    view : (2,) tuple of float
        Azimuth and elevation of the eye, degrees.

    Raises
    ------
    ValueError
        When the points of `before` have no loop.
    """
    state = np.asarray(before, dtype=np.float64)
    motion = np.asarray(after, dtype=np.float64) - state
    diagram = rips_persistence(state)
    if not len(diagram):
        raise ValueError(f"the {len(state)} points have no loop, so there is nothing that a statement could promise")
    counts = _sample_sizes(state, levels[0], 1.25 * float(diagram.lifetime[0]))
    observed = [farthest_point_sample(state, count)[0] for count in counts]
    shares = np.linspace(0, 1, levels[1])
    states = [state + share * motion for share in shares]

    # Check every pair of levels.
    statements = list(lemmas.verify_step(state, observed[0], states[0], observed[0]))
    shape = (*levels, len(statements), len(VERSIONS))
    outcomes = np.zeros(shape, dtype=np.uint8)
    numbers = np.zeros((*shape, 2))
    killers_then = np.zeros((*levels, 2), dtype=np.int64)
    alphas = np.zeros(levels)
    for a, ids in enumerate(observed):
        for e, moved in enumerate(states):
            ids_then, _ = farthest_point_sample(moved, len(ids), start=1)
            killers_then[a, e] = _killer(moved, ids_then)
            checks = lemmas.verify_step(state, ids, moved, ids_then)
            alphas[a, e] = checks["gates"].alpha
            for s, check in enumerate(checks.values()):
                for v, version in enumerate(VERSIONS):
                    verdict = check.versions.get(version)
                    if verdict is not None:
                        outcomes[a, e, s, v] = _outcome(verdict)
                        numbers[a, e, s, v] = verdict.statistic, verdict.bound

    low = state.min(axis=0)
    high = state.max(axis=0)
    seen = np.zeros((levels[0], len(state)), dtype=bool)
    for a, ids in enumerate(observed):
        seen[a, ids] = True
    data = {
        "statements": statements,
        "versions": VERSIONS,
        "along": ["epsilon" if name in OF_MOTION else "alpha" for name in statements],
        "counted": [name == "feature approximation" for name in statements],
        "alphas": alphas.tolist(),
        "epsilons": [float(np.linalg.norm(moved - state, axis=1).max()) for moved in states],
        "distortions": [float(np.abs(pdist(moved) - pdist(state)).max()) / 2 for moved in states],
        "counts": counts,
        "life": float(diagram.lifetime[0]),
        "outcomes": outcomes,
        "numbers": numbers,
        "before": state,
        "motion": motion,
        "seen": seen,
        "killers": np.array([_killer(state, ids) for ids in observed]),
        "killersThen": killers_then,
        "middle": ((low + high) / 2).tolist(),
        "spread": float((high - low).max()),
        "view": list(view),
        "start": [1, 1],
    }
    title = f"The lemmas on {len(state)} points of cloth"
    return _figure("verdicts", data, ["orbit.js", "planar.js"], 600, "drag to turn", title)


def _sample_sizes(points: NDArray[np.float64], levels: int, largest: float) -> list[int]:
    """Return numbers of farthest-point samples whose covering radii are spread evenly from 0 to `largest`."""
    n_points = len(points)
    radii = np.array([farthest_point_sample(points, count)[1] for count in range(1, n_points + 1)])
    least = float(radii[radii > 0].min())
    wanted = [0.0, *np.linspace(least, largest, levels - 1)]
    return [int(np.argmax(radii <= radius * (1 + 1e-9))) + 1 for radius in wanted]


def _killer(points: NDArray[np.float64], ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the killer edge (2,) of the longest bar of some points; twice their first point where there is no bar."""
    diagram = rips_persistence(points[ids])
    if not len(diagram):
        return ids[[0, 0]]
    return ids[diagram.killer_edge[0]]


def _outcome(verdict: Any) -> int:
    """Return 1 where no loop is long enough, 2 where the assumptions are not met, 3 for a true conclusion, 4 for a false one."""
    if not verdict.loops:
        return 1
    if not verdict.hypotheses:
        return 2
    return 3 if verdict.holds else 4


def cloud(samples: Mapping[str, ArrayLike]) -> HtmlFigure:
    """Return the page on which readers see the loops of their own clouds: files, pasted numbers, or a sample.

    Everything is computed in the browser, in a worker; no file leaves it.

    Parameters
    ----------
    samples : mapping of str to (n, 3) or (T, n, 3) array_like
        Clouds and films by name, metres. They are stored to 0.1 mm.
    """
    packed = {}
    for name, points in samples.items():
        ticks = np.rint(np.asarray(points, dtype=np.float64) * 10_000).astype(np.int64)
        low = ticks.reshape(-1, 3).min(axis=0)
        packed[name] = {"ticks": ticks - low, "low": low.tolist()}
    kernel = ["sampling.js", "rips.js", "assign.js", "seqph.js", "worker.js"]
    scripts = [*kernel, "cuts.js", "files.js", "samples.js", "out.js", "orbit.js", "planar.js"]
    return _figure("cloud", {"samples": packed}, scripts, 900, "drag to turn", "Loops of your cloud")


# ---- probability, links and results --------------------------------------------------------------------------------


def mixture(points: ArrayLike, border: int) -> HtmlFigure:
    """Return an interactive figure of the mixture of a planar cloud's longest-lived loop, as `topokit.loop_mixture` makes it.

    Sliders choose the number of neighbours of the killer triangles and the noise; the reader can drag any point. Charts show
    the density along the border of the opening and a reliability diagram of its points. The dashed curve is one Gaussian with
    the same moments.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 60 points, metres.
    border : int
        The number of points, the first ones, that are the border of the true opening, in order.
    """
    cloud = planar(points)
    data = {"points": cloud.tolist(), "border": int(border)}
    title = f"Mixture of {len(cloud)} points"
    return _figure("mixture", data, [*LOOPS, "planar.js"], 480, "drag a point", title)


def linked(curve: ArrayLike, line: ArrayLike, way: ArrayLike) -> HtmlFigure:
    """Return an interactive figure of a closed curve on its way to a hook, with their crossings, linking number and distance.

    Parameters
    ----------
    curve : (n, 3) array_like
        Handles of the curve, which the reader drags, at most 24.
    line : (m, 3) array_like
        Corners of an open line, which `topokit.linking.close_far` closes.
    way : (k, 3) array_like
        Shifts of the curve, from the left end of a slider to the right.
    """
    handles = np.asarray(curve, dtype=np.float64)
    corners = close_far(line)
    shifts = np.asarray(way, dtype=np.float64)
    data = {"curve": handles.tolist(), "line": corners.tolist(), "way": shifts.tolist()}
    title = f"A curve and a hook, linking number {linking_number(handles, corners)}"
    return _figure("linked", data, ["link.js", "planar.js"], 480, "drag a handle, or turn the view", title)


def shares(results: Mapping[str, Any], measures: Mapping[str, str]) -> HtmlFigure:
    """Return an interactive figure of a results file: shares with intervals by predictor, horizon, garment and condition.

    Parameters
    ----------
    results : mapping
        A file of `book/results` with forecasts.
    measures : mapping of str to str
        The measures that the reader may choose by name, each one of the file's `hull_treatments` or tables.
    """
    conditions = results["conditions"]
    garments = max((list(condition.get("by_garment", {})) for condition in conditions.values()), key=len)
    first_condition = next(iter(conditions.values()))
    models = list(first_condition["hull_accuracy"])
    horizons = list(results["horizons"])

    # (conditions, garments, measures, models, horizons, 4): mean, low, high and the number of windows
    cells = []
    for condition in conditions.values():
        by_garment = condition.get("by_garment", {})
        for tables in [condition, *(by_garment.get(garment, {}) for garment in garments)]:
            for measure in measures.values():
                table = tables.get("hull_treatments", {}).get(measure) or tables.get(measure)
                cells += [_share(table, model, horizon) for model in models for horizon in horizons]
    shape = (len(conditions), 1 + len(garments), len(measures), len(models), len(horizons), 4)
    table = np.reshape(cells, shape)

    data = {
        "measure": list(measures),
        "garment": ["all", *garments],
        "model": [model_label(model) for model in models],
        "horizon": horizons,
        "condition": list(conditions),
        "marks": [models.index(model) for model in ("ours", "seqph", "carry")],
        "cells": table[..., :3],
        "counts": table[..., 0, :, 3:],
    }
    scripts = ["orbit.js", "planar.js"]
    title = f"Shares of {len(models)} predictors"
    return _figure("shares", data, scripts, 560, "choose a row, or below", title)


def _share(table: Mapping[str, Any] | None, model: str, horizon: str) -> list[int]:
    """Return mean, low and high in ten thousandths, and the number of windows."""
    if table is None:
        return [NO_SHARE] * 4
    cell = table[model][horizon]
    values = [cell[key] for key in ("mean", "low", "high")]
    return [NO_SHARE if value is None else round(1e4 * value) for value in values] + [cell["n"]]


# ---- what the figures have in common -------------------------------------------------------------------------------


def _figure(
    name: str, data: Mapping[str, Any], scripts: Sequence[str], height: int, caption: str, title: str
) -> HtmlFigure:
    return HtmlFigure.from_parts(name, data, scripts=scripts, folder=HERE, height=height, caption=caption, title=title)


def _named_clouds(points: ArrayLike | Mapping[str, ArrayLike], most: int) -> tuple[dict[str, Any], str]:
    """Return planar clouds by name, and their numbers of points in words."""
    named = points if isinstance(points, Mapping) else {"points": points}
    clouds = {name: planar(cloud, most=most).tolist() for name, cloud in named.items()}
    return clouds, " or ".join(str(len(cloud)) for cloud in clouds.values())


def _ids(observed: Sequence[int]) -> list[int]:
    return sorted(set(map(int, observed)))


def planar(points: ArrayLike, *, most: int = MOST_POINTS) -> NDArray[np.float64]:
    """Return a cloud of the plane, or raise ValueError; every digit is kept, since ties must stay ties."""
    cloud = np.asarray(points, dtype=np.float64)
    if cloud.ndim != 2 or cloud.shape[1] != 2 or not 1 <= len(cloud) <= most:
        raise ValueError(f"the figure shows 1 to {most} points of the plane, not an array of shape {cloud.shape}")
    return cloud
