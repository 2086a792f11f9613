"""Figures of the browser: the data-flow picture, and points that the reader moves, on pages without a kernel.

Idea: the data are packed once beside scripts without dependencies, and the page is handed to the browser as the `srcdoc` of an
iframe. So it works the same in Jupyter, on a built page and as a file, and asks nothing of the network. `rips.js` computes loops
by the same lunes as `topokit.rips`, `match.js` matches diagrams as `topokit.lemmas` does, `link.js` links, and `rules.js` says
which bars are loops, all in milliseconds. Tests hold their answers to topokit's. Taught in chapters 1 to 7 and 14.
"""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points, as_sequence, positive, whole
from topokit.lemmas import vertex_ids
from topokit.linking import close_far, linking_number
from topokit.seqph import loop_colour
from topokit.view._packed import grown

MOST_POINTS = 60  # as many as the scripts can follow while a point is dragged
MOST_NUDGED = 24  # the script computes 121 clouds at every change
MOST_REDUCED = 10  # whose 120 triangles are columns that can still be told apart
REACHES = (0.05, 1e-3, 1e-6, 1e-9)


@dataclass(frozen=True, repr=False)
class Framed:
    """A moving figure; the last value of a notebook cell shows it."""

    page: str  #: the whole HTML page, its data and its script inside
    height: int  #: of the frame in CSS pixels; a narrow page stacks the parts and takes more
    title: str  #: what the frame is called for readers who hear the page

    def _repr_html_(self) -> str:
        source, title = html.escape(self.page, quote=True), html.escape(self.title)
        look = f"width:100%;height:{self.height}px;border:0;display:block"
        return f'<iframe srcdoc="{source}" title="{title}" loading="lazy" allowfullscreen style="{look}"></iframe>'

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.title!r}, {len(self.page) / 1000:.0f} kB)"

    def save(self, path: str | Path) -> Path:
        """Write the figure as one HTML file that opens in any browser, and return its path."""
        path = Path(path)
        path.write_text(self.page, encoding="utf-8")
        return path


def framed(name: str, scripts: tuple[str, ...], data: dict[str, Any], height: int, caption: str, title: str) -> Framed:
    """The page `name`: its parts, `name`.html, in the frame that all share, and its script, `name`.js, after `scripts`."""
    data = data | {"height": int(height), "title": caption, "palette": list(PALETTE)}
    lines = [line.strip() for script in ("frame.js", *scripts, f"{name}.js") for line in _text(script).splitlines()]
    code = "\n".join(line for line in lines if line and not line.startswith("//"))  # as written but for these
    parts = {
        "NAME": name,
        "STYLE": _text("frame.css"),
        "PARTS": _text(f"{name}.html"),
        "SCRIPT": f"(() => {{\n{code}\n}})();",
        "DATA": json.dumps(data, separators=(",", ":")).replace("</", "<\\/"),  # it could end the script element
    }
    page = _text("frame.html")
    for part, text in parts.items():
        page = page.replace(f"__{part}__", text)
    return Framed(page, height, title)


def _text(file: str) -> str:
    return resources.files("topokit.view").joinpath(file).read_text(encoding="utf-8")


PALETTE = tuple(loop_colour(number) for number in range(6))  # identities six apart share a colour
STAGES = ("cloth", "cloud", "loops", "tracks", "mixture", "model", "plan")
# how the box of a stage looks, and its name
_LIT = (f'fill="{PALETTE[1]}" stroke="{PALETTE[1]}"', 'fill="#ffffff" font-weight="600"')
_UNLIT = ('fill="none" stroke="currentColor" opacity="0.55"', 'opacity="0.75"')


@dataclass(frozen=True)
class DataFlow:
    """The picture; a notebook shows it, in the colours of the page around it."""

    svg: str = field(repr=False)  #: as SVG text

    def _repr_html_(self) -> str:
        return f'<div class="topokit-flow">{self.svg}</div>'


def data_flow(*lit: str) -> DataFlow:
    """Return the picture of the stages from cloth to plan, with the stages named in `lit` filled.

    Raises
    ------
    ValueError
        When a name is no stage.
    """
    for name in set(lit) - set(STAGES):
        raise ValueError(f"no stage {name!r}; there are {', '.join(STAGES)}")
    looks = {"lit": ", ".join(lit) or "none of them"}
    for name in STAGES:
        looks[f"{name}_box"], looks[f"{name}_ink"] = _LIT if name in lit else _UNLIT
    return DataFlow(Template(_text("data_flow.html")).substitute(looks))


def growth(
    points: ArrayLike,
    *,
    height: int = 500,
    start: float | None = None,
    max_radius: float | None = None,
    title: str = "drag a point",
) -> Framed:
    """Return an interactive figure of the Rips complex of a cloud as the radius grows, and of its loops.

    Beside the complex stand its diagram, where a loop is a circle while it lives and a dot once it is dead, and its bars.
    The tightest cycle of a living loop, its killer edge and its killer triangles have one colour. The points of the plane can
    be dragged. A film of space can be turned, and a second slider goes through its frames, whose loops are computed here.

    Parameters
    ----------
    points : (n, 2) or (T, n, 3) array_like
        At most 60 points of the plane, or a film of space, at most 16 frames of 160 points, kept to the 65,535th part of what
        they span. Radii, births and deaths are in their unit, and half the length of an edge.
    height : int
        Height of the frame in CSS pixels.
    start : float, optional
        The radius shown before anyone touches the figure; in the middle of the longest life by default.
    max_radius : float, optional
        Where the slider ends; a little after the last death by default.
    title : str
        The caption in the corner of the figure.

    Raises
    ------
    ValueError
        When `start` lies beyond `max_radius`, or a film has too many frames or points.
    """
    first = None if start is None else positive(start, "start")
    last = None if max_radius is None else positive(max_radius, "max_radius", zero=False)
    if first is not None and last is not None and first > last:
        raise ValueError(f"start must be at most max_radius, {last}, not {first}")
    data: dict[str, Any] = {"start": first, "end": last}
    scripts, space = ("rips.js", "planar.js"), np.ndim(points) == 3
    data |= grown(as_sequence(points), last) if space else {"points": planar(points, "points", MOST_POINTS).tolist()}
    name = f"Rips complex of {np.shape(points)[-2]} points"
    return framed("growth", ("orbit.js", *scripts) if space else scripts, data, height, title, name)


def elimination(points: ArrayLike, max_radius: float) -> Framed:
    """Return an interactive figure of the reduction of a planar cloud's boundary matrix, one sum of columns at a time.

    The matrix has a row for each edge and a column for each triangle up to `max_radius`, as `topokit.rips.reduction` orders
    them. The present column's triangles and edges light up in the cloud, and pairs enter a diagram. Points can be dragged.

    Parameters
    ----------
    points : (n, 2) array_like
        2 to 10 points. Radii, births and deaths are in their unit, and half the length of an edge.
    max_radius : float
        Of the last simplex.

    Raises
    ------
    ValueError
        When there are more points.
    """
    cloud, radius = planar(points, "points", MOST_REDUCED), positive(max_radius, "max_radius", zero=False)
    title, data = f"The boundary matrix of {len(cloud)} points, reduced", {"points": cloud.tolist(), "radius": radius}
    scripts = ("rips.js", "planar.js", "places.js", "columns.js")
    return framed("elimination", scripts, data, 500, "drag a point", title)


def coverage(
    points: ArrayLike,
    observed: ArrayLike,
    *,
    hand: tuple[float, float, float] | None = None,
    title: str = "click a point to hide or show it",
) -> Framed:
    """Return an interactive figure of a planar scene of which some points are observed.

    Balls of the covering radius alpha stand around the observed points. In the diagram every loop of the scene that lives
    longer than alpha has a square of side alpha, in which it must be seen. The third part shows alpha against the number of
    points for farthest-point samples. The reader hides points, draws others, drags them.

    Parameters
    ----------
    points : (n, 2) array_like
        The scene S, at most 60 points. Radii, births and deaths are in their unit.
    observed : (m,) array_like of int
        Which of them are observed at first, O.
    hand : (3,) float, optional
        Place and radius of a disc that the reader drags: what is below it is not observed. Beside alpha then stands its guess
        from the observed points alone, `topokit.sampling.spacing`.
    title : str
        The caption in the corner of the figure.
    """
    cloud = planar(points, "points", MOST_POINTS)
    ids = vertex_ids(cloud, observed)
    data: dict[str, Any] = {"points": cloud.tolist(), "observed": ids.tolist()}
    if hand is not None:
        place, radius = planar([hand[:2]], "hand", 1)[0].tolist(), positive(hand[2], "hand's radius", zero=False)
        data["hand"] = [*place, radius]
    scripts = ("rips.js", "match.js", "planar.js")
    return framed("coverage", scripts, data, 500, title, f"{len(ids)} of {len(cloud)} points observed")


def motion(points: ArrayLike, epsilon: float, observed: ArrayLike | None = None) -> Framed:
    """Return an interactive figure of a planar cloud whose points can be dragged, each within `epsilon` of where it was.

    Dragging beside all points moves them together. The diagram shows every loop before, with the square of side 2 epsilon
    around it, and after; the dashed lines are lifetimes of epsilon and of 2 epsilon. The play button lets an adversary push on
    the birth edge and the killer edge, and beside the bars stands what no motion can take from them.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 60 points, where they are before the motion.
    epsilon : float
        Radius of the discs at first; the reader can change it up to its double.
    observed : (m,) array_like of int, optional
        Who is seen before the motion, if not all are; what is seen then has a bar of its own, with the paper's filter on it.
    """
    cloud, radius = planar(points, "points", MOST_POINTS), positive(epsilon, "epsilon", zero=False)
    ids = None if observed is None else vertex_ids(cloud, observed).tolist()
    data = {"points": cloud.tolist(), "observed": ids, "epsilon": radius}
    title = f"{len(cloud)} points, each within {radius:g} of its place"
    scripts = ("rips.js", "match.js", "planar.js", "places.js", "adversary.js")
    return framed("motion", scripts, data, 440, "drag the points within their discs", title)


def nudge(points: ArrayLike | Mapping[str, ArrayLike]) -> Framed:
    """Return an interactive figure of how far three places of the longest-lived loop move when one point does.

    The places are the killer edge (compared by Hausdorff distance), the barycentre of the thick killer triangle, and the
    centroid of the representative cycle, by length. A slider moves the point by at most a twentieth to a billionth of a unit;
    charts show the moves, and birth and death, over its whole range. Any point can be chosen and dragged.

    Parameters
    ----------
    points : (n, 2) array_like, or mapping of str to (n, 2) array_like
        At most 24 points, about a unit in size; or several such clouds by name, of which the reader chooses.

    Raises
    ------
    ValueError
        When there is no cloud.
    """
    clouds, many = shapes(points, MOST_NUDGED)
    data = {"shapes": clouds, "reaches": list(REACHES)}
    title, scripts = f"Loop of {many} points, nudged", ("rips.js", "planar.js", "places.js")
    return framed("nudge", scripts, data, 480, "nudge a point, or drag one", title)


def stray(points: ArrayLike, start: ArrayLike, end: ArrayLike) -> Framed:
    """Return an interactive figure of two rules that tell which bars are loops, and of a stray point that spoils one of them.

    Beside the cloud stand its bars, each with the mark that the bar of a loop must reach: by the rule of ``SeqPH.paper()``, on
    all points, and by the evidence of `topokit.SeqPH` in one frame, on those that are not alone. Any point can be dragged.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 59 points. Radii, births and deaths are in their unit.
    start, end : (2,) array_like
        Where the stray point is at first, and where the slider and the play button take it.
    """
    cloud = planar(points, "points", MOST_POINTS - 1)
    ends = {"start": start, "end": end}
    way = {name: planar(np.asarray(place)[None], name, 1)[0].tolist() for name, place in ends.items()}
    title, scripts = f"{len(cloud)} points and a stray one", ("rips.js", "planar.js", "places.js", "rules.js")
    return framed("stray", scripts, {"points": cloud.tolist(), **way}, 480, "drag the stray point away", title)


def mixture(points: ArrayLike, border: int) -> Framed:
    """Return an interactive figure of the mixture of a planar cloud's longest-lived loop, as `topokit.loop_mixture` makes it.

    Sliders take the killer triangles alone or neighbours too, and change the noise; any point can be dragged. Charts show the
    density along the border of the opening and a reliability diagram of its points; dashed is one Gaussian of the same moments.

    Parameters
    ----------
    points : (n, 2) array_like
        At most 60 points, metres.
    border : int
        How many of them, the first ones, are the border of the true opening, in order.
    """
    cloud = planar(points, "points", MOST_POINTS)
    data = {"points": cloud.tolist(), "border": whole(border, "border", 3, len(cloud))}
    return framed("mixture", ("rips.js", "planar.js"), data, 480, "drag a point", f"Mixture of {len(cloud)} points")


def linked(curve: ArrayLike, line: ArrayLike, way: ArrayLike) -> Framed:
    """Return an interactive figure of a closed curve on its way to a hook, with their crossings, linking number and distance.

    Parameters
    ----------
    curve, line, way : (n, 3), (m, 3), (k, 3) array_like
        Handles that the reader drags; corners of an open line, which `topokit.linking.close_far` closes; and how far the
        curve is moved, from the left end of a slider to the right. At most 24 each.

    Raises
    ------
    ValueError
        When they are more, or less than two shifts, or curve and line touch.
    """
    handles, corners, shifts = as_points(curve, "curve"), close_far(line), as_points(way, "way")
    if shifts.shape[1] != 3 or len(shifts) < 2 or max(map(len, (handles, corners[4:], shifts))) > MOST_NUDGED:
        wrong = f"not {len(handles)}, {len(corners) - 4} and {shifts.shape}"
        raise ValueError(f"curve, line and way must have at most {MOST_NUDGED} rows, and way (2, 3) at least, {wrong}")
    title = f"A curve and a hook, linking number {linking_number(handles, corners)}"
    data = {"curve": handles.tolist(), "line": corners.tolist(), "way": shifts.tolist()}
    return framed("linked", ("link.js", "planar.js"), data, 480, "drag a handle, or turn the view", title)


def shapes(points: ArrayLike | Mapping[str, ArrayLike], most: int) -> tuple[dict[str, list[list[float]]], str]:
    """Clouds of the plane by name, and how many points they have, in words; or ValueError."""
    given = points if isinstance(points, Mapping) else {"points": points}
    clouds = {str(name): planar(cloud, str(name), most).tolist() for name, cloud in given.items()}
    if not clouds:
        raise ValueError("points names no cloud; give at least one")
    return clouds, " or ".join(str(len(cloud)) for cloud in clouds.values())


def planar(points: ArrayLike, name: str, most: int | None = None) -> NDArray[np.float64]:
    """A cloud of the plane with 1 to `most` points, every digit kept, since ties must stay ties; or ValueError."""
    cloud = as_points(points, name)
    if cloud.shape[1] != 2:
        raise ValueError(f"{name} must lie in the plane, not in {cloud.shape[1]} dimensions; choose two of them")
    if most and not 1 <= len(cloud) <= most:
        raise ValueError(f"{name} must be 1 to {most} points, not {len(cloud)}; see topokit.farthest_point_sample")
    return cloud
