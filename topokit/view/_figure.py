"""Interactive figures as HTML pages that need no kernel.

Idea: a page holds its data beside scripts without dependencies, and the browser gets it as the `srcdoc` of an iframe. So a
figure works the same in Jupyter, on a built page and as a file, and it asks nothing of the network.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._archive import atomic_file

from ._looks import cloth_marks, loop_colour

_PARTS = Path(__file__).parent


@dataclass(frozen=True, repr=False)
class HtmlFigure:
    """An interactive figure; the last value of a notebook cell shows it."""

    page: str  #: the whole HTML page with its data and its scripts
    height: int  #: height of the frame in CSS pixels; a narrow page stacks the parts and needs more
    title: str  #: the name of the frame for readers who hear the page

    @classmethod
    def from_parts(
        cls,
        name: str,
        data: Mapping[str, Any],
        *,
        height: int,
        caption: str,
        title: str,
        scripts: Sequence[str] = (),
        folder: Path | None = None,
    ) -> HtmlFigure:
        """Return the figure `name`: `name`.html, `name`.js, `name`.css where there is one, and what all figures share.

        Parameters
        ----------
        name : str
        data : mapping
            JSON values and NumPy arrays for the script, which reads the arrays by its function `unpack`.
        height : int
            Height of the frame in CSS pixels.
        caption, title : str
            The text in the corner of the figure, and the name of the frame.
        scripts : sequence of str
            Files that must run before `name`.js, in order.
        folder : Path, optional
            The folder of the files; those that are not there come from topokit.view, as all do by default.
        """
        folder = _PARTS if folder is None else folder
        data = {**data, "height": int(height), "title": caption, "palette": [loop_colour(k) for k in range(6)]}
        encoded = json.dumps(data, separators=(",", ":"), default=_packed)
        code = "\n".join(_code_lines(folder, ["frame.js", *scripts, f"{name}.js"]))
        parts = {
            "NAME": name,
            "STYLE": _text(folder, "frame.css") + _text(folder, f"{name}.css", missing=""),
            "PARTS": _text(folder, f"{name}.html"),
            "SCRIPT": f"(() => {{\n{code}\n}})();",
            "DATA": encoded.replace("<", "\\u003c"),  # "</script>" and "<!--" in a script element are markup
        }
        page = _text(folder, "frame.html")
        for part, text in parts.items():
            page = page.replace(f"__{part}__", text)
        return cls(page, height, title)

    @staticmethod
    def cloth(points: ArrayLike, faces: ArrayLike, loops: Iterable[ArrayLike] = ()) -> dict[str, Any]:
        """Return the data of a cloth for `mesh.js`, for a figure in which the reader turns it.

        Parameters
        ----------
        points : (T, N, 3) array_like
            The vertices in every frame, metres, z up.
        faces : (F, 3) array_like of int
            The triangles.
        loops : iterable of (L,) array_like of int
            The true loops, as closed cycles of vertex ids.
        """
        vertices = np.asarray(points, dtype=np.float64)
        corners = np.reshape(faces, (-1, 3)).astype(np.int64)
        low = vertices.min(axis=(0, 1))
        high = vertices.max(axis=(0, 1))
        marks = cloth_marks(vertices[0], corners, smooth=True)
        return {
            "frames": len(vertices),
            "points": pack_coordinates(vertices),
            "faces": corners,
            "centre": ((low + high) / 2).tolist(),
            "radius": float(np.linalg.norm(high - low) / 2) or 1.0,
            "marks": [{"face": face, "ends": pack_coordinates(ends), "bright": bright} for face, ends, bright in marks],
            "truth": [np.asarray(loop).tolist() for loop in loops],
        }

    def _repr_html_(self) -> str:
        source = html.escape(self.page, quote=True)
        title = html.escape(self.title)
        style = f"width:100%;height:{self.height}px;border:0;display:block"
        return f'<iframe srcdoc="{source}" title="{title}" loading="lazy" allowfullscreen style="{style}"></iframe>'

    def save(self, path: str | Path) -> Path:
        """Write the figure as one HTML file that opens in any browser, and return its path."""
        with atomic_file(path) as file:
            file.write(self.page.encode())
        return Path(path)


def _text(folder: Path, file: str, missing: str | None = None) -> str:
    """Return the text of a file of a folder, or else of this package."""
    path = folder / file
    if not path.exists():
        path = _PARTS / file
    if missing is not None and not path.exists():
        return missing
    return path.read_text(encoding="utf-8")


def _code_lines(folder: Path, scripts: Sequence[str]) -> Iterator[str]:
    """Yield the lines of scripts without indentation and without lines that are comments."""
    for script in scripts:
        lines = map(str.strip, _text(folder, script).splitlines())
        yield from (line for line in lines if line and not line.startswith("//"))


# ---- arrays in JSON ------------------------------------------------------------------------------------------------


def _packed(array: object) -> dict[str, Any]:
    """Return an array as JSON values: its bytes in base64, little-endian, in the smallest type that scripts read."""
    if not isinstance(array, np.ndarray):
        raise TypeError(f"a page holds JSON values and arrays, not {type(array).__name__}")
    if array.dtype.kind == "f":
        kind = "f4"
    elif array.dtype.kind == "b":
        kind = "u1"
    elif array.min(initial=0) >= 0 and array.max(initial=0) < 2**16:
        kind = "u2"
    else:
        kind = "i4"
    values = np.ascontiguousarray(array, dtype=f"<{kind}")
    return {"type": kind, "shape": list(array.shape), "values": base64.b64encode(values.tobytes()).decode("ascii")}


def pack_coordinates(points: NDArray[np.floating[Any]]) -> dict[str, Any]:
    """Return (..., 3) coordinates in 16 bits with one scale for the three axes; the error is at most half the scale."""
    points = np.asarray(points, dtype=np.float64)
    low = points.reshape(-1, 3).min(axis=0) if points.size else np.zeros(3)
    span = max(float((points - low).max(initial=0.0)), 1e-9)
    scale = span / (2**16 - 1)
    steps = np.round((points - low) / scale).astype(np.uint16)
    return {**_packed(steps), "scale": scale, "low": low.tolist()}
