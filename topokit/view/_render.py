"""Shaded pictures of a cloth and its loops, still or as a film, by PyVista; by Matplotlib where PyVista cannot draw.

Without the system's OpenGL, VTK does not raise an error but ends the process. So a process of its own finds out once whether
PyVista can draw.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from topokit._archive import atomic_file
from topokit._validate import Array
from topokit.io import Episode
from topokit.seqph import Loop, TopologicalState
from topokit.view._looks import loop_colour
from topokit.view._plots import (
    CLOTH,
    INK,
    LINING,
    ROD,
    Scene,
    check_one_state_a_frame,
    direction,
    draw_cloth,
)

_PROBE = """
import sys
sys.path[:] = filter(None, sys.path)  # files in the working directory are not imported
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(32, 32))
plotter.add_mesh(pyvista.Sphere(), color="black")
assert plotter.screenshot(None, return_img=True).min() < 128
"""
# In this environment VTK opens no window: EGL on Linux without a display.
_NO_SCREEN = sys.platform.startswith("linux") and not os.environ.get("DISPLAY")
_WINDOW = {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"} if _NO_SCREEN else {}
_STEEL = "#7F91A5"
_GLOSS = {"specular": 0.5, "specular_power": 22}
# degrees to the right of the eye and above it, colour, strength
_LAMPS = ((-45, 40, "#FFF6E5", 0.72), (55, 10, "#E6F0FF", 0.35), (170, 30, "white", 0.25))


@functools.cache
def pyvista_works() -> tuple[bool, str]:
    """Return True if PyVista can draw on this machine, and else the missing package; computed once a process."""
    if find_spec("pyvista") is None:
        return False, "PyVista is not installed: pip install 'topokit[view]'"
    command = [sys.executable, "-c", _PROBE]
    try:
        subprocess.run(command, env=os.environ | _WINDOW, capture_output=True, timeout=180, check=True)
    except (OSError, subprocess.SubprocessError):
        return False, "PyVista cannot draw without OpenGL; on Debian or Ubuntu: apt-get install libegl1 libgl1-mesa-dri"
    return True, "PyVista draws"


def render_cloth(
    points: ArrayLike, faces: ArrayLike, *, size: tuple[int, int] = (900, 700), **scene: Any
) -> Image.Image:
    """Return a shaded picture of a cloth with the killer triangles of its loops, as an RGB image of Pillow.

    Where PyVista cannot draw, `plot_cloth` makes the picture, and one line on stderr names the package to install.

    Parameters
    ----------
    points, faces : (N, 3) and (F, 3) array_like
        Vertices and triangles, as in `Scene`.
    size : (2,) int
        Width and height in pixels.
    **scene
        The other parameters of `Scene`.
    """
    checked = Scene(points, faces, **scene)
    works, reason = pyvista_works()
    if works:
        return Image.fromarray(_by_pyvista(checked, size))
    _tell(reason)
    return Image.fromarray(_by_matplotlib(checked, size))


def save_animation(
    path: str | Path,
    episode: Episode,
    states: Sequence[TopologicalState] = (),
    *,
    every: int = 2,
    size: tuple[int, int] = (420, 520),
    **scene: Any,
) -> Path:
    """Render an episode and write it as an animated GIF, for a README or a slide.

    Parameters
    ----------
    path : str or Path
        Name of the file, which ends in .gif.
    episode : Episode
        The cloth is drawn, and the target by its centre line where there are no rods.
    states : sequence of TopologicalState, optional
        States of all frames, as `topokit.track` returns them; their killer triangles are drawn.
    every : int
        Step between drawn frames.
    size : (2,) int
        Width and height in pixels.
    **scene
        The rods, view, zoom and focus of `Scene`.

    Raises
    ------
    ValueError
        When `path` does not end in .gif, `every` is not a positive whole number, or there is not one state for each frame.
    """
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise ValueError(f"{path}: an animation ends in .gif")
    if every != int(every) or every < 1:
        raise ValueError(f"every must be a whole number of frames, 1 or more, not {every}")
    if states:
        check_one_state_a_frame(episode, states)
    corners = np.concatenate([episode.points.reshape(-1, 3), episode.centre_line])
    scene.setdefault("focus", (corners.min(axis=0) + corners.max(axis=0)) / 2)  # the camera does not move
    scene |= {"true_loops": episode.loops, "centre_line": episode.centre_line, "rest": episode.points[0]}
    pictures = []
    for frame in range(0, len(episode), int(every)):
        loops = states[frame].loops if states else ()
        picture = render_cloth(episode.points[frame], episode.faces, size=size, loops=loops, **scene)
        pictures.append(picture.quantize(160, Image.Quantize.FASTOCTREE))  # a median cut loses small patches of colour
    pause = max(20, round(1000 * episode.dt * every))  # milliseconds; browsers slow down shorter pauses
    options: dict[str, Any] = {"save_all": True, "duration": pause, "loop": 0, "optimize": True}
    with atomic_file(path) as file:
        pictures[0].save(file, format="GIF", append_images=pictures[1:], **options)
    return path


@functools.cache
def _tell(reason: str) -> None:
    print(f"topokit.view: a plainer picture by Matplotlib. {reason}", file=sys.stderr)


def _by_matplotlib(scene: Scene, size: tuple[int, int]) -> NDArray[np.uint8]:
    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
    canvas: Any = FigureCanvasAgg(figure)
    draw_cloth(figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d"), scene)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


@functools.cache
def _pyvista() -> Any:
    """Import PyVista on first use; the import takes a second."""
    with warnings.catch_warnings():
        # Notebooks without ipywidgets would show this warning, and no picture has a progress bar.
        warnings.filterwarnings("ignore", "IProgress not found")
        import pyvista
    return pyvista


def _by_pyvista(scene: Scene, size: tuple[int, int]) -> NDArray[np.uint8]:
    os.environ.update(_WINDOW)
    pyvista = _pyvista()
    plotter = pyvista.Plotter(off_screen=True, window_size=list(size), lighting="none")
    plotter.set_background("#DCE3EA", top="#FFFFFF")
    extent = float(np.ptp(scene.points, axis=0).max(initial=0.0)) or 1.0

    # Draw cloth, target, true loops and killers.
    _add_cloth(plotter, scene)
    for line, radius in scene.capsules:
        _add_tube(plotter, line, radius, _STEEL, **_GLOSS)
        for end in line[[0, -1]]:
            ball = pyvista.Sphere(radius=radius, center=end, theta_resolution=24, phi_resolution=24)
            plotter.add_mesh(ball, color=_STEEL, smooth_shading=True, ambient=0.35, **_GLOSS)
    for cycle in scene.cycles:
        _add_tube(plotter, cycle, 0.0035 * extent, INK)
    for loop in scene.loops:
        _add_loop(plotter, loop, extent, direction(*scene.view))

    # lamps and camera
    for turn, lift, colour, strength in _LAMPS:
        place = 10 * direction(scene.view[0] + turn, scene.view[1] + lift)
        plotter.add_light(pyvista.Light(position=place, light_type="scene light", color=colour, intensity=strength))
    _place_camera(plotter, scene, size)
    plotter.enable_anti_aliasing("ssaa")
    image: NDArray[np.uint8] = plotter.screenshot(None, return_img=True)
    plotter.close()
    return np.ascontiguousarray(image[..., :3])


def _place_camera(plotter: Any, scene: Scene, size: tuple[int, int]) -> None:
    """Place the camera so that everything just fits, in parallel projection."""
    eye = direction(*scene.view)
    right = direction(scene.view[0] + 90, 0.0)
    axes = np.stack([right, np.cross(eye, right), eye])
    flat = scene.everything @ axes.T
    middle = scene.focus
    if middle is None:
        middle = (flat.min(axis=0) + flat.max(axis=0)) / 2 @ axes
    width, height, depth = np.ptp(flat, axis=0)
    plotter.camera_position = [middle + 2 * (depth + width + height) * eye, middle, axes[1]]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = 0.54 * max(height, width * size[1] / size[0], 1e-9) / scene.zoom
    plotter.reset_camera_clipping_range()


def _add_cloth(plotter: Any, scene: Scene) -> None:
    pyvista = _pyvista()
    if not len(scene.faces):
        plotter.add_mesh(pyvista.PolyData(scene.points), color=ROD, point_size=7, render_points_as_spheres=True)
        return
    mesh = pyvista.PolyData.from_regular_faces(scene.points, scene.faces)
    # VTK draws a face black where its order of vertices and its normals disagree about the front, so both are computed
    # anew. Normals are smooth, but not across a sharp fold.
    mesh = mesh.compute_normals(split_vertices=True, feature_angle=70)
    inside = {"color": LINING, "ambient": 0.4}
    plotter.add_mesh(mesh, color=CLOTH, smooth_shading=True, ambient=0.46, backface_params=inside)
    # check and seams lie a little nearer to the eye than their faces
    lift = 0.003 * float(np.ptp(scene.points, axis=0).max()) * direction(*scene.view)
    for face, ends, bright in scene.marks:
        lines = pyvista.line_segments_from_points((ends @ scene.points[scene.faces[face]] + lift).reshape(-1, 3))
        plotter.add_mesh(lines, color="black", opacity=1 - bright, line_width=2, lighting=False)
    for ring in scene.shadow:
        plotter.add_mesh(pyvista.PolyData(ring).delaunay_2d(), color="black", opacity=scene.darkness, lighting=False)


def _add_tube(plotter: Any, line: Array, radius: float, colour: str, **look: float) -> None:
    wall = _pyvista().lines_from_points(line).tube(radius=radius, n_sides=20, capping=True)
    wall = wall.compute_normals(auto_orient_normals=True, split_vertices=True, feature_angle=60)
    plotter.add_mesh(wall, color=colour, smooth_shading=True, ambient=0.35, **look)


def _add_loop(plotter: Any, loop: Loop, extent: float, eye: Array) -> None:
    """Draw the killer triangles as panes, a little nearer to the eye so that cloth they touch does not show through."""
    colour = loop_colour(loop.id)
    lift = 0.004 * extent * eye
    for triangle in loop.killer_triangles:
        pane = _pyvista().PolyData.from_regular_faces(triangle + lift, [[0, 1, 2]])
        plotter.add_mesh(pane, color=colour, opacity=0.5, lighting=False)
        _add_tube(plotter, np.vstack([triangle, triangle[:1]]) + lift, 0.002 * extent, colour)
    _add_tube(plotter, loop.killer_edge_points + lift, 0.007 * extent, colour)
