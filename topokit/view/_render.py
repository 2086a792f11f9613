"""The best still picture of a cloth and its loops, by PyVista; by Matplotlib where PyVista cannot draw.

Without the system's OpenGL, VTK does not raise: it ends the process. So whether it can draw is found out once, in a
process of its own.
"""

from __future__ import annotations

import functools
import importlib
import os
import subprocess
import sys
import warnings
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import as_points
from topokit.state import Loop
from topokit.view._geometry import as_faces, as_line
from topokit.view._palette import loop_colour

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["pyvista_works", "render_cloth"]

_PROBE = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(32, 32))
plotter.add_mesh(pyvista.Sphere(), color="black")
assert plotter.screenshot(None, return_img=True).min() < 128
"""
_PACKAGES = "apt-get install libegl1 libgl1-mesa-dri"
_told: set[str] = set()


@functools.cache
def pyvista_works() -> tuple[bool, str]:
    """Return whether PyVista can draw on this machine, and what to do when it cannot. Found out once a process.

    Examples
    --------
    >>> works, reason = pyvista_works()
    >>> isinstance(works, bool) and bool(reason)
    True
    """
    if find_spec("pyvista") is None:
        return False, "PyVista is not installed: pip install 'topokit[view]'"
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE], env=os.environ | _window(), capture_output=True, text=True, timeout=180
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return False, f"PyVista did not answer ({type(error).__name__}); on Debian or Ubuntu: {_PACKAGES}"
    if done.returncode:
        return False, f"PyVista cannot draw without the system's OpenGL; on Debian or Ubuntu: {_PACKAGES}"
    return True, "PyVista draws"


def render_cloth(
    points: ArrayLike,
    faces: ArrayLike,
    *,
    loops: Iterable[Loop] = (),
    true_loops: Sequence[ArrayLike] = (),
    centre_line: ArrayLike | None = None,
    rods: Iterable[tuple[ArrayLike, ArrayLike, float]] = (),
    thickness: float = 0.01,
    size: tuple[int, int] = (900, 700),
    view: tuple[float, float] = (-60.0, 15.0),
    zoom: float = 1.0,
    focus: ArrayLike | None = None,
) -> Image:
    """Return a shaded picture of a cloth with the killer triangles of its loops.

    Where PyVista cannot draw the picture is `plot_cloth`'s, and one line on stderr says what to install.

    Parameters
    ----------
    points : (N, 3) array_like
        Metres, z up.
    faces : (F, 3) array_like of int
    loops : iterable of Loop
        Killer triangles as translucent panes in the colour of the identity, the killer edge as a tube.
    true_loops : sequence of (L,) array_like of int
        Closed cycles of vertex ids, drawn as dark tubes.
    centre_line : (K, 3) array_like, optional
        The target's, drawn as a rod of radius `thickness`; not drawn where there are `rods`.
    rods : iterable of (start, end, radius)
        The target's capsules (`Target.rods`), metres.
    size : (2,) int
        Width and height in pixels.
    view : (2,) float
        Azimuth and elevation of the eye in degrees.
    zoom : float
        Above one comes nearer than the fit around everything.
    focus : (3,) array_like, optional
        The point in the middle of the picture; the middle of everything when not given.

    Returns
    -------
    PIL.Image.Image
        RGB, of the size asked for; a notebook shows it, `numpy.asarray` gives its pixels.

    Raises
    ------
    ValueError
        When `points`, `faces` or `centre_line` is not of its kind.
    """
    from PIL import Image

    cloud = as_points(points)
    parts: dict[str, Any] = {"loops": list(loops), "true_loops": true_loops, "thickness": thickness, "view": view}
    parts["centre_line"] = as_line(centre_line, "centre_line")
    parts["rods"] = [
        (as_line(np.array([start, end], dtype=np.float64), "rods"), float(radius)) for start, end, radius in rods
    ]
    triangles = as_faces(faces, len(cloud))
    works, reason = pyvista_works()
    if not works and reason not in _told:
        _told.add(reason)
        print(f"topokit.view: a plainer picture by Matplotlib. {reason}", file=sys.stderr)
    draw = _by_pyvista if works else _by_matplotlib
    return Image.fromarray(draw(cloud, triangles, size=size, zoom=zoom, focus=focus, **parts))


def _window() -> dict[str, str]:
    """The environment in which VTK opens no window: EGL on Linux without a display."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        return {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}
    return {}


@functools.cache
def _pyvista() -> Any:
    """PyVista, imported on first use: it takes a second, and only `_by_pyvista` may assume that it can draw."""
    with warnings.catch_warnings():
        # Notebooks without ipywidgets would show it, and no picture has a progress bar.
        warnings.filterwarnings("ignore", "IProgress not found")
        return importlib.import_module("pyvista")


def _by_matplotlib(
    cloud: NDArray[np.float64],
    faces: NDArray[np.int64],
    *,
    size: tuple[int, int],
    rods: list[tuple[NDArray[np.float64], float]],
    **parts: Any,
) -> NDArray[np.uint8]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from topokit.view._plots import plot_cloth

    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
    canvas: Any = FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
    if rods:
        parts["centre_line"] = None
    plot_cloth(cloud, faces, ax=axes, **parts)
    for line, _ in rods:
        axes.plot(*line.T, color="#7F91A5", linewidth=6, solid_capstyle="round")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _by_pyvista(
    cloud: NDArray[np.float64],
    faces: NDArray[np.int64],
    *,
    loops: list[Loop],
    true_loops: Sequence[ArrayLike],
    centre_line: NDArray[np.float64],
    rods: list[tuple[NDArray[np.float64], float]],
    thickness: float,
    size: tuple[int, int],
    view: tuple[float, float],
    zoom: float,
    focus: ArrayLike | None,
) -> NDArray[np.uint8]:
    os.environ.update(_window())
    pyvista = _pyvista()

    plotter = pyvista.Plotter(off_screen=True, window_size=list(size), lighting="none")
    plotter.set_background("#DCE3EA", top="#FFFFFF")
    eye = _direction(*view)
    extent = float(np.ptp(cloud, axis=0).max(initial=0.0)) or 1.0
    if len(faces):
        # Normals first, so that triangles and normals agree about the front: a face where they do not is drawn black.
        mesh = pyvista.PolyData.from_regular_faces(cloud, faces).compute_normals(split_vertices=False)
        back = {"color": "#CFD2E0", "ambient": 0.42}
        plotter.add_mesh(mesh, color="#F3EDE0", smooth_shading=True, specular=0.0, ambient=0.42, backface_params=back)
    else:
        plotter.add_mesh(pyvista.PolyData(cloud), color="#5B6B7C", point_size=7, render_points_as_spheres=True)
    for line, radius in rods:
        _add_capsule(plotter, line, radius)
    if len(centre_line) > 1 and not rods:
        _add_tube(plotter, centre_line, thickness, "#7F91A5", specular=0.6, specular_power=25)
    for ids in true_loops:
        cycle = np.asarray(ids, dtype=np.int64)
        _add_tube(plotter, cloud[np.append(cycle, cycle[:1])], 0.0035 * extent, "#1C2733")
    for loop in loops:
        _add_loop(plotter, loop, extent, eye)
    _light(plotter, view)
    _look(plotter, np.concatenate([cloud, centre_line, *(line for line, _ in rods)]), view, size, zoom, focus)
    plotter.enable_anti_aliasing("ssaa")
    image: NDArray[np.uint8] = plotter.screenshot(None, return_img=True)
    plotter.close()
    return np.ascontiguousarray(image[..., :3])


def _direction(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Unit vector towards an eye at these degrees."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _look(
    plotter: Any,
    everything: NDArray[np.float64],
    view: tuple[float, float],
    size: tuple[int, int],
    zoom: float,
    focus: ArrayLike | None,
) -> None:
    """Put the eye so that everything just fits, in parallel projection: near and far are drawn to one scale."""
    eye = _direction(*view)
    right = _direction(view[0] + 90, 0.0)
    axes = np.stack([right, np.cross(eye, right), eye])
    seen = everything @ axes.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2 if focus is None else axes @ np.asarray(focus)
    width, height, depth = np.ptp(seen, axis=0)
    plotter.camera.position = middle @ axes + 2 * (depth + width + height) * eye
    plotter.camera.focal_point = middle @ axes
    plotter.camera.up = axes[1]
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = 0.54 * max(height, width * size[1] / size[0], 1e-9) / zoom
    plotter.reset_camera_clipping_range()


def _light(plotter: Any, view: tuple[float, float]) -> None:
    """A warm lamp over the left shoulder, a weak cool one from the right, a little from behind."""
    pyvista = _pyvista()
    for turn, lift, colour, strength in (
        (-45, 40, "#FFF6E5", 0.85),
        (55, 10, "#E6F0FF", 0.35),
        (170, 30, "white", 0.25),
    ):
        position = 10 * _direction(view[0] + turn, view[1] + lift)
        plotter.add_light(pyvista.Light(position=position, light_type="scene light", color=colour, intensity=strength))


def _add_tube(plotter: Any, line: NDArray[np.float64], radius: float, colour: str, **look: float) -> None:
    rod = _pyvista().lines_from_points(line).tube(radius=radius, n_sides=20, capping=True)
    rod = rod.compute_normals(auto_orient_normals=True, split_vertices=True, feature_angle=60)
    plotter.add_mesh(rod, color=colour, smooth_shading=True, ambient=0.35, **look)


def _add_capsule(plotter: Any, line: NDArray[np.float64], radius: float) -> None:
    _add_tube(plotter, line, radius, "#7F91A5", specular=0.4, specular_power=20)
    for end in line:
        ball = _pyvista().Sphere(radius=radius, center=end, theta_resolution=24, phi_resolution=24)
        plotter.add_mesh(ball, color="#7F91A5", smooth_shading=True, ambient=0.35, specular=0.4, specular_power=20)


def _add_loop(plotter: Any, loop: Loop, extent: float, eye: NDArray[np.float64]) -> None:
    """The killer triangles as panes, raised a little towards the eye so that cloth they touch does not show through."""
    pyvista = _pyvista()
    colour, lift = loop_colour(loop.id), 0.004 * extent * eye
    for triangle in loop.killer_triangles:
        pane = pyvista.PolyData.from_regular_faces(triangle + lift, [[0, 1, 2]])
        plotter.add_mesh(pane, color=colour, opacity=0.5, lighting=False)
        _add_tube(plotter, np.vstack([triangle, triangle[:1]]) + lift, 0.002 * extent, colour)
    _add_tube(plotter, loop.killer_edge_points + lift, 0.007 * extent, colour)
